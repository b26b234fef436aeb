//! Tests of decoding without another program; tests/replay/encodings.rs compares with OpenCV.

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
    let uyvy = raw(&view("yuv422", 2, 1, 4, &[44, 10, 21, 20])).expect("two pixels");
    assert_eq!(uyvy, yuv);
    assert_eq!((yuv.luma, yuv.chroma.blue, yuv.chroma.red), (vec![10, 20], vec![44], vec![21]));
    let gray = raw(&view("mono8", 2, 2, 3, &[1, 2, 99, 3, 4])).expect("padded rows");
    assert_eq!(gray.luma, vec![1, 2, 3, 4]);
    let flat = raw(&view("bayer_rggb8", 4, 4, 4, &[80; 16])).expect("gray");
    assert!(flat.luma.iter().all(|y| *y == 80) && flat.chroma.blue.iter().all(|c| *c == 128));
}

#[test]
fn sizes_that_do_not_fit_are_refused() {
    for (width, height, step, bytes) in [(2, 2, 2, 3), (0, 2, 2, 4), (4, 1, 3, 12), (u32::MAX, u32::MAX, u32::MAX, 4)] {
        let data = vec![0; bytes];
        assert!(matches!(raw(&view("mono8", width, height, step, &data)), Err(DecodeError::Size { .. })));
    }
}

#[test]
fn an_unknown_encoding_is_told_which_are_read() {
    let refused = raw(&view("rgba16", 1, 1, 8, &[0; 8])).expect_err("16 bits").to_string();
    assert!(refused.contains("\"rgba16\""), "{refused}");
    for name in encodings() {
        assert!(refused.contains(name), "{name}: {refused}");
        let read = raw(&view(name, 4, 4, 16, &[9; 96]));
        assert_eq!(read.map(|picture| [picture.width, picture.height]).expect(name), [4, 4]);
    }
}

#[test]
fn odd_sizes_of_shared_chroma_are_refused() {
    for (encoding, width, height, word) in
        [("yuyv", 3, 2, "width must be even"), ("nv12", 3, 2, "even"), ("nv21", 4, 3, "width and height must be even")]
    {
        let refused = raw(&view(encoding, width, height, 16, &[9; 96])).expect_err("odd").to_string();
        assert!(refused.contains(word) && refused.contains(encoding), "{refused}");
    }
}

#[test]
fn both_planes_have_the_same_step() {
    // Two rows of luma and one of chroma pairs, each padded by two bytes; the last row lacks its padding.
    let data = [1, 2, 3, 4, 99, 99, 5, 6, 7, 8, 99, 99, 10, 20, 30, 40];
    let nv12 = raw(&view("nv12", 4, 2, 6, &data)).expect("padded");
    assert_eq!(nv12.luma, [1, 2, 3, 4, 5, 6, 7, 8]);
    assert_eq!((&nv12.chroma.blue[..], &nv12.chroma.red[..]), (&[10, 30][..], &[20, 40][..]));
    let nv21 = raw(&view("nv21", 4, 2, 6, &data)).expect("padded");
    assert_eq!((&nv21.chroma.blue, &nv21.chroma.red), (&nv12.chroma.red, &nv12.chroma.blue));
    assert!(matches!(raw(&view("nv12", 4, 2, 6, &data[..15])), Err(DecodeError::Size { .. })));
}

#[test]
fn the_byte_order_of_sixteen_bits_is_obeyed() {
    let little = view("mono16", 2, 1, 4, &[1, 200, 2, 100]);
    assert_eq!(raw(&little).expect("gray").luma, [200, 100]);
    assert_eq!(raw(&ImageView { is_bigendian: 1, ..little }).expect("gray").luma, [1, 2]);
}

/// What compressed_image_transport and compressed_depth_image_transport write, and what drivers write in place of it.
#[test]
fn every_format_of_a_compressed_image_is_read_but_depth() {
    let pixels: Vec<u8> = (0..16 * 16).flat_map(|i| [i as u8, 90, 200]).collect();
    let (mut jpeg, mut png) = (Vec::new(), Vec::new());
    let encoder = jpeg_encoder::Encoder::new(&mut jpeg, 90);
    encoder.encode(&pixels, 16, 16, jpeg_encoder::ColorType::Rgb).expect("encoded");
    let encoder = image::codecs::png::PngEncoder::new(&mut png);
    image::ImageEncoder::write_image(encoder, &pixels, 16, 16, image::ExtendedColorType::Rgb8).expect("encoded");
    let message = |format: &str, data: &[u8]| {
        let image = CompressedImage { format: format.to_owned(), data: data.to_vec(), ..CompressedImage::default() };
        let channel = Arc::new(Channel::of::<CompressedImage>(0, "/image", Default::default()));
        LogMessage { channel, sequence: 0, log_time_ns: 0, publish_time_ns: 0, data: image.encode() }
    };
    let formats =
        ["jpeg", "jpg", "png", "", "rgb8; jpeg compressed bgr8", "bgra8; png compressed ", "mono8; jpeg compressed "];
    for format in formats {
        for data in [&jpeg, &png] {
            let read = picture(&message(format, data)).unwrap_or_else(|error| panic!("{format:?}: {error}"));
            assert_eq!(read, compressed(data).expect("decodes"), "{format:?}");
        }
    }
    for format in ["16UC1; compressedDepth png", "32FC1; compressedDepth", "16UC1; compressedDepth rvl"] {
        let refused = picture(&message(format, &png)).expect_err("a depth image").to_string();
        assert!(refused.contains(format) && refused.contains("depth image"), "{refused}");
    }
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
