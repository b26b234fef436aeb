//! The messages `sensor_msgs/CompressedImage` and `sensor_msgs/Image`, owned and borrowed.

use serde::Serialize;

use super::message;
use super::time::Header;
use crate::cdr::{CdrError, CdrReader, CdrWriter, Wire, wire_struct};

wire_struct! {
    /// `sensor_msgs/CompressedImage`: an image as a JPEG or PNG.
    #[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
    pub struct CompressedImage {
        /// `stamp` is the time of the exposure, `frame_id` the optical frame (z forward, x right, y down).
        pub header: Header,
        /// Format: `jpeg`, `png`, or `rgb8; jpeg compressed bgr8` as image_transport writes.
        pub format: String,
        /// Bytes of the JPEG or PNG.
        pub data: Vec<u8>,
    }
}

wire_struct! {
    /// `sensor_msgs/Image`: an image as raw pixels.
    #[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
    pub struct Image {
        /// `stamp` is the time of the exposure, `frame_id` the optical frame (z forward, x right, y down).
        pub header: Header,
        /// Height, pixels.
        pub height: u32,
        /// Width, pixels.
        pub width: u32,
        /// Pixel format: `rgb8`, `mono8`, `nv12`, ...
        pub encoding: String,
        /// Whether pixels of more than 8 bits are big-endian: 0 if not.
        pub is_bigendian: u8,
        /// Bytes from one row to the next.
        pub step: u32,
        /// Pixels, `height` times `step` bytes.
        pub data: Vec<u8>,
    }
}

message!(CompressedImage is "sensor_msgs" / "CompressedImage", needs "std_msgs/Header", needs "builtin_interfaces/Time");
message!(Image is "sensor_msgs" / "Image", needs "std_msgs/Header", needs "builtin_interfaces/Time");

/// A [`CompressedImage`] that borrows its bytes from the encoded message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CompressedImageView<'a> {
    /// `stamp` is the time of the exposure, `frame_id` the optical frame (z forward, x right, y down).
    pub header: Header,
    /// Format, as in [`CompressedImage::format`].
    pub format: &'a str,
    /// Bytes of the JPEG or PNG.
    pub data: &'a [u8],
}

/// An [`Image`] that borrows its pixels from the encoded message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ImageView<'a> {
    /// `stamp` is the time of the exposure, `frame_id` the optical frame (z forward, x right, y down).
    pub header: Header,
    /// Height, pixels.
    pub height: u32,
    /// Width, pixels.
    pub width: u32,
    /// Pixel format, as in [`Image::encoding`].
    pub encoding: &'a str,
    /// Whether pixels of more than 8 bits are big-endian: 0 if not.
    pub is_bigendian: u8,
    /// Bytes from one row to the next.
    pub step: u32,
    /// Pixels, `height` times `step` bytes.
    pub data: &'a [u8],
}

impl<'a> CompressedImageView<'a> {
    /// Decodes a message without copying its image.
    pub fn decode(bytes: &'a [u8]) -> Result<Self, CdrError> {
        let mut reader = CdrReader::new(bytes)?;
        let header = Header::read(&mut reader)?;
        let view = Self { header, format: reader.str()?, data: reader.bytes()? };
        reader.finish()?;
        Ok(view)
    }

    /// Encodes the message into a buffer, whose content it replaces.
    pub fn encode_into(&self, buffer: &mut Vec<u8>) {
        let mut writer = CdrWriter::new(buffer);
        self.header.write(&mut writer);
        writer.str(self.format);
        writer.bytes(self.data);
    }

    /// Copies the image into a message of its own.
    pub fn to_message(&self) -> CompressedImage {
        CompressedImage { header: self.header.clone(), format: self.format.to_owned(), data: self.data.to_vec() }
    }
}

impl<'a> ImageView<'a> {
    /// Decodes a message without copying its image.
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

    /// Encodes the message into a buffer, whose content it replaces.
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

    /// Copies the image into a message of its own.
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
