//! The sheet that a field is drawn on: the mapping from `map` to pixels, and the axes at its border.

use glam::DVec2;

use super::canvas::{Canvas, Ink};
use super::text;
use realitysim_geometry::Field;

/// Colour of text.
pub(super) const TEXT: [u8; 3] = [55, 60, 66];
/// Colour of the axes.
const FRAME: [u8; 3] = [120, 128, 120];
/// Smallest distance between numbers at the border, in units of the size of the text.
const NUMBER_SPACING: f64 = 2.8;

/// The carpet on the picture, to scale: x to the right, y up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Plot {
    /// Left top corner of the carpet, pixels.
    pub(super) low: DVec2,
    /// Right bottom corner of the carpet, pixels.
    pub(super) high: DVec2,
    pub(super) pixels_per_metre: f64,
    /// Size of the text, pixels.
    pub(super) text_size: f64,
}

impl Plot {
    /// Lays out a field on a picture of the given width.
    pub(super) fn new(field: &Field, width_px: u32) -> Self {
        let width = f64::from(width_px);
        let text_size = width / 46.0;
        let (left, right, top) = (3.9 * text_size, 0.9 * text_size, 0.9 * text_size);
        let carpet = 2.0 * field.carpet_half_extent();
        // The picture is at most twice as high as wide: a long field that is narrow would make it endless.
        let room = DVec2::new(width - left - right, 2.0 * width);
        let pixels_per_metre = (room / carpet).min_element();
        let size = carpet * pixels_per_metre;
        let low = DVec2::new(left + (room.x - size.x) / 2.0, top);
        Self { low, high: low + size, pixels_per_metre, text_size }
    }

    /// Returns the pixel of a point in `map`.
    pub(super) fn pixel(&self, map: DVec2) -> DVec2 {
        (self.low + self.high) / 2.0 + DVec2::new(map.x, -map.y) * self.pixels_per_metre
    }

    /// Returns where axes and numbers end, pixels from the top.
    pub(super) fn bottom(&self) -> f64 {
        self.high.y + 3.0 * self.text_size
    }

    pub(super) fn draw_axes(&self, canvas: &mut Canvas) {
        let size = self.text_size;
        let pen = Ink::solid(FRAME).pen((size / 16.0).max(1.0)).square();
        canvas.stroke_rectangle(self.low, self.high, pen);
        let half = (self.high - self.low) / (2.0 * self.pixels_per_metre);
        let step = tick_step(NUMBER_SPACING * size / self.pixels_per_metre);
        let tick = 0.35 * size;
        let below = self.high.y + 1.45 * size;
        for value in ticks(half.x, step) {
            let x = self.pixel(DVec2::new(value, 0.0)).x;
            canvas.stroke(&[vec![DVec2::new(x, self.high.y), DVec2::new(x, self.high.y + tick)]], pen);
            let number = number(value, step);
            canvas.text(DVec2::new(x - text::width(size, &number) / 2.0, below), size, TEXT, &number);
        }
        for value in ticks(half.y, step) {
            let y = self.pixel(DVec2::new(0.0, value)).y;
            canvas.stroke(&[vec![DVec2::new(self.low.x - tick, y), DVec2::new(self.low.x, y)]], pen);
            let number = number(value, step);
            let x = self.low.x - 1.7 * tick - text::width(size, &number);
            canvas.text(DVec2::new(x, y + 0.33 * size), size, TEXT, &number);
        }
        let middle = (self.low + self.high) / 2.0;
        let (x, y) = ("x in m", "y in m");
        canvas.text(DVec2::new(middle.x - text::width(size, x) / 2.0, self.high.y + 2.7 * size), size, TEXT, x);
        canvas.text_upwards(DVec2::new(1.3 * size, middle.y + text::width(size, y) / 2.0), size, TEXT, y);
    }
}

/// Returns 1, 2 or 5 times a power of ten that is at least `least` metres.
fn tick_step(least: f64) -> f64 {
    [0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0].into_iter().find(|step| *step >= least).unwrap_or(100.0)
}

/// Returns the multiples of `step` within `half` on both sides of 0.
fn ticks(half: f64, step: f64) -> Vec<f64> {
    let most = libm::floor(half / step + 1e-9) as i32;
    (-most..=most).map(|count| f64::from(count) * step).collect()
}

/// Formats a number at the border.
fn number(value: f64, step: f64) -> String {
    let digits = usize::from(step < 1.0);
    // The minus sign is as wide as a plus, as in print.
    format!("{value:.digits$}").replace('-', "\u{2212}")
}
