//! A wrong scene file is told what is wrong where.

use realitysim::geometry::FieldDimensions;
use realitysim::scene::{Scene, SceneError, SceneFile};

use super::common::{DEMO, LOOP, STRAIGHT, fisheye_640, kid_2009, plain, with_effects};

fn refusal(toml: &str) -> String {
    let built = SceneFile::from_toml(toml).and_then(|file| Scene::build(file, kid_2009(), fisheye_640()));
    built.expect_err("must be refused").to_string()
}

/// The straight walk with one line changed.
fn changed(from: &str, to: &str) -> String {
    assert!(STRAIGHT.contains(from), "{from}");
    refusal(&STRAIGHT.replacen(from, to, 1))
}

#[test]
fn the_shelf_is_right() {
    for toml in [STRAIGHT, LOOP, DEMO] {
        let file = SceneFile::from_toml(toml).expect("readable");
        assert!(toml.starts_with('#') && !file.scene.task.is_empty());
        Scene::build(file, kid_2009(), fisheye_640()).expect("possible");
    }
}

#[test]
fn values_out_of_range_name_key_and_value() {
    for (from, to, words) in [
        ("rate_hz = 10.0", "rate_hz = 0.0", vec!["camera.rate_hz is 0"]),
        ("rate_hz = 50.0", "rate_hz = nan", vec!["odometry.rate_hz is NaN"]),
        ("jpeg_quality = 90", "jpeg_quality = 0", vec!["camera.jpeg_quality is 0", "1 to 100"]),
        ("torso_height_m = 0.38", "torso_height_m = -1.0", vec!["camera.torso_height_m is -1"]),
        ("mount_xyz_m = [0.04, 0.0, 0.11]", "mount_xyz_m = [0.0, 7.0, 0.0]", vec!["camera.mount_xyz_m (y) is 7"]),
        ("[2.9, 0.1]", "[29.0, 0.1]", vec!["route.waypoints[1] is [29.0, 0.1]", "4.7 m in x"]),
        ("[[-2.9, 0.1], [2.9, 0.1]]", "[[1.0, 0.1], [1.0, 0.1]]", vec!["route.waypoints[1]", "at least 0.01 m"]),
        ("[[-2.9, 0.1], [2.9, 0.1]]", "[]", vec!["route.waypoints is 0 points"]),
        ("speed_m_s = 0.25", "speed_m_s = inf", vec!["route.speed_m_s is inf"]),
        ("yaw_deg = 2.0", "yaw_deg = 400.0", vec!["scene.initial_pose.yaw_deg is 400"]),
        ("roll_deg = 2.0", "roll_deg = 90.0", vec!["effect[0].roll_deg is 90"]),
        ("read_noise_dn = 1.5", "read_noise_dn = -1.0", vec!["effect[3].read_noise_dn is -1"]),
    ] {
        let message = changed(from, to);
        assert!(words.iter().all(|word| message.contains(word)), "{to}: {message}");
    }
}

#[test]
fn unknown_and_missing_keys_are_named() {
    for (from, to, word) in [
        ("seed = 20130601", "sead = 1", "unknown field `sead`"),
        ("speed_m_s = 0.25", "speed = 0.25", "unknown field `speed`"),
        ("step_hz = 2.4", "step_hz = 2.4\nenabled = false", "unknown field `enabled`"),
        ("noise_deg = 0.25", "", "missing field `noise_deg`"),
        ("kind = \"gait_sway\"", "kind = \"gait\"", "unknown variant `gait`"),
        ("role = \"base\"", "role = \"extra\"", "unknown variant `extra`"),
        ("initial_pose = { x_m", "initial_pose = { x", "unknown field `x`"),
        (
            "initial_pose = {",
            "initial_pose = \"exakt\" #",
            "initial_pose is \"exakt\", expected initial_pose: \"exact\"",
        ),
        ("seed = 20130601", "seed = -4", "seed"),
    ] {
        let message = changed(from, to);
        assert!(message.contains(word), "{to}: {message}");
    }
}

#[test]
fn effects_stand_once_and_in_physical_order() {
    let sway = "kind = \"gait_sway\"\nroll_deg = 2\npitch_deg = 1\nlateral_m = 0.01\nvertical_m = 0.0\nstep_hz = 2";
    let noise = "kind = \"sensor_noise\"\nread_noise_dn = 1\nshot_noise_factor = 0";
    let imu = "kind = \"imu_error\"\nroll_bias_deg = 0\npitch_bias_deg = 0\nnoise_deg = 0\ngyro_noise_deg_s = 0";
    let base = plain(STRAIGHT);
    let message = refusal(&with_effects(&base, &[noise, sway]));
    assert!(message.starts_with("effect[1].kind is gait_sway") && message.contains("physical order"), "{message}");
    let message = refusal(&with_effects(&base, &[noise, noise]));
    assert!(message.starts_with("effect[1].kind is sensor_noise") && message.contains("already"), "{message}");
    let without_imu = base.replace("[imu]\nrate_hz = 100.0", "");
    let message = refusal(&with_effects(&without_imu, &[imu]));
    assert!(message.starts_with("effect[0].kind is imu_error") && message.contains("[imu]"), "{message}");
    let still = base.replace(
        "kind = \"walk\"\nwaypoints = [[-2.9, 0.1], [2.9, 0.1]]\nspeed_m_s = 0.25\nturn_deg_s = 30.0",
        "kind = \"still\"\nposes = [[0, 0, 0]]\nhold_s = 1",
    );
    let message = refusal(&with_effects(&still, &[sway]));
    assert!(message.starts_with("effect[0].kind is gait_sway") && message.contains("still"), "{message}");
}

#[test]
fn field_and_lens_are_checked_too() {
    let build = |field, lens| {
        let file = SceneFile::from_toml(STRAIGHT).expect("readable");
        Scene::build(file, field, lens).expect_err("must be refused")
    };
    let error = build(FieldDimensions { width_m: 0.0, ..kid_2009() }, fisheye_640());
    assert!(matches!(error, SceneError::Field(_)) && error.to_string().contains("width_m is 0"));
    let mut lens = fisheye_640();
    lens.fx = -1.0;
    let error = build(kid_2009(), lens);
    assert!(matches!(error, SceneError::Lens(_)) && error.to_string().contains("fx is -1"));
}
