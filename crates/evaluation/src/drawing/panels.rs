//! Pages of several pictures, each with words below it.

use glam::DVec2;
use image::imageops;
use image::{Rgb, RgbImage};

use super::canvas::Canvas;
use super::plot::TEXT;

/// Space between the pictures, pixels.
const MARGIN_PX: u32 = 8;
/// Height of the words below a picture, pixels.
const WORDS_PX: u32 = 26;
/// Size of the words, pixels.
const TEXT_SIZE: f64 = 15.0;

/// Arranges pictures and their words row by row in `columns` columns, without scaling.
pub fn panels(pictures: &[(RgbImage, String)], columns: u32) -> RgbImage {
    let columns = columns.clamp(1, pictures.len().max(1) as u32);
    let widest = pictures.iter().map(|(picture, _)| picture.width()).max().unwrap_or(1);
    let highest = pictures.iter().map(|(picture, _)| picture.height()).max().unwrap_or(1);
    let (across, down) = (widest + MARGIN_PX, highest + WORDS_PX + MARGIN_PX);
    let rows = (pictures.len() as u32).div_ceil(columns);
    let mut page = RgbImage::from_pixel(columns * across + MARGIN_PX, rows * down + MARGIN_PX, Rgb([255; 3]));
    let corner =
        |index: usize| (MARGIN_PX + index as u32 % columns * across, MARGIN_PX + index as u32 / columns * down);
    for (index, (picture, _)) in pictures.iter().enumerate() {
        let (x, y) = corner(index);
        imageops::replace(&mut page, picture, i64::from(x), i64::from(y));
    }
    let Some(mut canvas) = Canvas::on_top_of(&page) else { return page };
    for (index, (_, words)) in pictures.iter().enumerate() {
        let (x, y) = corner(index);
        canvas.text(DVec2::new(f64::from(x), f64::from(y + highest) + 18.0), TEXT_SIZE, TEXT, words);
    }
    canvas.into_image()
}
