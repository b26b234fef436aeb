//! The answer of a detector that finds landmarks: a line for each.

use anyhow::{Context, ensure};
use glam::DVec2;

use super::shortened;
use crate::geometry::Physical;
use crate::labels::{ClassList, Detection, LandmarkKind};

/// The landmarks in a detector's answer, `class u v [score]` or `class u_min v_min u_max v_max [score]` a line. The left upper corner of
/// the picture is (0, 0), so that the first pixel's centre is (0.5, 0.5).
///
/// Classes of the list that no landmark has, such as a ball, are passed over.
///
/// # Errors
///
/// Fails if a line is anything else.
pub fn detections_in(answer: &str, classes: ClassList) -> anyhow::Result<Vec<Detection>> {
    let lines = answer.lines().map(str::trim).filter(|line| !line.is_empty());
    let found = lines.map(|line| detection(line, classes).with_context(|| format!("printed {:?}", shortened(line))));
    Ok(found.collect::<anyhow::Result<Vec<_>>>()?.into_iter().flatten().collect())
}

const FORM: &str = "class u v [score] or class u_min v_min u_max v_max [score] is needed";

fn detection(line: &str, classes: ClassList) -> anyhow::Result<Option<Detection>> {
    let mut words = line.split_whitespace();
    let name = words.next().context(FORM)?;
    let class = classes.names.iter().position(|known| *known == name);
    let class = class.with_context(|| format!("the classes are {}", classes.names.join(", ")))?;
    let numbers: Option<Vec<f64>> = words.map(|word| word.parse().ok().filter(f64::is_possible)).collect();
    let of_box = |[left, top, right, bottom]: [f64; 4], score: f64| {
        ensure!(left <= right && top <= bottom, "the left upper corner comes first");
        Ok(Detection::of_box(classes, class, [DVec2::new(left, top), DVec2::new(right, bottom)], score))
    };
    let found = match numbers.context(FORM)?[..] {
        [u, v] => Detection::point(class, DVec2::new(u, v), 1.0),
        [u, v, score] => Detection::point(class, DVec2::new(u, v), score),
        [left, top, right, bottom] => of_box([left, top, right, bottom], 1.0)?,
        [left, top, right, bottom, score] => of_box([left, top, right, bottom], score)?,
        _ => anyhow::bail!(FORM),
    };
    ensure!((0.0..=1.0).contains(&found.score), "a score is 0 to 1");
    let has_landmarks = KINDS.into_iter().any(|kind| classes.class(kind) == Some(class));
    Ok(has_landmarks.then_some(found))
}

/// The kinds of landmarks that may have a class.
const KINDS: [LandmarkKind; 6] = [
    LandmarkKind::LCrossing,
    LandmarkKind::TCrossing,
    LandmarkKind::XCrossing,
    LandmarkKind::PenaltyMark,
    LandmarkKind::Centre,
    LandmarkKind::PostFoot,
];

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    use crate::labels::{BOOSTER_CLASSES, LANDMARK_CLASSES};

    proptest! {
        #[test]
        fn no_answer_makes_the_reader_panic_or_a_number_infinite(
            lines in prop::collection::vec("(l_crossing|goalpost|.{0,8})( [-+.0-9eEinfNa]{0,6}| .{0,4}){0,7}", 0..4),
        ) {
            for found in detections_in(&lines.join("\n"), LANDMARK_CLASSES).unwrap_or_default() {
                prop_assert!(found.at.is_finite() && (0.0..=1.0).contains(&found.score), "{found:?}");
            }
        }
    }

    #[test]
    fn points_and_boxes_are_read_and_anything_else_is_named() {
        let answer = "l_crossing 10.5 20.5\n\nt_crossing 0 0 10 20 0.5\ngoalpost 4 0 6 50\n x_crossing 1 2 0.25\n";
        let at = |class, u, v, is_box, score| Detection { class, at: DVec2::new(u, v), is_box, score };
        let points = [at(0, 10.0, 20.0, false, 1.0), at(2, 0.5, 1.5, false, 0.25)];
        let expected = [points[0], at(1, 4.5, 9.5, true, 0.5), at(5, 4.5, 49.5, true, 1.0), points[1]];
        assert_eq!(detections_in(answer, LANDMARK_CLASSES).unwrap(), expected);
        assert_eq!(detections_in("Ball 1 2\nLCross 1 2", BOOSTER_CLASSES).unwrap(), [at(3, 0.5, 1.5, false, 1.0)]);
        assert_eq!(detections_in("", LANDMARK_CLASSES).unwrap(), []);
        for (line, said) in [
            ("ball 1 2", "the classes are l_crossing, t_crossing"),
            ("l_crossing", "is needed"),
            ("l_crossing 1", "is needed"),
            ("l_crossing 1 NaN", "is needed"),
            ("l_crossing 1 2 3 4 5 6", "is needed"),
            ("l_crossing 1 2 3", "a score is 0 to 1"),
            ("l_crossing 5 5 1 1", "left upper corner"),
            ("Traceback (most recent call last):", "the classes are"),
        ] {
            let error = format!("{:#}", detections_in(line, LANDMARK_CLASSES).expect_err(line));
            assert!(error.contains(said) && error.contains(line), "{line}: {error}");
        }
    }
}
