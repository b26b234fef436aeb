//! Tests in which a walk with known poses and constants is recovered.

use nalgebra::Vector6;

use super::*;
use crate::refinement::miscalibration::row;
use crate::refinement::{error_between, moved_pose};
use realitysim_geometry::{Euler, Lens};

const COUNT: usize = 30;

fn lens() -> LensParameters {
    LensParameters {
        width: 640,
        height: 480,
        fx: 210.0,
        fy: 210.0,
        cx: 322.0,
        cy: 236.0,
        model: LensModel::KannalaBrandt { k: [-0.01, 0.002, 0.0, 0.0] },
        fov_deg: Some(170.0),
    }
}

/// A deterministic sequence, uniform between -1 and 1.
fn noise(number: usize) -> f64 {
    2.0 * ((number as f64 + 0.5) * 0.618_033_988_75).fract() - 1.0
}

/// A walk along a curve: the true poses, and the frames as tagged and measured.
fn walk(truth: &Constants, noise_px: f64) -> (Vec<Isometry>, Vec<Frame>) {
    swaying_walk(truth, noise_px, DVec3::ZERO)
}

/// The same with a torso that sways at this speed, which neither feet nor gyro tell.
fn swaying_walk(truth: &Constants, noise_px: f64, unseen_m_per_s: DVec3) -> (Vec<Isometry>, Vec<Frame>) {
    let real = Lens::new(truth.lens(&lens())).expect("a lens");
    let lines: Vec<(DVec3, DVec3)> = (0..9)
        .map(|i| f64::from(i) - 4.0)
        .flat_map(|at| [(DVec3::new(at, 0.0, 0.0), DVec3::Y), (DVec3::new(0.0, 0.75 * at, 0.0), DVec3::X)])
        .collect();
    let mut truths = Vec::new();
    let mut frames = Vec::new();
    for i in 0..COUNT {
        let (part, wave) = (i as f64 / COUNT as f64, libm::sin(i as f64));
        let feet = Pose2::new(-1.5 + 2.0 * part, 0.5 * libm::sin(3.0 * part), 1.0 * part);
        let euler = Euler { yaw: 0.02 * wave, pitch: 0.5 + 0.01 * wave, roll: 0.01 * wave };
        let believed = Isometry::from_euler(euler, DVec3::new(0.05, 0.0, 0.52)) * Isometry::link_from_optical();
        let tilt = glam::DQuat::from_scaled_axis(DVec3::new(truth.tilt_x, 0.0, truth.tilt_z));
        let mounted =
            Isometry::new(believed.rotation * tilt.conjugate(), believed.translation + DVec3::Z * truth.height_m);
        let pose = feet.to_isometry() * mounted;
        let other_wave = libm::sin(1.7 * i as f64);
        let twist = Twist {
            linear: DVec3::new(0.1 * other_wave, 0.0, 0.25),
            angular: DVec3::new(0.4 * wave, 0.5 + 0.3 * other_wave, 0.2 * wave),
        };
        let unseen = unseen_m_per_s * libm::sin(2.3 * i as f64);
        let swaying = Twist { linear: twist.linear + unseen, ..twist };
        let mut places = Vec::new();
        for (origin, tangent) in &lines {
            for k in -20..=20 {
                let point = *origin + *tangent * (0.2 * f64::from(k));
                let seen = pose.inverse().transform_point(point);
                let far = point.distance(pose.translation);
                let at_its_row = |pixel: DVec2| {
                    let then = swaying.carries(&pose, truth.readout_s * row(&real, pixel));
                    real.project(then.inverse().transform_point(point))
                };
                let drawn = real.project(seen).and_then(at_its_row).and_then(at_its_row);
                if let Some(pixel) = drawn.filter(|pixel| far < 3.0 && seen.z > 0.2 && real.contains(*pixel)) {
                    let number = frames.len() * 1000 + places.len();
                    let pixel = pixel + DVec2::new(noise(number), noise(number + 77_777)) * noise_px;
                    let pixels_per_rad = real.focal();
                    places.push(Place {
                        pixel,
                        point,
                        tangent: *tangent,
                        by_size: [DVec3::ZERO; 2],
                        sigmas: 1.0,
                        pixels_per_rad,
                    });
                }
            }
        }
        let off = Vector6::from_fn(|k, _| noise(7 * i + k) * if k < 3 { 0.012 } else { 0.006 });
        frames.push(Frame {
            stamp_ns: i as i64 * 100_000_000,
            map_from_optical: moved_pose(&pose, &off),
            footprint_from_optical: Some(believed),
            odometry: Some(Pose2::new(3.0, 1.0, 0.4).compose(&feet)),
            turned_rad: None,
            twist,
            turn_is_measured: true,
            places,
            overlap: None,
        });
        truths.push(pose);
    }
    (truths, frames)
}

fn errors(found: &[Isometry], truth: &[Isometry]) -> (f64, f64) {
    let off = |(a, b): (&Isometry, &Isometry)| {
        let off = error_between(b, a);
        (off.fixed_rows::<3>(0).norm(), off.fixed_rows::<3>(3).norm())
    };
    let all: Vec<(f64, f64)> = found.iter().zip(truth).map(off).collect();
    let median = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    (median(all.iter().map(|x| x.0).collect()), median(all.iter().map(|x| x.1).collect()))
}

/// Mean squared deviation in units of the covariances; 6 is expected for six unknowns.
fn squared_deviation(found: &Smoothed, truths: &[Isometry]) -> f64 {
    let deviation = |i: usize| {
        let off = error_between(&found.map_from_optical[i], &truths[i]);
        let inverse = found.covariances[i].try_inverse().expect("a covariance");
        (off.transpose() * inverse * off)[0]
    };
    (0..COUNT).map(deviation).sum::<f64>() / COUNT as f64
}

#[test]
fn a_walk_without_noise_is_found_exactly_with_its_constants() {
    let truth = Constants {
        focal_share: 0.004,
        centre: DVec2::new(1.0, -0.8),
        k: [0.002, 0.0, 0.0, 0.0],
        tilt_x: 0.008,
        tilt_z: -0.006,
        height_m: 0.01,
        readout_s: 0.016,
        ..Constants::default()
    };
    let (truths, frames) = walk(&truth, 0.0);
    // Nothing but the lines is to count.
    let model = Model { line_px: 0.001, ..Model::default() };
    let found = smooth(&frames, &lens(), &model).expect("a lens");
    let (metres, radians) = errors(&found.map_from_optical, &truths);
    assert!(metres < 1e-4 && radians < 1e-4, "{metres} m, {radians} rad; {:?}", found.constants);
    let off = |value: f64, wanted: f64, most: f64| assert!((value - wanted).abs() < most, "{:?}", found.constants);
    off(found.constants.focal_share, truth.focal_share, 1e-4);
    off(found.constants.centre.x, truth.centre.x, 0.05);
    off(found.constants.centre.y, truth.centre.y, 0.05);
    off(found.constants.k[0], truth.k[0], 3e-4);
    off(found.constants.tilt_x, truth.tilt_x, 5e-4);
    off(found.constants.tilt_z, truth.tilt_z, 5e-4);
    off(found.constants.height_m, truth.height_m, 5e-4);
    off(found.constants.readout_s, truth.readout_s, 1e-4);
}

#[test]
fn smoothed_tags_are_ten_times_closer_with_consistent_covariance() {
    let truth = Constants { focal_share: 0.003, tilt_x: 0.007, height_m: 0.008, ..Constants::default() };
    let (truths, frames) = walk(&truth, 0.5);
    let before: Vec<Isometry> = frames.iter().map(|frame| frame.map_from_optical).collect();
    let found = smooth(&frames, &lens(), &Model { line_px: 0.3, ..Model::default() }).expect("a lens");
    let ((m_before, rad_before), (m_after, rad_after)) =
        (errors(&before, &truths), errors(&found.map_from_optical, &truths));
    assert!(
        m_after < 0.1 * m_before && rad_after < 0.1 * rad_before,
        "{m_before} to {m_after} m, {rad_before} to {rad_after} rad"
    );
    let mean = squared_deviation(&found, &truths);
    // The noise is independent from frame to frame here, and is allowed for as if it were not.
    assert!((0.1..18.0).contains(&mean), "{mean}");
    assert!(found.rms_px[1] < found.rms_px[0], "{:?}", found.rms_px);
    assert!(
        found.known.iter().zip(found.believed).all(|(known, believed)| *known <= believed * 1.000_001),
        "{:?}",
        found.known
    );
}

#[test]
fn lines_that_took_no_part_tell_better_poses_from_others() {
    let model = Model { line_px: 0.3, ..Model::default() };
    let (_, frames) = walk(&Constants { focal_share: 0.004, ..Constants::default() }, 0.3);
    let [before, after] = held_out_rms_px(frames, &lens(), &model).expect("a lens");
    assert!(after < 0.9 * before, "tags and lens are off: {before} to {after} px");
    // Tags are the truth and the lens is right: only noise could be fitted.
    let (truths, mut frames) = walk(&Constants::default(), 0.3);
    frames.iter_mut().zip(&truths).for_each(|(frame, truth)| frame.map_from_optical = *truth);
    let [before, after] = held_out_rms_px(frames, &lens(), &model).expect("a lens");
    assert!(after > 0.99 * before, "{before} to {after} px");
}

/// Every frame sees the same errors, so that they do not average out.
#[test]
fn lines_that_are_painted_crookedly_leave_all_less_certain() {
    let (truths, mut frames) = walk(&Constants::default(), 0.05);
    for place in frames.iter_mut().flat_map(|frame| &mut frame.places) {
        let spot = place.point.dot(DVec3::new(5.0, 500.0, 0.0));
        place.point += place.tangent.cross(DVec3::Z) * (0.012 * noise((spot.round() + 1e5) as usize));
    }
    let found = smooth(&frames, &lens(), &Model::default()).expect("a lens");
    let mean = squared_deviation(&found, &truths);
    assert!((0.5..18.0).contains(&mean), "{mean}");
}

#[test]
fn a_torso_that_sways_unseen_while_rows_are_read_moves_no_tag() {
    let truth = Constants { readout_s: 0.02, ..Constants::default() };
    let (truths, frames) = swaying_walk(&truth, 0.2, DVec3::new(0.2, 0.05, 0.0));
    let found = smooth(&frames, &lens(), &Model::default()).expect("a lens");
    let (metres, radians) = errors(&found.map_from_optical, &truths);
    assert!(metres < 0.0005 && radians < 0.000_25, "{metres} m, {radians} rad; {:?}", found.constants);
}

#[test]
fn frames_without_lines_are_carried_by_their_neighbours() {
    let (truths, mut frames) = walk(&Constants::default(), 0.2);
    for frame in &mut frames[12..15] {
        frame.places.clear();
        frame.map_from_optical = moved_pose(&frame.map_from_optical, &Vector6::new(0.03, -0.03, 0.0, 0.0, 0.0, 0.01));
    }
    let found = smooth(&frames, &lens(), &Model::default()).expect("a lens");
    for i in 12..15 {
        let (before, after) = (frames[i].map_from_optical, found.map_from_optical[i]);
        let off = |pose: &Isometry| pose.translation.distance(truths[i].translation);
        assert!(off(&after) < 0.6 * off(&before), "{} to {} m", off(&before), off(&after));
        assert!(found.covariances[i][(0, 0)] > 4.0 * found.covariances[5][(0, 0)]);
    }
}

#[test]
fn places_that_are_nowhere_near_a_line_pull_at_nothing() {
    let (truths, mut frames) = walk(&Constants::default(), 0.2);
    for frame in &mut frames {
        let wrong = frame.places.len() / 10;
        frame.places.iter_mut().take(wrong).for_each(|place| place.pixel += DVec2::new(15.0, -12.0));
    }
    let found = smooth(&frames, &lens(), &Model::default()).expect("a lens");
    let (metres, _) = errors(&found.map_from_optical, &truths);
    assert!(metres < 0.002, "{metres} m");
}

#[test]
fn a_single_frame_and_none_are_walks_too() {
    let (_, frames) = walk(&Constants::default(), 0.2);
    assert_eq!(smooth(&frames[..1], &lens(), &Model::default()).expect("a lens").map_from_optical.len(), 1);
    assert_eq!(smooth(&[], &lens(), &Model::default()).expect("a lens").map_from_optical.len(), 0);
}

/// Adds points of the ground that neighbouring frames show.
fn with_overlaps(truths: &[Isometry], frames: &mut [Frame], noise_px: f64) {
    let lens = Lens::new(lens()).expect("a lens");
    for i in 1..frames.len() {
        let pixel = |pose: &Isometry, place: DVec3| {
            let seen = pose.inverse().transform_point(place);
            lens.project(seen).filter(|pixel| seen.z > 0.2 && lens.contains(*pixel))
        };
        let places = (0..40).map(|k| {
            let ahead = DVec2::new(0.4 + 1.6 * (0.5 + 0.5 * noise(k)), 1.2 * noise(k + 5000));
            let feet = Pose2::from_isometry(&(truths[i] * Isometry::link_from_optical().inverse()));
            feet.to_isometry().transform_point(ahead.extend(0.0)).with_z(0.0)
        });
        let pair = |(k, place): (usize, DVec3)| {
            let off =
                |which: usize| DVec2::new(noise(91 * i + 2 * k + which), noise(57 * i + 3 * k + which)) * noise_px;
            let (before, here) = (pixel(&truths[i - 1], place)?, pixel(&truths[i], place)?);
            // One in ten is something that moves.
            let walked = if k % 10 == 3 { DVec2::new(25.0, -20.0) } else { DVec2::ZERO };
            Some(Match { before: before + off(0), here: here + off(1) + walked })
        };
        let matches: Vec<Match> = places.enumerate().filter_map(pair).collect();
        assert!(matches.len() > 20, "{}", matches.len());
        frames[i].overlap = Some(Overlap { before_ns: frames[i - 1].stamp_ns, matches });
    }
}

#[test]
fn overlapping_images_carry_frames_whose_lines_say_little() {
    let (truths, mut frames) = walk(&Constants::default(), 0.5);
    for (i, frame) in frames.iter_mut().enumerate() {
        // Only every fifth frame has lines, and feet slip.
        if i % 5 != 0 {
            frame.places.clear();
        }
        frame.odometry = None;
    }
    let alone = smooth(&frames, &lens(), &Model::default()).expect("a lens");
    with_overlaps(&truths, &mut frames, 0.3);
    let together = smooth(&frames, &lens(), &Model::default()).expect("a lens");
    let ((m_alone, rad_alone), (m, rad)) =
        (errors(&alone.map_from_optical, &truths), errors(&together.map_from_optical, &truths));
    // The relative pose of two frames says little about how both lean.
    assert!(m < 0.3 * m_alone && rad < rad_alone, "{m_alone} to {m} m, {rad_alone} to {rad} rad");
    assert!(m < 0.003, "{m} m");
}

#[test]
fn an_overlap_with_a_frame_that_is_not_there_says_nothing() {
    let (truths, mut frames) = walk(&Constants::default(), 0.2);
    let without = smooth(&frames, &lens(), &Model::default()).expect("a lens");
    with_overlaps(&truths, &mut frames, 0.3);
    frames.iter_mut().filter_map(|frame| frame.overlap.as_mut()).for_each(|overlap| overlap.before_ns += 1);
    assert_eq!(smooth(&frames, &lens(), &Model::default()).expect("a lens"), without);
}

/// The lines at `x` and `y` of +-1.5 and +-1 m stand for goal lines and touchlines that were measured wrongly.
#[test]
fn a_walk_tells_the_size_of_the_field_the_scale_of_odometry_and_the_delay() {
    let truth = Constants { focal_share: 0.03, k: [0.004, 0.002, 0.0, 0.0], height_m: 0.02, ..Constants::default() };
    let (size, share, delay_s) = (DVec2::new(0.06, -0.04), 0.08, 0.012);
    let (truths, mut frames) = walk(&truth, 0.0);
    let before: Vec<Frame> = frames.clone();
    for (frame, original) in frames.iter_mut().zip(&before) {
        for place in &mut frame.places {
            let far = |value: f64| if value.abs() > 1.2 { value.signum() / 2.0 } else { 0.0 };
            place.by_size = [DVec3::X * far(place.point.x), DVec3::Y * far(place.point.y)];
            place.point -= place.by_size[0] * size.x + place.by_size[1] * size.y;
        }
        // Odometry says too little by the share.
        frame.odometry = original.odometry.map(|odometry| {
            let start = before[0].odometry.expect("there");
            let way = start.inverse().compose(&odometry);
            start.compose(&Pose2::new(way.x / (1.0 + share), way.y / (1.0 + share), way.yaw))
        });
        // The attitude is that of the stamp, and the image was exposed before it.
        let turn = glam::DQuat::from_scaled_axis(frame.twist.angular * delay_s);
        frame.footprint_from_optical =
            frame.footprint_from_optical.map(|place| Isometry::new(place.rotation * turn, place.translation));
    }
    let model = Model { line_px: 0.001, tilt_rad: 1e-4, sway_m: 1e-4, step_share: 1e-3, ..Model::calibration() };
    let found = smooth(&frames, &lens(), &model).expect("a lens");
    let (metres, _) = errors(&found.map_from_optical, &truths);
    let constants = found.constants;
    assert!(metres < 1e-3, "{metres} m, {constants:?}");
    assert!((constants.field_m - size).length() < 1e-3, "{constants:?}");
    assert!((constants.focal_share - truth.focal_share).abs() < 1e-3, "{constants:?}");
    assert!((constants.odometry_share - share).abs() < 2e-3, "{constants:?}");
    assert!((constants.delay_s - delay_s).abs() < 1e-3, "{constants:?}");
}
