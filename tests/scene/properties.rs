//! Same file, same bytes; and no effect reaches further than it should.

use realitysim::geometry::Isometry;
use realitysim::scene::{Renderer, Scene, SceneEvent, SceneEventKind};

use super::common::{STRAIGHT, image, plain, scene, straight_with as build, with_effects};

const SWAY: &str = "kind = \"gait_sway\"\nroll_deg = 2.0\npitch_deg = 1.3\nlateral_m = 0.018\nvertical_m = 0.006\n\
                    step_hz = 2.4";
const ODOMETRY: &str = "kind = \"odometry_error\"\nscale_percent = 6.0\nyaw_drift_deg_per_m = 1.0\nnoise_m_per_m = 0.1";
const IMU: &str = "kind = \"imu_error\"\nroll_bias_deg = 0.5\npitch_bias_deg = 0.5\nnoise_deg = 0.25\n\
                   gyro_noise_deg_s = 0.3";
const NOISE: &str = "kind = \"sensor_noise\"\nrole = \"filler\"\nread_noise_dn = 1.5\nshot_noise_factor = 0.15";

fn events(scene: &Scene, pick: fn(&SceneEventKind) -> bool) -> Vec<SceneEvent> {
    scene.events().filter(|event| pick(&event.kind)).collect()
}

fn is_odometry(kind: &SceneEventKind) -> bool {
    matches!(kind, SceneEventKind::Odometry(_))
}

fn is_imu(kind: &SceneEventKind) -> bool {
    matches!(kind, SceneEventKind::Imu(_))
}

#[test]
fn the_same_scene_is_the_same_to_the_last_bit() {
    let [a, b] = [(); 2].map(|()| build(&[SWAY, ODOMETRY, IMU, NOISE]));
    assert!(a.events().eq(b.events()));
    assert_eq!(image(&a, 17), image(&b, 17));
}

#[test]
fn frames_do_not_depend_on_what_was_rendered_before() {
    let scene = build(&[SWAY, NOISE]);
    let renderer = Renderer::new(&scene);
    let mut pixels = vec![9; 7];
    for index in [40, 3, 17] {
        renderer.render(index, &mut pixels);
    }
    assert_eq!(pixels, image(&scene, 17));
}

#[test]
fn another_seed_is_another_scene() {
    let toml = with_effects(&plain(STRAIGHT), &[SWAY, ODOMETRY, IMU, NOISE]);
    let [a, b] = [scene(&toml), scene(&toml.replace("seed = 20130601", "seed = 5"))];
    assert_ne!(image(&a, 5), image(&b, 5));
    assert_ne!(events(&a, is_odometry), events(&b, is_odometry));
    assert_ne!(events(&a, is_imu), events(&b, is_imu));
}

#[test]
fn sensor_effects_leave_truth_and_each_other_alone() {
    let base = build(&[SWAY, IMU]);
    let more = build(&[SWAY, ODOMETRY, IMU, NOISE]);
    for index in 0..200 {
        let time = f64::from(index) * 0.117;
        assert_eq!(base.truth(time), more.truth(time));
    }
    let strip = |scene: &Scene| -> Vec<_> {
        let told = |event: SceneEvent| match event.kind {
            // The yaw is the odometry's, error included.
            SceneEventKind::Imu(imu) => Some((imu.angular_velocity, imu.linear_acceleration)),
            _ => None,
        };
        scene.events().filter_map(told).collect()
    };
    assert_eq!(strip(&base), strip(&more));
    // Neither the place nor the neighbours of an effect change what it draws.
    let reordered = build(&[SWAY, NOISE, ODOMETRY, IMU]);
    assert!(reordered.events().eq(more.events()));
    assert_eq!(image(&reordered, 30), image(&more, 30));
    assert_eq!(events(&build(&[ODOMETRY]), is_odometry), events(&more, is_odometry));
}

#[test]
fn noise_on_the_sensor_is_the_same_whatever_the_other_effects() {
    let [quiet, noisy] = [build(&[IMU]), build(&[IMU, NOISE])];
    assert_ne!(image(&quiet, 12), image(&noisy, 12));
    assert_eq!(image(&noisy, 12), image(&build(&[ODOMETRY, NOISE]), 12));
    let mut clean = Vec::new();
    Renderer::new(&noisy).render_clean(&noisy.truth(1.2).map_from_camera_link, 12, &mut clean);
    assert_eq!(clean, image(&quiet, 12));
}

#[test]
fn an_absent_effect_changes_no_bit() {
    let base = build(&[]);
    assert!(base.events().eq(scene(&plain(STRAIGHT)).events()));
    let swaying = build(&[SWAY]);
    assert_eq!(events(&base, is_odometry), events(&swaying, is_odometry));
    assert_eq!(base.truth(5.0).map_from_base_footprint, swaying.truth(5.0).map_from_base_footprint);
    assert_ne!(base.truth(5.0).map_from_base_link, swaying.truth(5.0).map_from_base_link);
}

const LIGHT: &str = "kind = \"light\"\ngain = 0.3\ngradient_per_m = [0.1, 0.05]\ncolour = [1.0, 0.9, 0.8]";
const OBSTACLES: &str = "kind = \"obstacles\"\nrandom = 6";
const WORN: &str = "kind = \"worn_lines\"\nshare = 0.4\npatch_m = 0.3";
const TURF: &str = "kind = \"turf\"\nblades = 0.14\nglint_share = 0.003\npaint = 0.4\nragged_mm = 3.5";
const SUN: &str = "kind = \"sun_patches\"\ngain = 2\nshare = 0.5\nlength_m = 1.5\nedge_m = 0.2";
const OPTICS: &str = "kind = \"optics\"\nstray_light = 0.1\nlateral_colour_px = 1";
const HUNTING: &str = "kind = \"exposure_hunting\"\namplitude = 0.4\nperiod_s = 2";
const PROCESSING: &str = "kind = \"image_processing\"\ncolour_filter = true\nsharpening = 1";
const CALIBRATION: &str = "kind = \"calibration_error\"\nfocal_percent = 0.6";

#[test]
fn what_is_seen_leaves_what_is_measured_alone() {
    let base = build(&[SWAY, ODOMETRY, IMU]);
    let seen = build(&[
        SWAY,
        TURF,
        WORN,
        SUN,
        LIGHT,
        OBSTACLES,
        OPTICS,
        HUNTING,
        ODOMETRY,
        IMU,
        NOISE,
        PROCESSING,
        CALIBRATION,
    ]);
    assert!(base.events().eq(seen.events()));
}

#[test]
fn each_effect_on_what_is_seen_does_the_same_beside_any_other() {
    // Figures stand where they stand, whatever else there is: in the difference of two images with and without them
    // the same pixels differ, by any light and on any lines.
    let touched = |others: &[&str]| -> Vec<bool> {
        let with: Vec<&str> = others.iter().copied().chain([OBSTACLES]).collect();
        let (without, with) = (image(&build(others), 9), image(&build(&with), 9));
        without.chunks_exact(3).zip(with.chunks_exact(3)).map(|(a, b)| a != b).collect()
    };
    let (alone, beside) = (touched(&[]), touched(&[WORN]));
    let differ = alone.iter().zip(&beside).filter(|(a, b)| a != b).count();
    // Where a figure has the colour of the ground behind it, worn or not.
    assert!(alone.iter().filter(|touched| **touched).count() > 500 && differ < 20, "{differ}");
}

/// Recordings and measurements are only comparable across machines and versions if the scenes are. Whoever changes
/// the look or the sensors on purpose puts the new numbers here and says why in the commit.
#[test]
fn the_bits_are_the_same_on_every_machine() {
    let straight = scene(STRAIGHT);
    assert_eq!([crc32fast::hash(&image(&straight, 17)), sensors_of(&straight)], [3846772934, 2236369454]);
    let all = [
        SWAY,
        "kind = \"head_motion\"\npan_amplitude_deg = 60\npan_period_s = 4\ntilt_amplitude_deg = 10\n\
         tilt_period_s = 3\nencoder_noise_deg = 0.1",
        "kind = \"kidnapping\"\nat_s = 1.0\nduration_s = 2.0\nto_m = [-1.5, 0.5]\nto_yaw_deg = 30\nlift_m = 0.3",
        WORN,
        LIGHT,
        OBSTACLES,
        ODOMETRY,
        IMU,
        NOISE,
    ];
    let all = build(&all);
    assert_eq!([crc32fast::hash(&image(&all, 17)), sensors_of(&all)], [3962010911, 1993327904]);
}

fn sensors_of(scene: &Scene) -> u32 {
    let mut sensors = Vec::new();
    for event in scene.events() {
        sensors.extend(event.stamp_ns.to_le_bytes());
        let numbers = match event.kind {
            SceneEventKind::InitialPose(estimate) => vec![estimate.map_from_base_footprint.yaw],
            SceneEventKind::Odometry(odometry) => {
                let pose = odometry.odom_from_base_footprint;
                vec![pose.x, pose.y, pose.yaw]
            }
            SceneEventKind::Imu(imu) => {
                [imu.orientation.to_array().as_slice(), &imu.angular_velocity.to_array()].concat()
            }
            SceneEventKind::Joints(joints) => vec![joints.pan, joints.tilt],
            SceneEventKind::Frame { map_from_camera_link, .. } => {
                let Isometry { rotation, translation } = map_from_camera_link;
                [rotation.to_array().as_slice(), &translation.to_array()].concat()
            }
        };
        sensors.extend(numbers.into_iter().flat_map(f64::to_le_bytes));
    }
    crc32fast::hash(&sensors)
}
