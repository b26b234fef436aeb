//! Decodes the image in a frame's message into a picture.

mod bayer;
mod raw;

use std::cell::Cell;

use image::error::{LimitError, LimitErrorKind};
use image::{DynamicImage, ImageDecoder};
use thiserror::Error;
use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;
use zune_jpeg::JpegDecoder;

use super::file_kind::{FileKind, START_BYTES};
pub use raw::{encodings, raw};
use realitysim_geometry::lens::{MAX_PIXELS, MAX_SIDE, is_image_size};
use realitysim_ros2::cdr::CdrError;
use realitysim_ros2::mcap_read::LogMessage;
use realitysim_ros2::messages::{CompressedImageView, ImageView};
use realitysim_vision::Picture;

/// Largest JPEG or PNG file that is read, bytes: no image of a camera comes near it.
pub const MAX_IMAGE_FILE_BYTES: u64 = 256 << 20;

/// Why an image cannot be decoded.
#[derive(Debug, Error)]
pub enum DecodeError {
    /// The bytes of the message are not those of its type.
    #[error("the message is not what its type says: {0}")]
    Message(#[from] CdrError),
    /// The type of the message is not that of an image.
    #[error("{type_name} holds no image: sensor_msgs/msg/CompressedImage or Image is needed")]
    Type {
        /// The type that the message has.
        type_name: String,
    },
    /// The JPEG is damaged or of a kind that is not supported; the decoder's reason.
    #[error("the JPEG does not decode: {0}")]
    Jpeg(String),
    /// The PNG is damaged or too large.
    #[error("the PNG does not decode: {0}")]
    Png(image::ImageError),
    /// The message is a depth image of the image transport `compressedDepth`.
    #[error("format {0:?} is a depth image: an image in colour or gray is needed, as JPEG or PNG")]
    Depth(String),
    /// The compressed image is of another format.
    #[error("the image is neither JPEG nor PNG, it is {0}")]
    Format(FileKind),
    /// The raw image has an encoding that is not supported.
    #[error("encoding {0:?}: the encodings that are read are {names}", names = raw::encoding_names())]
    Encoding(String),
    /// The raw image has an odd number of columns or rows, and its pixels share their chroma.
    #[error("{width} x {height} pixels of {encoding}: {needed}")]
    OddSize {
        /// Width, pixels.
        width: u32,
        /// Height, pixels.
        height: u32,
        /// Pixel encoding, as ROS names it.
        encoding: String,
        /// What would be right, in words.
        needed: &'static str,
    },
    /// The image is not of the wanted size.
    #[error("{} x {} pixels, where {} x {} are wanted", found[0], found[1], wanted[0], wanted[1])]
    OtherSize {
        /// Width and height of the image, pixels.
        found: [usize; 2],
        /// Width and height that are wanted, pixels.
        wanted: [usize; 2],
    },
    /// The image has more pixels than are decoded.
    #[error("{} x {} pixels: at most {MAX_PIXELS} are decoded", found[0], found[1])]
    TooLarge {
        /// Width and height of the image, pixels.
        found: [usize; 2],
    },
    /// The stated size of the image does not fit its bytes.
    #[error("{width} x {height} pixels of {encoding} with step {step} do not fit {bytes} bytes")]
    Size {
        /// Width, pixels.
        width: u32,
        /// Height, pixels.
        height: u32,
        /// Pixel encoding, as ROS names it.
        encoding: String,
        /// Length of a row, bytes.
        step: u32,
        /// Number of bytes that there are.
        bytes: usize,
    },
}

/// Decodes the image of a `CompressedImage` or `Image` message.
pub fn picture(message: &LogMessage) -> Result<Picture, DecodeError> {
    picture_if(message, &accept_any_possible)
}

/// Decodes the image of a message if it has the width and height `wanted`, pixels.
///
/// A header of a few bytes may claim a gigabyte of pixels, so an image of another size is refused before any pixel is decoded.
pub fn picture_of_size(message: &LogMessage, wanted: [usize; 2]) -> Result<Picture, DecodeError> {
    picture_if(message, &|found| if found == wanted { Ok(()) } else { Err(DecodeError::OtherSize { found, wanted }) })
}

/// Width and height that the image of a message states, pixels, without decoding it; `None` if they cannot be read or are impossible.
pub fn stated_size(message: &LogMessage) -> Option<[u32; 2]> {
    let stated = Cell::new(None);
    // What is read after the size does not matter: the image is refused in any case.
    let _ = picture_if(message, &|found| {
        stated.set(Some(found));
        Err(DecodeError::TooLarge { found })
    });
    let [width, height] = stated.get()?;
    accept_any_possible([width, height]).ok()?;
    Some([u32::try_from(width).ok()?, u32::try_from(height).ok()?])
}

/// Accepts every size that the project can work with.
fn accept_any_possible(found: [usize; 2]) -> Result<(), DecodeError> {
    let [width, height] = found.map(|side| side as u64);
    if is_image_size(width, height) { Ok(()) } else { Err(DecodeError::TooLarge { found }) }
}

/// Decides by width and height whether an image is decoded.
type Accept<'a> = &'a dyn Fn([usize; 2]) -> Result<(), DecodeError>;

fn picture_if(message: &LogMessage, accept: Accept) -> Result<Picture, DecodeError> {
    match message.channel.type_name.as_str() {
        "sensor_msgs/msg/CompressedImage" => {
            let image = CompressedImageView::decode(&message.data)?;
            // A depth image is a PNG as well, behind 12 bytes of its own or without them.
            if image.format.contains("compressedDepth") {
                return Err(DecodeError::Depth(image.format.to_owned()));
            }
            compressed_if(image.data, accept)
        }
        "sensor_msgs/msg/Image" => {
            let image = ImageView::decode(&message.data)?;
            accept([image.width as usize, image.height as usize])?;
            raw(&image)
        }
        other => Err(DecodeError::Type { type_name: other.to_owned() }),
    }
}

/// Returns the time of exposure of the frame in this message, nanoseconds.
pub fn stamp_ns(message: &LogMessage) -> Result<i64, DecodeError> {
    let header = match message.channel.type_name.as_str() {
        "sensor_msgs/msg/CompressedImage" => CompressedImageView::decode(&message.data)?.header,
        "sensor_msgs/msg/Image" => ImageView::decode(&message.data)?.header,
        other => return Err(DecodeError::Type { type_name: other.to_owned() }),
    };
    Ok(header.stamp.to_nanoseconds())
}

/// Decodes a JPEG or PNG. They are told apart by their first bytes, since `format` fields are not reliable.
pub fn compressed(data: &[u8]) -> Result<Picture, DecodeError> {
    compressed_if(data, &accept_any_possible)
}

/// Returns width and height of a JPEG or PNG by its header, pixels, without decoding it.
pub fn dimensions(data: &[u8]) -> Result<[usize; 2], DecodeError> {
    if data.starts_with(&[0xff, 0xd8]) {
        let (_, size) = jpeg_header(data)?;
        Ok(size)
    } else if data.starts_with(b"\x89PNG") {
        let (width, height) = png_header(data)?.dimensions();
        Ok([width as usize, height as usize])
    } else {
        Err(DecodeError::Format(FileKind::of(&data[..data.len().min(START_BYTES)])))
    }
}

fn compressed_if(data: &[u8], accept: Accept) -> Result<Picture, DecodeError> {
    if data.starts_with(&[0xff, 0xd8]) {
        jpeg(data, accept)
    } else if data.starts_with(b"\x89PNG") {
        png(data, accept)
    } else {
        Err(DecodeError::Format(FileKind::of(&data[..data.len().min(START_BYTES)])))
    }
}

/// Decodes a JPEG into luma and chroma as the file holds them, which saves the conversion to RGB and back.
fn jpeg(data: &[u8], accept: Accept) -> Result<Picture, DecodeError> {
    let (mut decoder, [width, height]) = jpeg_header(data)?;
    accept([width, height])?;
    let gray = decoder.input_colorspace() == Some(ColorSpace::Luma);
    let wanted = if gray { ColorSpace::Luma } else { ColorSpace::YCbCr };
    decoder.set_options(decoder.options().jpeg_set_out_colorspace(wanted));
    let pixels = decoder.decode().map_err(|error| bad_jpeg(&error.to_string()))?;
    let picture =
        if gray { Picture::from_gray(width, height, pixels) } else { Picture::from_ycbcr(width, height, &pixels) };
    picture.ok_or_else(|| bad_jpeg("its pixels do not fit its size"))
}

/// A decoder of a JPEG in memory.
type JpegReader<'a> = JpegDecoder<ZCursor<&'a [u8]>>;

/// A decoder that has read the headers of a JPEG, with width and height.
fn jpeg_header(data: &[u8]) -> Result<(JpegReader<'_>, [usize; 2]), DecodeError> {
    let limits = DecoderOptions::default()
        .set_max_width(MAX_SIDE as usize)
        .set_max_height(MAX_SIDE as usize)
        // A truncated image is refused instead of being filled up with gray.
        .set_strict_mode(true);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(data), limits);
    decoder.decode_headers().map_err(|error| bad_jpeg(&error.to_string()))?;
    let (width, height) = decoder.dimensions().ok_or_else(|| bad_jpeg("no size"))?;
    Ok((decoder, [width, height]))
}

/// Some messages of the decoder end in a newline.
fn bad_jpeg(message: &str) -> DecodeError {
    DecodeError::Jpeg(message.trim_end().to_owned())
}

/// Decodes a PNG, gray or in colour.
fn png(data: &[u8], accept: Accept) -> Result<Picture, DecodeError> {
    let bytes_allowed = png_limits().max_alloc;
    let decoder = png_header(data)?;
    let (width, height) = decoder.dimensions();
    let (width, height) = (width as usize, height as usize);
    accept([width, height])?;
    if bytes_allowed.is_some_and(|allowed| decoder.total_bytes() > allowed) {
        return Err(DecodeError::Png(image::ImageError::Limits(LimitError::from_kind(
            LimitErrorKind::InsufficientMemory,
        ))));
    }
    let image = DynamicImage::from_decoder(decoder).map_err(DecodeError::Png)?;
    let picture = if image.color().has_color() {
        Picture::from_rgb(width, height, image.to_rgb8().as_raw())
    } else {
        Picture::from_gray(width, height, image.into_luma8().into_raw())
    };
    picture.ok_or(DecodeError::Size {
        width: width as u32,
        height: height as u32,
        encoding: "PNG".to_owned(),
        step: 0,
        bytes: 0,
    })
}

/// A decoder that has read the header of a PNG.
fn png_header(data: &[u8]) -> Result<impl ImageDecoder, DecodeError> {
    let mut reader = image::ImageReader::with_format(std::io::Cursor::new(data), image::ImageFormat::Png);
    reader.limits(png_limits());
    reader.into_decoder().map_err(DecodeError::Png)
}

fn png_limits() -> image::Limits {
    let mut limits = image::Limits::default();
    (limits.max_image_width, limits.max_image_height) = (Some(MAX_SIDE), Some(MAX_SIDE));
    limits
}

#[cfg(test)]
mod tests;
