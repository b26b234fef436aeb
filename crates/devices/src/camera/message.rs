//! A frame as the message that is recorded: MJPEG as it came, raw pixels as they came or as a JPEG.

use jpeg_encoder::ColorType;

use super::{Frame, Negotiated, PixelFormat};
use realitysim_log_input::encode::{EncodeError, jpeg};
use realitysim_ros2::messages::{CompressedImage, Header, Image};

pub enum ImageMessage {
    Compressed(CompressedImage),
    Raw(Image),
}

/// `quality` of the JPEG of a raw camera; none records the pixels themselves. Gray and Bayer pixels are recorded as they are
/// either way when `quality` is none; a Bayer image is never turned into JPEG, which would mix its colours.
pub fn image_message(
    frame: Frame,
    camera: &Negotiated,
    quality: Option<u8>,
    header: Header,
) -> Result<ImageMessage, EncodeError> {
    let Negotiated { format, width, height, stride, .. } = *camera;
    if format == PixelFormat::Mjpeg {
        return Ok(ImageMessage::Compressed(CompressedImage { header, format: "jpeg".to_owned(), data: frame.data }));
    }
    let (pixels, colour) = match (format, quality) {
        (PixelFormat::Yuyv, Some(_)) => (yuyv(&frame.data, width, height, stride), ColorType::Ycbcr),
        (PixelFormat::Nv12, _) => (nv12(&frame.data, width, height, stride), ColorType::Ycbcr),
        (PixelFormat::Grey, Some(_)) => (rows(&frame.data, width, height, stride), ColorType::Luma),
        _ => {
            let (encoding, step) = (encoding(format), stride);
            let encoding = encoding.to_owned();
            let raw = Image { header, height, width, encoding, is_bigendian: 0, step, data: frame.data };
            return Ok(ImageMessage::Raw(raw));
        }
    };
    let quality = quality.unwrap_or(LOSSLESS_ENOUGH);
    let data = jpeg(&pixels, width as usize, height as usize, colour, quality)?;
    Ok(ImageMessage::Compressed(CompressedImage { header, format: "jpeg".to_owned(), data }))
}

/// NV12 has no reader among the usual tools: it becomes a JPEG in any case.
const LOSSLESS_ENOUGH: u8 = 98;

fn encoding(format: PixelFormat) -> &'static str {
    match format {
        PixelFormat::Mjpeg | PixelFormat::Nv12 => "",
        PixelFormat::Yuyv => "yuv422_yuy2",
        PixelFormat::Grey => "mono8",
        PixelFormat::BayerRggb => "bayer_rggb8",
        PixelFormat::BayerBggr => "bayer_bggr8",
        PixelFormat::BayerGbrg => "bayer_gbrg8",
        PixelFormat::BayerGrbg => "bayer_grbg8",
    }
}

fn rows(data: &[u8], width: u32, height: u32, stride: u32) -> Vec<u8> {
    data.chunks(stride as usize).take(height as usize).flat_map(|row| &row[..width as usize]).copied().collect()
}

/// Y0 U Y1 V: two pixels share their chroma.
fn yuyv(data: &[u8], width: u32, height: u32, stride: u32) -> Vec<u8> {
    let mut pixels = Vec::with_capacity(3 * width as usize * height as usize);
    for row in data.chunks(stride as usize).take(height as usize) {
        for quad in row[..2 * width as usize].chunks_exact(4) {
            pixels.extend([quad[0], quad[1], quad[3], quad[2], quad[1], quad[3]]);
        }
    }
    pixels
}

/// A plane of Y, then one of U V pairs for each two by two pixels.
fn nv12(data: &[u8], width: u32, height: u32, stride: u32) -> Vec<u8> {
    let (width, height, stride) = (width as usize, height as usize, stride as usize);
    let (luma, chroma) = data.split_at(stride * height);
    let mut pixels = Vec::with_capacity(3 * width * height);
    for (v, row) in luma.chunks(stride).take(height).enumerate() {
        let pairs = &chroma[stride * (v / 2)..];
        for (u, y) in row[..width].iter().enumerate() {
            pixels.extend([*y, pairs[u & !1], pairs[u | 1]]);
        }
    }
    pixels
}
