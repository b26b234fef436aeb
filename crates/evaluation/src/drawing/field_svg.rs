//! The field from above as an SVG picture, on which dots, arrows and pieces of lines are drawn.

use core::f64::consts::{FRAC_PI_2, TAU};

use glam::DVec2;

use super::svg::Svg;
use realitysim_geometry::Field;
use realitysim_geometry::field::Stroke;

/// A picture of the field that is being drawn. Points are in `map`, metres; sizes on the paper are pixels.
pub struct FieldSvg {
    svg: Svg,
    half: DVec2,
    scale: f64,
}

/// Width of the picture, pixels.
const WIDTH_PX: f64 = 1000.0;
/// Height of the title above the field, pixels.
const HEAD_PX: f64 = 26.0;
/// Colour of the field's lines.
const LINE: &str = "#bbb";

impl FieldSvg {
    /// The field with its lines, x to the right and y up.
    pub fn new(field: &Field, title: &str) -> Self {
        let half = field.carpet_half_extent();
        let scale = WIDTH_PX / (2.0 * half.x);
        let mut svg = Svg::new(WIDTH_PX, libm::ceil(2.0 * half.y * scale) + HEAD_PX, title);
        svg.words(DVec2::new(4.0, 17.0), 15.0, "#222", title);
        let mut picture = Self { svg, half, scale };
        let width = (field.line_width() * scale).max(1.0);
        field.strokes().iter().for_each(|stroke| picture.line(&outline(stroke), LINE, width));
        picture
    }

    /// Draws a line through points.
    pub fn line(&mut self, points: &[DVec2], colour: &str, width_px: f64) {
        let points: Vec<DVec2> = points.iter().map(|point| self.pixel(*point)).collect();
        self.svg.polyline(&points, colour, width_px, None);
    }

    /// Draws a dot.
    pub fn dot(&mut self, at: DVec2, radius_px: f64, colour: &str) {
        let at = self.pixel(at);
        self.svg.disc(at, radius_px, colour);
    }

    /// Draws an arrow from a point along a vector whose length is in pixels.
    pub fn arrow(&mut self, from: DVec2, along_px: DVec2, colour: &str) {
        let from = self.pixel(from);
        let along = along_px * DVec2::new(1.0, -1.0);
        let (tip, back) = (from + along, along.normalize_or_zero() * 6.0);
        self.svg.line(from, tip, colour, 1.6, None);
        self.svg.polygon(&[tip, tip - back + back.perp() * 0.5, tip - back - back.perp() * 0.5], colour);
    }

    /// Writes words, moved from a point by `by_px` to the right and down.
    pub fn words(&mut self, at: DVec2, by_px: DVec2, size_px: f64, words: &str) {
        let at = self.pixel(at) + by_px;
        self.svg.words(at, size_px, "#222", words);
    }

    /// The picture's text.
    pub fn finish(self) -> String {
        self.svg.finish()
    }

    fn pixel(&self, at: DVec2) -> DVec2 {
        DVec2::new(at.x + self.half.x, self.half.y - at.y) * self.scale + DVec2::new(0.0, HEAD_PX)
    }
}

/// Points along a stroke, its ends included.
fn outline(stroke: &Stroke) -> Vec<DVec2> {
    let arc = |centre: DVec2, radius: f64, side: DVec2, angle: f64, pieces: u32| {
        (0..=pieces).map(move |piece| {
            let at = DVec2::from_angle(angle * f64::from(piece) / f64::from(pieces));
            centre + at * side * radius
        })
    };
    match *stroke {
        Stroke::Segment { from, to } => vec![from, to],
        Stroke::Circle { centre, radius } => arc(centre, radius, DVec2::ONE, TAU, 72).collect(),
        Stroke::Quarter { centre, radius, side } => arc(centre, radius, side, FRAC_PI_2, 18).collect(),
    }
}
