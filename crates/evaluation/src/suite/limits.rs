//! What a case must keep.

use serde::{Deserialize, Serialize};

use super::judge::Judged;

/// In a case, what nothing can break (`inf`, a `valid_share` or `ellipse95_share` of 0) takes away the suite's limit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Limits {
    /// Of the position, in x and y.
    pub mean_cm: Option<f64>,
    pub median_cm: Option<f64>,
    pub p95_cm: Option<f64>,
    pub max_cm: Option<f64>,
    pub yaw_median_deg: Option<f64>,
    pub roll_median_deg: Option<f64>,
    pub pitch_median_deg: Option<f64>,
    /// At least this share of the tags that are judged has the truth within its 95 % ellipse.
    pub ellipse95_share: Option<f64>,
    /// At least this share of the judged frames has a valid tag.
    pub valid_share: Option<f64>,
    /// At most this share of the judged frames has a valid tag: for a case that must be refused. The suite's limits do not hold for it.
    pub most_valid_share: Option<f64>,
    /// At least this share of the valid tags has a truth to be judged by; without it 0.9.
    pub judged_share: Option<f64>,
    /// The slowest, of all times that the case names in `recovery_from_s`.
    pub recovered_within_s: Option<f64>,
    /// 99 of 100 frames take no longer than this many times the calibration loop.
    pub p99_ratio: Option<f64>,
}

/// Errors of a few tags say nothing about all.
const MOST_OF_THEM: f64 = 0.9;
/// Limits from below; all others are from above.
pub const LEAST: [&str; 3] = ["ellipse95_share", "valid_share", "judged_share"];
/// Limits that are shares of what is judged.
const SHARES: [&str; 4] = ["ellipse95_share", "valid_share", "most_valid_share", "judged_share"];

/// A limit that was not kept.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Broken {
    pub limit: &'static str,
    /// None if there is nothing to measure, as of a robot that did not recover.
    pub value: Option<f64>,
    pub allowed: f64,
}

impl Limits {
    /// By name.
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

    fn named(mut self) -> impl Iterator<Item = (&'static str, f64)> {
        self.each_mut().map(|(name, value)| (name, *value)).into_iter().filter_map(|(name, value)| Some((name, value?)))
    }

    /// These over those of the suite; what nothing can break is gone.
    pub(super) fn over(mut self, suite: &Self) -> Self {
        let mut suite = if self.most_valid_share.is_some() { Self::default() } else { *suite };
        for ((name, own), (_, suite)) in self.each_mut().into_iter().zip(suite.each_mut()) {
            *own = own.or(*suite).filter(|value| !is_endless(name, *value));
        }
        self
    }

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

    /// A limit that nothing can break, unless it takes one away that `suite` sets.
    pub(super) fn endless(&self, suite: &Self) -> Option<String> {
        let sets = |wanted: &str| suite.named().any(|(name, _)| name == wanted);
        let (name, value) = self.named().find(|(name, value)| is_endless(name, *value) && !sets(name))?;
        Some(format!("limits.{name} is {value}, which nothing can break: leave it out"))
    }

    /// Whether anything but the truth itself is asked for.
    pub fn ask_for_something(&self) -> bool {
        Self { judged_share: None, ..*self } != Self::default()
    }

    /// Whether the true poses are needed to tell.
    pub fn ask_for_truth(&self) -> bool {
        Self { valid_share: None, most_valid_share: None, p99_ratio: None, ..*self }.ask_for_something()
    }

    /// All but the time, which is measured later.
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
            of_errors.filter_map(|(name, allowed)| above(name, measured(name), allowed)).collect();
        let held = error(c.ellipse95_share);
        broken.extend(self.ellipse95_share.and_then(|allowed| below("ellipse95_share", held, allowed)));
        broken.extend(self.valid_share.and_then(|allowed| below("valid_share", judged.valid_share, allowed)));
        broken.extend(self.most_valid_share.and_then(|most| above("most_valid_share", judged.valid_share, most)));
        if self.ask_for_truth() && c.valid > 0 {
            let share = c.judged as f64 / c.valid as f64;
            broken.extend(below("judged_share", Some(share), self.judged_share.unwrap_or(MOST_OF_THEM)));
        }
        broken
    }

    pub fn too_slow(&self, ratio: f64) -> Option<Broken> {
        above("p99_ratio", Some(ratio), self.p99_ratio?)
    }
}

fn above(limit: &'static str, value: Option<f64>, allowed: f64) -> Option<Broken> {
    let kept = value.is_some_and(|value| value <= allowed);
    (!kept).then_some(Broken { limit, value, allowed })
}

fn below(limit: &'static str, value: Option<f64>, allowed: f64) -> Option<Broken> {
    let kept = value.is_some_and(|value| value >= allowed);
    (!kept).then_some(Broken { limit, value, allowed })
}

fn is_endless(name: &str, value: f64) -> bool {
    // A judged_share of 0 takes away what holds without it.
    value.is_infinite()
        || name == "most_valid_share" && value == 1.0
        || ["ellipse95_share", "valid_share"].contains(&name) && value == 0.0
}
