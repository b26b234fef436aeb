//! What odometry is worth: its scale in each direction, and what remains.

use serde::Serialize;

use super::GameFrame;
use realitysim_geometry::{Pose2, wrap_angle};

/// A direction in which a robot moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Motion {
    /// Along x.
    Forward,
    /// Against x.
    Backward,
    /// Along y.
    Left,
    /// Against y.
    Right,
    /// Anticlockwise.
    TurnLeft,
    /// Clockwise.
    TurnRight,
}

/// All directions.
const MOTIONS: [Motion; 6] =
    [Motion::Forward, Motion::Backward, Motion::Left, Motion::Right, Motion::TurnLeft, Motion::TurnRight];

/// The odometry of one direction.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct DirectionFit {
    /// The direction.
    pub motion: Motion,
    /// How far the odometry says that the robot moved in it, metres or degrees.
    pub moved: f64,
    /// The true motion over that of the odometry; 1 is right, less than 1 is slip. `None` if it moved too little to tell.
    pub scale: Option<f64>,
    /// Standard deviation of `scale`.
    pub sigma: Option<f64>,
}

/// The odometry of a game.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct OdometryFit {
    /// Each direction.
    pub directions: Vec<DirectionFit>,
    /// Root mean square of what the scales leave of a second's motion, metres.
    pub left_m: f64,
    /// The same of turns, degrees.
    pub left_deg: f64,
    /// Number of seconds that were compared.
    pub seconds: usize,
}

/// Time over which motions are compared, nanoseconds: several steps of a walk.
const STEP_NS: i64 = 1_000_000_000;
/// Longest time, if a frame is missing, nanoseconds.
const LONGEST_STEP_NS: i64 = 1_300_000_000;
/// Least motion in a direction that determines its scale: metres.
const TELLING_M: f64 = 0.5;
/// The same of turns, radians.
const TELLING_RAD: f64 = 0.8;
/// A motion that differs by more than this, in metres, from its odometry is a kick, a fall or a hand that carries the robot.
const CARRIED_M: f64 = 0.4;
/// The same of turns, radians.
const CARRIED_RAD: f64 = 0.7;

impl OdometryFit {
    /// Compares the motion of each second by odometry with that by the tags.
    pub fn of(frames: &[GameFrame]) -> Self {
        let steps = steps(frames);
        let mut left = [0.0; 3];
        let mut directions: Vec<DirectionFit> = Vec::new();
        let mut scales = [[1.0; 2]; 3];
        for (axis, scales) in scales.iter_mut().enumerate() {
            for (back, scale) in scales.iter_mut().enumerate() {
                let sign = if back == 1 { -1.0 } else { 1.0 };
                let own: Vec<(f64, f64)> = (steps.iter())
                    .map(|(odometry, tagged)| (sign * odometry[axis], sign * tagged[axis]))
                    .filter(|(odometry, _)| *odometry > 0.0)
                    .collect();
                let fit = fit(MOTIONS[2 * axis + back], &own);
                *scale = fit.scale.unwrap_or(1.0);
                directions.push(fit);
            }
        }
        for (odometry, tagged) in &steps {
            for axis in 0..3 {
                let scale = scales[axis][usize::from(odometry[axis] < 0.0)];
                left[axis] += (tagged[axis] - scale * odometry[axis]).powi(2);
            }
        }
        let count = steps.len().max(1) as f64;
        let left_m = libm::sqrt((left[0] + left[1]) / count);
        Self { directions, left_m, left_deg: libm::sqrt(left[2] / count).to_degrees(), seconds: steps.len() }
    }
}

/// The scale of one direction by least squares through the origin.
fn fit(motion: Motion, pairs: &[(f64, f64)]) -> DirectionFit {
    let is_turn = matches!(motion, Motion::TurnLeft | Motion::TurnRight);
    // The sum of nothing would be -0.
    let moved = pairs.iter().fold(0.0, |moved, (odometry, _)| moved + odometry);
    let shown = if is_turn { moved.to_degrees() } else { moved };
    if pairs.len() < 3 || moved < if is_turn { TELLING_RAD } else { TELLING_M } {
        return DirectionFit { motion, moved: shown, scale: None, sigma: None };
    }
    let squares: f64 = pairs.iter().map(|(odometry, _)| odometry * odometry).sum();
    let scale = pairs.iter().map(|(odometry, tagged)| odometry * tagged).sum::<f64>() / squares;
    let rest: f64 = pairs.iter().map(|(odometry, tagged)| (tagged - scale * odometry).powi(2)).sum();
    let sigma = libm::sqrt(rest / (pairs.len() - 1) as f64 / squares);
    DirectionFit { motion, moved: shown, scale: Some(scale), sigma: Some(sigma) }
}

/// The motions of about a second each, by odometry and by tags: x, y in metres and turn in radians, in the robot's frame.
fn steps(frames: &[GameFrame]) -> Vec<([f64; 3], [f64; 3])> {
    let known: Vec<(i64, Pose2, Pose2)> =
        frames.iter().filter_map(|frame| Some((frame.stamp_ns, frame.odometry?, frame.tagged?))).collect();
    let (mut found, mut at) = (Vec::new(), 0);
    while let Some((from_ns, odometry, tagged)) = known.get(at) {
        let next = known[at..].iter().position(|(stamp_ns, ..)| stamp_ns - from_ns >= STEP_NS).map(|steps| at + steps);
        let Some(next) = next else { break };
        let (to_ns, to_odometry, to_tagged) = known[next];
        if to_ns - from_ns <= LONGEST_STEP_NS {
            let pair = (motion(*odometry, to_odometry), motion(*tagged, to_tagged));
            let off: [f64; 3] = core::array::from_fn(|axis| (pair.0[axis] - pair.1[axis]).abs());
            if libm::hypot(off[0], off[1]) < CARRIED_M && off[2] < CARRIED_RAD {
                found.push(pair);
            }
        }
        at = next;
    }
    found
}

/// The motion from one pose to another, in the frame of the first: x, y in metres, turn in radians.
pub(super) fn motion(from: Pose2, to: Pose2) -> [f64; 3] {
    let (sine, cosine) = libm::sincos(from.yaw);
    let (x, y) = (to.x - from.x, to.y - from.y);
    [cosine * x + sine * y, cosine * y - sine * x, wrap_angle(to.yaw - from.yaw)]
}
