//! Selection of the segments that are wanted: by session, time, place and validity. Times are the robot's own, as
//! recorded; this machine's clock plays no part.

use crate::ManifestLine;

/// Which segments are wanted; by default all of them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Selection {
    /// Beginnings of the names of sessions; empty for all.
    pub sessions: Vec<String>,
    /// Earliest log time that is wanted, ns.
    pub since_ns: Option<i64>,
    /// Latest log time that is wanted, ns.
    pub until_ns: Option<i64>,
    /// Only segments with a valid pose near this disc.
    pub within: Option<Within>,
    /// Least share of valid tags in a segment, 0 to 1.
    pub valid_share: Option<f64>,
}

/// A disc on the field, metres in `map`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Within {
    /// x of the centre, m.
    pub x: f64,
    /// y of the centre, m.
    pub y: f64,
    /// Radius, m.
    pub radius: f64,
}

impl Selection {
    /// Whether a session of this name is wanted.
    pub fn takes_session(&self, name: &str) -> bool {
        self.sessions.is_empty() || self.sessions.iter().any(|beginning| name.starts_with(beginning.as_str()))
    }

    /// Whether a segment is wanted.
    pub fn takes(&self, line: &ManifestLine) -> bool {
        // A segment without a message has no time.
        let is_asked = |bound: Option<i64>, is_within: &dyn Fn(i64, (i64, i64)) -> bool| {
            bound.is_none_or(|bound| line.times().is_some_and(|times| is_within(bound, times)))
        };
        is_asked(self.since_ns, &|since, (_, last)| last >= since)
            && is_asked(self.until_ns, &|until, (first, _)| first <= until)
            && self.within.is_none_or(|disc| touches(disc, line))
            && self.valid_share.is_none_or(|least| valid_share(line).is_some_and(|share| share >= least))
    }
}

/// Whether the box around the segment's valid poses reaches into the disc. A segment without valid poses does not.
fn touches(disc: Within, line: &ManifestLine) -> bool {
    line.poses.is_some_and(|poses| {
        let beyond = |at: f64, [low, high]: [f64; 2]| (low - at).max(at - high).max(0.0);
        libm::hypot(beyond(disc.x, poses.x), beyond(disc.y, poses.y)) <= disc.radius
    })
}

/// Share of valid tags in a segment, 0 to 1; `None` without tags.
pub fn valid_share(line: &ManifestLine) -> Option<f64> {
    line.frames.valid_share()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Counts, PoseBox};

    fn line() -> ManifestLine {
        ManifestLine {
            name: "0000.mcap".into(),
            bytes: 1,
            blake3: String::new(),
            first_ns: 100,
            last_ns: 200,
            messages: 1,
            frames: Counts { captured: 4, written: 4, tagged: 4, valid: 3, ..Counts::default() },
            poses: Some(PoseBox { x: [0.0, 1.0], y: [-1.0, 0.0] }),
            cut_bytes: None,
        }
    }

    #[test]
    fn a_segment_is_taken_for_its_time_place_and_validity() {
        let takes = |change: &dyn Fn(&mut Selection)| {
            let mut selection = Selection::default();
            change(&mut selection);
            selection.takes(&line())
        };
        assert!(takes(&|_| ()));
        assert!(takes(&|s| (s.since_ns, s.until_ns) = (Some(200), Some(200))));
        assert!(!takes(&|s| s.since_ns = Some(201)));
        assert!(!takes(&|s| s.until_ns = Some(99)));
        let of_no_time = ManifestLine { messages: 0, first_ns: 0, last_ns: 0, ..line() };
        assert!(!Selection { until_ns: Some(300), ..Selection::default() }.takes(&of_no_time));
        assert!(Selection::default().takes(&of_no_time));
        let disc = |x: f64, y: f64, radius: f64| takes(&|s| s.within = Some(Within { x, y, radius }));
        assert!(disc(0.5, -0.5, 0.0), "inside");
        assert!(disc(4.0, 4.0, 5.0) && !disc(4.0, 4.0, 4.99), "3 and 4 m from the corner");
        assert!(takes(&|s| s.valid_share = Some(0.75)) && !takes(&|s| s.valid_share = Some(0.76)));
        let mut dropped = line();
        (dropped.frames.written, dropped.frames.dropped) = (1, [("queue_full".to_owned(), 3)].into());
        assert!(
            Selection { valid_share: Some(0.75), ..Selection::default() }.takes(&dropped)
                && !Selection { valid_share: Some(0.76), ..Selection::default() }.takes(&dropped),
            "frames that could not be written have their tags all the same"
        );
        let unknown = ManifestLine { poses: None, ..line() };
        assert!(
            !Selection { within: Some(Within { x: 0.0, y: 0.0, radius: 9.0 }), ..Selection::default() }.takes(&unknown)
        );
    }

    #[test]
    fn a_session_is_called_by_the_beginning_of_its_name() {
        let selection = Selection { sessions: vec!["2026-11-21".into()], ..Selection::default() };
        assert!(
            selection.takes_session("2026-11-21T10-00-00Z-r1") && !selection.takes_session("2026-11-20T10-00-00Z-r1")
        );
    }
}
