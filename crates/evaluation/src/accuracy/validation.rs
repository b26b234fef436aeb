//! How well each measure predicts the true error, on rendered walks with a fault that is known.

use glam::DVec2;
use serde::Serialize;

use crate::statistics::rms;
use realitysim_geometry::Isometry;

/// A fault of the calibration that a walk is tagged with, as keys of the effect `calibration_error`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fault {
    /// Name for people.
    pub name: &'static str,
    /// Key and value.
    pub key: Option<(&'static str, f64)>,
}

/// The faults that are tried.
pub const FAULTS: [Fault; 4] = [
    Fault { name: "none", key: None },
    Fault { name: "camera 2 cm higher than said", key: Some(("height_m", -0.02)) },
    Fault { name: "mount pitch 1 degree off", key: Some(("mount_pitch_deg", 1.0)) },
    Fault { name: "focal length 1 % off", key: Some(("focal_percent", 1.0)) },
];

/// The true errors of the tags of a walk.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct TrueError {
    /// Root mean square of the horizontal distance, centimetres.
    pub rms_cm: f64,
    /// The mean error in the coordinate frame of the robot, centimetres: forward and left.
    pub forward_left_cm: DVec2,
    /// Root mean square of the rest, centimetres.
    pub rest_cm: f64,
}

impl TrueError {
    /// Compares tags with true poses of the same stamps, in order of time. `None` if no stamp is in both.
    pub fn of(tags: &[(i64, Isometry)], truth: &[(i64, Isometry)]) -> Option<Self> {
        let off = |(stamp_ns, tag): &(i64, Isometry)| {
            let at = truth.binary_search_by_key(stamp_ns, |(stamp_ns, _)| *stamp_ns).ok()?;
            let pose = truth[at].1;
            let off = (tag.translation - pose.translation).truncate() * 100.0;
            Some(DVec2::from_angle(-pose.euler().yaw).rotate(off))
        };
        let off: Vec<DVec2> = tags.iter().filter_map(off).collect();
        let mean = off.iter().sum::<DVec2>() / off.len().max(1) as f64;
        (!off.is_empty()).then(|| Self {
            rms_cm: rms(off.iter().map(|off| off.length())),
            forward_left_cm: mean,
            rest_cm: rms(off.iter().map(|off| off.distance(mean))),
        })
    }
}

/// The largest truth over the smallest below which a correlation says nothing of prediction: a few hundredths of a centimetre are
/// noise of the rendering, and correlate with anything.
pub const MIN_RANGE: f64 = 2.0;

/// Pearson's correlation of measures with the truth, which comes second. `None` of fewer than three pairs, if the truth varies by less
/// than [`MIN_RANGE`], or if the measure does not vary.
pub fn correlation(pairs: &[(f64, f64)]) -> Option<f64> {
    let [low, high] = range(pairs.iter().map(|pair| pair.1));
    if pairs.len() < 3 || high < MIN_RANGE * low {
        return None;
    }
    let count = pairs.len() as f64;
    let (sum_x, sum_y) = pairs.iter().fold((0.0, 0.0), |(x, y), pair| (x + pair.0, y + pair.1));
    let (mean_x, mean_y) = (sum_x / count, sum_y / count);
    let mut sums = [0.0; 3];
    for (x, y) in pairs {
        let (x, y) = (x - mean_x, y - mean_y);
        sums = [sums[0] + x * x, sums[1] + y * y, sums[2] + x * y];
    }
    let [xx, yy, xy] = sums;
    (xx > 0.0 && yy > 0.0).then(|| xy / libm::sqrt(xx * yy))
}

/// Smallest and largest of values; not finite of none.
pub fn range(values: impl Iterator<Item = f64>) -> [f64; 2] {
    values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| [low.min(value), high.max(value)])
}
