//! sensor_msgs/CompressedImage and sensor_msgs/Image, owned and borrowed.

use serde::Serialize;

use super::message;
use super::time::Header;
use crate::cdr::{CdrError, CdrReader, CdrWriter, Wire, wire_struct};

wire_struct! {
    /// sensor_msgs/CompressedImage.
    #[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
    pub struct CompressedImage {
        /// `stamp` is the exposure, `frame_id` the optical frame (z forward, x right, y down).
        pub header: Header,
        /// `jpeg`, `png`, or `rgb8; jpeg compressed bgr8` as image_transport writes.
        pub format: String,
        pub data: Vec<u8>,
    }
}

wire_struct! {
    /// sensor_msgs/Image.
    #[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
    pub struct Image {
        /// `stamp` is the exposure, `frame_id` the optical frame (z forward, x right, y down).
        pub header: Header,
        /// Rows.
        pub height: u32,
        /// Columns.
        pub width: u32,
        /// `rgb8`, `mono8`, `yuv422_yuy2`, ...
        pub encoding: String,
        /// Not 0 if pixels of more than 8 bits are big-endian.
        pub is_bigendian: u8,
        /// Bytes from one row to the next.
        pub step: u32,
        /// `height` times `step` bytes.
        pub data: Vec<u8>,
    }
}

message!(CompressedImage is "sensor_msgs" / "CompressedImage", needs "std_msgs/Header", needs "builtin_interfaces/Time");
message!(Image is "sensor_msgs" / "Image", needs "std_msgs/Header", needs "builtin_interfaces/Time");

/// A [`CompressedImage`] whose pixels stay where they are.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CompressedImageView<'a> {
    pub header: Header,
    pub format: &'a str,
    pub data: &'a [u8],
}

/// An [`Image`] whose pixels stay where they are.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ImageView<'a> {
    pub header: Header,
    pub height: u32,
    pub width: u32,
    pub encoding: &'a str,
    pub is_bigendian: u8,
    pub step: u32,
    pub data: &'a [u8],
}

impl<'a> CompressedImageView<'a> {
    pub fn decode(bytes: &'a [u8]) -> Result<Self, CdrError> {
        let mut reader = CdrReader::new(bytes)?;
        let header = Header::read(&mut reader)?;
        let view = Self { header, format: reader.str()?, data: reader.bytes()? };
        reader.finish()?;
        Ok(view)
    }

    /// Replaces what the buffer holds.
    pub fn encode_into(&self, buffer: &mut Vec<u8>) {
        let mut writer = CdrWriter::new(buffer);
        self.header.write(&mut writer);
        writer.str(self.format);
        writer.bytes(self.data);
    }

    pub fn to_message(&self) -> CompressedImage {
        CompressedImage { header: self.header.clone(), format: self.format.to_owned(), data: self.data.to_vec() }
    }
}

impl<'a> ImageView<'a> {
    pub fn decode(bytes: &'a [u8]) -> Result<Self, CdrError> {
        let mut reader = CdrReader::new(bytes)?;
        let view = Self {
            header: Header::read(&mut reader)?,
            height: reader.u32()?,
            width: reader.u32()?,
            encoding: reader.str()?,
            is_bigendian: reader.u8()?,
            step: reader.u32()?,
            data: reader.bytes()?,
        };
        reader.finish()?;
        Ok(view)
    }

    /// Replaces what the buffer holds.
    pub fn encode_into(&self, buffer: &mut Vec<u8>) {
        let mut writer = CdrWriter::new(buffer);
        self.header.write(&mut writer);
        self.height.write(&mut writer);
        self.width.write(&mut writer);
        writer.str(self.encoding);
        self.is_bigendian.write(&mut writer);
        self.step.write(&mut writer);
        writer.bytes(self.data);
    }

    pub fn to_message(&self) -> Image {
        Image {
            header: self.header.clone(),
            height: self.height,
            width: self.width,
            encoding: self.encoding.to_owned(),
            is_bigendian: self.is_bigendian,
            step: self.step,
            data: self.data.to_vec(),
        }
    }
}
