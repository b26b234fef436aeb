//! The limits that the tags of a case must keep.

use serde::{Deserialize, Serialize};

use super::judge::Judged;

/// Limits on errors, shares and times; `None` is no limit.
///
/// In a case, a value that nothing can break (`inf`, a `valid_share` or `ellipse95_share` of 0) removes the limit of
/// the suite.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Limits {
    /// Largest mean error of the position in x and y, centimetres.
    pub mean_cm: Option<f64>,
    /// Largest median error of the position, centimetres.
    pub median_cm: Option<f64>,
    /// Largest 95 % quantile of the error of the position, centimetres.
    pub p95_cm: Option<f64>,
    /// Largest error of the position, centimetres.
    pub max_cm: Option<f64>,
    /// Largest median error of yaw, degrees.
    pub yaw_median_deg: Option<f64>,
    /// Largest median error of roll, degrees.
    pub roll_median_deg: Option<f64>,
    /// Largest median error of pitch, degrees.
    pub pitch_median_deg: Option<f64>,
    /// Smallest share of the judged tags whose 95 % ellipse contains the truth.
    pub ellipse95_share: Option<f64>,
    /// Smallest share of the judged frames with a valid tag.
    pub valid_share: Option<f64>,
    /// Largest share of the judged frames with a valid tag, for a case that must be refused. It disables the limits of
    /// the suite.
    pub most_valid_share: Option<f64>,
    /// Smallest share of the valid tags that have a true pose to be judged by; 0.9 if not given.
    pub judged_share: Option<f64>,
    /// Largest time to recover from any of the times in `recovery_from_s`, seconds.
    pub recovered_within_s: Option<f64>,
    /// Largest 99 % quantile of the time for a frame, in units of the calibration loop.
    pub p99_ratio: Option<f64>,
}

/// Smallest share of the valid tags that must be judged by default: errors of a few tags say nothing about all.
const MIN_JUDGED_SHARE: f64 = 0.9;
/// Names of the limits from below; all others are from above.
pub const LOWER_LIMITS: [&str; 3] = ["ellipse95_share", "valid_share", "judged_share"];
/// Names of the limits that are shares, 0 to 1.
const SHARES: [&str; 4] = ["ellipse95_share", "valid_share", "most_valid_share", "judged_share"];

/// A limit that was not kept.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Broken {
    /// Name of the limit.
    pub limit: &'static str,
    /// Measured value; `None` if there is nothing to measure, as for a robot that did not recover.
    pub value: Option<f64>,
    /// Value of the limit.
    pub allowed: f64,
}

impl Limits {
    /// Returns all limits with their names.
    fn each_mut(&mut self) -> [(&'static str, &mut Option<f64>); 13] {
        [
            ("mean_cm", &mut self.mean_cm),
            ("median_cm", &mut self.median_cm),
            ("p95_cm", &mut self.p95_cm),
            ("max_cm", &mut self.max_cm),
            ("yaw_median_deg", &mut self.yaw_median_deg),
            ("roll_median_deg", &mut self.roll_median_deg),
            ("pitch_median_deg", &mut self.pitch_median_deg),
            ("ellipse95_share", &mut self.ellipse95_share),
            ("valid_share", &mut self.valid_share),
            ("most_valid_share", &mut self.most_valid_share),
            ("judged_share", &mut self.judged_share),
            ("recovered_within_s", &mut self.recovered_within_s),
            ("p99_ratio", &mut self.p99_ratio),
        ]
    }

    /// Returns the limits that are set, with their names.
    fn named(mut self) -> impl Iterator<Item = (&'static str, f64)> {
        self.each_mut().map(|(name, value)| (name, *value)).into_iter().filter_map(|(name, value)| Some((name, value?)))
    }

    /// Merges these limits over those of the suite, and drops limits that nothing can break.
    pub(super) fn merged_over(mut self, suite: &Self) -> Self {
        let mut suite = if self.most_valid_share.is_some() { Self::default() } else { *suite };
        for ((name, own), (_, suite)) in self.each_mut().into_iter().zip(suite.each_mut()) {
            *own = own.or(*suite).filter(|value| !is_unbreakable(name, *value));
        }
        self
    }

    /// Refuses values outside of the range of their limit.
    pub(super) fn check(&self) -> Result<(), String> {
        for (name, value) in self.named() {
            if SHARES.contains(&name) && !(0.0..=1.0).contains(&value) {
                return Err(format!("limits.{name} is {value}: it is 0 to 1"));
            }
            if !SHARES.contains(&name) && (value.is_nan() || value <= 0.0) {
                return Err(format!("limits.{name} is {value}: it must be above 0"));
            }
        }
        Ok(())
    }

    /// Describes the first limit that nothing can break and that removes no limit of `suite`.
    pub(super) fn unbreakable(&self, suite: &Self) -> Option<String> {
        let sets = |wanted: &str| suite.named().any(|(name, _)| name == wanted);
        let (name, value) = self.named().find(|(name, value)| is_unbreakable(name, *value) && !sets(name))?;
        Some(format!("limits.{name} is {value}, which nothing can break: leave it out"))
    }

    /// Returns whether any limit but `judged_share` is set.
    pub fn ask_for_something(&self) -> bool {
        Self { judged_share: None, ..*self } != Self::default()
    }

    /// Returns whether the true poses are needed to check the limits.
    pub fn ask_for_truth(&self) -> bool {
        Self { valid_share: None, most_valid_share: None, p99_ratio: None, ..*self }.ask_for_something()
    }

    /// Returns the broken limits, without that on time, which is measured later.
    pub fn broken(&self, judged: &Judged) -> Vec<Broken> {
        let c = &judged.comparison;
        let error = |value: f64| (c.judged > 0).then_some(value);
        let measured = |name: &str| match name {
            "mean_cm" => error(c.position_cm.mean),
            "median_cm" => error(c.position_cm.median),
            "p95_cm" => error(c.position_cm.p95),
            "max_cm" => error(c.position_cm.max),
            "yaw_median_deg" => error(c.yaw_deg.median),
            "roll_median_deg" => error(c.roll_deg.median),
            "pitch_median_deg" => error(c.pitch_deg.median),
            _ => judged.slowest_recovery_s(),
        };
        let of_errors = self.named().filter(|(name, _)| *name != "p99_ratio" && !SHARES.contains(name));
        let mut broken: Vec<Broken> =
            of_errors.filter_map(|(name, allowed)| check_upper(name, measured(name), allowed)).collect();
        let held = error(c.ellipse95_share);
        broken.extend(self.ellipse95_share.and_then(|allowed| check_lower("ellipse95_share", held, allowed)));
        broken.extend(self.valid_share.and_then(|allowed| check_lower("valid_share", judged.valid_share, allowed)));
        broken.extend(self.most_valid_share.and_then(|most| check_upper("most_valid_share", judged.valid_share, most)));
        if self.ask_for_truth() && c.valid > 0 {
            let share = c.judged as f64 / c.valid as f64;
            broken.extend(check_lower("judged_share", Some(share), self.judged_share.unwrap_or(MIN_JUDGED_SHARE)));
        }
        broken
    }

    /// Returns the limit on time if `ratio`, in units of the calibration loop, breaks it.
    pub fn too_slow(&self, ratio: f64) -> Option<Broken> {
        check_upper("p99_ratio", Some(ratio), self.p99_ratio?)
    }
}

/// Returns the limit as broken unless the value is known and at most `allowed`.
fn check_upper(limit: &'static str, value: Option<f64>, allowed: f64) -> Option<Broken> {
    let kept = value.is_some_and(|value| value <= allowed);
    (!kept).then_some(Broken { limit, value, allowed })
}

/// Returns the limit as broken unless the value is known and at least `allowed`.
fn check_lower(limit: &'static str, value: Option<f64>, allowed: f64) -> Option<Broken> {
    let kept = value.is_some_and(|value| value >= allowed);
    (!kept).then_some(Broken { limit, value, allowed })
}

/// Returns whether nothing can break the limit.
fn is_unbreakable(name: &str, value: f64) -> bool {
    // A judged_share of 0 is no such value: it removes the default.
    value.is_infinite()
        || name == "most_valid_share" && value == 1.0
        || ["ellipse95_share", "valid_share"].contains(&name) && value == 0.0
}
