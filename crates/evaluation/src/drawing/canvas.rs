//! A canvas with the few strokes and shapes that the pictures need, on tiny-skia. Positions are pixels with (0, 0) at
//! the corner of the picture.

use glam::DVec2;
use image::{Rgb, RgbImage};
use tiny_skia::{Color, FillRule, LineCap, LineJoin, Mask, Paint, Path, PathBuilder, Pixmap, Rect, Stroke, Transform};

use super::text;

/// A picture that is drawn on.
pub(super) struct Canvas {
    pixmap: Pixmap,
    clip: Option<Mask>,
}

/// Colour and opacity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Ink {
    pub(super) colour: [u8; 3],
    /// Opacity, 0 to 1.
    pub(super) alpha: f64,
}

/// Ink and shape of a stroke.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pen {
    pub(super) ink: Ink,
    /// Width, pixels.
    pub(super) width: f64,
    /// Whether ends are round and reach half the width farther. Otherwise they are cut square.
    pub(super) round: bool,
}

/// Largest coordinate that is drawn, pixels. The rasteriser counts in 16.16 fixed point, and nothing so far outside is
/// visible.
const MAX_COORDINATE_PX: f64 = 16_000.0;

impl Ink {
    pub(super) const fn solid(colour: [u8; 3]) -> Self {
        Self { colour, alpha: 1.0 }
    }

    /// Returns a pen of this ink with round ends.
    pub(super) fn pen(self, width: f64) -> Pen {
        Pen { ink: self, width, round: true }
    }

    fn paint(self) -> Paint<'static> {
        let [r, g, b] = self.colour;
        let mut paint = Paint::default();
        let mut colour = Color::from_rgba8(r, g, b, 255);
        colour.apply_opacity(self.alpha as f32);
        paint.set_color(colour);
        paint
    }
}

impl Pen {
    /// Returns this pen with square ends.
    pub(super) fn square(self) -> Self {
        Self { round: false, ..self }
    }
}

impl Canvas {
    /// Returns a canvas of one colour; `None` for a size without pixels or beyond the memory.
    pub(super) fn filled(width: u32, height: u32, [r, g, b]: [u8; 3]) -> Option<Self> {
        let mut pixmap = Pixmap::new(width, height)?;
        pixmap.fill(Color::from_rgba8(r, g, b, 255));
        Some(Self { pixmap, clip: None })
    }

    /// Returns a canvas with an image; `None` for an image without pixels.
    pub(super) fn on_top_of(image: &RgbImage) -> Option<Self> {
        let mut pixmap = Pixmap::new(image.width(), image.height())?;
        for (to, Rgb([r, g, b])) in pixmap.data_mut().chunks_exact_mut(4).zip(image.pixels()) {
            to.copy_from_slice(&[*r, *g, *b, 255]);
        }
        Some(Self { pixmap, clip: None })
    }

    pub(super) fn into_image(self) -> RgbImage {
        let mut image = RgbImage::new(self.pixmap.width(), self.pixmap.height());
        // The canvas is opaque throughout, so premultiplied and plain colours are the same.
        for (to, from) in image.pixels_mut().zip(self.pixmap.data().chunks_exact(4)) {
            to.0.copy_from_slice(&from[..3]);
        }
        image
    }

    /// Restricts strokes and shapes, but not text, to a rectangle until [`Canvas::unclip`].
    pub(super) fn clip_to(&mut self, low: DVec2, high: DVec2) {
        self.clip = Mask::new(self.pixmap.width(), self.pixmap.height());
        if let Some((mask, rect)) = self.clip.as_mut().zip(rectangle(low, high)) {
            mask.fill_path(&PathBuilder::from_rect(rect), FillRule::Winding, true, Transform::identity());
        }
    }

    pub(super) fn unclip(&mut self) {
        self.clip = None;
    }

    pub(super) fn fill_rectangle(&mut self, low: DVec2, high: DVec2, ink: Ink) {
        if let Some(rect) = rectangle(low, high) {
            self.fill(&PathBuilder::from_rect(rect), ink);
        }
    }

    pub(super) fn stroke_rectangle(&mut self, low: DVec2, high: DVec2, pen: Pen) {
        if let Some(rect) = rectangle(low, high) {
            self.stroke_path(&PathBuilder::from_rect(rect), pen);
        }
    }

    pub(super) fn fill_circle(&mut self, centre: DVec2, radius: f64, ink: Ink) {
        if let Some(path) = circle(centre, radius) {
            self.fill(&path, ink);
        }
    }

    pub(super) fn stroke_circle(&mut self, centre: DVec2, radius: f64, pen: Pen) {
        if let Some(path) = circle(centre, radius) {
            self.stroke_path(&path, pen);
        }
    }

    /// Draws all lines in one stroke: where they overlap, a transparent pen does not darken twice.
    pub(super) fn stroke(&mut self, lines: &[Vec<DVec2>], pen: Pen) {
        if let Some(path) = polylines(lines) {
            self.stroke_path(&path, pen);
        }
    }

    /// Draws words to the right; `at` is the left end of the baseline.
    pub(super) fn text(&mut self, at: DVec2, size: f64, colour: [u8; 3], words: &str) {
        self.words(Transform::from_translate(at.x as f32, at.y as f32), size, colour, words);
    }

    /// Draws words upwards; `at` is the lower end of the baseline.
    pub(super) fn text_upwards(&mut self, at: DVec2, size: f64, colour: [u8; 3], words: &str) {
        self.words(Transform::from_row(0.0, -1.0, 1.0, 0.0, at.x as f32, at.y as f32), size, colour, words);
    }

    fn words(&mut self, placed: Transform, size: f64, colour: [u8; 3], words: &str) {
        if let Some(path) = text::outline(size, words).and_then(|path| path.transform(placed)) {
            let bounds = path.bounds();
            if [bounds.left(), bounds.top(), bounds.right(), bounds.bottom()]
                .iter()
                .all(|edge| f64::from(edge.abs()) < MAX_COORDINATE_PX)
            {
                let ink = Ink::solid(colour).paint();
                self.pixmap.fill_path(&path, &ink, FillRule::Winding, Transform::identity(), None);
            }
        }
    }

    fn fill(&mut self, path: &Path, ink: Ink) {
        let clip = self.clip.as_ref();
        self.pixmap.fill_path(path, &ink.paint(), FillRule::Winding, Transform::identity(), clip);
    }

    fn stroke_path(&mut self, path: &Path, pen: Pen) {
        let (line_cap, line_join) =
            if pen.round { (LineCap::Round, LineJoin::Round) } else { (LineCap::Butt, LineJoin::Miter) };
        let stroke = Stroke { width: pen.width as f32, line_cap, line_join, ..Stroke::default() };
        self.pixmap.stroke_path(path, &pen.ink.paint(), &stroke, Transform::identity(), self.clip.as_ref());
    }
}

fn polylines(lines: &[Vec<DVec2>]) -> Option<Path> {
    let mut builder = PathBuilder::new();
    for line in lines {
        let mut points = line.iter().map(|point| clamp_to_range(*point));
        let Some(first) = points.next() else { continue };
        builder.move_to(first.x as f32, first.y as f32);
        for point in points {
            builder.line_to(point.x as f32, point.y as f32);
        }
    }
    builder.finish()
}

fn rectangle(low: DVec2, high: DVec2) -> Option<Rect> {
    let (low, high) = (clamp_to_range(low), clamp_to_range(high));
    Rect::from_ltrb(low.x as f32, low.y as f32, high.x as f32, high.y as f32)
}

fn circle(centre: DVec2, radius: f64) -> Option<Path> {
    let centre = clamp_to_range(centre);
    PathBuilder::from_circle(centre.x as f32, centre.y as f32, radius.min(MAX_COORDINATE_PX) as f32)
}

/// Moves a point to where the rasteriser can count.
fn clamp_to_range(point: DVec2) -> DVec2 {
    point.clamp(DVec2::splat(-MAX_COORDINATE_PX), DVec2::splat(MAX_COORDINATE_PX))
}
