//! Decides when systemd's watchdog is fed. systemd restarts the recorder when it is not.

use std::time::{Duration, Instant};

/// Round counters of the watched threads; a counter stands still when its thread does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Rounds {
    pub camera: u64,
    /// Counter of the recording thread, while there is a session.
    pub recorder: Option<u64>,
}

/// Watches the camera's thread and the recording thread. The event loop is the caller.
#[derive(Debug, Default)]
pub struct Watchdog {
    fed: Rounds,
    recorder_progress_at: Option<Instant>,
}

/// A disk that stands still for this long does not come back. Until then the recording thread is waited for: a restart
/// would lose what it holds and gain nothing.
const MAX_STALL: Duration = Duration::from_secs(60);

impl Watchdog {
    /// Returns whether the watchdog is to be fed: the camera's thread made progress since the last feeding, and the
    /// recording thread does not stall.
    pub fn check_progress(&mut self, rounds: Rounds, now: Instant) -> bool {
        if rounds.recorder.is_none() || rounds.recorder != self.fed.recorder {
            (self.fed.recorder, self.recorder_progress_at) = (rounds.recorder, Some(now));
        }
        let stalls = self.recorder_progress_at.is_some_and(|went| now.duration_since(went) >= MAX_STALL);
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
    fn it_is_fed_while_both_threads_progress_or_a_stall_is_short() {
        let (mut watchdog, began) = (Watchdog::default(), Instant::now());
        let mut fed = |camera, recorder, after_s| {
            watchdog.check_progress(Rounds { camera, recorder }, began + Duration::from_secs(after_s))
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
