//! What a detector says of a picture: its output as text, and which landmark each of its detections is of.

use glam::DVec2;
use realitysim_geometry::Physical;

use crate::{ClassList, Keypoint, LANDMARK_CLASSES, Labeller, LandmarkKind, Visibility};

/// A landmark that a detector found in a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Detection {
    /// Number of its class in the detector's list.
    pub class: usize,
    /// Where it is, pixels; the first pixel's centre is (0, 0).
    pub at: DVec2,
    /// Whether `at` is that of a box: the middle of a box is not quite the landmark.
    pub is_box: bool,
    /// How sure the detector is, 0 to 1.
    pub score: f64,
}

impl Detection {
    /// A landmark found as a point, in pixels of which the left upper corner of the picture is (0, 0).
    pub fn point(class: usize, at: DVec2, score: f64) -> Self {
        Self { class, at: at - 0.5, is_box: false, score }
    }

    /// A landmark found as a box with these corners, in the same pixels.
    pub fn of_box(classes: ClassList, class: usize, [from, to]: [DVec2; 2], score: f64) -> Self {
        let is_post = classes.class(LandmarkKind::PostFoot) == Some(class);
        Self { class, at: anchor(from, to, is_post) - 0.5, is_box: true, score }
    }
}

/// The point of a box that is compared: of a goal post the middle of the lower edge, since detectors differ in how much of it they take,
/// else the middle.
pub(crate) fn anchor(from: DVec2, to: DVec2, is_post: bool) -> DVec2 {
    let middle = (from + to) / 2.0;
    if is_post { middle.with_y(to.y) } else { middle }
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
const FORM: &str = "`class u v [score]` or `class u_min v_min u_max v_max [score]`";
/// Longest word that an error message quotes, characters.
const QUOTED_CHARACTERS: usize = 40;
/// Distance between a detection and its landmark that is always allowed, as a share of the picture's width.
const GATE_SHARE: f64 = 0.03;
/// Distance that the error of the label may add, in standard deviations.
const GATE_SIGMAS: f64 = 3.0;

/// Reads detections of classes of a list, one a line: `class u v [score]` or `class u_min v_min u_max v_max [score]`. The left upper corner
/// of the picture is (0, 0), so that the first pixel's centre is (0.5, 0.5); without a score it is 1.
///
/// Lines without a word are skipped, and so are classes that no landmark has, such as a ball.
///
/// # Errors
///
/// Fails if a line is anything else.
pub fn parse_detections(text: &str, classes: ClassList) -> Result<Vec<Detection>, DetectionError> {
    let mut found = Vec::new();
    for (at, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
        let detection = parse_line(line, classes).map_err(|what| DetectionError { line: at + 1, what })?;
        found.extend(is_of_landmarks(detection.class, classes).then_some(detection));
    }
    Ok(found)
}

fn parse_line(line: &str, classes: ClassList) -> Result<Detection, String> {
    let mut words = line.split_whitespace();
    let name = words.next().unwrap_or_default();
    let class = classes.names.iter().position(|known| *known == name);
    let class = class.ok_or_else(|| format!("{:?} is none of {}", quoted(name), classes.names.join(", ")))?;
    let numbers = words.map(number).collect::<Result<Vec<f64>, String>>()?;
    let corners = |[left, top, right, bottom]: [f64; 4]| {
        let is_box = left <= right && top <= bottom;
        is_box.then(|| [DVec2::new(left, top), DVec2::new(right, bottom)]).ok_or("the box ends before it begins")
    };
    let found = match numbers[..] {
        [u, v] => Detection::point(class, DVec2::new(u, v), 1.0),
        [u, v, score] => Detection::point(class, DVec2::new(u, v), score),
        [a, b, c, d] => Detection::of_box(classes, class, corners([a, b, c, d])?, 1.0),
        [a, b, c, d, score] => Detection::of_box(classes, class, corners([a, b, c, d])?, score),
        _ => return Err(format!("{} numbers behind the class", numbers.len())),
    };
    let is_score = (0.0..=1.0).contains(&found.score);
    is_score.then_some(found).ok_or_else(|| format!("the score is {}, and it is 0 to 1", found.score))
}

fn number(word: &str) -> Result<f64, String> {
    let number = word.parse().ok().filter(f64::is_possible);
    number.ok_or_else(|| format!("{:?} is no number of pixels or score", quoted(word)))
}

fn quoted(word: &str) -> String {
    word.chars().take(QUOTED_CHARACTERS).collect()
}

/// Whether a class of the list is that of landmarks.
fn is_of_landmarks(class: usize, classes: ClassList) -> bool {
    LandmarkKind::ALL.into_iter().any(|kind| classes.class(kind) == Some(class))
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
    use crate::BOOSTER_CLASSES;
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
        Detection { class, at: at.into(), is_box: false, score: 1.0 }
    }

    #[test]
    fn points_and_boxes_are_read_and_anything_else_is_named() {
        let text = "l_crossing 10.5 20.5\n\nt_crossing 0 0 10 20 0.5\n  goalpost 4 0 6 50\n x_crossing 1 2 0.25\n";
        let at = |class, u, v, is_box, score| Detection { class, at: DVec2::new(u, v), is_box, score };
        let expected = [
            at(0, 10.0, 20.0, false, 1.0),
            at(1, 4.5, 9.5, true, 0.5),
            at(5, 4.5, 49.5, true, 1.0),
            at(2, 0.5, 1.5, false, 0.25),
        ];
        assert_eq!(parse_detections(text, LANDMARK_CLASSES).unwrap(), expected);
        let booster = parse_detections("Ball 1 2\nLCross 1 2", BOOSTER_CLASSES);
        assert_eq!(booster.unwrap(), [at(3, 0.5, 1.5, false, 1.0)], "no landmark is a ball");
        assert_eq!(parse_detections(" \n", LANDMARK_CLASSES), Ok(Vec::new()));
        for (wrong, said) in [
            ("ball 1 2", "line 1: \"ball\" is none of l_crossing, t_crossing"),
            ("centre 1 2\ncentre 1", "line 2: 1 numbers behind the class: `class u v [score]` or"),
            ("centre 1 2 3 4 5 6", "6 numbers"),
            ("centre 1 NaN", "\"NaN\" is no number"),
            ("centre 1 two", "\"two\" is no number"),
            ("centre 1 2 3", "the score is 3"),
            ("centre 3 2 1 4", "the box ends before it begins"),
            ("Traceback (most recent call last):", "\"Traceback\" is none of"),
        ] {
            let error = parse_detections(wrong, LANDMARK_CLASSES).unwrap_err().to_string();
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
            for found in parse_detections(&text, LANDMARK_CLASSES).unwrap_or_default() {
                prop_assert!(found.at.is_finite() && (0.0..=1.0).contains(&found.score), "{found:?}");
            }
        }

        #[test]
        fn what_is_written_is_read_back(found in detections()) {
            let line = |one: &Detection| {
                format!("{} {} {}\n", LANDMARK_CLASSES.names[one.class], one.at.x + 0.5, one.at.y + 0.5)
            };
            let read = parse_detections(&found.iter().map(line).collect::<String>(), LANDMARK_CLASSES).unwrap();
            prop_assert_eq!(read.len(), found.len());
            for (read, found) in read.iter().zip(&found) {
                prop_assert!(read.class == found.class && read.at.distance(found.at) < 1e-9, "{read:?} of {found:?}");
            }
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
