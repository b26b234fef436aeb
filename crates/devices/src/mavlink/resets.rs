//! Joins odometry across the jumps of a device's estimate.

use super::measurement::{DeviceTime, Step};
use glam::DQuat;
use realitysim_geometry::Isometry;

/// Turns the poses that a device sends into those of one unbroken path.
#[derive(Debug, Default)]
pub(super) struct Continuity {
    last: Option<Last>,
    /// `path_from_odom` of the device's present coordinate frame; `None` before the first jump.
    correction: Option<Isometry>,
}

/// The last message, on the unbroken path.
#[derive(Debug)]
struct Last {
    time: Option<DeviceTime>,
    step: Step,
}

/// Longest time over which the last velocity is carried on at a jump, nanoseconds.
const MAX_BRIDGED_NS: i64 = 500_000_000;
/// A clock that goes back by more, nanoseconds, shows that the device has restarted. Its estimate then jumps, too, even if
/// `reset_counter` stays the same.
const MAX_BACK_NS: i64 = 500_000_000;

impl Continuity {
    /// Returns the message with its pose on the unbroken path, and whether the estimate has jumped.
    ///
    /// Over a jump the robot is taken to have moved on with the last velocity, because `reset_counter` says only that the
    /// estimate jumped, not by how much.
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

/// Returns the time since the last message by the device's clock, nanoseconds; 0 where that is not known.
fn elapsed_ns(last: &Last, now: Option<DeviceTime>) -> i64 {
    match (last.time, now) {
        (Some(before), Some(now)) if before.base == now.base => now.floor_ns.saturating_sub(before.floor_ns),
        _ => 0,
    }
}

/// Returns the motion since the last message at the last velocity; none after a long silence.
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
