//! When the whole field is tried although a pose is believed.
//!
//! Another place may look so much like the right one that its lines never contradict a pose: after a robot was carried, or
//! where it was found while it was. But lines are missing there. So a believed pose is tried against the whole field when
//! fewer lines fit than should, when frames have been doubted for long or tell of another walk than odometry, and
//! several times after it was found by search, or after a frame that looks as if the robot had been put elsewhere: then it
//! is not believed either, until its lines are back or the whole field has had nothing better to offer.

use serde::{Deserialize, Serialize};

use realitysim_geometry::Physical;

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RelocalizationTrigger {
    /// Of the line places expected those that fit, over about [`MEAN_S`].
    share: Option<f64>,
    /// As if all lines were clear: where they are faint, of those that are there fewer fit.
    clear_share: f64,
    /// The share over [`USUAL_S`], or since the field was last tried.
    usual: f64,
    waited_s: f64,
    pause_s: f64,
    /// For how long frames have been doubted.
    doubted_s: f64,
    /// Frames in a row whose lines and odometry told of two different walks.
    surprised: u32,
    /// Looks that the pose still needs: it was found by search, or the robot may have been put elsewhere.
    owed: u32,
    /// What the share was before the robot may have been put elsewhere, until that is settled.
    put_from: Option<f64>,
}

/// With more of the expected line places the pose is hardly ever another one: of windows of ten frames with a wrong pose 9 %
/// have more, of those with the right one 83 % (docs/design.md says on which walks).
const CONVINCING: f64 = 0.9;
const MEAN_S: f64 = 0.5;
const USUAL_S: f64 = 8.0;
/// Between two looks: first, and most; twice as long after each that finds nothing better.
const FIRST_PAUSE_S: f64 = 1.0;
const LONGEST_PAUSE_S: f64 = 16.0;
/// A share that falls by so much begins anew.
const FALLS_BY: f64 = 0.1;
/// Of a single frame.
const FRAME_FALLS_BY: f64 = 0.07;
const DOUBTED_S: f64 = 1.5;
const SURPRISED: u32 = 3;
const OWED_IF_FOUND: u32 = 3;
const OWED_IF_PUT: u32 = 5;
/// Between looks that are owed.
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
            surprised: 0,
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
    /// At a pose that was found by search.
    pub fn found() -> Self {
        Self { owed: OWED_IF_FOUND, ..Self::default() }
    }

    /// A frame so many seconds after the last one: its share of fitting line places, and that as if all lines were clear, if enough are
    /// expected, whether its pose was doubted, and whether lines and odometry told of different walks.
    pub fn note(&mut self, seconds: f64, shares: Option<[f64; 2]>, doubted: bool, surprised: bool) {
        let share = shares.map(|[share, _]| share);
        self.waited_s += seconds;
        self.doubted_s = if doubted { self.doubted_s + seconds } else { 0.0 };
        self.surprised = if surprised { self.surprised + 1 } else { 0 };
        // Lines that were there are not, and what is left of them lies where no step leads: as if the robot had been put elsewhere.
        if surprised && share.is_some_and(|share| self.falls_to(share)) {
            self.owed = OWED_IF_PUT;
            self.waited_s = self.waited_s.max(self.pause_s);
            self.put_from = self.put_from.or(self.share);
        }
        if let Some([share, clear_share]) = shares {
            self.put_from = self.put_from.filter(|before| share < before - FRAME_FALLS_BY);
            let near = |mean: f64, share: f64, seconds_of: f64| mean + (share - mean) * (seconds / seconds_of).min(1.0);
            self.usual = if self.share.is_some() { near(self.usual, share, USUAL_S) } else { share };
            self.clear_share =
                if self.share.is_some() { near(self.clear_share, clear_share, MEAN_S) } else { clear_share };
            self.share = Some(self.share.map_or(share, |mean| near(mean, share, MEAN_S)));
        }
        if self.falls() {
            self.pause_s = self.pause_s.min(FIRST_PAUSE_S);
        }
    }

    fn falls(&self) -> bool {
        self.share.is_some_and(|share| share < self.usual - FALLS_BY)
    }

    /// A frame with this share has lost what the frames before it had.
    pub fn falls_to(&self, share: f64) -> bool {
        self.share.is_some_and(|mean| share < mean - FRAME_FALLS_BY)
    }

    /// The robot may have been put elsewhere: lines have not come back, and the whole field has not been tried often enough.
    pub fn may_be_elsewhere(&self) -> bool {
        self.put_from.is_some()
    }

    pub fn is_due(&self) -> bool {
        let is_odd = self.owed > 0 || self.clear_share < CONVINCING || self.doubted_s >= DOUBTED_S;
        let pause_s = if self.owed > 0 { PAUSE_IF_OWED_S } else { self.pause_s };
        (is_odd && self.waited_s >= pause_s) || (self.surprised >= SURPRISED && self.waited_s >= FIRST_PAUSE_S)
    }

    /// Lines that were there a moment ago are not, or tell of another walk, or the pose is new.
    pub fn is_urgent(&self) -> bool {
        self.owed > 0 || self.surprised >= SURPRISED || self.falls()
    }

    /// Nothing better was found.
    pub fn looked(&mut self) {
        (self.waited_s, self.doubted_s, self.surprised) = (0.0, 0.0, 0);
        self.usual = self.share.unwrap_or(self.usual);
        if self.owed > 0 {
            self.owed -= 1;
            self.put_from = self.put_from.filter(|_| self.owed > 0);
        } else {
            self.pause_s = (2.0 * self.pause_s).min(LONGEST_PAUSE_S);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// When looks are due, in seconds, at 10 Hz.
    fn looks(
        mut look: RelocalizationTrigger,
        seconds: f64,
        share: impl Fn(f64) -> Option<f64>,
        doubted: bool,
    ) -> Vec<f64> {
        let mut due = Vec::new();
        for frame in 1..=(seconds * 10.0) as u32 {
            let at = f64::from(frame) / 10.0;
            look.note(0.1, share(at).map(|share| [share; 2]), doubted, false);
            if look.is_due() {
                look.looked();
                due.push(at);
            }
        }
        due
    }

    #[test]
    fn a_pose_whose_lines_are_there_is_left_alone() {
        assert_eq!(looks(RelocalizationTrigger::default(), 60.0, |_| Some(0.95), false), [0.0; 0]);
    }

    #[test]
    fn a_pose_that_was_found_is_tried_three_times() {
        let looks = looks(RelocalizationTrigger::found(), 60.0, |_| Some(0.95), false);
        assert!(looks.len() == 3 && looks[2] < 1.5, "{looks:?}");
    }

    #[test]
    fn missing_lines_are_looked_into_ever_more_rarely_until_more_are_missing() {
        let crowd = looks(RelocalizationTrigger::default(), 60.0, |_| Some(0.75), false);
        assert!(crowd.len() <= 6 && crowd[0] <= 1.1, "{crowd:?}");
        let carried =
            looks(RelocalizationTrigger::default(), 60.0, |at| Some(if at < 40.0 { 0.8 } else { 0.55 }), false);
        assert!(carried.iter().any(|at| (40.0..41.2).contains(at)), "{carried:?}");
    }

    #[test]
    fn a_frame_as_of_a_robot_that_was_put_elsewhere_is_looked_into_at_once_and_again() {
        let put = |share: f64, surprised: bool| {
            let mut look = RelocalizationTrigger::default();
            (0..30).for_each(|_| look.note(0.1, Some([0.98; 2]), false, false));
            look.note(0.1, Some([share; 2]), false, surprised);
            (look.is_due() && look.is_urgent(), look)
        };
        assert!(put(0.86, true).0 && !put(0.86, false).0 && !put(0.96, true).0, "fewer lines, and where no step leads");
        let looks = looks(put(0.86, true).1, 60.0, |_| Some(0.95), false);
        assert!(looks.len() == 5 && looks[4] < 2.0, "{looks:?}");
    }

    #[test]
    fn who_may_have_been_put_elsewhere_is_doubted_until_lines_are_back_or_nothing_better_was_found() {
        let put = || {
            let mut look = RelocalizationTrigger::default();
            (0..30).for_each(|_| look.note(0.1, Some([0.98; 2]), false, false));
            assert!(!look.may_be_elsewhere());
            look.note(0.1, Some([0.86; 2]), false, true);
            look
        };
        let mut back = put();
        back.note(0.1, None, false, false);
        back.note(0.1, Some([0.88; 2]), false, false);
        assert!(back.may_be_elsewhere(), "a crowd, or another place");
        back.note(0.1, Some([0.95; 2]), false, false);
        assert!(!back.may_be_elsewhere());
        let mut tried = put();
        for _ in 0..OWED_IF_PUT {
            assert!(tried.may_be_elsewhere());
            tried.looked();
            tried.note(0.1, Some([0.88; 2]), false, false);
        }
        assert!(!tried.may_be_elsewhere());
    }

    #[test]
    fn frames_that_show_nothing_are_looked_into_as_well() {
        assert!(looks(RelocalizationTrigger::default(), 3.0, |_| None, true)[0] <= 1.6);
    }
}
