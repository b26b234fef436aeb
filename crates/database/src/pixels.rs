//! Decodes stored images in full colour. Pictures for the filter have half of the chroma, views need all of it.

use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

use image::{DynamicImage, ImageDecoder, ImageEncoder};
use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;
use zune_jpeg::JpegDecoder;

use super::record::{Form, Record};
use super::remote_files::reader_of;
use realitysim_config::plain_file;
use realitysim_geometry::lens::{MAX_PIXELS, MAX_SIDE, is_image_size};
use realitysim_log_input::decode;
use realitysim_ros2::messages::ImageView;

/// A decoded image.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Colours {
    pub(super) width: usize,
    pub(super) height: usize,
    /// Interleaved R, G, B, row by row.
    pub(super) rgb: Vec<u8>,
}

/// Largest stored image, bytes; no recorded frame comes near it.
const MAX_STORED_BYTES: u32 = 256 << 20;

/// Reads a part of a file of this machine.
pub(super) fn read_bytes(path: &Path, offset: u64, length: u32) -> io::Result<Vec<u8>> {
    if length > MAX_STORED_BYTES {
        return Err(io::Error::new(io::ErrorKind::InvalidData, format!("{length} bytes are no image")));
    }
    let mut file = plain_file::open(path)?;
    file.seek(SeekFrom::Start(offset))?;
    let mut bytes = Vec::new();
    file.take(u64::from(length)).read_to_end(&mut bytes)?;
    if bytes.len() == length as usize { Ok(bytes) } else { Err(io::ErrorKind::UnexpectedEof.into()) }
}

/// Reads the bytes of a record's image from its file, which may be a remote one.
pub(super) fn read_image(path: &Path, record: &Record) -> io::Result<Vec<u8>> {
    let Record { offset, length, crc, .. } = *record;
    match reader_of(path) {
        Some(_) if length > MAX_STORED_BYTES => {
            Err(io::Error::new(io::ErrorKind::InvalidData, format!("{length} bytes are no image")))
        }
        Some(files) => files.read(path, offset, length, crc),
        None => read_bytes(path, offset, length),
    }
}

/// The usual ending of a stored file's name: `png` or `jpg`.
pub(super) fn ending(bytes: &[u8]) -> &'static str {
    if bytes.starts_with(PNG_MAGIC) { "png" } else { "jpg" }
}

/// What a PNG begins with.
const PNG_MAGIC: &[u8] = b"\x89PNG";

/// The image as a PNG.
pub(super) fn png_of(colours: &Colours) -> Result<Vec<u8>, String> {
    let mut bytes = Vec::new();
    let encoder = image::codecs::png::PngEncoder::new(&mut bytes);
    let (width, height) = (colours.width as u32, colours.height as u32);
    let written = encoder.write_image(&colours.rgb, width, height, image::ExtendedColorType::Rgb8);
    written.map_err(|error| error.to_string())?;
    Ok(bytes)
}

/// Decodes an image. The error says what is wrong with the bytes.
pub(super) fn colours(bytes: &[u8], form: Form) -> Result<Colours, String> {
    match form {
        Form::RosImage => {
            let view = ImageView::decode(bytes).map_err(|error| error.to_string())?;
            let picture = decode::raw(&view).map_err(|error| error.to_string())?;
            Ok(Colours { width: picture.width, height: picture.height, rgb: picture.to_rgb() })
        }
        Form::File if bytes.starts_with(&[0xff, 0xd8]) => jpeg(bytes),
        Form::File => png(bytes),
    }
}

fn jpeg(bytes: &[u8]) -> Result<Colours, String> {
    let said = |error: zune_jpeg::errors::DecodeErrors| error.to_string().trim_end().to_owned();
    let options = DecoderOptions::default()
        .set_max_width(MAX_SIDE as usize)
        .set_max_height(MAX_SIDE as usize)
        .set_strict_mode(true)
        .jpeg_set_out_colorspace(ColorSpace::RGB);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    decoder.decode_headers().map_err(said)?;
    let (width, height) = decoder.dimensions().ok_or("no size")?;
    check_size(width as u64, height as u64)?;
    let rgb = decoder.decode().map_err(said)?;
    if rgb.len() == 3 * width * height { Ok(Colours { width, height, rgb }) } else { Err("not in colour".to_owned()) }
}

fn png(bytes: &[u8]) -> Result<Colours, String> {
    let mut reader = image::ImageReader::with_format(io::Cursor::new(bytes), image::ImageFormat::Png);
    let mut limits = image::Limits::default();
    (limits.max_image_width, limits.max_image_height) = (Some(MAX_SIDE), Some(MAX_SIDE));
    reader.limits(limits);
    let decoder = reader.into_decoder().map_err(|error| error.to_string())?;
    let (width, height) = decoder.dimensions();
    check_size(width.into(), height.into())?;
    let image = DynamicImage::from_decoder(decoder).map_err(|error| error.to_string())?.into_rgb8();
    Ok(Colours { width: image.width() as usize, height: image.height() as usize, rgb: image.into_raw() })
}

/// Checks the size that an image's header states, before any pixel is decoded.
fn check_size(width: u64, height: u64) -> Result<(), String> {
    let what = || format!("{width} x {height} pixels: at most {MAX_PIXELS} are decoded");
    if is_image_size(width, height) { Ok(()) } else { Err(what()) }
}

/// Sharpness and brightness of an image, over the pixels that are not black.
///
/// Sharpness is the mean absolute second difference of green along the rows over the mean of green, brightness is that mean.
pub(super) fn quality(colours: &Colours) -> (f32, f32) {
    let (mut sum, mut bends, mut count) = (0u64, 0u64, 0u64);
    for row in colours.rgb.chunks_exact(3 * colours.width).step_by(2) {
        for three in row.windows(9).step_by(6) {
            let [a, b, c] = [three[1], three[4], three[7]].map(i64::from);
            if b > 0 {
                sum += b as u64;
                bends += (a + c - 2 * b).unsigned_abs();
                count += 1;
            }
        }
    }
    let mean = sum as f32 / count.max(1) as f32;
    (bends as f32 / count.max(1) as f32 / mean.max(1.0), mean)
}
