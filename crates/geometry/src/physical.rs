//! The range of numbers that can describe a robot.
//!
//! A value outside of it, from a sensor, a file or an operator, is a fault. It is counted and left out before it enters any
//! calculation. Squares and products of numbers within the range neither overflow nor underflow.

use glam::{DQuat, DVec3};

use super::{Isometry, Pose2};

/// Largest magnitude of a measurement that is believed, in metres, radians or radians per second.
///
/// Coordinates of a map projection reach a million metres.
pub const MAX_MAGNITUDE: f64 = 2e6;
/// Largest length of anything on a robot, and largest height of a camera above the ground, metres.
pub const MAX_MOUNT_M: f64 = 100.0;
/// Smallest magnitude that is told from zero. Its square is still far above the smallest normal number.
pub const MIN_MAGNITUDE: f64 = 1e-30;
/// Lengths of a quaternion whose direction is still defined.
const QUATERNION_LENGTHS: core::ops::Range<f64> = 1e-12..1e12;

/// A value from outside that can be checked against what is physically possible for a robot.
pub trait Physical {
    /// Whether every number is finite and within the range that a robot can have.
    fn is_possible(&self) -> bool;
}

/// Replaces a number of smaller magnitude than [`MIN_MAGNITUDE`], denormal ones included, by zero; other numbers stay as they are.
pub fn settled(value: f64) -> f64 {
    if value.abs() < MIN_MAGNITUDE && value != 0.0 { 0.0 } else { value }
}

impl Physical for f64 {
    fn is_possible(&self) -> bool {
        self.abs() <= MAX_MAGNITUDE
    }
}

impl Physical for DVec3 {
    fn is_possible(&self) -> bool {
        self.to_array().iter().all(Physical::is_possible)
    }
}

impl Physical for DQuat {
    fn is_possible(&self) -> bool {
        QUATERNION_LENGTHS.contains(&self.length())
    }
}

impl Physical for Pose2 {
    fn is_possible(&self) -> bool {
        [self.x, self.y, self.yaw].iter().all(Physical::is_possible)
    }
}

impl Physical for Isometry {
    fn is_possible(&self) -> bool {
        self.rotation.is_possible() && self.translation.is_possible()
    }
}

impl<T: Physical> Physical for Option<T> {
    fn is_possible(&self) -> bool {
        self.as_ref().is_none_or(Physical::is_possible)
    }
}

impl<T: Physical> Physical for [T] {
    fn is_possible(&self) -> bool {
        self.iter().all(Physical::is_possible)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn squares_of_settled_possible_numbers_stay_normal(bits in any::<u64>()) {
            let value = settled(f64::from_bits(bits));
            if value.is_possible() {
                let square = value * value;
                prop_assert!(square == 0.0 || (square.is_normal() && (square * square).is_normal()));
            }
        }
    }

    #[test]
    fn nan_and_infinity_are_never_possible() {
        for wild in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e308, -2.1e6] {
            assert!(!wild.is_possible() && !DVec3::new(0.0, wild, 0.0).is_possible());
            assert!(!Pose2::new(0.0, 0.0, wild).is_possible() && !Some(wild).is_possible());
        }
        assert!(
            !DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0).is_possible() && DQuat::from_xyzw(0.0, 0.0, 0.0, 7.0).is_possible()
        );
        assert!(None::<f64>.is_possible() && (-0.0f64).is_possible());
    }

    #[test]
    fn a_denormal_number_settles_to_zero_and_a_signed_zero_stays() {
        assert_eq!(settled(5e-324), 0.0);
        assert_eq!(settled(-1e-160), 0.0);
        assert_eq!(settled(1e-17), 1e-17);
        assert!(settled(-0.0).is_sign_negative());
    }
}
