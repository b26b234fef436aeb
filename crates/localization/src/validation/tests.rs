use nalgebra::Matrix3;

use super::*;
use crate::estimate::Estimate;
use crate::filter::Effort;
use crate::line_distance_map::ExplainedLines;
use crate::observation::Support;
use realitysim_config::load_field;

/// Number of frames that a found pose needs.
fn needed(validator: &PoseValidator) -> u32 {
    let mut found = *validator;
    found.start_found();
    match found.tracking {
        TrackingState::Candidate { missing } => missing,
        other => panic!("{other:?}"),
    }
}

/// The validator after `poses` poses in a row that the next frame contradicted.
fn refuted(mut validator: PoseValidator, poses: usize) -> PoseValidator {
    for _ in 0..poses {
        validator.start_found();
        validator.note_proof(true, 0.1);
    }
    validator
}

#[test]
fn each_refuted_pose_asks_for_more_frames_and_time_for_fewer() {
    let fresh = PoseValidator::default();
    assert_eq!(needed(&fresh), THRESHOLDS.confirmations);
    let needs: Vec<u32> = (0..12).map(|poses| needed(&refuted(fresh, poses))).collect();
    assert!(needs.windows(2).all(|pair| pair[0] < pair[1]), "{needs:?}");
    assert!((7..=9).contains(&needs[1]) && needs[10] > 90, "{needs:?}");
    let mut later = refuted(fresh, 10);
    later.tracking = TrackingState::Lost;
    (0..1000).for_each(|_| later.note_proof(false, 0.1));
    assert_eq!(needed(&later), THRESHOLDS.confirmations, "100 s later");
}

#[test]
fn a_pose_that_was_announced_and_is_wrong_counts_as_three() {
    let mut announced = PoseValidator::default();
    announced.start_announced();
    announced.note_proof(true, 0.1);
    assert!(needed(&announced).abs_diff(needed(&refuted(PoseValidator::default(), 3))) <= 1);
}

/// The robot is tracked for some seconds, then carried: refuted poses count less, unless the seconds were few and ended in contradiction.
#[test]
fn a_robot_that_has_been_on_its_field_is_believed_sooner() {
    let tracked = |frames: u32| {
        let mut validator =
            PoseValidator { tracking: TrackingState::Tracking { contradictions: 0 }, ..PoseValidator::default() };
        (0..frames).for_each(|_| validator.note_proof(false, 0.1));
        for bad in 0..THRESHOLDS.lost_after {
            validator.tracking = TrackingState::Tracking { contradictions: bad };
            validator.note_proof(true, 0.1);
        }
        needed(&refuted(validator, 4))
    };
    let strange = needed(&refuted(PoseValidator::default(), 4));
    assert!(tracked(100) <= 2 * THRESHOLDS.confirmations, "{} after ten seconds", tracked(100));
    assert!(tracked(10) > strange, "{} after one second, {strange} without it", tracked(10));
}

/// A frame with many good lines, in the middle of the field.
fn good() -> Fix {
    Fix {
        estimate: Estimate {
            best: Pose2::new(0.0, 0.0, 0.0),
            covariance: Matrix3::identity() * 1e-4,
            spread_m: 0.01,
            spread_yaw_rad: 0.01,
            effective_sample_size: 100.0,
            evidence: 0.0,
            degenerate: false,
        },
        support: Support { share: 1.0, weight: 100.0, points: 100 },
        map_from_optical: Isometry::IDENTITY,
        covariance: Matrix6::identity() * 1e-4,
        refined: true,
        contradicts_prediction: false,
        strays: false,
        lacks_odometry: false,
        misfits: false,
        agreement: Agreement {
            expected: 100,
            fitting: 100,
            rms_px: 0.1,
            share: 1.0,
            visible: 100.0,
            digits: THRESHOLDS.frame_digits,
            foremost: 1.0,
            half_seen_px: 1.0,
        },
        explained: ExplainedLines { shown_m2: 1.0, share: 1.0 },
        explained_in_view: 1.0,
        effort: Effort::default(),
        ambiguous: false,
        rejection: None,
    }
}

fn changed(change: impl FnOnce(&mut Fix)) -> Fix {
    let mut fix = good();
    change(&mut fix);
    fix
}

/// The rejections of these frames, a tenth of a second apart.
fn judged(validator: &mut PoseValidator, frames: &[Fix]) -> Vec<Option<Rejection>> {
    let field = Field::new(load_field("kid-2009").expect("shipped")).expect("checked");
    let valid = Validity { share: 0.35, points: 6.0, spread_m: 0.2, refined_m: 0.15 };
    let rules = Rules { valid: &valid, field: &field, refinement: true, random_walk: false };
    let moment = FrameSensors {
        stamp_ns: 0,
        odometry: Some(Pose2::new(0.0, 0.0, 0.0)),
        turned_rad: None,
        swayed_rad: None,
        camera_twist: None,
        turn_is_measured: false,
        footprint_from_optical: None,
        tilt_is_measured: true,
        lean_rad: None,
        stale: false,
        stamp_sigma_s: 0.0,
        tilt_sigma_rad: 0.0,
    };
    frames.iter().map(|fix| validator.judge(&rules, &moment, fix, 0.1)).collect()
}

#[test]
fn a_found_pose_needs_three_frames_of_forty_digits_or_more_with_fewer() {
    for (digits, frames) in [(80.0, 3), (THRESHOLDS.frame_digits, 3), (THRESHOLDS.frame_digits / 2.0, 6)] {
        let mut validator = PoseValidator::default();
        validator.start_found();
        let said = judged(&mut validator, &vec![changed(|fix| fix.agreement.digits = digits); frames]);
        assert!(
            said[..frames - 1].iter().all(|rejection| *rejection == Some(Rejection::Unconfirmed)),
            "{digits} digits: {said:?}"
        );
        assert_eq!(said[frames - 1], None, "{digits} digits: {said:?}");
    }
}

#[test]
fn poor_frames_never_confirm_a_pose() {
    let poor = [
        changed(|fix| fix.agreement.rms_px = THRESHOLDS.confirmed_rms_px + 0.01),
        changed(|fix| fix.agreement.digits = THRESHOLDS.digits_per_place * 100.0 - 0.1),
        changed(|fix| fix.agreement.foremost = THRESHOLDS.announced_foremost - 0.01),
        changed(|fix| fix.misfits = true),
        changed(|fix| fix.explained_in_view = THRESHOLDS.explained_in_view - 0.01),
    ];
    for is_announced in [false, true] {
        for fix in &poor {
            let mut validator = PoseValidator::default();
            if is_announced {
                validator.start_announced()
            } else {
                validator.start_found()
            }
            let said = judged(&mut validator, &vec![fix.clone(); 200]);
            assert!(
                said.iter().all(|rejection| *rejection == Some(Rejection::Unconfirmed)),
                "announced: {is_announced}, {fix:?}"
            );
        }
    }
}

#[test]
fn a_lucky_frame_among_poor_ones_confirms_nothing() {
    let frames: Vec<Fix> = (0..200).map(|index| changed(|fix| fix.misfits = index % 2 == 0)).collect();
    let mut validator = PoseValidator::default();
    validator.start_found();
    assert!(judged(&mut validator, &frames).iter().all(|rejection| *rejection == Some(Rejection::Unconfirmed)));
}

#[test]
fn a_contradicted_pose_is_used_again_after_as_many_good_frames() {
    let bad = changed(|fix| fix.agreement.rms_px = THRESHOLDS.believed_rms_px + 0.01);
    let mut validator =
        PoseValidator { tracking: TrackingState::Tracking { contradictions: 0 }, ..PoseValidator::default() };
    let said = judged(&mut validator, &[bad.clone(), bad, good(), good(), good()]);
    let disagree = Some(Rejection::LinesDisagree);
    assert_eq!(said, [disagree, disagree, Some(Rejection::Unconfirmed), None, None]);
}

#[test]
fn missing_lines_trigger_a_search_unless_they_are_too_faint() {
    for (half_seen_px, share, is_due) in [(1.0, 0.95, false), (1.0, 0.75, true), (2.7, 0.75, false), (2.7, 0.5, true)] {
        let mut validator =
            PoseValidator { tracking: TrackingState::Tracking { contradictions: 0 }, ..PoseValidator::default() };
        let frame = changed(|fix| {
            fix.agreement.share = share;
            fix.agreement.half_seen_px = half_seen_px;
        });
        judged(&mut validator, &vec![frame; 20]);
        assert_eq!(
            validator.relocalization_is_due(),
            is_due,
            "{share} of lines seen half the time at {half_seen_px} px"
        );
    }
}
