//! Marks on pictures.

use anyhow::Context;
use glam::DVec2;
use image::{Rgb, RgbImage};

use crate::views::Raster;

/// The colours of an image.
pub(super) fn rgb(image: &Raster) -> anyhow::Result<RgbImage> {
    let picture = RgbImage::from_raw(image.width as u32, image.height as u32, image.to_rgb());
    picture.context("three bytes for each pixel")
}

/// Draws a box, a pixel wide. The left upper corner of the picture is (0, 0).
pub(super) fn frame_box(picture: &mut RgbImage, from: DVec2, to: DVec2, colour: Rgb<u8>) {
    let [left, top, right, bottom] = [from.x, from.y, to.x, to.y].map(|value| value as i64);
    for u in left..=right {
        dot(picture, u, top, colour);
        dot(picture, u, bottom, colour);
    }
    for v in top..=bottom {
        dot(picture, left, v, colour);
        dot(picture, right, v, colour);
    }
}

/// Draws an upright cross around a pixel.
pub(super) fn cross(picture: &mut RgbImage, at: DVec2, arm_px: i64, colour: Rgb<u8>) {
    let (u, v) = (at.x.round() as i64, at.y.round() as i64);
    for step in -arm_px..=arm_px {
        dot(picture, u + step, v, colour);
        dot(picture, u, v + step, colour);
    }
}

/// Draws a line between two pixels.
pub(super) fn line(picture: &mut RgbImage, from: DVec2, to: DVec2, colour: Rgb<u8>) {
    // A line leaves the picture after as many steps as the picture has pixels along its sides.
    let longest = f64::from(picture.width() + picture.height());
    let steps = from.distance(to).ceil().clamp(1.0, longest) as i64;
    for step in 0..=steps {
        let at = from.lerp(to, step as f64 / steps as f64);
        dot(picture, at.x.round() as i64, at.y.round() as i64, colour);
    }
}

/// Colours a pixel, if the picture has it.
fn dot(picture: &mut RgbImage, u: i64, v: i64, colour: Rgb<u8>) {
    if let (Ok(u), Ok(v)) = (u32::try_from(u), u32::try_from(v))
        && u < picture.width()
        && v < picture.height()
    {
        picture.put_pixel(u, v, colour);
    }
}
