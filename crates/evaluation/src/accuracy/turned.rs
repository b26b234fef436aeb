//! The same place in opposite headings: half the difference of the tags is what turns with the robot.
//!
//! Where the crossing lies cancels: this needs neither a tape nor a field that was laid out well, only that the robot stood on the same
//! spot both times.

use glam::DVec2;
use serde::Serialize;

use super::Measure;
use super::taped::{StandError, Taped};
use crate::statistics::rms;
use realitysim_geometry::wrap_angle;

/// What turns with the robot, from pairs of stands on one crossing with opposite headings.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Turned {
    /// Number of pairs.
    pub pairs: usize,
    /// Mean of the halved differences in the coordinate frame of the robot, centimetres: forward and left.
    pub forward_left_cm: DVec2,
    /// Root mean square of their scatter about that mean, centimetres.
    pub scatter_cm: f64,
}

/// Largest deviation from opposite headings, radians.
const MAX_OFF_RAD: f64 = 0.27;

/// Compares the stands of each crossing that have opposite headings.
pub fn turned(taped: &Measure<Taped>) -> Measure<Turned> {
    let stands: Vec<&StandError> = taped.known().map(|taped| taped.stands.iter().collect()).unwrap_or_default();
    let mut halves = Vec::new();
    for (index, one) in stands.iter().enumerate() {
        halves.extend(stands[index + 1..].iter().filter_map(|other| half_difference(one, other)));
    }
    if halves.is_empty() {
        return Measure::missing(
            "no crossing is marked with two opposite headings: mark each with 0, 90, 180 and 270 degrees",
        );
    }
    let mean = halves.iter().sum::<DVec2>() / halves.len() as f64;
    let scatter_cm = rms(halves.iter().map(|half| half.distance(mean)));
    Measure::Known(Turned { pairs: halves.len(), forward_left_cm: mean, scatter_cm })
}

/// Half the difference in the coordinate frame of the robot, centimetres; `None` of stands that are no such pair.
fn half_difference(one: &StandError, other: &StandError) -> Option<DVec2> {
    let [heading, opposite] = [one, other].map(|stand| stand.heading_deg.to_radians());
    let off = wrap_angle(heading - opposite - core::f64::consts::PI).abs();
    let is_pair = one.crossing == other.crossing && off < MAX_OFF_RAD && !one.is_gross() && !other.is_gross();
    is_pair.then(|| DVec2::from_angle(-heading).rotate(one.off_m - other.off_m) * 50.0)
}
