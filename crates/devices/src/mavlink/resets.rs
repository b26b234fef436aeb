//! Odometry that goes on through the jumps of the device's estimate.

use super::measurement::{DeviceTime, Step};
use glam::DQuat;
use realitysim_geometry::Isometry;

/// What turns a device's poses into those of one unbroken path.
#[derive(Debug, Default)]
pub(super) struct Continuity {
    last: Option<Last>,
    /// `path_from_odom`: of the device's present frame.
    correction: Option<Isometry>,
}

#[derive(Debug)]
struct Last {
    time: Option<DeviceTime>,
    step: Step,
}

/// Across a longer silence a twist says nothing about where the robot went.
const MAX_BRIDGED_NS: i64 = 500_000_000;
/// A clock that goes back by more is that of a device that has started anew, whose estimate has too, and whose
/// `reset_counter` may be what it was.
const MAX_BACK_NS: i64 = 500_000_000;

impl Continuity {
    /// The pose on the unbroken path, and whether the estimate has jumped.
    ///
    /// Over a jump the robot is taken to have moved on with the last twist: `reset_counter` says that the estimate jumped,
    /// not by how much.
    pub fn join(&mut self, time: Option<DeviceTime>, mut step: Box<Step>) -> (Box<Step>, bool) {
        let jumped = self
            .last
            .as_ref()
            .is_some_and(|last| last.step.reset_counter != step.reset_counter || elapsed_ns(last, time) < -MAX_BACK_NS);
        if let (true, Some(last)) = (jumped, &self.last) {
            let moved = last.step.odom_from_body * motion(last, time);
            self.correction = Some(moved * step.odom_from_body.inverse());
        }
        if let Some(correction) = self.correction {
            step.odom_from_body = correction * step.odom_from_body;
        }
        self.last = Some(Last { time, step: *step });
        (step, jumped)
    }
}

/// By the device's clock; 0 where it does not say.
fn elapsed_ns(last: &Last, now: Option<DeviceTime>) -> i64 {
    match (last.time, now) {
        (Some(before), Some(now)) if before.base == now.base => now.floor_ns.saturating_sub(before.floor_ns),
        _ => 0,
    }
}

fn motion(last: &Last, now: Option<DeviceTime>) -> Isometry {
    let elapsed_ns = elapsed_ns(last, now);
    if !(0..=MAX_BRIDGED_NS).contains(&elapsed_ns) {
        return Isometry::IDENTITY;
    }
    let seconds = elapsed_ns as f64 * 1e-9;
    let turn = last.step.angular_velocity * seconds;
    let angle = turn.length();
    let (sine, cosine) = (libm::sin(angle / 2.0), libm::cos(angle / 2.0));
    let axis = if angle > 0.0 { turn / angle } else { turn };
    let rotation = DQuat::from_xyzw(axis.x * sine, axis.y * sine, axis.z * sine, cosine);
    Isometry::new(rotation, last.step.velocity * seconds)
}
