//! Frames in every encoding that robots record.

use std::io::Cursor;

use image::{ImageFormat, RgbImage};
use realitysim::log_input::decode;
use realitysim::ros2::LogMessage;
use realitysim::ros2::messages::{CompressedImage, Header, Image, Message};

use super::support::{IMAGE, Replayed, Room, assert_same, changed, farthest_apart, message, on, walk};

struct Frame {
    header: Header,
    log_time_ns: i64,
    pixels: RgbImage,
}

fn frames() -> Vec<Frame> {
    on(&walk().messages, IMAGE)
        .map(|message| {
            let compressed = CompressedImage::decode(&message.data).unwrap();
            let pixels = image::load_from_memory(&compressed.data).unwrap().to_rgb8();
            Frame { header: compressed.header, log_time_ns: message.log_time_ns, pixels }
        })
        .collect()
}

/// The walk with its frames written otherwise, in their old places.
fn with_frames<M: Message>(topic: &str, mut make: impl FnMut(Header, &RgbImage) -> M) -> Vec<LogMessage> {
    let mut frames = frames().into_iter();
    let mut messages = walk().messages.clone();
    for old in messages.iter_mut().filter(|message| message.channel.topic == IMAGE) {
        let frame = frames.next().unwrap();
        assert_eq!(frame.log_time_ns, old.log_time_ns);
        *old = message(900, topic, frame.log_time_ns, &make(frame.header, &frame.pixels));
    }
    messages
}

fn raw(header: Header, pixels: &RgbImage, encoding: &str, bytes_per_pixel: u32, data: Vec<u8>) -> Image {
    let (width, height) = pixels.dimensions();
    Image { header, width, height, encoding: encoding.into(), is_bigendian: 0, step: width * bytes_per_pixel, data }
}

/// Near the tags of the JPEGs; nearer than `bound_m` from them.
fn assert_as_good(messages: &[LogMessage], what: &str, bound_m: f64) -> Replayed {
    let room = Room::with_log(messages);
    let replayed = room.replay("log.mcap");
    assert_eq!(replayed.run.code, Some(0), "{what}: {:?}", replayed.run);
    let valid = replayed.count("valid");
    assert!(
        10 * valid >= 9 * walk().frames(),
        "{what}: {valid} of {} valid: {}",
        walk().frames(),
        replayed.report["invalid"]
    );
    let apart = farthest_apart(&replayed.tags, &walk().tags);
    println!("{what}: at most {apart:.3} m apart");
    assert!(apart < bound_m, "{what}: {apart} m");
    replayed
}

fn luma(pixel: &image::Rgb<u8>) -> f64 {
    let [r, g, b] = pixel.0.map(f64::from);
    0.299 * r + 0.587 * g + 0.114 * b
}

#[test]
fn png_frames_are_read() {
    let messages = with_frames(IMAGE, |header, pixels| {
        let mut data = Vec::new();
        pixels.write_to(&mut Cursor::new(&mut data), ImageFormat::Png).unwrap();
        // What `format` says is not to be relied on.
        CompressedImage { header, format: "jpeg".into(), data }
    });
    assert_as_good(&messages, "png", 0.15);
}

#[test]
fn raw_colour_frames_are_read() {
    let rgb = with_frames("/camera/image_raw", |header, pixels| raw(header, pixels, "rgb8", 3, pixels.to_vec()));
    let rgb = assert_as_good(&rgb, "rgb8", 0.15);
    let bgr = with_frames("/camera/image_raw", |header, pixels| {
        let data = pixels.pixels().flat_map(|p| [p[2], p[1], p[0]]).collect();
        raw(header, pixels, "bgr8", 3, data)
    });
    let bgr = assert_as_good(&bgr, "bgr8", 0.15);
    assert_same(&bgr.tags, &rgb.tags, "the same colours in another order");
    let bgra = with_frames("/camera/image_raw", |header, pixels| {
        let data = pixels.pixels().flat_map(|p| [p[2], p[1], p[0], 77]).collect();
        raw(header, pixels, "bgra8", 4, data)
    });
    assert_same(&Room::with_log(&bgra).replay("log.mcap").tags, &rgb.tags, "with transparency");
}

#[test]
fn raw_gray_frames_are_read() {
    let messages = with_frames("/camera/image_raw", |header, pixels| {
        let data = pixels.pixels().map(|pixel| luma(pixel).round() as u8).collect();
        raw(header, pixels, "mono8", 1, data)
    });
    let gray = assert_as_good(&messages, "mono8", 0.2);
    let wide = with_frames("/camera/image_raw", |header, pixels| {
        let data = pixels.pixels().flat_map(|pixel| [luma(pixel).round() as u8, 77]).collect();
        Image { is_bigendian: 1, ..raw(header, pixels, "mono16", 2, data) }
    });
    assert_same(&Room::with_log(&wide).replay("log.mcap").tags, &gray.tags, "16 bits");
}

#[test]
fn raw_yuyv_frames_are_read() {
    let messages = with_frames("/camera/image_raw", |header, pixels| {
        let samples: Vec<_> = pixels.pixels().collect();
        let data = samples
            .chunks_exact(2)
            .flat_map(|pair| {
                let [a, b] = [luma(pair[0]), luma(pair[1])];
                let mean = |channel: usize| (f64::from(pair[0][channel]) + f64::from(pair[1][channel])) / 2.0;
                let cb = 128.0 + 0.564 * (mean(2) - (a + b) / 2.0);
                let cr = 128.0 + 0.713 * (mean(0) - (a + b) / 2.0);
                [a, cb, b, cr].map(|value| value.round().clamp(0.0, 255.0) as u8)
            })
            .collect();
        raw(header, pixels, "yuv422_yuy2", 2, data)
    });
    let yuyv = assert_as_good(&messages, "yuv422_yuy2", 0.2);
    let uyvy = changed::<Image>(&messages, "/camera/image_raw", |image| {
        image.encoding = "uyvy".into();
        image.data.chunks_exact_mut(2).for_each(|pair| pair.swap(0, 1));
    });
    assert_same(&Room::with_log(&uyvy).replay("log.mcap").tags, &yuyv.tags, "uyvy");
}

/// The pixels of the walk's JPEGs, as a decoder has them before it makes colours of them.
#[test]
fn two_planes_are_read_as_the_same_picture() {
    let mut jpegs = on(&walk().messages, IMAGE).map(|message| decode::picture(message).unwrap());
    let messages = with_frames("/camera/image_raw", |header, pixels| {
        let picture = jpegs.next().unwrap();
        let pairs = picture.chroma.blue.iter().zip(&picture.chroma.red).flat_map(|(blue, red)| [*blue, *red]);
        let data = picture.luma.iter().copied().chain(pairs).collect();
        raw(header, pixels, "nv12", 1, data)
    });
    assert_same(&Room::with_log(&messages).replay("log.mcap").tags, &walk().tags, "nv12");
}

#[test]
fn raw_bayer_frames_are_read() {
    let messages = with_frames("/camera/image_raw", |header, pixels| {
        let colour = |u: u32, v: u32| match (v % 2, u % 2) {
            (0, 0) => 0,
            (1, 1) => 2,
            _ => 1,
        };
        let data = pixels.enumerate_pixels().map(|(u, v, pixel)| pixel[colour(u, v)]).collect();
        raw(header, pixels, "bayer_rggb8", 1, data)
    });
    assert_as_good(&messages, "bayer_rggb8", 0.25);
}

#[test]
fn rows_with_padding_are_read() {
    let messages = with_frames("/camera/image_raw", |header, pixels| {
        let width = pixels.width();
        let rows = pixels.as_raw().chunks(3 * width as usize);
        let data = rows.flat_map(|row| [row, &[77; 20]].concat()).collect();
        Image { step: 3 * width + 20, ..raw(header, pixels, "rgb8", 3, data) }
    });
    assert_as_good(&messages, "padded rgb8", 0.15);
}
