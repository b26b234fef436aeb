//! A frame's message with its image in fewer bytes.

use std::sync::Arc;

use super::decode;
use crate::ros2::mcap_read::{Channel, LogMessage};
use crate::ros2::messages::{CompressedImage, Image, Message};

/// As a JPEG of this quality, 1 to 100, on the same topic; a raw image becomes a compressed one. None of an image that
/// does not decode, or would not get smaller: it stays what it is.
pub fn as_jpeg(message: &LogMessage, quality: u8) -> Option<LogMessage> {
    let picture = decode::picture(message).ok()?;
    let header = match message.channel.type_name.as_str() {
        Image::TYPE => Image::decode(&message.data).ok()?.header,
        _ => CompressedImage::decode(&message.data).ok()?.header,
    };
    let [width, height] = [picture.width, picture.height].map(u16::try_from);
    let mut data = Vec::new();
    jpeg_encoder::Encoder::new(&mut data, quality)
        .encode(&picture.to_rgb(), width.ok()?, height.ok()?, jpeg_encoder::ColorType::Rgb)
        .ok()?;
    let data = CompressedImage { header, format: "jpeg".to_owned(), data }.encode();
    let Channel { id, topic, metadata, .. } = message.channel.as_ref();
    let channel = Arc::new(Channel::of::<CompressedImage>(*id, topic, metadata.clone()));
    (data.len() < message.data.len()).then(|| LogMessage { channel, data, ..message.clone() })
}
