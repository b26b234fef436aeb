//! Raw images of every encoding, decoded here and by OpenCV.

use std::process::Command;

use realitysim::localization::random::{Purpose, Stream};
use realitysim::log_input::decode;
use realitysim::ros2::messages::Image;
use realitysim::ros2::messages::ImageView;
use realitysim::vision::Picture;
use serde_json::json;

use super::support::Room;

/// Names a Python interpreter that has OpenCV.
const INTERPRETER: &str = "REALITYSIM_PYTHON";
const WIDTH: usize = 22;
const HEIGHT: usize = 14;
/// Bytes behind each row that are no pixels.
const PADDING: usize = 6;

fn is_shared_by_two(encoding: &str) -> bool {
    encoding.starts_with("yu") || encoding == "uyvy"
}

/// An image of noise.
fn noise(encoding: &str, is_bigendian: u8, padding: usize) -> Image {
    let bytes_per_pixel = match encoding {
        "rgba8" | "bgra8" => 4,
        "rgb8" | "bgr8" => 3,
        "mono16" | "16UC1" => 2,
        _ if is_shared_by_two(encoding) || encoding.ends_with("16") => 2,
        _ => 1,
    };
    let rows = if encoding.starts_with("nv") { HEIGHT * 3 / 2 } else { HEIGHT };
    let step = WIDTH * bytes_per_pixel + padding;
    let mut draw = Stream::new(3, Purpose::Start, 0, 0, 0);
    let mut data: Vec<u8> = (0..step * rows).map(|_| draw.below(256) as u8).collect();
    if is_shared_by_two(encoding) {
        // A picture has one chroma value for each 2 x 2 pixels: with two rows of the same chroma, no mean is taken.
        let first_chroma = if encoding.starts_with("yuy") || encoding == "yuv422_yuy2" { 1 } else { 0 };
        for pair in data.chunks_exact_mut(2 * step) {
            for at in (first_chroma..step).step_by(2) {
                pair[step + at] = pair[at];
            }
        }
    }
    let header = Default::default();
    let (width, height, step) = (WIDTH as u32, HEIGHT as u32, step as u32);
    Image { header, height, width, encoding: encoding.to_owned(), is_bigendian, step, data }
}

fn decoded(image: &Image) -> Picture {
    let view = ImageView {
        header: Default::default(),
        height: image.height,
        width: image.width,
        encoding: &image.encoding,
        is_bigendian: image.is_bigendian,
        step: image.step,
        data: &image.data,
    };
    decode::raw(&view).unwrap_or_else(|error| panic!("{error}"))
}

/// R, G, B of a picture whose bytes are taken as limited range (BT.601, luma 16 to 235), which is how OpenCV takes them.
fn as_limited_range(picture: &Picture) -> Vec<f64> {
    let half = WIDTH / 2;
    let pixel = |i: usize| {
        let at = i / WIDTH / 2 * half + i % WIDTH / 2;
        let [cb, cr] = [picture.chroma.blue[at], picture.chroma.red[at]].map(|level| f64::from(level) - 128.0);
        let y = 1.164_383 * (f64::from(picture.luma[i]).max(16.0) - 16.0);
        [y + 1.596_027 * cr, y - 0.391_762 * cb - 0.812_968 * cr, y + 2.017_232 * cb]
            .map(|level| level.clamp(0.0, 255.0))
    };
    (0..WIDTH * HEIGHT).flat_map(pixel).collect()
}

#[test]
fn opencv_finds_the_same_pixels_in_every_raw_encoding() {
    let Some(python) = std::env::var_os(INTERPRETER) else {
        assert!(std::env::var("CI").is_err(), "{INTERPRETER} is not set: `./dev test` sets it");
        println!("skipped: {INTERPRETER} names no interpreter");
        return;
    };
    let room = Room::new();
    let images: Vec<Image> = decode::encodings()
        .flat_map(|encoding| [(0, 0), (0, PADDING), (1, 0)].map(|(order, padding)| noise(encoding, order, padding)))
        .collect();
    for (number, image) in images.iter().enumerate() {
        room.write(&format!("{number}.in"), &image.data);
    }
    let case = |image: &Image| {
        json!({
            "encoding": image.encoding, "width": image.width, "height": image.height, "step": image.step,
            "is_bigendian": image.is_bigendian != 0,
        })
    };
    room.write("cases.json", serde_json::to_vec(&images.iter().map(case).collect::<Vec<_>>()).unwrap());
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/replay/decode_with_opencv.py");
    let output = Command::new(python).arg(script).arg(room.path(".")).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    for (number, image) in images.iter().enumerate() {
        let theirs = std::fs::read(room.path(&format!("{number}.out"))).unwrap();
        let ours = decoded(image);
        let what = format!("{} with step {} and order {}", image.encoding, image.step, image.is_bigendian);
        if ours.chroma.is_empty() {
            assert_eq!(ours.luma, theirs, "{what}");
        } else if image.encoding.starts_with("nv") || is_shared_by_two(&image.encoding) {
            for (at, (level, other)) in as_limited_range(&ours).iter().zip(&theirs).enumerate() {
                assert!((level - f64::from(*other)).abs() < 1.5, "{what}: byte {at} is {level}, and {other} in OpenCV");
            }
        } else if image.encoding.starts_with("bayer") {
            assert_same_inside(&ours, &theirs, &what);
        } else {
            assert_eq!(ours, Picture::from_rgb(WIDTH, HEIGHT, &theirs).unwrap(), "{what}");
        }
    }
}

/// Compares all but the border, where OpenCV repeats the pixels beside it: two pixels, since chroma is a mean of 2 x 2.
fn assert_same_inside(ours: &Picture, theirs: &[u8], what: &str) {
    let theirs = Picture::from_rgb(WIDTH, HEIGHT, theirs).unwrap();
    for v in 2..HEIGHT - 2 {
        let row = v * WIDTH + 2..v * WIDTH + WIDTH - 2;
        assert_eq!(ours.luma[row.clone()], theirs.luma[row], "{what}: row {v}");
        let row = v / 2 * (WIDTH / 2) + 1..v / 2 * (WIDTH / 2) + WIDTH / 2 - 1;
        assert_eq!(ours.chroma.blue[row.clone()], theirs.chroma.blue[row.clone()], "{what}: row {v}");
        assert_eq!(ours.chroma.red[row.clone()], theirs.chroma.red[row], "{what}: row {v}");
    }
}
