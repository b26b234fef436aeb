//! Decides when the whole field is searched although a pose is believed.
//!
//! Another pose may look so much like the right one that lines never contradict it: after the robot was carried, or when it was
//! found while somebody carried it. But lines are missing there. So the field is searched for a better pose when fewer lines fit than
//! should, when frames have been doubted for long or show another motion than odometry, and several times after the pose was found
//! by search, or after a frame that looks as if the robot had been put elsewhere. In the last case the pose is not believed
//! until its lines are back or the searches have found nothing better.

use serde::{Deserialize, Serialize};

use realitysim_geometry::Physical;

/// What recent frames say about the need to search the field for a better pose than the believed one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RelocalizationTrigger {
    /// Share of the expected line places that fit, averaged over about [`MEAN_S`].
    share: Option<f64>,
    /// The same share if all lines were clear: where lines are faint, fewer of them fit.
    clear_share: f64,
    /// The share averaged over [`USUAL_S`], or since the field was last searched.
    usual: f64,
    /// Time since the last search.
    waited_s: f64,
    /// Time to wait between two searches.
    pause_s: f64,
    /// Time for which frames have been doubted.
    doubted_s: f64,
    /// Number of frames in a row whose lines and odometry showed different motions.
    contradictions: u32,
    /// Number of searches that the pose still needs, since it was found by search or the robot may have been put elsewhere.
    owed: u32,
    /// The share before the robot may have been put elsewhere, until that is decided.
    put_from: Option<f64>,
}

/// Share of fitting line places above which the pose is hardly ever a wrong one: of windows of ten frames with a wrong pose 9 %
/// have more, of those with the right one 83 %.
const CONVINCING: f64 = 0.9;
/// Time constant of the mean share, seconds.
const MEAN_S: f64 = 0.5;
/// Time constant of the usual share, seconds.
const USUAL_S: f64 = 8.0;
/// First pause between two searches, seconds. It doubles after each search that finds nothing better.
const FIRST_PAUSE_S: f64 = 1.0;
/// Longest pause between two searches, seconds.
const PAUSE_LIMIT_S: f64 = 16.0;
/// Drop of the mean share below the usual one that resets the pause.
const MEAN_DROP: f64 = 0.1;
/// Drop of a single frame's share below the mean that is a loss of lines.
const FRAME_DROP: f64 = 0.07;
/// Time of doubted frames that calls for a search, seconds.
const DOUBTED_S: f64 = 1.5;
/// Number of frames in a row with different motions that calls for a search.
const MIN_CONTRADICTIONS: u32 = 3;
/// Number of searches owed to a pose that was found by search.
const OWED_IF_FOUND: u32 = 3;
/// Number of searches owed when the robot may have been put elsewhere.
const OWED_IF_PUT: u32 = 5;
/// Pause between two searches that are owed, seconds.
const PAUSE_IF_OWED_S: f64 = 0.4;

impl Default for RelocalizationTrigger {
    fn default() -> Self {
        Self {
            share: None,
            clear_share: 1.0,
            usual: 1.0,
            waited_s: 0.0,
            pause_s: FIRST_PAUSE_S,
            doubted_s: 0.0,
            contradictions: 0,
            owed: 0,
            put_from: None,
        }
    }
}

impl Physical for RelocalizationTrigger {
    fn is_possible(&self) -> bool {
        let times = [self.waited_s, self.pause_s, self.doubted_s];
        self.share.is_possible()
            && self.clear_share.is_possible()
            && self.usual.is_possible()
            && self.put_from.is_possible()
            && times.iter().all(|seconds| seconds.is_finite())
    }
}

impl RelocalizationTrigger {
    /// The trigger for a pose that was just found by search.
    pub fn after_search() -> Self {
        Self { owed: OWED_IF_FOUND, ..Self::default() }
    }

    /// Takes a frame, `seconds` after the last one.
    ///
    /// `shares` are its share of fitting line places and the same if all lines were clear, or `None` if too few places are expected.
    /// `doubted`: its pose was rejected as uncertain. `contradicts`: its lines and odometry showed different motions.
    pub fn note_frame(&mut self, seconds: f64, shares: Option<[f64; 2]>, doubted: bool, contradicts: bool) {
        let share = shares.map(|[share, _]| share);
        self.waited_s += seconds;
        self.doubted_s = if doubted { self.doubted_s + seconds } else { 0.0 };
        self.contradictions = if contradicts { self.contradictions + 1 } else { 0 };
        // Lines are missing, and the others lie where no step leads: the robot may have been put elsewhere.
        if contradicts && share.is_some_and(|share| self.is_drop(share)) {
            self.owed = OWED_IF_PUT;
            self.waited_s = self.waited_s.max(self.pause_s);
            self.put_from = self.put_from.or(self.share);
        }
        if let Some([share, clear_share]) = shares {
            self.put_from = self.put_from.filter(|before| share < before - FRAME_DROP);
            let near = |mean: f64, share: f64, seconds_of: f64| mean + (share - mean) * (seconds / seconds_of).min(1.0);
            self.usual = if self.share.is_some() { near(self.usual, share, USUAL_S) } else { share };
            self.clear_share =
                if self.share.is_some() { near(self.clear_share, clear_share, MEAN_S) } else { clear_share };
            self.share = Some(self.share.map_or(share, |mean| near(mean, share, MEAN_S)));
        }
        if self.has_dropped() {
            self.pause_s = self.pause_s.min(FIRST_PAUSE_S);
        }
    }

    /// Whether the mean share has dropped below the usual one.
    fn has_dropped(&self) -> bool {
        self.share.is_some_and(|share| share < self.usual - MEAN_DROP)
    }

    /// Whether a frame with this share has lost lines that the frames before it had.
    pub fn is_drop(&self, share: f64) -> bool {
        self.share.is_some_and(|mean| share < mean - FRAME_DROP)
    }

    /// Whether the robot may have been put elsewhere: lines have not come back, and the field has not been searched often enough.
    pub fn may_be_elsewhere(&self) -> bool {
        self.put_from.is_some()
    }

    /// Whether the field is to be searched.
    pub fn is_due(&self) -> bool {
        let is_odd = self.owed > 0 || self.clear_share < CONVINCING || self.doubted_s >= DOUBTED_S;
        let pause_s = if self.owed > 0 { PAUSE_IF_OWED_S } else { self.pause_s };
        (is_odd && self.waited_s >= pause_s)
            || (self.contradictions >= MIN_CONTRADICTIONS && self.waited_s >= FIRST_PAUSE_S)
    }

    /// Whether a search is urgent: lines have just disappeared or show another motion than odometry, or the pose is new.
    pub fn is_urgent(&self) -> bool {
        self.owed > 0 || self.contradictions >= MIN_CONTRADICTIONS || self.has_dropped()
    }

    /// Notes a search that has found nothing better.
    pub fn note_fruitless_search(&mut self) {
        (self.waited_s, self.doubted_s, self.contradictions) = (0.0, 0.0, 0);
        self.usual = self.share.unwrap_or(self.usual);
        if self.owed > 0 {
            self.owed -= 1;
            self.put_from = self.put_from.filter(|_| self.owed > 0);
        } else {
            self.pause_s = (2.0 * self.pause_s).min(PAUSE_LIMIT_S);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Times at which searches are due, in seconds, at 10 Hz.
    fn searches(
        mut trigger: RelocalizationTrigger,
        seconds: f64,
        share: impl Fn(f64) -> Option<f64>,
        doubted: bool,
    ) -> Vec<f64> {
        let mut due = Vec::new();
        for frame in 1..=(seconds * 10.0) as u32 {
            let at = f64::from(frame) / 10.0;
            trigger.note_frame(0.1, share(at).map(|share| [share; 2]), doubted, false);
            if trigger.is_due() {
                trigger.note_fruitless_search();
                due.push(at);
            }
        }
        due
    }

    #[test]
    fn a_pose_whose_lines_are_seen_causes_no_search() {
        assert_eq!(searches(RelocalizationTrigger::default(), 60.0, |_| Some(0.95), false), [0.0; 0]);
    }

    #[test]
    fn a_pose_that_was_found_is_searched_against_three_times() {
        let searches = searches(RelocalizationTrigger::after_search(), 60.0, |_| Some(0.95), false);
        assert!(searches.len() == 3 && searches[2] < 1.5, "{searches:?}");
    }

    #[test]
    fn missing_lines_cause_ever_rarer_searches_until_more_are_missing() {
        let crowd = searches(RelocalizationTrigger::default(), 60.0, |_| Some(0.75), false);
        assert!(crowd.len() <= 6 && crowd[0] <= 1.1, "{crowd:?}");
        let carried =
            searches(RelocalizationTrigger::default(), 60.0, |at| Some(if at < 40.0 { 0.8 } else { 0.55 }), false);
        assert!(carried.iter().any(|at| (40.0..41.2).contains(at)), "{carried:?}");
    }

    #[test]
    fn a_robot_that_seems_put_elsewhere_is_searched_for_at_once_and_again() {
        let put = |share: f64, contradicts: bool| {
            let mut trigger = RelocalizationTrigger::default();
            (0..30).for_each(|_| trigger.note_frame(0.1, Some([0.98; 2]), false, false));
            trigger.note_frame(0.1, Some([share; 2]), false, contradicts);
            (trigger.is_due() && trigger.is_urgent(), trigger)
        };
        assert!(put(0.86, true).0 && !put(0.86, false).0 && !put(0.96, true).0, "fewer lines, and where no step leads");
        let searches = searches(put(0.86, true).1, 60.0, |_| Some(0.95), false);
        assert!(searches.len() == 5 && searches[4] < 2.0, "{searches:?}");
    }

    #[test]
    fn a_robot_put_elsewhere_is_doubted_until_lines_or_searches_settle_it() {
        let put = || {
            let mut trigger = RelocalizationTrigger::default();
            (0..30).for_each(|_| trigger.note_frame(0.1, Some([0.98; 2]), false, false));
            assert!(!trigger.may_be_elsewhere());
            trigger.note_frame(0.1, Some([0.86; 2]), false, true);
            trigger
        };
        let mut back = put();
        back.note_frame(0.1, None, false, false);
        back.note_frame(0.1, Some([0.88; 2]), false, false);
        assert!(back.may_be_elsewhere(), "a crowd, or another place");
        back.note_frame(0.1, Some([0.95; 2]), false, false);
        assert!(!back.may_be_elsewhere());
        let mut tried = put();
        for _ in 0..OWED_IF_PUT {
            assert!(tried.may_be_elsewhere());
            tried.note_fruitless_search();
            tried.note_frame(0.1, Some([0.88; 2]), false, false);
        }
        assert!(!tried.may_be_elsewhere());
    }

    #[test]
    fn doubted_frames_cause_a_search() {
        assert!(searches(RelocalizationTrigger::default(), 3.0, |_| None, true)[0] <= 1.6);
    }
}
