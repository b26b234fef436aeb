//! Makes the message that is recorded of a frame: MJPEG as it came, raw pixels as they came or as a JPEG.

use jpeg_encoder::ColorType;

use super::{Frame, Negotiated, PixelFormat};
use realitysim_log_input::encode::{EncodeError, jpeg};
use realitysim_ros2::messages::{CompressedImage, Header, Image};

/// The message of a frame.
pub enum ImageMessage {
    /// A JPEG.
    Compressed(CompressedImage),
    /// Raw pixels.
    Raw(Image),
}

/// Makes the message of a frame.
///
/// `quality`, 1 to 100, is that of the JPEG which raw pixels become; with `None` they are recorded as they are. A Bayer image is
/// never turned into JPEG, which would mix its colours, and NV12 always is.
///
/// # Errors
/// If the image is too large for a JPEG.
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

/// Quality of a JPEG where none is wanted: NV12 always becomes a JPEG, because the usual tools cannot read it.
const LOSSLESS_ENOUGH: u8 = 98;

/// Returns ROS's name of a format that is recorded as raw pixels.
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

/// Removes the padding of the rows.
fn rows(data: &[u8], width: u32, height: u32, stride: u32) -> Vec<u8> {
    data.chunks(stride as usize).take(height as usize).flat_map(|row| &row[..width as usize]).copied().collect()
}

/// Converts Y0 U Y1 V, where two pixels share their chroma, into Y U V for each pixel.
fn yuyv(data: &[u8], width: u32, height: u32, stride: u32) -> Vec<u8> {
    let mut pixels = Vec::with_capacity(3 * width as usize * height as usize);
    for row in data.chunks(stride as usize).take(height as usize) {
        for quad in row[..2 * width as usize].chunks_exact(4) {
            pixels.extend([quad[0], quad[1], quad[3], quad[2], quad[1], quad[3]]);
        }
    }
    pixels
}

/// Converts a plane of Y and one of U V pairs, one for each two by two pixels, into Y U V for each pixel.
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
