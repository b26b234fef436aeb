//! Painted lines over a camera image: where they should be if lens and pose are right.

use glam::{DVec2, DVec3};
use image::RgbImage;

use super::canvas::{Canvas, Ink};
use super::paint::{Edge, Patch, patches};
use realitysim_geometry::{Field, Isometry, Lens};

/// Draws the outline of the paint of the field, as the camera would see it, over the image half transparent.
///
/// The outline follows the lens as far as it sees, beyond 90 degrees too, and stops at the border of the image. An
/// image of another size than that of the lens counts as the whole picture, scaled. If the pose is not finite, the
/// image is returned unchanged.
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
    // The thinnest line that the eye can follow, at the scale at which an image of this size is viewed.
    let width = (size.x / 800.0).clamp(1.1, 3.0);
    canvas.stroke(&lines, Ink { colour, alpha: 0.75 }.pen(width));
    canvas.into_image()
}

/// Returns the outline of the paint of the field as a camera would see it: polylines in pixels of the lens, counted from the corner of
/// the image, (0.5, 0.5) being the centre of the first pixel.
///
/// The lines follow the lens, and end a little beyond the image. A pose that is not finite sees none.
pub fn projected_lines(lens: &Lens, map_from_camera_link: &Isometry, field: &Field) -> Vec<Vec<DVec2>> {
    let size = DVec2::new(f64::from(lens.width()), f64::from(lens.height()));
    outline(size, lens, map_from_camera_link, field)
}

/// Returns the outline of the paint as polylines.
///
/// Coordinates are pixels: (0, 0) is the corner of the image, and (0.5, 0.5) the centre of the first pixel.
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
            trace.follow(start, end, MAX_HALVINGS);
        }
    }
    lines
}

/// A lens at a pose, for an image of some size.
struct Camera<'a> {
    lens: &'a Lens,
    optical_from_map: Isometry,
    position: DVec3,
    /// Size of the image, pixels.
    size: DVec2,
    /// Image pixels per lens pixel.
    scale: DVec2,
}

impl Camera<'_> {
    /// Projects a point of the ground; `None` outside of the view or clearly outside of the image.
    fn project_ground(&self, ground: DVec2) -> Option<DVec2> {
        let pixel = self.lens.project(self.optical_from_map.transform_point(ground.extend(0.0)))?;
        // The lens counts pixels from their centres.
        let point = (pixel + 0.5) * self.scale;
        let near = |value: f64, size: f64| value > -BEYOND_PX && value < size + BEYOND_PX;
        (near(point.x, self.size.x) && near(point.y, self.size.y)).then_some(point)
    }
}

/// Distance that lines go on beyond the image, so that their ends do not show, pixels.
const BEYOND_PX: f64 = 16.0;
/// Longest straight piece, pixels: a fisheye bends it by less than 0.05 px.
const SPLIT_THRESHOLD_PX: f64 = 4.0;
/// Shortest distance between points, pixels: closer points only cost time.
const MIN_SPACING_PX: f64 = 0.5;
/// Longest piece that is not halved, per distance to the camera: it spans less than 3 degrees, about [`BEYOND_PX`].
const SPLIT_THRESHOLD_PER_DISTANCE: f64 = 0.05;
/// Largest number of halvings of an edge: they divide the longest line of the largest field to a hundredth of a
/// millimetre.
const MAX_HALVINGS: u32 = 24;

/// State of the conversion of one edge to polylines.
struct Trace<'a> {
    camera: &'a Camera<'a>,
    patches: &'a [Patch],
    /// Index of the patch that the edge belongs to.
    which: usize,
    edge: Edge,
    line_width: f64,
    lines: &'a mut Vec<Vec<DVec2>>,
    /// Whether the next piece continues the last polyline.
    open: bool,
}

/// A point of an edge, and where it shows.
#[derive(Clone, Copy)]
struct Sample {
    t: f64,
    seen: Option<DVec2>,
}

impl Trace<'_> {
    /// Samples the edge at `t`, 0 to 1. Points inside of other patches are not seen.
    fn sample(&self, t: f64) -> Sample {
        let ground = self.edge.at(t);
        let hidden = self.patches.iter().enumerate().any(|(i, patch)| i != self.which && patch.covers(ground));
        Sample { t, seen: if hidden { None } else { self.camera.project_ground(ground) } }
    }

    /// Halves a piece of the edge until it is straight in the image, or until the point where it appears is found.
    fn follow(&mut self, a: Sample, b: Sample, halvings: u32) {
        let far = |p: DVec2, q: DVec2| p.distance(q) > SPLIT_THRESHOLD_PX;
        let needs_split = match (a.seen, b.seen) {
            (Some(p), Some(q)) => far(p, q),
            (None, None) => false,
            _ => true,
        };
        if halvings > 0 && (needs_split || self.is_coarse(a.t, b.t)) {
            let middle = self.sample((a.t + b.t) / 2.0);
            self.follow(a, middle, halvings - 1);
            self.follow(middle, b, halvings - 1);
            return;
        }
        match (a.seen, b.seen) {
            // The ends are still apart: the image of the line jumps, as behind a lens that sees all around.
            (Some(p), Some(q)) if far(p, q) => self.open = false,
            (Some(p), Some(q)) => self.join(p, q),
            _ => self.open = false,
        }
    }

    /// Returns whether a crossing line or a corner of the image could lie between two samples.
    fn is_coarse(&self, a: f64, b: f64) -> bool {
        let distance = self.edge.at((a + b) / 2.0).extend(0.0).distance(self.camera.position);
        let longest = (SPLIT_THRESHOLD_PER_DISTANCE * distance).clamp(1e-4, self.line_width / 2.0);
        self.edge.length() * (b - a) > longest
    }

    /// Adds a straight piece to the polylines.
    fn join(&mut self, p: DVec2, q: DVec2) {
        match self.lines.last_mut().filter(|_| self.open) {
            Some(line) => {
                if let [.., before, last] = line.as_mut_slice()
                    && before.distance(*last) < MIN_SPACING_PX
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
