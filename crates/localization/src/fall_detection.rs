//! Whether the robot stands, by how far its IMU says that the torso leans.
//!
//! Lines tell a fall late: on the way down, and on the floor, too few are in view to contradict anything.

use serde::{Deserialize, Serialize};

/// What the leans so far say.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FallDetector {
    fall: Option<Fall>,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Fall {
    began_ns: i64,
    /// When the torso was last seen to lean too far to stand.
    leant_ns: i64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FallState {
    Stands,
    Fallen,
    /// Stands again, and may have been moved meanwhile.
    HasRisen,
}

/// No gait leans the torso so far: beyond it a humanoid falls.
const FALLING_RAD: f64 = 0.52;
/// Who has got up leans less than this for so long.
const UPRIGHT_RAD: f64 = 0.35;
const UPRIGHT_NS: i64 = 500_000_000;
/// A torso that seemed to lean for no longer than this has not moved the robot.
const BLINK_NS: i64 = 150_000_000;

impl FallDetector {
    /// `lean_rad`: between the torso's axis and the vertical; none where nothing measures it, which says nothing.
    pub fn judge(&mut self, stamp_ns: i64, lean_rad: Option<f64>) -> FallState {
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
        // A clock that was set back must not keep the robot down.
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
        leans.enumerate().map(|(at, lean)| posture.judge(at as i64 * 100_000_000, Some(lean.to_radians()))).collect()
    }

    #[test]
    fn who_walks_stands_and_who_leans_on_his_way_up_does_not_yet() {
        assert!(judged(&[(5, 3.0), (5, 18.0), (5, 25.0)]).iter().all(|stand| *stand == FallState::Stands));
        let fall = judged(&[(5, 3.0), (2, 45.0), (9, 90.0), (3, 25.0), (9, 5.0)]);
        assert!(fall[..5].iter().all(|stand| *stand == FallState::Stands));
        assert!(fall[5..23].iter().all(|stand| *stand == FallState::Fallen), "{fall:?}");
        assert_eq!(fall[23], FallState::HasRisen);
        assert!(fall[24..].iter().all(|stand| *stand == FallState::Stands));
    }

    #[test]
    fn a_blink_is_no_fall() {
        let blink = judged(&[(5, 3.0), (1, 60.0), (9, 3.0)]);
        assert!(!blink.contains(&FallState::HasRisen) && blink[14] == FallState::Stands, "{blink:?}");
    }

    #[test]
    fn what_nothing_measures_says_nothing_and_a_clock_set_back_ends_it() {
        let mut posture = FallDetector::default();
        assert_eq!(posture.judge(0, None), FallState::Stands);
        posture.judge(5_000_000_000, Some(1.0));
        assert_eq!(posture.judge(5_100_000_000, None), FallState::Fallen);
        assert_ne!(posture.judge(1_000_000_000, Some(0.0)), FallState::Fallen);
    }
}
