//! Detects falls from the lean of the torso, which the IMU measures.
//!
//! Lines reveal a fall late: on the way down, and on the floor, too few are in view to contradict a pose.

use serde::{Deserialize, Serialize};

/// Follows the robot through falls, frame by frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FallDetector {
    fall: Option<Fall>,
}

/// A fall that has not ended.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Fall {
    /// Time at which the torso first leant too far.
    began_ns: i64,
    /// Time at which the torso last leant too far for a standing robot.
    leant_ns: i64,
}

/// Posture of the robot in one frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FallState {
    /// The robot stands.
    Stands,
    /// The robot is falling, lies on the floor or is getting up.
    Fallen,
    /// The robot stands again since this frame, and may have been moved meanwhile.
    HasRisen,
}

/// Lean beyond which a humanoid falls: no gait leans the torso so far. Radians.
const FALLING_RAD: f64 = 0.52;
/// Lean below which a fallen robot is upright again, radians.
const UPRIGHT_RAD: f64 = 0.35;
/// Time for which a fallen robot must be upright until it counts as standing, nanoseconds.
const UPRIGHT_NS: i64 = 500_000_000;
/// A lean that lasts no longer than this is a measurement error: it has not moved the robot. Nanoseconds.
const BLINK_NS: i64 = 150_000_000;

impl FallDetector {
    /// Takes the lean of one frame and returns the posture.
    ///
    /// `lean_rad` is the angle between the torso's axis and the vertical; `None`, where nothing measures it, changes nothing.
    pub fn update(&mut self, stamp_ns: i64, lean_rad: Option<f64>) -> FallState {
        let Some(lean_rad) = lean_rad else {
            return if self.fall.is_some() { FallState::Fallen } else { FallState::Stands };
        };
        let Some(fall) = &mut self.fall else {
            if lean_rad <= FALLING_RAD {
                return FallState::Stands;
            }
            self.fall = Some(Fall { began_ns: stamp_ns, leant_ns: stamp_ns });
            return FallState::Fallen;
        };
        if lean_rad > UPRIGHT_RAD {
            fall.leant_ns = stamp_ns;
        }
        // Negative where the clock was set back, which must not prolong the fall.
        let upright_ns = stamp_ns.saturating_sub(fall.leant_ns);
        if (0..UPRIGHT_NS).contains(&upright_ns) {
            return FallState::Fallen;
        }
        let lay_ns = fall.leant_ns.saturating_sub(fall.began_ns);
        self.fall = None;
        if lay_ns > BLINK_NS { FallState::HasRisen } else { FallState::Stands }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn judged(leans_deg: &[(usize, f64)]) -> Vec<FallState> {
        let mut posture = FallDetector::default();
        let leans = leans_deg.iter().flat_map(|(frames, lean)| std::iter::repeat_n(*lean, *frames));
        leans.enumerate().map(|(at, lean)| posture.update(at as i64 * 100_000_000, Some(lean.to_radians()))).collect()
    }

    #[test]
    fn a_walking_robot_stands_and_one_that_is_getting_up_does_not_yet() {
        assert!(judged(&[(5, 3.0), (5, 18.0), (5, 25.0)]).iter().all(|stand| *stand == FallState::Stands));
        let fall = judged(&[(5, 3.0), (2, 45.0), (9, 90.0), (3, 25.0), (9, 5.0)]);
        assert!(fall[..5].iter().all(|stand| *stand == FallState::Stands));
        assert!(fall[5..23].iter().all(|stand| *stand == FallState::Fallen), "{fall:?}");
        assert_eq!(fall[23], FallState::HasRisen);
        assert!(fall[24..].iter().all(|stand| *stand == FallState::Stands));
    }

    #[test]
    fn a_lean_of_one_frame_is_no_fall() {
        let blink = judged(&[(5, 3.0), (1, 60.0), (9, 3.0)]);
        assert!(!blink.contains(&FallState::HasRisen) && blink[14] == FallState::Stands, "{blink:?}");
    }

    #[test]
    fn a_missing_lean_changes_nothing_and_a_clock_set_back_ends_a_fall() {
        let mut posture = FallDetector::default();
        assert_eq!(posture.update(0, None), FallState::Stands);
        posture.update(5_000_000_000, Some(1.0));
        assert_eq!(posture.update(5_100_000_000, None), FallState::Fallen);
        assert_ne!(posture.update(1_000_000_000, Some(0.0)), FallState::Fallen);
    }
}
