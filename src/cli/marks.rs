//! Marks on pictures.

use anyhow::Context;
use glam::DVec2;
use image::{Rgb, RgbImage};

use crate::views::Raster;

/// The colours of an image.
pub fn rgb(image: &Raster) -> anyhow::Result<RgbImage> {
    let picture = RgbImage::from_raw(image.width as u32, image.height as u32, image.to_rgb());
    picture.context("three bytes for each pixel")
}

/// Draws a box, a pixel wide. The left upper corner of the picture is (0, 0).
pub fn frame_box(picture: &mut RgbImage, from: DVec2, to: DVec2, colour: Rgb<u8>) {
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

/// The arms of an upright cross, to the right and down.
pub const UPRIGHT: [[i64; 2]; 2] = [[1, 0], [0, 1]];
/// The arms of a diagonal cross.
pub const DIAGONAL: [[i64; 2]; 2] = [[1, 1], [1, -1]];

/// Draws a cross around a pixel, whose arms are `arm_px` long to both sides.
pub fn cross(picture: &mut RgbImage, at: DVec2, arms: [[i64; 2]; 2], arm_px: i64, colour: Rgb<u8>) {
    let (u, v) = (at.x.round() as i64, at.y.round() as i64);
    for ([right, down], step) in arms.into_iter().flat_map(|arm| (-arm_px..=arm_px).map(move |step| (arm, step))) {
        dot(picture, u.saturating_add(right * step), v.saturating_add(down * step), colour);
    }
}

/// Draws a line between two pixels.
pub fn line(picture: &mut RgbImage, from: DVec2, to: DVec2, colour: Rgb<u8>) {
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
