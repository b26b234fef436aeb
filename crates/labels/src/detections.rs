//! What a detector says of a picture: its output as text, and which landmark each of its detections is of.

use glam::DVec2;

use crate::{Keypoint, LANDMARK_CLASSES, Labeller, LandmarkKind, Visibility};

/// A landmark that a detector found in a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Detection {
    /// Number of its class in [`LANDMARK_CLASSES`].
    pub class: usize,
    /// Where the landmark is, pixels; the first pixel's centre is (0, 0).
    ///
    /// Of a box it is the centre, and of a goal post's box the middle of the lower edge, where the foot is.
    pub at: DVec2,
    /// Left upper and right lower corner of its box, pixels, as [`crate::LabelBox`] has them. `None` if it is a point.
    pub corners: Option<[DVec2; 2]>,
    /// How sure the detector is, on a scale of its own.
    pub score: Option<f64>,
}

/// Why a text is no list of detections.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DetectionError {
    /// Number of the line, from 1.
    pub line: usize,
    /// What is wrong with it.
    pub what: String,
}

impl core::fmt::Display for DetectionError {
    fn fmt(&self, f: &mut core::fmt::Formatter) -> core::fmt::Result {
        let Self { line, what } = self;
        write!(f, "line {line}: {what}: {FORM} is needed")
    }
}

impl core::error::Error for DetectionError {}

/// The forms of a line, for error messages.
const FORM: &str = "`class u v` or `class u_min v_min u_max v_max [score]`";
/// Distance between a detection and its landmark that is always allowed, as a share of the picture's width.
const GATE_SHARE: f64 = 0.03;
/// Distance that the error of the label may add, in standard deviations.
const GATE_SIGMAS: f64 = 3.0;

/// Reads detections, one a line. Lines without a word are skipped.
///
/// A line is `class u v`, a point, whose coordinates count from the centre of the first pixel, or
/// `class u_min v_min u_max v_max [score]`, a box, whose coordinates count from the left upper corner of the picture. The class is a
/// name of [`LANDMARK_CLASSES`].
pub fn parse_detections(text: &str) -> Result<Vec<Detection>, DetectionError> {
    let lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    lines.map(|(at, line)| parse_line(line).map_err(|what| DetectionError { line: at + 1, what })).collect()
}

fn parse_line(line: &str) -> Result<Detection, String> {
    let mut words = line.split_whitespace();
    let name = words.next().unwrap_or_default();
    let class = LANDMARK_CLASSES.names.iter().position(|known| *known == name);
    let class = class.ok_or_else(|| format!("{name:?} is none of {}", LANDMARK_CLASSES.names.join(", ")))?;
    let numbers = words.map(finite).collect::<Result<Vec<f64>, String>>()?;
    match numbers[..] {
        [u, v] => Ok(Detection { class, at: DVec2::new(u, v), corners: None, score: None }),
        [left, top, right, bottom] => boxed(class, [left, top, right, bottom], None),
        [left, top, right, bottom, score] => boxed(class, [left, top, right, bottom], Some(score)),
        _ => Err(format!("{} numbers behind the class", numbers.len())),
    }
}

fn finite(word: &str) -> Result<f64, String> {
    word.parse().ok().filter(|number: &f64| number.is_finite()).ok_or_else(|| format!("{word:?} is no finite number"))
}

fn boxed(class: usize, [left, top, right, bottom]: [f64; 4], score: Option<f64>) -> Result<Detection, String> {
    if left > right || top > bottom {
        return Err("the box ends before it begins".to_owned());
    }
    let is_post = Some(class) == LANDMARK_CLASSES.class(LandmarkKind::PostFoot);
    let v = if is_post { bottom } else { top.midpoint(bottom) };
    let at = DVec2::new(left.midpoint(right), v) - 0.5;
    Ok(Detection { class, at, corners: Some([DVec2::new(left, top), DVec2::new(right, bottom)]), score })
}

impl Labeller {
    /// Which landmark each detection is of: for each detection the place of its landmark in [`Labeller::landmarks`].
    ///
    /// `keypoints` are those of [`Labeller::keypoints`], `width_px` is the width of the picture. A landmark is matched with a detection
    /// of its class within 3 % of the width plus three standard deviations of the label, the nearest pair first, each at most once.
    /// Hidden landmarks are matched as well; a detection of one is neither right nor wrong.
    pub fn match_detections(
        &self,
        keypoints: &[Keypoint],
        detections: &[Detection],
        width_px: usize,
    ) -> Vec<Option<usize>> {
        let mut pairs: Vec<(f64, usize, usize)> = Vec::new();
        for (landmark, keypoint) in keypoints.iter().enumerate() {
            if keypoint.visibility == Visibility::Outside {
                continue;
            }
            let class = self.landmarks().get(landmark).and_then(|landmark| LANDMARK_CLASSES.class(landmark.kind));
            let gate_px = GATE_SHARE * width_px as f64 + GATE_SIGMAS * keypoint.sigma_px;
            for (place, detection) in detections.iter().enumerate().filter(|(_, found)| Some(found.class) == class) {
                let distance_px = detection.at.distance(keypoint.at);
                if distance_px <= gate_px {
                    pairs.push((distance_px, place, landmark));
                }
            }
        }
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        let (mut matched, mut is_taken) = (vec![None; detections.len()], vec![false; keypoints.len()]);
        for (_, place, landmark) in pairs {
            if matched[place].is_none() && !is_taken[landmark] {
                (matched[place], is_taken[landmark]) = (Some(landmark), true);
            }
        }
        matched
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat2;
    use proptest::prelude::*;
    use realitysim_config::load_field;
    use realitysim_geometry::Field;

    const WIDTH_PX: usize = 640;

    fn labeller() -> Labeller {
        Labeller::new(&Field::new(load_field("kid-2020").unwrap()).unwrap(), true)
    }

    fn keypoint(at: (f64, f64), visibility: Visibility) -> Keypoint {
        Keypoint { at: at.into(), sigma_px: 0.5, covariance_px2: DMat2::IDENTITY * 0.25, visibility }
    }

    fn point(class: usize, at: (f64, f64)) -> Detection {
        Detection { class, at: at.into(), corners: None, score: None }
    }

    #[test]
    fn points_and_boxes_are_read_and_nothing_else_is() {
        let text = "x_crossing 10.5 -2\n\n  goalpost 10 20 14 80 0.75 \nt_crossing 1 2 3 4\n";
        let found = parse_detections(text).unwrap();
        assert_eq!(found[0], point(2, (10.5, -2.0)));
        assert_eq!((found[1].at, found[1].score), (DVec2::new(11.5, 79.5), Some(0.75)));
        assert_eq!((found[2].at, found[2].score), (DVec2::new(1.5, 2.5), None));
        assert_eq!(parse_detections(" \n"), Ok(Vec::new()));
        for (wrong, said) in [
            ("ball 1 2", "line 1: \"ball\" is none of l_crossing, t_crossing"),
            ("centre 1 2\ncentre 1", "line 2: 1 numbers behind the class: `class u v` or"),
            ("centre 1 2 0.5", "3 numbers"),
            ("centre 1 2 3 4 5 6", "6 numbers"),
            ("centre 1 NaN", "\"NaN\" is no finite number"),
            ("centre 1 two", "\"two\" is no finite number"),
            ("centre 3 2 1 4", "the box ends before it begins"),
        ] {
            let error = parse_detections(wrong).unwrap_err().to_string();
            assert!(error.contains(said), "{wrong}: {error}");
        }
    }

    #[test]
    fn a_detection_of_another_class_or_far_away_is_of_nothing() {
        let labeller = labeller();
        let is_corner = |landmark: &crate::Landmark| landmark.kind == LandmarkKind::LCrossing;
        let corner = labeller.landmarks().iter().position(is_corner).unwrap();
        let mut keypoints = vec![keypoint((0.0, 0.0), Visibility::Outside); labeller.landmarks().len()];
        keypoints[corner] = keypoint((100.0, 100.0), Visibility::Hidden);
        let detections = [point(0, (103.0, 100.0)), point(0, (101.0, 100.0)), point(1, (100.0, 100.0))];
        let matched = labeller.match_detections(&keypoints, &detections, WIDTH_PX);
        assert_eq!(matched, [None, Some(corner), None]);
        let matched = labeller.match_detections(&keypoints, &[point(0, (130.0, 100.0))], WIDTH_PX);
        assert_eq!(matched, [None]);
    }

    fn detections() -> impl Strategy<Value = Vec<Detection>> {
        prop::collection::vec((0..6usize, (0.0..200.0f64, 0.0..200.0f64)), 0..24)
            .prop_map(|found| found.into_iter().map(|(class, at)| point(class, at)).collect())
    }

    proptest! {
        #[test]
        fn no_text_makes_the_parser_panic(text in "\\PC*|([a-z_]{1,12}( -?[0-9.e]{1,9}){0,6}\n){0,4}") {
            let _ = parse_detections(&text);
        }

        #[test]
        fn what_is_written_is_read_back(found in detections()) {
            let line = |one: &Detection| format!("{} {} {}\n", LANDMARK_CLASSES.names[one.class], one.at.x, one.at.y);
            prop_assert_eq!(parse_detections(&found.iter().map(line).collect::<String>()), Ok(found));
        }

        #[test]
        fn a_match_is_one_to_one_within_the_gate_and_complete(
            found in detections(),
            at in prop::collection::vec((0.0..200.0f64, 0.0..200.0f64), 40),
        ) {
            let labeller = labeller();
            let landmarks = labeller.landmarks();
            let keypoints: Vec<Keypoint> =
                landmarks.iter().zip(at.iter().cycle()).map(|(_, at)| keypoint(*at, Visibility::Visible)).collect();
            let matched = labeller.match_detections(&keypoints, &found, WIDTH_PX);
            let fits = |one: &Detection, landmark: usize| {
                LANDMARK_CLASSES.class(landmarks[landmark].kind) == Some(one.class)
                    && one.at.distance(keypoints[landmark].at) <= 0.03 * WIDTH_PX as f64 + 1.5
            };
            let taken: Vec<usize> = matched.iter().flatten().copied().collect();
            let mut distinct = taken.clone();
            distinct.sort_unstable();
            distinct.dedup();
            prop_assert_eq!(distinct.len(), taken.len());
            for (one, landmark) in found.iter().zip(&matched) {
                match landmark {
                    Some(landmark) => prop_assert!(fits(one, *landmark)),
                    None => prop_assert!((0..landmarks.len()).all(|at| taken.contains(&at) || !fits(one, at))),
                }
            }
        }
    }
}
