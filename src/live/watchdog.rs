//! Whether what must go on does go on: systemd begins the recorder anew when it is not told so.

use std::time::{Duration, Instant};

/// Who goes round, by counts that stand still when they do.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Rounds {
    pub camera: u64,
    /// While there is a session.
    pub recorder: Option<u64>,
}

/// Of the camera's thread and the recorder's; the agent's own is the one that asks.
#[derive(Debug, Default)]
pub struct Watchdog {
    fed: Rounds,
    recorder_went_round: Option<Instant>,
}

/// A disk that stands still for this long does not come back. Until then the recorder is waited for: beginning anew would cost
/// what it holds, and bring nothing.
const MAX_STALL: Duration = Duration::from_secs(60);

impl Watchdog {
    /// Whether both got on since this was last true.
    pub fn is_fed(&mut self, rounds: Rounds, now: Instant) -> bool {
        if rounds.recorder.is_none() || rounds.recorder != self.fed.recorder {
            (self.fed.recorder, self.recorder_went_round) = (rounds.recorder, Some(now));
        }
        let stalls = self.recorder_went_round.is_some_and(|went| now.duration_since(went) >= MAX_STALL);
        let fed = rounds.camera != self.fed.camera && !stalls;
        if fed {
            self.fed.camera = rounds.camera;
        }
        fed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_fed_while_camera_and_recorder_both_go_round_and_a_stall_is_waited_for() {
        let (mut watchdog, began) = (Watchdog::default(), Instant::now());
        let mut fed = |camera, recorder, after_s| {
            watchdog.is_fed(Rounds { camera, recorder }, began + Duration::from_secs(after_s))
        };
        assert!(fed(1, None, 0), "no session: the camera is enough");
        assert!(!fed(1, None, 1), "the camera's thread hangs");
        assert!(fed(2, Some(1), 2) && fed(3, Some(2), 3));
        assert!(fed(4, Some(2), 40), "the disk stalls");
        assert!(!fed(5, Some(2), 63), "and does not come back");
        assert!(fed(6, Some(3), 64), "it does");
        assert!(!fed(6, Some(4), 65), "the camera's thread hangs again");
        assert!(fed(7, None, 200) && fed(8, Some(0), 300), "another session");
    }
}
