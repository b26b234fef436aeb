//! What a case must keep.

use serde::{Deserialize, Serialize};

use super::judge::Judged;

/// Infinite: no limit, also where the suite has one for all.
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
    /// At least this share of the judged frames has a valid tag.
    pub valid_share: Option<f64>,
    /// The slowest, of all times that the case names in `recovery_from_s`.
    pub recovered_within_s: Option<f64>,
    /// 99 of 100 frames take no longer than this many times the calibration loop.
    pub p99_ratio: Option<f64>,
}

/// A limit that was not kept.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Broken {
    pub limit: &'static str,
    /// None if there is nothing to measure, as of a robot that did not recover.
    pub value: Option<f64>,
    pub allowed: f64,
}

impl Limits {
    pub fn or(&self, other: &Self) -> Self {
        let of = |pick: fn(&Self) -> Option<f64>| pick(self).or(pick(other));
        Self {
            mean_cm: of(|l| l.mean_cm),
            median_cm: of(|l| l.median_cm),
            p95_cm: of(|l| l.p95_cm),
            max_cm: of(|l| l.max_cm),
            yaw_median_deg: of(|l| l.yaw_median_deg),
            roll_median_deg: of(|l| l.roll_median_deg),
            pitch_median_deg: of(|l| l.pitch_median_deg),
            valid_share: of(|l| l.valid_share),
            recovered_within_s: of(|l| l.recovered_within_s),
            p99_ratio: of(|l| l.p99_ratio),
        }
    }

    pub(super) fn check(&self, key: &str) -> Result<(), String> {
        for (name, bound) in self.upper() {
            if bound.is_some_and(|bound| bound.is_nan() || bound <= 0.0) {
                return Err(format!("{key}.{name} is {}: it must be above 0 (inf: no limit)", bound.unwrap_or(0.0)));
            }
        }
        match self.valid_share {
            Some(share) if !(0.0..=1.0).contains(&share) => Err(format!("{key}.valid_share is {share}: it is 0 to 1")),
            _ => Ok(()),
        }
    }

    /// By name; all but `valid_share` are limits from above.
    fn upper(&self) -> [(&'static str, Option<f64>); 9] {
        [
            ("mean_cm", self.mean_cm),
            ("median_cm", self.median_cm),
            ("p95_cm", self.p95_cm),
            ("max_cm", self.max_cm),
            ("yaw_median_deg", self.yaw_median_deg),
            ("roll_median_deg", self.roll_median_deg),
            ("pitch_median_deg", self.pitch_median_deg),
            ("recovered_within_s", self.recovered_within_s),
            ("p99_ratio", self.p99_ratio),
        ]
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
        let of_errors = self.upper().into_iter().filter(|(name, _)| *name != "p99_ratio");
        let mut broken: Vec<Broken> =
            of_errors.filter_map(|(name, allowed)| above(name, measured(name), allowed?)).collect();
        if let Some(allowed) = self.valid_share
            && judged.valid_share < allowed
        {
            broken.push(Broken { limit: "valid_share", value: Some(judged.valid_share), allowed });
        }
        broken
    }

    pub fn too_slow(&self, ratio: f64) -> Option<Broken> {
        above("p99_ratio", Some(ratio), self.p99_ratio?)
    }
}

fn above(limit: &'static str, value: Option<f64>, allowed: f64) -> Option<Broken> {
    let kept = allowed.is_infinite() || value.is_some_and(|value| value <= allowed);
    (!kept).then_some(Broken { limit, value, allowed })
}
