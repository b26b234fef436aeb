//! Warnings: findings that a user will want to know although nothing failed.

use std::collections::{BTreeMap, BTreeSet};

use super::filter_stats::FilterStats;
use super::report::Quantiles;
use realitysim_config::FrameNames;
use realitysim_geometry::FieldDimensions;
use realitysim_geometry::physical::MAX_MAGNITUDE;
use realitysim_localization::{LensOff, Rejection};
use realitysim_log_input::attitude_filter::MADE_TILT_SIGMA_RAD;
use realitysim_log_input::synchroniser::{GONE_NS, LOG_TIME_SIGMA_S};
use realitysim_log_input::topic_resolution::TopicChoice;
use realitysim_ros2::messages::{Imu, LowState, Message, Odometer};

/// Rejections of frames that show lines which fit nowhere.
const LOST: [Rejection; 5] = [
    Rejection::PoseUnknown,
    Rejection::Unconfirmed,
    Rejection::LinesDisagree,
    Rejection::LinesUnexplained,
    Rejection::NotStanding,
];
/// Rejections of frames that show hardly any lines.
const HARDLY_SEEN: [Rejection; 2] = [Rejection::FewLines, Rejection::Spread];
/// Share of the frames that may take longer than the budget without a warning, as on a busy machine.
const OVER_BUDGET: f64 = 0.05;
/// Share by which the focal length must differ from the calibration before a warning.
const MIN_STRETCH: f64 = 0.003;
/// Distance of the image centre from the calibrated one before a warning, pixels.
const MIN_SHIFT_PX: f64 = 1.0;
/// A deviation of the lens must also be this many standard deviations.
const CLEAR_SIGMAS: f64 = 5.0;

/// Whether the reason of a tag means that its frame could not be placed on the field.
pub fn is_unplaced(reason: &str) -> bool {
    Rejection::from_reason(reason)
        .is_some_and(|rejection| LOST.contains(&rejection) || HARDLY_SEEN.contains(&rejection))
}

/// Number of tags with this rejection.
fn count(invalid: &BTreeMap<String, u64>, rejection: Rejection) -> u64 {
    invalid.get(rejection.as_str()).copied().unwrap_or(0)
}

/// Warns that the field was assumed, because nobody named one: its lines decide every pose.
///
/// `recorded_on` is the field on which the capture that is replayed was recorded, and its name, if that is another.
pub fn assumed_field(
    field: &str,
    dimensions: &FieldDimensions,
    recorded_on: Option<(&str, &FieldDimensions)>,
) -> String {
    let FieldDimensions { length_m, width_m, .. } = dimensions;
    let choose = match recorded_on {
        Some((other, FieldDimensions { length_m, width_m, .. })) => format!(
            "the capture was recorded on {other} of {length_m} x {width_m} m: choose it with --field {other}, and with \
             --field-size if the size was measured"
        ),
        None => {
            "choose yours with --field NAME or `field` in the config (config/fields has the shipped ones)".to_owned()
        }
    };
    format!("no field was named, and {field} is assumed, which is {length_m} x {width_m} m: {choose}")
}

/// Warns if most frames show lines that fit nowhere on the field, or if no tag is valid and most frames could not be placed.
///
/// `cause` gives the end of the sentence; it is called only if there is a warning.
pub fn unplaced(
    field: &str,
    invalid: &BTreeMap<String, u64>,
    tagged: u64,
    cause: impl FnOnce() -> String,
) -> Option<String> {
    let of = |rejections: &[Rejection]| rejections.iter().map(|rejection| count(invalid, *rejection)).sum::<u64>();
    let (lost, hardly_seen) = (of(&LOST), of(&HARDLY_SEEN));
    let none_is_valid = invalid.values().sum::<u64>() == tagged;
    let (count, though) = if 2 * lost > tagged {
        (lost, ", though lines are seen")
    } else if none_is_valid && 2 * (lost + hardly_seen) > tagged {
        (lost + hardly_seen, "")
    } else {
        return None;
    };
    Some(format!("{count} of {tagged} frames could not be placed on the field {field}{though}: {}", cause()))
}

/// The end of the warning of [`unplaced`] on a robot, which has no time for a diagnosis.
pub fn possible_causes(budget_ms: f64) -> String {
    let hurried = match budget_ms {
        0.0 => String::new(),
        budget_ms => format!(" Or is filter.budget_ms = {budget_ms} too small for a search of the field?"),
    };
    format!(
        "is it the right field (field = ...), the right lens and the right mount of camera and IMU?{hurried} `realitysim replay` of \
         what was recorded looks for the cause"
    )
}

/// Warns if more than a tenth of the images are black, overexposed or frozen.
pub fn no_picture(invalid: &BTreeMap<String, u64>, tagged: u64) -> Option<String> {
    let of = |rejection| count(invalid, rejection);
    let defects = [
        (Rejection::TooDark, "were black: is the lens covered, or the exposure far too short?"),
        (Rejection::Overexposed, "were mostly white: is the exposure or the gain far too high?"),
        (
            Rejection::ImageFrozen,
            "showed the same picture again although the robot moved: does the camera stand still?",
        ),
    ];
    let (rejection, said) = defects.into_iter().max_by_key(|(rejection, _)| of(*rejection))?;
    (10 * of(rejection) > tagged).then(|| format!("{} of {tagged} frames {said}", of(rejection)))
}

/// Warns if the torso lay in most frames, by its attitude from the topic `imu`.
pub fn never_upright(imu: &str, invalid: &BTreeMap<String, u64>, tagged: u64) -> Option<String> {
    let lay = count(invalid, Rejection::Fallen);
    (2 * lay > tagged).then(|| {
        format!(
            "in {lay} of {tagged} frames the torso did not stand, by {imu}: is the IMU built in upside down or on its side? The \
             transform from the torso to the IMU's frame in /tf_static says how"
        )
    })
}

/// Warns if too many frames took longer than the budget.
pub fn small_budget(budget_ms: f64, effort: &FilterStats, tagged: u64) -> Option<String> {
    let over = effort.over_budget;
    let Quantiles { p50, p99, .. } = effort.durations.quantiles();
    (over as f64 > OVER_BUDGET * tagged as f64).then(|| {
        format!(
            "filter.budget_ms = {budget_ms}: {over} of {tagged} frames took longer (p50 {p50:.1}, p99 {p99:.1} ms), though \
             {} had fewer particles for it: {}",
            effort.capped,
            if p50 > budget_ms { "seeing and refining alone take that long here" } else { "a busy machine, or searches" }
        )
    })
}

/// Warns if the field's lines show clearly that the lens differs from its calibration.
pub fn wrong_lens(off: &LensOff) -> Option<String> {
    let LensOff { stretch, centre_u_px, centre_v_px } = *off;
    let is_clear = |(value, sigma): (f64, f64), least: f64| value.abs() > least.max(CLEAR_SIGMAS * sigma);
    let is_off =
        is_clear(stretch, MIN_STRETCH) || is_clear(centre_u_px, MIN_SHIFT_PX) || is_clear(centre_v_px, MIN_SHIFT_PX);
    is_off.then(|| {
        format!(
            "by the field's lines the lens is not quite as it was calibrated: focal length {:+.2} %, centre {:+.1}, {:+.1} px. \
             Tags allow for it, views do not; `realitysim calibrate --walk` measures it from a whole walk",
            stretch.0 * 100.0,
            centre_u_px.0,
            centre_v_px.0,
        )
    })
}

/// Warns that the lens was scaled to images of another size: right if they were scaled, wrong if they were cut.
pub fn scaled_lens(origin: &str, stated: [u32; 2], image: [u32; 2]) -> String {
    let [[width, height], [to_width, to_height]] = [stated, image];
    format!(
        "{origin}: the lens is for images of {width} x {height}, but these have {to_width} x {to_height}: it was scaled to them. \
         If they are a part of the larger image, give a lens file of the part"
    )
}

/// Warns of particle weights that were NaN or +inf. They are a fault of this program and were left out.
pub fn unusable_weights(count: u64) -> Option<String> {
    (count > 0).then(|| {
        format!("{count} weights of particles were no numbers or infinite, and were left out: please report this log")
    })
}

/// Warns of measurements that are physically impossible: a fault of a driver or of another filter. They were not used.
pub fn impossible_measurements(count: u64) -> Option<String> {
    (count > 0).then(|| {
        format!(
            "{count} measurements hold numbers that are not finite, beyond {MAX_MAGNITUDE:e} (metres, radians, radians per second), or \
             no covariance: they were recorded, but not used"
        )
    })
}

/// Warns of frames after which the localizer started from nothing, which is a fault of this program.
pub fn begun_anew(count: u64) -> Option<String> {
    (count > 0).then(|| {
        format!("after {count} frames localization began anew, since a number was not finite: please report this log")
    })
}

/// Warns that the stamps of two topics are of different clocks: those of `topic` are `apart_s` seconds later than those of `image`,
/// by the times at which both were logged.
pub fn clocks_apart(image: &str, topic: &str, apart_s: f64) -> String {
    let order = if apart_s > 0.0 { "after" } else { "before" };
    format!(
        "by the times of the log, the stamps on {topic} are {:.1} s {order} those on {image}: their clocks differ, so that they are not \
         brought together. Let one clock stamp both",
        apart_s.abs()
    )
}

/// Warns that measurements have no stamps of their own.
pub fn without_stamps(choices: &[TopicChoice]) -> Option<String> {
    let unstamped =
        choices.iter().filter(|choice| [Odometer::TYPE, LowState::TYPE].contains(&choice.type_name.as_str()));
    let topics: BTreeSet<&str> = unstamped.map(|choice| choice.topic.as_str()).collect();
    let named: Vec<&str> = topics.into_iter().collect();
    (!named.is_empty()).then(|| {
        format!(
            "{} without stamps: the times of the log stand for them, and are believed to {:.0} ms. What moves is less certain for it",
            named.join(" and "),
            LOG_TIME_SIGMA_S * 1e3
        )
    })
}

/// Warns that the attitude was made of raw turn rates and accelerations.
pub fn made_attitude(imu: &str, is_made: bool) -> Option<String> {
    is_made.then(|| {
        format!(
            "{imu} states no orientation: roll and pitch were made of its turn rates and accelerations, and are believed to {:.1} degrees. \
             The topic of a filter that computes them, such as imu_filter_madgwick, is better while the robot walks",
            MADE_TILT_SIGMA_RAD.to_degrees()
        )
    })
}

/// Where the torso's attitude comes from.
#[derive(Clone, Debug)]
pub struct AttitudeSource {
    /// The topic `topics.imu`, configured or found.
    pub topic: String,
    /// All topics of the log with IMU messages.
    pub all: Vec<String>,
}

impl AttitudeSource {
    /// Warns if `unknown` of `frames` were tagged without a measured tilt of the torso, with the cause.
    ///
    /// `was_heard` says whether an attitude came at all.
    pub fn warning(&self, unknown: u64, frames: u64, was_heard: bool, names: &FrameNames) -> Option<String> {
        if unknown == 0 {
            return None;
        }
        let Self { topic, all } = self;
        let kind = Imu::TYPE;
        let why = if was_heard && unknown == frames {
            let FrameNames { base_footprint, base_link, .. } = names;
            format!(
                "the attitude on {topic} is that of {base_link}, and the transforms from {base_footprint} to the camera \
                 do not pass through it: name the torso with frames.base_link"
            )
        } else if was_heard {
            format!("{topic} had told no attitude yet, or none for {} s", GONE_NS / 1_000_000_000)
        } else if all.contains(topic) {
            format!(
                "{topic} states no orientation (orientation_covariance[0] is -1, or the quaternion is zero), and none could be made of \
                 its turn rates and accelerations, since the robot never stood quietly for a second: record the topic of a filter \
                 that computes it, such as imu_filter_madgwick"
            )
        } else if all.is_empty() {
            format!("the log has no topic of type {kind}: record the torso's attitude")
        } else {
            format!("{topic} is not of type {kind}: choose one with topics.imu: {}", all.join(", "))
        };
        let consequence = "as if the torso stood upright, which costs several times the accuracy";
        Some(format!("{unknown} of {frames} frames were tagged {consequence}: {why}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn warning(all: &[&str], unknown: u64, was_heard: bool) -> String {
        let all = all.iter().map(|topic| (*topic).to_owned()).collect();
        let source = AttitudeSource { topic: "/imu/data".to_owned(), all };
        source.warning(unknown, 9, was_heard, &FrameNames::default()).unwrap_or_default()
    }

    #[test]
    fn a_field_is_doubted_when_lines_fit_nowhere() {
        let invalid = |unexplained, few| {
            BTreeMap::from([("lines_unexplained".to_owned(), unexplained), ("few_lines".to_owned(), few)])
        };
        let told =
            |unexplained, few| unplaced("kid-2009", &invalid(unexplained, few), 100, || "is it the lens?".to_owned());
        let said = told(51, 40).expect("told");
        assert!(said.starts_with("51 of 100 frames could not be placed on the field kid-2009, though lines"), "{said}");
        assert!(said.ends_with("are seen: is it the lens?"), "{said}");
        assert_eq!(told(6, 90), None, "no lines are seen");
        assert!(told(6, 94).expect("no tag is valid").starts_with("100 of 100 frames could not be placed"));
        assert!(!possible_causes(0.0).contains("budget") && possible_causes(2.5).contains("filter.budget_ms = 2.5"));
    }

    #[test]
    fn an_imu_by_which_the_robot_always_lies_is_doubted() {
        let invalid = |lay| BTreeMap::from([("fallen".to_owned(), lay)]);
        assert!(never_upright("/imu/data", &invalid(60), 100).expect("told").contains("by /imu/data"));
        assert_eq!(never_upright("/imu/data", &invalid(40), 100), None, "it fell");
    }

    #[test]
    fn a_lens_that_is_off_is_told_when_that_is_clear() {
        let off = LensOff { stretch: (-0.006, 0.0002), centre_u_px: (0.4, 0.1), centre_v_px: (-0.2, 0.1) };
        let said = wrong_lens(&off).expect("told");
        assert!(said.contains("-0.60 %") && said.contains("+0.4, -0.2 px"), "{said}");
        assert_eq!(wrong_lens(&LensOff { stretch: (-0.006, 0.002), ..off }), None, "not known well enough");
        assert_eq!(wrong_lens(&LensOff { stretch: (-0.002, 0.0002), ..off }), None, "as calibrations are");
        assert!(wrong_lens(&LensOff { stretch: (0.0, 0.001), centre_v_px: (1.4, 0.2), ..off }).is_some());
    }

    #[test]
    fn faults_of_numbers_are_told_and_counted() {
        assert_eq!(unusable_weights(0), None);
        assert!(unusable_weights(7).expect("told").starts_with("7 weights"));
        assert_eq!((impossible_measurements(0), begun_anew(0)), (None, None));
        assert!(impossible_measurements(3).expect("told").starts_with("3 measurements"));
        assert!(begun_anew(2).expect("told").starts_with("after 2 frames"));
    }

    #[test]
    fn each_cause_has_its_remedy() {
        assert_eq!(warning(&["/imu/data"], 0, true), "");
        assert!(warning(&[], 9, false).contains("the log has no topic of type sensor_msgs/msg/Imu"));
        assert!(warning(&["/a", "/b"], 9, false).contains("choose one with topics.imu: /a, /b"));
        assert!(warning(&["/imu/data"], 9, false).contains("orientation_covariance[0]"));
        assert!(warning(&["/imu/data"], 2, true).starts_with("2 of 9 frames"));
        assert!(warning(&["/imu/data"], 9, true).contains("frames.base_link"));
    }
}
