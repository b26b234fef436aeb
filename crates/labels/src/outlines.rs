//! Painted lines and marks as polygons in an image.

use glam::{DVec2, DVec3};

use realitysim_geometry::Isometry;
use realitysim_geometry::field::Stroke;

use crate::Labeller;
use crate::class_map::PosedImage;

/// A closed polygon in an image.
#[derive(Clone, Debug, PartialEq)]
pub struct Outline {
    /// Its corners, pixels; the left upper corner of the image is (0, 0), so that the first pixel's centre is (0.5, 0.5).
    pub corners: Vec<DVec2>,
}

/// Length of the pieces in which edges of paint are projected, metres.
const PIECE_M: f64 = 0.05;
/// Pieces of a stroke that belong to one outline at most, so that a circle becomes several outlines without a hole.
const PIECES_AT_ONCE: usize = 80;
/// Smallest area of an outline, square pixels.
const MIN_AREA_PX: f64 = 4.0;

impl Labeller {
    /// The painted lines and marks that an image shows, each as one or several outlines. What hides a part of them is not cut out.
    pub fn line_outlines(&self, image: &PosedImage) -> Vec<Outline> {
        let optical_from_map = (image.map_from_link * Isometry::link_from_optical()).inverse();
        let lens = image.camera.lens();
        let pixel = |at: DVec2| -> Option<DVec2> {
            let pixel = lens.project(optical_from_map.transform_point(DVec3::new(at.x, at.y, 0.0)))?;
            lens.contains(pixel).then_some(pixel + 0.5)
        };
        let half_width = self.field.line_width() / 2.0;
        let mut outlines = Vec::new();
        for stroke in self.field.painted_strokes() {
            let sides = cross_sections(&stroke, half_width)
                .into_iter()
                .map(|[left, right]| Some([pixel(left)?, pixel(right)?]));
            let mut run: Vec<[DVec2; 2]> = Vec::new();
            for section in sides.chain([None]) {
                if let Some(section) = section {
                    run.push(section);
                }
                if section.is_none() || run.len() > PIECES_AT_ONCE {
                    let last = run.last().copied();
                    outlines.extend(closed(&run));
                    run.clear();
                    // The next outline begins where this one ends.
                    run.extend(last.filter(|_| section.is_some()));
                }
            }
        }
        outlines
    }
}

/// The polygon between both sides; `None` if it is too small.
fn closed(run: &[[DVec2; 2]]) -> Option<Outline> {
    let corners: Vec<DVec2> = run.iter().map(|side| side[0]).chain(run.iter().rev().map(|side| side[1])).collect();
    let next = corners.iter().cycle().skip(1);
    let area: f64 = corners.iter().zip(next).map(|(a, b)| a.perp_dot(*b) / 2.0).sum();
    (run.len() >= 2 && area.abs() >= MIN_AREA_PX).then_some(Outline { corners })
}

/// The two edges of a stroke's paint at places along it.
fn cross_sections(stroke: &Stroke, half_width: f64) -> Vec<[DVec2; 2]> {
    let pieces = libm::ceil(stroke.length() / PIECE_M).max(1.0) as usize;
    let part = |i: usize| i as f64 / pieces as f64;
    match *stroke {
        Stroke::Segment { from, to } => {
            let across = (to - from).normalize_or(DVec2::X).perp() * half_width;
            (0..=pieces).map(|i| from.lerp(to, part(i))).map(|at| [at + across, at - across]).collect()
        }
        Stroke::Circle { centre, radius } => {
            let at = |i: usize| DVec2::from_angle(core::f64::consts::TAU * part(i));
            (0..=pieces)
                .map(at)
                .map(|out| [centre + out * (radius + half_width), centre + out * (radius - half_width)])
                .collect()
        }
        Stroke::Quarter { centre, radius, side } => {
            let at = |i: usize| DVec2::from_angle(core::f64::consts::FRAC_PI_2 * part(i)) * side;
            (0..=pieces)
                .map(at)
                .map(|out| [centre + out * (radius + half_width), centre + out * (radius - half_width)])
                .collect()
        }
    }
}
