//! Integrates the velocity of a robot on the ground to a pose, for robots whose odometry is a velocity.

use serde::{Deserialize, Serialize};

use realitysim_geometry::{Physical, Pose2};

/// Velocity of the footprint along its own axes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PlanarVelocity {
    /// Forwards, metres per second.
    pub x_m_per_s: f64,
    /// To the left, metres per second.
    pub y_m_per_s: f64,
    /// About the vertical, radians per second.
    pub yaw_rad_per_s: f64,
}

/// The pose that velocities have added up to.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct VelocityIntegrator {
    /// Stamp (ns) and value of the last velocity.
    last: Option<(i64, PlanarVelocity)>,
    /// Pose since the first velocity, metres and radians.
    pose: Pose2,
    /// Stamp of the first velocity after the last gap, nanoseconds.
    begun_anew_ns: Option<i64>,
}

/// Longest time between two velocities that is integrated over, nanoseconds. Over a longer one nothing says how far the robot walked.
pub const MAX_VELOCITY_GAP_NS: i64 = 500_000_000;

impl VelocityIntegrator {
    /// Takes a velocity, and returns the pose at its time; `None` if it is not later than the last one.
    pub fn push(&mut self, stamp_ns: i64, velocity: PlanarVelocity) -> Option<Pose2> {
        let last = self.last;
        if let Some((last_ns, _)) = last
            && (-MAX_VELOCITY_GAP_NS..=0).contains(&stamp_ns.saturating_sub(last_ns))
        {
            return None;
        }
        self.last = Some((stamp_ns, velocity));
        let Some((last_ns, before)) = last else { return Some(self.pose) };
        let step_ns = stamp_ns.saturating_sub(last_ns);
        if (1..=MAX_VELOCITY_GAP_NS).contains(&step_ns) {
            let moved = self.pose.compose(&arc(before, velocity, step_ns as f64 * 1e-9));
            // A pose beyond all bounds begins at the origin again, as after a gap.
            (self.pose, self.begun_anew_ns) =
                if moved.is_possible() { (moved, self.begun_anew_ns) } else { (Pose2::default(), Some(stamp_ns)) };
        } else {
            self.begun_anew_ns = Some(stamp_ns);
        }
        Some(self.pose)
    }

    /// Returns whether a gap ended after `since_ns` and not after `until_ns`, so that the way between them is not known.
    pub fn has_gap_between(&self, since_ns: i64, until_ns: i64) -> bool {
        self.begun_anew_ns.is_some_and(|begun_ns| since_ns < begun_ns && begun_ns <= until_ns)
    }
}

/// The step of a robot whose velocity changes evenly: an arc of a circle with the mean velocity.
fn arc(before: PlanarVelocity, after: PlanarVelocity, seconds: f64) -> Pose2 {
    let mean = |a: f64, b: f64| 0.5 * (a + b) * seconds;
    let (x, y) = (mean(before.x_m_per_s, after.x_m_per_s), mean(before.y_m_per_s, after.y_m_per_s));
    let yaw = mean(before.yaw_rad_per_s, after.yaw_rad_per_s);
    let (sin, cos) = libm::sincos(yaw);
    // sin(yaw) / yaw and (1 - cos(yaw)) / yaw, by their series where the quotient would lose digits.
    let (along, across) = if yaw.abs() < 1e-4 {
        (1.0 - yaw * yaw / 6.0, 0.5 * yaw - yaw * yaw * yaw / 24.0)
    } else {
        (sin / yaw, (1.0 - cos) / yaw)
    };
    Pose2::new(along * x - across * y, across * x + along * y, yaw)
}

impl Physical for PlanarVelocity {
    fn is_possible(&self) -> bool {
        [self.x_m_per_s, self.y_m_per_s, self.yaw_rad_per_s].iter().all(Physical::is_possible)
    }
}

impl Physical for VelocityIntegrator {
    fn is_possible(&self) -> bool {
        self.pose.is_possible() && self.last.is_none_or(|(_, velocity)| velocity.is_possible())
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        /// The oracle adds up a thousand small straight steps.
        #[test]
        fn a_constant_velocity_gives_the_circle_that_small_steps_give(
            x in -1.0f64..1.0, y in -1.0f64..1.0, yaw in -3.0f64..3.0,
        ) {
            let velocity = PlanarVelocity { x_m_per_s: x, y_m_per_s: y, yaw_rad_per_s: yaw };
            let mut integrator = VelocityIntegrator::default();
            integrator.push(0, velocity);
            let found = (1..=5).map(|i| integrator.push(i * 100_000_000, velocity)).last().flatten().expect("taken");
            let small = Pose2::new(x * 5e-4, y * 5e-4, yaw * 5e-4);
            let expected = (0..1000).fold(Pose2::default(), |pose, _| pose.compose(&small));
            prop_assert!(found.distance(&expected) < 1e-3, "{found:?} {expected:?}");
            prop_assert!((found.yaw - expected.yaw).abs() < 1e-9);
        }

        #[test]
        fn no_velocities_make_a_pose_that_is_not_finite(
            samples in prop::collection::vec((any::<i64>(), prop::array::uniform3(-2e6f64..2e6)), 0..40),
        ) {
            let mut integrator = VelocityIntegrator::default();
            for (stamp_ns, [x_m_per_s, y_m_per_s, yaw_rad_per_s]) in samples {
                let pose = integrator.push(stamp_ns, PlanarVelocity { x_m_per_s, y_m_per_s, yaw_rad_per_s });
                prop_assert!(pose.is_none_or(|pose| pose.is_possible()) && integrator.is_possible());
            }
        }
    }

    #[test]
    fn over_a_gap_nothing_is_integrated_and_the_gap_is_known() {
        let ahead = PlanarVelocity { x_m_per_s: 1.0, ..PlanarVelocity::default() };
        let mut integrator = VelocityIntegrator::default();
        let second = 1_000_000_000;
        assert_eq!(integrator.push(0, ahead), Some(Pose2::default()));
        let there = integrator.push(second / 2, ahead).expect("taken");
        assert!((there.x - 0.5).abs() < 1e-12);
        assert_eq!(integrator.push(second / 2, ahead), None, "known already");
        assert_eq!(integrator.push(second * 2, ahead), Some(there), "a gap");
        assert!(integrator.has_gap_between(second, second * 2) && !integrator.has_gap_between(second * 2, second * 3));
        assert!(integrator.push(second * 2 + second / 10, ahead).expect("taken").x > 0.59);
    }
}
