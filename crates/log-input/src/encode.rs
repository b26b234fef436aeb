//! Encodes pixels as JPEG, and makes the image in a frame's message smaller.

use std::sync::Arc;

use jpeg_encoder::{ColorType, Encoder, EncodingError};
use thiserror::Error;

use super::decode;
use realitysim_ros2::mcap_read::{Channel, LogMessage};
use realitysim_ros2::messages::{CompressedImage, Image, Message};

/// Why an image cannot be encoded.
#[derive(Debug, Error)]
pub enum EncodeError {
    /// A side is longer than JPEG allows.
    #[error("{width} x {height} pixels are too many for a JPEG: 65535 x 65535 at most")]
    Size {
        /// Width, pixels.
        width: usize,
        /// Height, pixels.
        height: usize,
    },
    /// The encoder refuses the image.
    #[error("the frame does not encode: {0}")]
    Jpeg(#[from] EncodingError),
}

/// Encodes pixels as JPEG. The rows of `pixels` follow each other without gaps; `quality` is 1 to 100.
pub fn jpeg(
    pixels: &[u8],
    width: usize,
    height: usize,
    colour: ColorType,
    quality: u8,
) -> Result<Vec<u8>, EncodeError> {
    let side = |pixels: usize| u16::try_from(pixels).map_err(|_| EncodeError::Size { width, height });
    // Few images need more than one byte for eight values.
    let mut data = Vec::with_capacity(pixels.len() / 8);
    Encoder::new(&mut data, quality).encode(pixels, side(width)?, side(height)?, colour)?;
    Ok(data)
}

/// Re-encodes the image of a message as JPEG of this quality, 1 to 100, on the same topic.
///
/// A raw image becomes a compressed one. `None` where the image does not decode or would not get smaller: it stays as it is.
pub fn as_jpeg(message: &LogMessage, quality: u8) -> Option<LogMessage> {
    let picture = decode::picture(message).ok()?;
    let header = match message.channel.type_name.as_str() {
        Image::TYPE => Image::decode(&message.data).ok()?.header,
        _ => CompressedImage::decode(&message.data).ok()?.header,
    };
    let data = jpeg(&picture.to_rgb(), picture.width, picture.height, ColorType::Rgb, quality).ok()?;
    let data = CompressedImage { header, format: "jpeg".to_owned(), data }.encode();
    let Channel { id, topic, metadata, .. } = message.channel.as_ref();
    let channel = Arc::new(Channel::of::<CompressedImage>(*id, topic, metadata.clone()));
    (data.len() < message.data.len()).then(|| LogMessage { channel, data, ..message.clone() })
}
