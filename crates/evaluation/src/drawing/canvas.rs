//! A canvas with the few strokes and shapes that the pictures need, on tiny-skia. Positions are pixels with (0, 0) at
//! the corner of the picture.

use glam::DVec2;
use image::RgbImage;
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
        let mut canvas = Self { pixmap: Pixmap::new(image.width(), image.height())?, clip: None };
        canvas.place(image, [0, 0]);
        Some(canvas)
    }

    /// Draws an image with its upper left corner at a pixel. What lies beyond the canvas is left out.
    pub(super) fn place(&mut self, image: &RgbImage, [left, top]: [u32; 2]) {
        let columns = image.width().min(self.pixmap.width().saturating_sub(left)) as usize;
        let (from, to) = (3 * image.width().max(1) as usize, 4 * self.pixmap.width() as usize);
        let rows = self.pixmap.data_mut().chunks_exact_mut(to).skip(top as usize);
        for (row, image_row) in rows.zip(image.as_raw().chunks_exact(from)) {
            let Some(row) = row.get_mut(4 * left as usize..) else { return };
            let (pixels, _) = row.as_chunks_mut::<4>();
            let (colours, _) = image_row.as_chunks::<3>();
            for (to, [r, g, b]) in pixels[..columns].iter_mut().zip(colours) {
                *to = [*r, *g, *b, 255];
            }
        }
    }

    pub(super) fn into_image(self) -> RgbImage {
        let mut image = RgbImage::new(self.pixmap.width(), self.pixmap.height());
        // The canvas is opaque throughout, so premultiplied and plain colours are the same.
        let (colours, _) = image.as_chunks_mut::<3>();
        let (pixels, _) = self.pixmap.data().as_chunks::<4>();
        for (to, [r, g, b, _]) in colours.iter_mut().zip(pixels) {
            *to = [*r, *g, *b];
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

#[cfg(test)]
mod tests {
    use image::Rgb;

    use super::*;

    #[test]
    fn an_image_is_placed_as_far_as_it_lies_on_the_canvas() {
        let image = RgbImage::from_fn(3, 2, |x, y| Rgb([x as u8, y as u8, 7]));
        for [left, top] in [[0, 0], [1, 1], [2, 2], [4, 0], [9, 9], [0, 3]] {
            let mut canvas = Canvas::filled(4, 3, [200; 3]).expect("it has pixels");
            canvas.place(&image, [left, top]);
            for (x, y, pixel) in canvas.into_image().enumerate_pixels() {
                let inside = (left..left + 3).contains(&x) && (top..top + 2).contains(&y);
                let wanted = if inside { *image.get_pixel(x - left, y - top) } else { Rgb([200; 3]) };
                assert_eq!(*pixel, wanted, "({x}, {y}) at {left}, {top}");
            }
        }
    }
}
