//! Two pictures beside each other.

use glam::DVec2;
use image::imageops;
use image::{Rgb, RgbImage};

use super::canvas::Canvas;
use super::plot::TEXT;
use super::scaling::scaled;
use super::text;

/// Largest width of the page, pixels: fits a README.
const WIDTH_PX: u32 = 1_600;
/// Largest height of the page, pixels.
const HEIGHT_PX: u32 = 620;
/// Space around the pictures, pixels.
const MARGIN_PX: u32 = 14;
const TEXT_SIZE: f64 = 19.0;
const LINE_PX: u32 = 27;
/// Largest number of lines of a caption.
const MAX_LINES: usize = 4;
const PAGE: [u8; 3] = [255, 255, 255];

/// Joins two pictures without scaling, with aligned upper edges.
pub fn beside(left: &RgbImage, right: &RgbImage) -> RgbImage {
    let size = (left.width() + right.width(), left.height().max(right.height()));
    let mut page = RgbImage::from_pixel(size.0, size.1, Rgb(PAGE));
    imageops::replace(&mut page, left, 0, 0);
    imageops::replace(&mut page, right, i64::from(left.width()), 0);
    page
}

/// Joins two pictures at the same height, with the caption below: at most 1600 x 620 pixels.
///
/// A field map 720 px wide fits beside a camera image almost without scaling, so that its letters stay sharp.
pub fn side_by_side(left: &RgbImage, right: &RgbImage, caption: &str) -> RgbImage {
    let mut lines = text::wrap(TEXT_SIZE, caption, f64::from(WIDTH_PX - 2 * MARGIN_PX));
    lines.truncate(MAX_LINES);
    let below = if lines.is_empty() { 0 } else { lines.len() as u32 * LINE_PX };
    let shape = |image: &RgbImage| f64::from(image.width()) / f64::from(image.height().max(1));
    let room = f64::from(WIDTH_PX - 3 * MARGIN_PX);
    let height = f64::from(HEIGHT_PX - 2 * MARGIN_PX - below).min(room / (shape(left) + shape(right)).max(1e-6));
    let widths = [left, right].map(|image| (libm::round(height * shape(image)) as u32).clamp(1, WIDTH_PX));
    let height = (libm::round(height) as u32).max(1);

    let size = (widths[0] + widths[1] + 3 * MARGIN_PX, height + below + 2 * MARGIN_PX);
    let mut page = RgbImage::from_pixel(size.0, size.1, Rgb(PAGE));
    let mut x = MARGIN_PX;
    for (image, width) in [left, right].into_iter().zip(widths) {
        if image.width() > 0 && image.height() > 0 {
            let picture = scaled(image, width, height);
            imageops::replace(&mut page, &picture, i64::from(x), i64::from(MARGIN_PX));
        }
        x += width + MARGIN_PX;
    }
    let Some(mut canvas) = Canvas::on_top_of(&page) else { return page };
    let mut baseline = f64::from(height + 2 * MARGIN_PX) + 0.65 * TEXT_SIZE;
    for line in &lines {
        canvas.text(DVec2::new(f64::from(MARGIN_PX), baseline), TEXT_SIZE, TEXT, line);
        baseline += f64::from(LINE_PX);
    }
    canvas.into_image()
}
