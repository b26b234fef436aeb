//! Painted lines over a camera image: where they should be if lens and pose are right.

use glam::{DVec2, DVec3};
use image::RgbImage;

use super::canvas::{Canvas, Ink};
use super::paint::{Edge, Patch, patches};
use realitysim_geometry::{Field, Isometry, Lens};

/// The outline of the field's paint as the camera would see it, drawn over the image half transparent.
///
/// Follows the lens as far as it sees, beyond 90 deg too, and stops at the image's border. An image of another size
/// than the lens's counts as the whole picture, scaled. Without a finite pose the image comes back as it is.
pub fn overlay(
    image: &RgbImage,
    lens: &Lens,
    map_from_camera_link: &Isometry,
    field: &Field,
    colour: [u8; 3],
) -> RgbImage {
    let Some(mut canvas) = Canvas::on_top_of(image) else { return image.clone() };
    let size = DVec2::new(f64::from(image.width()), f64::from(image.height()));
    let lines = outline(size, lens, map_from_camera_link, field);
    // As thin as can be followed by eye, at the size at which an image of this size is looked at.
    let width = (size.x / 800.0).clamp(1.1, 3.0);
    canvas.stroke(&lines, Ink { colour, alpha: 0.75 }.pen(width));
    canvas.into_image()
}

/// Polylines in picture coordinates: (0, 0) is the image's corner, the first pixel's centre is (0.5, 0.5).
pub(super) fn outline(size: DVec2, lens: &Lens, map_from_camera_link: &Isometry, field: &Field) -> Vec<Vec<DVec2>> {
    if !map_from_camera_link.is_finite() {
        return Vec::new();
    }
    let camera = Camera {
        lens,
        optical_from_map: (*map_from_camera_link * Isometry::link_from_optical()).inverse(),
        position: map_from_camera_link.translation,
        size,
        scale: size / DVec2::new(f64::from(lens.width()), f64::from(lens.height())),
    };
    let patches = patches(field);
    let mut lines = Vec::new();
    for (which, patch) in patches.iter().enumerate() {
        for edge in patch.edges() {
            let line_width = field.line_width();
            let mut trace =
                Trace { camera: &camera, patches: &patches, which, edge, line_width, lines: &mut lines, open: false };
            let (start, end) = (trace.sample(0.0), trace.sample(1.0));
            trace.follow(start, end, MOST_HALVINGS);
        }
    }
    lines
}

struct Camera<'a> {
    lens: &'a Lens,
    optical_from_map: Isometry,
    position: DVec3,
    size: DVec2,
    /// Image pixels per lens pixel.
    scale: DVec2,
}

impl Camera<'_> {
    /// Where a point of the ground shows; `None` outside the view or clearly outside the image.
    fn see(&self, ground: DVec2) -> Option<DVec2> {
        let pixel = self.lens.project(self.optical_from_map.transform_point(ground.extend(0.0)))?;
        // The lens counts from pixel centres.
        let point = (pixel + 0.5) * self.scale;
        let near = |value: f64, size: f64| value > -BEYOND_PX && value < size + BEYOND_PX;
        (near(point.x, self.size.x) && near(point.y, self.size.y)).then_some(point)
    }
}

/// Lines run on a little beyond the image, so that their ends do not show.
const BEYOND_PX: f64 = 16.0;
/// A straight piece this long cannot be told from the curve: a fisheye bends it by less than 0.05 px.
const LONGEST_PX: f64 = 4.0;
/// Closer points would only cost time.
const SHORTEST_PX: f64 = 0.5;
/// Looked at one by one until a piece spans less than 3 deg: about [`BEYOND_PX`].
const LONGEST_PER_DISTANCE: f64 = 0.05;
/// Halves the longest line of the largest field to a hundredth of a millimetre.
const MOST_HALVINGS: u32 = 24;

/// One edge on its way into polylines.
struct Trace<'a> {
    camera: &'a Camera<'a>,
    patches: &'a [Patch],
    which: usize,
    edge: Edge,
    line_width: f64,
    lines: &'a mut Vec<Vec<DVec2>>,
    /// Whether the last line may grow.
    open: bool,
}

#[derive(Clone, Copy)]
struct Sample {
    t: f64,
    seen: Option<DVec2>,
}

impl Trace<'_> {
    fn sample(&self, t: f64) -> Sample {
        let ground = self.edge.at(t);
        let hidden = self.patches.iter().enumerate().any(|(i, patch)| i != self.which && patch.covers(ground));
        Sample { t, seen: if hidden { None } else { self.camera.see(ground) } }
    }

    /// Halves the piece until it is straight on the image, or until the place where it appears is found.
    fn follow(&mut self, a: Sample, b: Sample, halvings: u32) {
        let far = |p: DVec2, q: DVec2| p.distance(q) > LONGEST_PX;
        let rough = match (a.seen, b.seen) {
            (Some(p), Some(q)) => far(p, q),
            (None, None) => false,
            _ => true,
        };
        if halvings > 0 && (rough || self.coarse(a.t, b.t)) {
            let middle = self.sample((a.t + b.t) / 2.0);
            self.follow(a, middle, halvings - 1);
            self.follow(middle, b, halvings - 1);
            return;
        }
        match (a.seen, b.seen) {
            // Still apart: the image of the line jumps, as behind a lens that sees all around.
            (Some(p), Some(q)) if far(p, q) => self.open = false,
            (Some(p), Some(q)) => self.join(p, q),
            _ => self.open = false,
        }
    }

    /// Whether a crossing line or a corner of the image could hide between the two.
    fn coarse(&self, a: f64, b: f64) -> bool {
        let distance = self.edge.at((a + b) / 2.0).extend(0.0).distance(self.camera.position);
        let longest = (LONGEST_PER_DISTANCE * distance).clamp(1e-4, self.line_width / 2.0);
        self.edge.length() * (b - a) > longest
    }

    fn join(&mut self, p: DVec2, q: DVec2) {
        match self.lines.last_mut().filter(|_| self.open) {
            Some(line) => {
                if let [.., before, last] = line.as_mut_slice()
                    && before.distance(*last) < SHORTEST_PX
                {
                    *last = q;
                } else {
                    line.push(q);
                }
            }
            None => self.lines.push(vec![p, q]),
        }
        self.open = true;
    }
}
