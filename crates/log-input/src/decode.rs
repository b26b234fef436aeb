//! Decodes the image in a frame's message into a picture.

use image::error::{LimitError, LimitErrorKind};
use image::{DynamicImage, ImageDecoder};
use thiserror::Error;
use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;
use zune_jpeg::JpegDecoder;

use super::file_kind::{FileKind, START_BYTES};
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
    /// The compressed image is of another format.
    #[error("the image is neither JPEG nor PNG, it is {0}")]
    Format(FileKind),
    /// The raw image has an encoding that is not supported.
    #[error("encoding {0:?}: supported are mono8, rgb8, bgr8, yuv422_yuy2 and bayer_rggb8, bggr8, gbrg8, grbg8")]
    Encoding(String),
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

/// Accepts every size that the project can work with.
fn accept_any_possible(found: [usize; 2]) -> Result<(), DecodeError> {
    let [width, height] = found.map(|side| side as u64);
    if is_image_size(width, height) { Ok(()) } else { Err(DecodeError::TooLarge { found }) }
}

/// Decides by width and height whether an image is decoded.
type Accept<'a> = &'a dyn Fn([usize; 2]) -> Result<(), DecodeError>;

fn picture_if(message: &LogMessage, accept: Accept) -> Result<Picture, DecodeError> {
    match message.channel.type_name.as_str() {
        "sensor_msgs/msg/CompressedImage" => compressed_if(CompressedImageView::decode(&message.data)?.data, accept),
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

/// Converts an uncompressed image into a picture. The error names an encoding or size that is not possible.
pub fn raw(image: &ImageView) -> Result<Picture, DecodeError> {
    let size = || DecodeError::Size {
        width: image.width,
        height: image.height,
        encoding: image.encoding.to_owned(),
        step: image.step,
        bytes: image.data.len(),
    };
    let (width, height, step) = (image.width as usize, image.height as usize, image.step as usize);
    let bytes_per_pixel = match image.encoding {
        "mono8" | "8UC1" | "bayer_rggb8" | "bayer_bggr8" | "bayer_gbrg8" | "bayer_grbg8" => 1,
        "yuv422_yuy2" => 2,
        "rgb8" | "bgr8" => 3,
        other => return Err(DecodeError::Encoding(other.to_owned())),
    };
    let line = width.checked_mul(bytes_per_pixel).ok_or_else(size)?;
    let fits = is_image_size(width as u64, height as u64) && step >= line;
    // The last row may lack the padding that `step` adds.
    if !fits || image.data.len() < step * (height - 1) + line {
        return Err(size());
    }
    let rows = || image.data.chunks(step).take(height).map(|row| &row[..line]);
    let picture = match image.encoding {
        "rgb8" => Picture::from_rgb(width, height, &rows().flatten().copied().collect::<Vec<u8>>()),
        "bgr8" => {
            let rgb: Vec<u8> = rows().flat_map(|row| row.chunks_exact(3).flat_map(|p| [p[2], p[1], p[0]])).collect();
            Picture::from_rgb(width, height, &rgb)
        }
        "yuv422_yuy2" => yuy2(width, height, rows()),
        "bayer_rggb8" | "bayer_bggr8" | "bayer_gbrg8" | "bayer_grbg8" => {
            let rgb = demosaic(width, height, &rows().collect::<Vec<_>>(), first_red(image.encoding));
            Picture::from_rgb(width, height, &rgb)
        }
        _ => Picture::from_gray(width, height, rows().flatten().copied().collect()),
    };
    picture.ok_or_else(size)
}

/// Converts rows of YUYV (bytes Y0 U Y1 V), where two pixels share their chroma, into a picture.
fn yuy2<'a>(width: usize, height: usize, rows: impl Iterator<Item = &'a [u8]>) -> Option<Picture> {
    let pixels = rows.flat_map(|row| {
        row.chunks(4).flat_map(|quad| {
            let [u, v] = [1, 3].map(|at| quad.get(at).copied().unwrap_or(128));
            quad.iter().step_by(2).flat_map(move |y| [*y, u, v])
        })
    });
    Picture::from_ycbcr(width, height, &pixels.collect::<Vec<u8>>())
}

/// Returns column and row of the first red pixel: the names list the first two rows from left to right.
fn first_red(encoding: &str) -> [usize; 2] {
    match encoding {
        "bayer_bggr8" => [1, 1],
        "bayer_gbrg8" => [0, 1],
        "bayer_grbg8" => [1, 0],
        _ => [0, 0],
    }
}

/// Converts a Bayer mosaic into RGB bilinearly: a missing colour is the mean of the nearest neighbours of that colour.
fn demosaic(width: usize, height: usize, rows: &[&[u8]], [red_u, red_v]: [usize; 2]) -> Vec<u8> {
    let colour_at = |u: usize, v: usize| match ((v + red_v) % 2, (u + red_u) % 2) {
        (0, 0) => 0,
        (1, 1) => 2,
        _ => 1,
    };
    let mut rgb = Vec::with_capacity(3 * width * height);
    for v in 0..height {
        for u in 0..width {
            for colour in 0..3 {
                if colour_at(u, v) == colour {
                    rgb.push(rows[v][u]);
                    continue;
                }
                let (mut sum, mut count) = (0u32, 0u32);
                let columns = u.saturating_sub(1)..(u + 2).min(width);
                for (nv, row) in rows.iter().enumerate().take((v + 2).min(height)).skip(v.saturating_sub(1)) {
                    for nu in columns.clone() {
                        // Missing green is taken from the four direct neighbours, red and blue from all eight.
                        let beside = colour != 1 || nu == u || nv == v;
                        if beside && colour_at(nu, nv) == colour {
                            sum += u32::from(row[nu]);
                            count += 1;
                        }
                    }
                }
                rgb.push(((sum + count / 2) / count.max(1)) as u8);
            }
        }
    }
    rgb
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use realitysim_ros2::mcap_read::Channel;
    use realitysim_ros2::messages::{CompressedImage, Header, Message};

    fn view<'a>(encoding: &'a str, width: u32, height: u32, step: u32, data: &'a [u8]) -> ImageView<'a> {
        ImageView { header: Header::default(), height, width, encoding, is_bigendian: 0, step, data }
    }

    #[test]
    fn every_bayer_pattern_gives_the_same_colours() {
        let (width, height) = (16, 12);
        let colour = [200u8, 90, 30];
        for (encoding, first_rows) in [
            ("bayer_rggb8", [0, 1, 1, 2]),
            ("bayer_bggr8", [2, 1, 1, 0]),
            ("bayer_gbrg8", [1, 2, 0, 1]),
            ("bayer_grbg8", [1, 0, 2, 1]),
        ] {
            let data: Vec<u8> =
                (0..width * height).map(|i| colour[first_rows[i / width % 2 * 2 + i % width % 2]]).collect();
            let picture = raw(&view(encoding, width as u32, height as u32, width as u32, &data)).expect("decodes");
            for pixel in picture.to_rgb().as_chunks::<3>().0 {
                for (found, expected) in pixel.iter().zip(colour) {
                    assert!(found.abs_diff(expected) <= 2, "{encoding}: {pixel:?}");
                }
            }
        }
    }

    #[test]
    fn colours_of_every_raw_encoding() {
        let rgb = raw(&view("rgb8", 1, 1, 3, &[0, 255, 0])).expect("green");
        let bgr = raw(&view("bgr8", 1, 1, 3, &[0, 255, 0])).expect("green");
        assert_eq!(rgb, bgr);
        let yuv = raw(&view("yuv422_yuy2", 2, 1, 4, &[10, 44, 20, 21])).expect("two pixels");
        assert_eq!((yuv.luma, yuv.chroma.blue, yuv.chroma.red), (vec![10, 20], vec![44], vec![21]));
        let gray = raw(&view("mono8", 2, 2, 3, &[1, 2, 99, 3, 4])).expect("padded rows");
        assert_eq!(gray.luma, vec![1, 2, 3, 4]);
        let flat = raw(&view("bayer_rggb8", 4, 4, 4, &[80; 16])).expect("gray");
        assert!(flat.luma.iter().all(|y| *y == 80) && flat.chroma.blue.iter().all(|c| *c == 128));
    }

    #[test]
    fn sizes_that_do_not_fit_are_refused() {
        for (width, height, step, bytes) in
            [(2, 2, 2, 3), (0, 2, 2, 4), (4, 1, 3, 12), (u32::MAX, u32::MAX, u32::MAX, 4)]
        {
            let data = vec![0; bytes];
            assert!(matches!(raw(&view("mono8", width, height, step, &data)), Err(DecodeError::Size { .. })));
        }
        assert!(matches!(raw(&view("rgba16", 1, 1, 8, &[0; 8])), Err(DecodeError::Encoding(_))));
    }

    /// The JPEG ends after its header: if a pixel were decoded, the error would say that there is none.
    #[test]
    fn another_size_is_refused_before_a_pixel_is_decoded() {
        let noise: Vec<u8> = (0..64 * 64 * 3).map(|i: u32| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
        let mut jpeg = Vec::new();
        let encoder = jpeg_encoder::Encoder::new(&mut jpeg, 90);
        encoder.encode(&noise, 64, 64, jpeg_encoder::ColorType::Rgb).expect("encoded");
        let mut png = Vec::new();
        let encoder = image::codecs::png::PngEncoder::new(&mut png);
        image::ImageEncoder::write_image(encoder, &noise, 64, 64, image::ExtendedColorType::Rgb8).expect("encoded");
        // The frame header's marker, length and precision stand before the height and the width.
        let head = jpeg.windows(2).position(|two| two == [0xff, 0xc0]).expect("a baseline JPEG") + 5;
        jpeg[head..head + 4].copy_from_slice(&[0x40, 0, 0x40, 0]);
        let scan = jpeg.windows(2).position(|two| two == [0xff, 0xda]).expect("a scan");
        let message = |data: &[u8]| {
            let image = CompressedImage { data: data.to_vec(), ..CompressedImage::default() };
            let channel = Arc::new(Channel::of::<CompressedImage>(0, "/image", Default::default()));
            LogMessage { channel, sequence: 0, log_time_ns: 0, publish_time_ns: 0, data: image.encode() }
        };
        for (data, found) in [(&jpeg[..scan + 14], 16_384), (&png[..], 64)] {
            let refused = picture_of_size(&message(data), [320, 240]).expect_err("another size");
            let DecodeError::OtherSize { found: told, wanted } = refused else { panic!("{refused}") };
            assert_eq!((told, wanted), ([found; 2], [320, 240]));
        }
        assert_eq!(picture_of_size(&message(&png), [64, 64]).expect("its size").width, 64);
        let refused = compressed(&jpeg[..scan + 14]).expect_err("268 megapixels");
        assert!(matches!(refused, DecodeError::TooLarge { found: [16_384, 16_384] }), "{refused}");
    }

    #[test]
    fn a_torn_jpeg_is_an_error() {
        let mut bytes = Vec::new();
        let encoder = jpeg_encoder::Encoder::new(&mut bytes, 90);
        let noise: Vec<u8> = (0..64 * 64 * 3).map(|i: u32| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
        encoder.encode(&noise, 64, 64, jpeg_encoder::ColorType::Rgb).expect("encoded");
        assert_eq!(compressed(&bytes).expect("whole").width, 64);
        for cut in [0, 1, 3, 20, bytes.len() / 2] {
            assert!(compressed(&bytes[..cut]).is_err(), "{cut} bytes");
        }
    }
}
