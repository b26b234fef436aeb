//! Absolute error at taped places: tags of a robot that stands on crossings of the field. Nothing is aligned.
//!
//! The error of a stand is `R(heading) offset + field + rest`: the offset turns with the robot (the camera's lever arm, its mount, how
//! the robot is put on the crossing), the other does not (lines that lie beside where the field file has them). Both are found by least
//! squares and reported; only the offset is taken out, and only for the figures that are named so.

use glam::DVec2;
use nalgebra::{DMatrix, DVector, Matrix4, Vector4};
use serde::Serialize;

use super::Measure;
use super::stands::{Stand, mean};
use crate::statistics::{Summary, rms};
use realitysim_geometry::wrap_angle;

/// The errors at all taped places.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Taped {
    /// Each stand.
    pub stands: Vec<StandError>,
    /// Number of different crossings.
    pub crossings: usize,
    /// Number of stands more than [`GROSS_M`] off: the crossing is another, or the tag is wrong. The offset is found without them.
    pub gross: usize,
    /// Root mean square of all distances, centimetres.
    pub rms_cm: f64,
    /// The distances, centimetres.
    pub position_cm: Summary,
    /// Sizes of the errors of heading, degrees.
    pub heading_deg: Summary,
    /// The constant part of the errors.
    pub offset: Measure<Offset>,
    /// What is left at crossings that took no part in finding the offset.
    pub held_out: Measure<HeldOut>,
}

/// The error of one stand.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StandError {
    /// The crossing.
    pub crossing: String,
    /// Its position in `map`, metres.
    pub at_m: DVec2,
    /// Heading as marked, degrees.
    pub heading_deg: f64,
    /// From the crossing to where the tags have the point between the feet, in `map`, metres.
    pub off_m: DVec2,
    /// The same in the coordinate frame of the robot as marked, centimetres: forward and left.
    pub forward_left_cm: DVec2,
    /// Heading by the tags less that marked, degrees.
    pub turned_deg: f64,
    /// Scatter of the tags about their mean, root mean square, centimetres.
    pub scatter_cm: f64,
    /// Number of tags.
    pub tags: usize,
    /// What is left at this crossing once the offset by the others is taken out, centimetres.
    pub held_out_cm: Option<f64>,
}

/// The parts of the errors that are the same in all stands.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Offset {
    /// What turns with the robot, centimetres: forward and left.
    pub forward_left_cm: DVec2,
    /// What is fixed to the field, centimetres: along x and y of `map`.
    pub field_cm: DVec2,
    /// Mean error of heading, degrees.
    pub turned_deg: f64,
    /// Standard deviation of each of the four lengths, the largest one, centimetres.
    pub sigma_cm: f64,
    /// Root mean square of what neither explains, centimetres.
    pub rest_cm: f64,
}

/// What the offset by the other crossings leaves at each crossing in turn.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct HeldOut {
    /// Root mean square of the distances, centimetres.
    pub rms_cm: f64,
    /// Largest root mean square of one crossing, centimetres.
    pub worst_cm: f64,
    /// Root mean square of the headings, degrees.
    pub heading_deg: f64,
}

/// A stand farther off is no inaccuracy, metres: it is another crossing, or a wrong tag.
pub const GROSS_M: f64 = 0.5;
/// Fewest crossings of which one can be held out.
pub const MIN_CROSSINGS: usize = 3;
/// Smallest eigenvalue of the mean normal matrix at which headings differ enough to tell robot from field.
const MIN_SPREAD: f64 = 0.05;

/// Compares stands with their crossings.
pub fn taped(stands: &[Stand]) -> Measure<Taped> {
    if stands.is_empty() {
        return Measure::missing(
            "no mark says where the robot stood: put it on a crossing and give `realitysim recorder mark \"at CROSSING HEADING\"`",
        );
    }
    let mut errors: Vec<StandError> = stands.iter().map(error_of).collect();
    let held_out = held_out(&mut errors);
    let fine: Vec<&StandError> = errors.iter().filter(|error| !error.is_gross()).collect();
    let offset = match fit(&fine) {
        Some(offset) => Measure::Known(offset),
        None => Measure::missing(
            "headings differ too little to tell robot from field: mark each crossing with opposite headings",
        ),
    };
    let distances: Vec<f64> = errors.iter().map(|error| 100.0 * error.off_m.length()).collect();
    let turned: Vec<f64> = errors.iter().map(|error| error.turned_deg.abs()).collect();
    Measure::Known(Taped {
        crossings: names(&errors).len(),
        gross: errors.len() - fine.len(),
        rms_cm: rms(distances.iter().copied()),
        position_cm: Summary::of(&distances),
        heading_deg: Summary::of(&turned),
        offset,
        held_out,
        stands: errors,
    })
}

impl StandError {
    /// Whether it is farther off than any inaccuracy.
    pub fn is_gross(&self) -> bool {
        self.off_m.length() > GROSS_M
    }
}

fn error_of(stand: &Stand) -> StandError {
    let at = mean(&stand.tagged);
    let off_m = DVec2::new(at.x, at.y) - stand.at_m;
    let scatter = stand.tagged.iter().map(|pose| libm::hypot(pose.x - at.x, pose.y - at.y));
    StandError {
        crossing: stand.crossing.clone(),
        at_m: stand.at_m,
        heading_deg: stand.heading_rad.to_degrees(),
        off_m,
        forward_left_cm: DVec2::from_angle(-stand.heading_rad).rotate(off_m) * 100.0,
        turned_deg: wrap_angle(at.yaw - stand.heading_rad).to_degrees(),
        scatter_cm: 100.0 * rms(scatter),
        tags: stand.tagged.len(),
        held_out_cm: None,
    }
}

fn names(errors: &[StandError]) -> Vec<String> {
    let mut names: Vec<String> = errors.iter().map(|error| error.crossing.clone()).collect();
    names.sort();
    names.dedup();
    names
}

/// Least squares of `off = R(heading) offset + field`. `None` if the headings do not separate the two.
fn fit(errors: &[&StandError]) -> Option<Offset> {
    let rows = errors.len();
    let (mut design, mut off) = (DMatrix::zeros(2 * rows, 4), DVector::zeros(2 * rows));
    for (row, error) in errors.iter().enumerate() {
        let DVec2 { x: cos, y: sin } = DVec2::from_angle(error.heading_deg.to_radians());
        design.view_mut((2 * row, 0), (2, 4)).copy_from_slice(&[cos, sin, -sin, cos, 1.0, 0.0, 0.0, 1.0]);
        (off[2 * row], off[2 * row + 1]) = (error.off_m.x, error.off_m.y);
    }
    let normal: Matrix4<f64> = (design.transpose() * &design).fixed_view::<4, 4>(0, 0).into();
    if rows < 3 || normal.symmetric_eigenvalues().min() / (rows as f64) < MIN_SPREAD {
        return None;
    }
    let inverse = normal.try_inverse()?;
    let right: Vector4<f64> = (design.transpose() * &off).fixed_rows::<4>(0).into();
    let found = inverse * right;
    let rest = (&off - &design * DVector::from_column_slice(found.as_slice())).norm_squared();
    let variance = rest / (2.0 * rows as f64 - 4.0).max(1.0);
    Some(Offset {
        forward_left_cm: DVec2::new(found[0], found[1]) * 100.0,
        field_cm: DVec2::new(found[2], found[3]) * 100.0,
        turned_deg: errors.iter().map(|error| error.turned_deg).sum::<f64>() / rows as f64,
        sigma_cm: 100.0 * libm::sqrt(variance * inverse.diagonal().max()),
        rest_cm: 100.0 * libm::sqrt(rest / rows as f64),
    })
}

/// Holds out each crossing in turn, and notes what is left in its stands.
fn held_out(errors: &mut [StandError]) -> Measure<HeldOut> {
    let names = names(errors);
    if names.len() < MIN_CROSSINGS {
        return Measure::missing(format!(
            "{} crossings are marked, and to hold one out takes {MIN_CROSSINGS}",
            names.len()
        ));
    }
    let (mut left_cm, mut turned_deg, mut worst_cm): (Vec<f64>, Vec<f64>, f64) = Default::default();
    for name in &names {
        let others: Vec<&StandError> =
            errors.iter().filter(|error| error.crossing != *name && !error.is_gross()).collect();
        let Some(offset) = fit(&others) else {
            return Measure::missing(
                "without one of the crossings headings differ too little: mark each with opposite headings",
            );
        };
        let mut here = Vec::new();
        for error in errors.iter_mut().filter(|error| error.crossing == *name) {
            let left = (error.forward_left_cm - offset.forward_left_cm).length();
            error.held_out_cm = Some(left);
            here.push(left);
            turned_deg.push(error.turned_deg - offset.turned_deg);
        }
        worst_cm = worst_cm.max(rms(here.iter().copied()));
        left_cm.extend(here);
    }
    Measure::Known(HeldOut { rms_cm: rms(left_cm), worst_cm, heading_deg: rms(turned_deg) })
}
