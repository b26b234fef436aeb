use glam::DVec2;
use proptest::prelude::*;

use super::validation::{TrueError, correlation};
use super::verdict::Verdict;
use super::*;
use realitysim_config::load_field;
use realitysim_geometry::{Euler, Field, wrap_angle};

fn field() -> Field {
    Field::new(load_field("kid-2020").expect("shipped")).expect("checked")
}

/// Stands on the recommended crossings with four headings, with this offset of the robot and this shift of the field.
fn stood(offset: DVec2, shift: DVec2, yaw_rad: f64) -> Vec<Stand> {
    let all = crossings(&field());
    let on = |crossing: &Crossing, heading_rad: f64| {
        let at = crossing.at_m + shift + DVec2::from_angle(heading_rad).rotate(offset);
        let tagged = vec![Pose2::new(at.x, at.y, heading_rad + yaw_rad); 5];
        Stand { crossing: crossing.name.clone(), at_m: crossing.at_m, heading_rad, tagged }
    };
    let headings = [0.0, 90.0, 180.0, 270.0f64].map(f64::to_radians);
    crossings::recommended(&all).iter().flat_map(|crossing| headings.map(|heading| on(crossing, heading))).collect()
}

const LIMITS: Limits = Limits { labels_m: 0.04, views_m: 0.01, ball_m: 0.07 };

proptest! {
    #[test]
    fn an_offset_of_the_robot_and_one_of_the_field_are_told_apart(
        forward in -0.1..0.1f64, left in -0.1..0.1f64, x in -0.1..0.1f64, y in -0.1..0.1f64, yaw in -0.2..0.2f64
    ) {
        let stands = stood(DVec2::new(forward, left), DVec2::new(x, y), yaw);
        let taped = taped(&stands);
        let found = taped.known().expect("stands");
        let offset = found.offset.known().expect("opposite headings");
        prop_assert!((offset.forward_left_cm - 100.0 * DVec2::new(forward, left)).length() < 1e-9);
        prop_assert!((offset.field_cm - 100.0 * DVec2::new(x, y)).length() < 1e-9);
        prop_assert!((offset.turned_deg - yaw.to_degrees()).abs() < 1e-9 && offset.rest_cm < 1e-9);
        // What is fixed to the field stays in the held-out figure, what turns with the robot does not.
        let held_out = found.held_out.known().expect("six crossings");
        prop_assert!((held_out.rms_cm - 100.0 * libm::hypot(x, y)).abs() < 1e-9);
        let turned = turned(&taped);
        let turned = turned.known().expect("pairs");
        prop_assert_eq!(turned.pairs, 12);
        prop_assert!((turned.forward_left_cm - offset.forward_left_cm).length() < 1e-9);
    }

    #[test]
    fn the_footprint_of_a_true_tag_is_where_the_robot_stands(
        x in -4.0..4.0f64, y in -3.0..3.0f64, yaw in -3.1..3.1f64, pitch in 0.0..0.9f64, pan in -1.0..1.0f64
    ) {
        let stands = Pose2::new(x, y, yaw);
        let arm = Isometry::from_euler(Euler { roll: 0.0, pitch, yaw: pan }, [0.05, 0.01, 0.5].into());
        let found = footprint(&(stands.to_isometry() * arm), &arm);
        prop_assert!(found.distance(&stands) < 1e-9 && wrap_angle(found.yaw - yaw).abs() < 1e-9);
    }
}

#[test]
fn a_tilt_of_the_mount_moves_the_footprint_by_less_than_a_millimetre() {
    let arm = |pitch_deg: f64| {
        Isometry::from_euler(Euler { roll: 0.0, pitch: pitch_deg.to_radians(), yaw: 0.0 }, [0.05, 0.0, 0.5].into())
    };
    let found = footprint(&arm(20.0), &arm(21.0));
    assert!(libm::hypot(found.x, found.y) < 1e-3, "{found:?}");
}

#[test]
fn every_shipped_field_has_six_places_to_stand_on() {
    for name in realitysim_config::field_names() {
        let field = Field::new(load_field(&name).expect("shipped")).expect("checked");
        let all = crossings(&field);
        assert_eq!(crossings::recommended(&all).len(), 6, "{name}");
        for crossing in &all {
            let text = format!("at {} -90", crossing.name);
            let (found, heading) = crossings::parse_mark(&text, &all).expect("a place").expect("a crossing");
            assert_eq!((found, heading.to_degrees().round()), (crossing, -90.0));
        }
    }
}

/// Frames at 10 Hz over four seconds; the odometry goes at this speed.
fn frames(speed_m_s: f64, tagged: bool, odometry: bool) -> Vec<SeenFrame> {
    let frame = |index: i64| {
        let pose = Pose2::new(speed_m_s * 0.1 * index as f64, 0.0, 0.0);
        SeenFrame { stamp_ns: index * 100_000_000, tagged: tagged.then_some(pose), odometry: odometry.then_some(pose) }
    };
    (0..40).map(frame).collect()
}

#[test]
fn a_mark_that_cannot_be_used_says_what_would_mend_it() {
    let all = crossings(&field());
    let why = |mark: &str, frames: &[SeenFrame]| {
        let (stands, refused) = stands(&[(2_000_000_000, mark.to_owned())], frames, &all);
        assert!(stands.is_empty(), "{mark}");
        refused.into_iter().map(|refused| refused.why).collect::<String>()
    };
    let still = frames(0.0, true, true);
    assert!(why("at cornr_+x+y 90", &still).contains("did you mean corner_+x+y"));
    assert!(why("at LB 90", &still).contains("--crossings"));
    assert!(why("at centre", &still).contains("a crossing and a heading"));
    assert!(why("at centre north", &still).contains("no heading"));
    assert!(why("at centre NaN", &still).contains("no heading"));
    assert!(why("at centre 90", &frames(0.1, true, true)).contains("the robot moved by 20 cm"));
    assert!(why("at centre 90", &frames(0.1, true, false)).contains("the robot moved"));
    assert!(why("at centre 90", &frames(0.0, false, true)).contains("0 valid tags"));
    assert!(why("second half begins", &still).is_empty(), "a mark about something else");
}

#[test]
fn the_last_mark_of_a_place_and_heading_counts() {
    let all = crossings(&field());
    let marks = [1, 2, 3].map(|second| (second * 1_000_000_000, "at centre 90".to_owned()));
    let (found, refused) = stands(&marks, &frames(0.0, true, true), &all);
    assert_eq!((found.len(), refused.len()), (1, 0));
}

#[test]
fn too_few_places_and_one_heading_are_named() {
    assert!(taped(&[]).known().is_none());
    let all = stood(DVec2::ZERO, DVec2::ZERO, 0.0);
    let one_heading: Vec<Stand> = all.iter().step_by(4).cloned().collect();
    let of_one = taped(&one_heading);
    let known = of_one.known().expect("stands");
    assert!(known.offset.known().is_none() && known.held_out.known().is_none());
    assert!(turned(&of_one).known().is_none());
    let of_two = taped(&all[..8]);
    assert!(of_two.known().expect("stands").held_out.known().is_none());
    let verdicts = verdicts(&LIMITS, &of_two, &turned(&of_two), &[]);
    assert!(verdicts.iter().all(|verdict| verdict.verdict == Verdict::NotShown), "{verdicts:?}");
}

#[test]
fn a_wrong_crossing_is_gross_and_spoils_no_offset_but_every_verdict() {
    let mut stands = stood(DVec2::new(0.01, 0.0), DVec2::ZERO, 0.0);
    let half = |noise_cm| {
        let by = Halving::Metres;
        Measure::Known(SplitHalf { by, frames: 99, apart_cm: 1.0, apart_deg: 0.1, claimed: 1.0, noise_cm })
    };
    let judged = |stands: &[Stand], noise_cm| {
        let taped = taped(stands);
        let verdicts = verdicts(&LIMITS, &taped, &turned(&taped), &[half(noise_cm)]);
        verdicts.iter().map(|verdict| verdict.verdict).collect::<Vec<_>>()
    };
    use Verdict::{No, NotShown, Yes};
    assert_eq!(judged(&stands, 0.1), [Yes, No, Yes], "1 cm and 0.1 cm are more than 1 cm");
    assert_eq!(judged(&[], 0.1), [NotShown; 3]);
    assert_eq!(judged(&[], 5.0), [No, No, NotShown]);
    stands[3].tagged.iter_mut().for_each(|pose| pose.x += 2.0);
    let found = taped(&stands);
    let known = found.known().expect("stands");
    assert_eq!(known.gross, 1);
    let offset = known.offset.known().expect("others");
    assert!((offset.forward_left_cm - DVec2::new(1.0, 0.0)).length() < 1e-9);
    assert_eq!(judged(&stands, 0.1), [No; 3]);
}

#[test]
fn correlation_agrees_with_numpy() {
    let pairs = [(1.0, 2.0), (2.0, 1.0), (3.0, 5.0), (4.0, 4.0)];
    assert!((correlation(&pairs).expect("four pairs") - core::f64::consts::FRAC_1_SQRT_2).abs() < 1e-12);
    assert_eq!(correlation(&pairs[..2]), None);
    assert_eq!(correlation(&[(1.0, 1.0); 5]), None);
}

/// A true error that differs by a hundredth of a centimetre correlates perfectly with noise.
#[test]
fn a_truth_that_hardly_varies_gives_no_correlation() {
    let pairs = [(0.070, 0.020), (0.071, 0.021), (0.072, 0.022), (0.073, 0.023)];
    assert_eq!(correlation(&pairs), None);
    let spread = pairs.map(|(measure, truth)| (measure, truth * if truth > 0.021 { 3.0 } else { 1.0 }));
    assert!(correlation(&spread).is_some());
}

#[test]
fn the_true_error_is_that_of_the_pose() {
    let pose = |x, yaw| Isometry::from_euler(Euler { roll: 0.0, pitch: 0.0, yaw }, [x, 0.0, 0.5].into());
    let truth = [(1, pose(0.0, 0.0)), (2, pose(1.0, 3.0)), (3, pose(2.0, 1.0))];
    let tags = truth.map(|(stamp_ns, truth)| (stamp_ns, truth * pose(0.02, 0.0)));
    let found = TrueError::of(&tags[1..], &truth).expect("stamps");
    assert!((found.rms_cm - 2.0).abs() < 1e-9 && found.rest_cm < 1e-9, "{found:?}");
    assert!((found.forward_left_cm - DVec2::new(2.0, 0.0)).length() < 1e-9);
    assert_eq!(TrueError::of(&tags, &[]), None);
}
