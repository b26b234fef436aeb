//! A wrong scene file is told what is wrong where.

use realitysim::geometry::FieldDimensions;
use realitysim::scene::{Role, Scene, SceneError, SceneFile};

use super::common::{STRAIGHT, fisheye_640, kid_2009, plain, shelf, with_effects};

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
    let scenes = shelf();
    assert!(scenes.len() >= 22);
    for (name, scene) in scenes {
        let text = std::fs::read_to_string(format!("replay/scenes/{name}.toml")).expect("readable");
        let file = scene.file();
        assert!(text.starts_with('#') && text.contains("# Why it exists:") && !file.scene.task.is_empty(), "{name}");
        assert!((5.0..50.0).contains(&scene.duration_s()) && file.camera.rate_hz == 10.0, "{name}");
        for effect in ["gait_sway", "odometry_error", "imu_error", "sensor_noise"] {
            assert!(file.effects.iter().any(|listed| listed.name() == effect), "{name} lacks {effect}");
        }
        assert!(file.effects.iter().all(|effect| effect.role().is_some()), "{name}: what is an effect for?");
        // The header says in words what the roles say.
        let header: Vec<&str> = text.lines().take_while(|line| line.starts_with('#')).collect();
        for (role, word) in [(Role::Base, "# Base: "), (Role::Filler, "# Filler: ")] {
            let of_role = file.effects.iter().filter(|effect| effect.role() == Some(role));
            let names: Vec<&str> = of_role.map(|effect| effect.name()).collect();
            let stated = header.iter().find_map(|line| line.strip_prefix(word)).unwrap_or_default();
            assert!(!names.is_empty(), "{name}: {word}: which are they?");
            assert_eq!(stated.trim_end_matches('.'), names.join(", "), "{name}: {word}");
        }
    }
}

/// On the straight walk.
fn refused(effect: &str) -> String {
    refusal(&with_effects(&plain(STRAIGHT), &[effect]))
}

/// Not the line where its table begins.
#[test]
fn a_key_that_cannot_be_read_is_refused_with_its_own_line() {
    let first = plain(STRAIGHT).lines().count() + 2;
    for (effect, line, words) in [
        ("kind = \"light\"\ngain = 0.5\ngian = 3", 3, "unknown field `gian`"),
        ("kind = \"light\"\ngain = \"much\"", 2, "this is the text \"much\""),
        ("kind = \"light\"\ngain = 0.5\n\ncolour = [1, 2]", 4, "invalid length 2"),
        ("kind = \"kidnapping\"\nto_m = [0, 0]\nto_yaw_deg = 0\nat_s = 5\nlift = 1", 5, "unknown field `lift`"),
        ("kind = \"obstacles\"\nfigures = [\n{ shape = \"robot\" },\n{ shape = \"dog\" },\n]", 4, "variant `dog`"),
        ("kind = \"odometry_error\"\nscale_percent = 5\njump = { at_s = 1, x = 2 }", 3, "unknown field `x`"),
        ("kind = \"light\"\nrole = \"main\"\ngain = 0.5", 2, "unknown variant `main`"),
        ("role = \"base\"\nkind = \"snow\"", 2, "unknown variant `snow`"),
    ] {
        // A sound one before it, and one behind it with a mistake of its own.
        let sway = "kind = \"gait_sway\"\nroll_deg = 2\npitch_deg = 1\nlateral_m = 0\nvertical_m = 0\nstep_hz = 2";
        let message = refusal(&with_effects(&plain(STRAIGHT), &[effect, "kind = \"light\"\nglow = 1"]));
        assert!(message.contains(&format!("line {},", first + line)) && message.contains(words), "{effect}: {message}");
        let message = refusal(&with_effects(&plain(STRAIGHT), &[sway, effect]));
        assert!(
            message.contains(&format!("line {},", first + 8 + line)) && message.contains(words),
            "{effect}: {message}"
        );
    }
    let message = changed("turn_deg_s", "turns_deg_s");
    let line = STRAIGHT.lines().position(|line| line.starts_with("turn_deg_s")).expect("a line") + 1;
    assert!(message.contains(&format!("line {line},")) && message.contains("unknown field `turns_deg_s`"), "{message}");
}

#[test]
fn effects_out_of_range_name_key_and_value() {
    let dark = "kind = \"light\"\ngain = ";
    let figures = |list: &str| format!("kind = \"obstacles\"\nfigures = [{list}]");
    let robot = |rest: &str| figures(&format!("{{ shape = \"robot\", {rest} }}"));
    let taken = "kind = \"kidnapping\"\nto_m = [0, 0]\nto_yaw_deg = 0\nat_s = ";
    let head = "kind = \"head_motion\"\npan_amplitude_deg = 40\ntilt_amplitude_deg = 5\ntilt_period_s = 2\n";
    let odometry = "kind = \"odometry_error\"\nscale_percent = 5\nyaw_drift_deg_per_m = 0\nnoise_m_per_m = 0\n";
    let imu = "kind = \"imu_error\"\nroll_bias_deg = 0\npitch_bias_deg = 0\nnoise_deg = 0\ngyro_noise_deg_s = 0\n";
    for (effect, words) in [
        (format!("{dark}0.0"), vec!["effect[0].gain is 0", "0.01 to 3"]),
        (format!("{dark}1.0\ngradient_per_m = [0.0, 7.0]"), vec!["effect[0].gradient_per_m (y) is 7"]),
        (format!("{dark}1.0\ncolour = [1.0, 1.0, nan]"), vec!["effect[0].colour (blue) is NaN"]),
        (format!("{dark}1.0\ncamera_gain = 0.5"), vec!["effect[0].camera_gain is 0.5", "1 to 16"]),
        (figures(""), vec!["effect[0].figures is 0 in all", "1 to 48"]),
        ("kind = \"obstacles\"\nrandom = 400".to_owned(), vec!["effect[0].random is 400", "0 to 48"]),
        ("kind = \"obstacles\"\nrandom = -1".to_owned(), vec!["effect[0].random is -1"]),
        (robot("position_m = [30.0, 0.0]"), vec!["effect[0].figures[0] is [30.0, 0.0]", "8.7 m in x"]),
        (robot("yaw_deg = 3"), vec!["figures[0] is neither position_m nor path", "to stand"]),
        (robot("position_m = [1, 1], path = [[0, 0], [1, 1]]"), vec!["both position_m and path"]),
        (robot("position_m = [1, 1], speed_m_s = 1"), vec!["figures[0].speed_m_s is 1", "only a figure with a path"]),
        (robot("path = [[0, 0], [1, 1]]"), vec!["speed_m_s is absent"]),
        (robot("path = [[0, 0], [0, 0]], speed_m_s = 1"), vec!["figures[0].path is", "two or more points"]),
        (robot("position_m = [1, 1], height_m = 9"), vec!["figures[0].height_m is 9"]),
        (robot("position_m = [1, 1], accent = [0, 0, 256]"), vec!["figures[0].accent is 256"]),
        (figures("{ shape = \"tree\", position_m = [1, 1] }"), vec!["unknown variant `tree`"]),
        (format!("{taken}400"), vec!["effect[0].at_s is 400", "the route takes 23.20 s"]),
        (format!("{taken}5\nlift_m = 1"), vec!["lift_m is 1", "duration_s"]),
        (taken.replace("[0, 0]", "[9, 0]") + "5", vec!["effect[0].to_m is [9.0, 0.0]"]),
        (taken.replace("[0, 0]", "[4, 0]") + "5", vec!["effect[0]: the route, which goes on from to_m", "4.7 m in x"]),
        (format!("{head}pan_period_s = 0"), vec!["effect[0].pan_period_s is 0"]),
        (format!("{odometry}freeze = {{ from_s = 3, for_s = 0 }}"), vec!["effect[0].freeze.for_s is 0"]),
        (format!("{odometry}missing = {{ from_s = -3, for_s = 1 }}"), vec!["effect[0].missing.from_s is -3"]),
        (format!("{odometry}freeze_from_s = 3"), vec!["unknown field `freeze_from_s`"]),
        (format!("{imu}mount_roll_deg = 200"), vec!["effect[0].mount_roll_deg is 200"]),
        ("kind = \"worn_lines\"\nshare = 2\npatch_m = 1".to_owned(), vec!["effect[0].share is 2"]),
        (
            "kind = \"turf\"\nblades = 2\nglint_share = 0.003\npaint = 0.4\nragged_mm = 3.5".to_owned(),
            vec!["effect[0].blades is 2", "0 (flat carpet) to 1"],
        ),
        (
            "kind = \"turf\"\nblades = 0.14\nglint_share = 0.5\npaint = 0.4\nragged_mm = 3.5".to_owned(),
            vec!["effect[0].glint_share is 0.5"],
        ),
        (
            "kind = \"turf\"\nblades = 0.14\nglint_share = 0.003\npaint = -1\nragged_mm = 3.5".to_owned(),
            vec!["effect[0].paint is -1"],
        ),
        (
            "kind = \"turf\"\nblades = 0.14\nglint_share = 0.003\npaint = 0.4\nragged_mm = 50".to_owned(),
            vec!["effect[0].ragged_mm is 50"],
        ),
        (
            "kind = \"sun_patches\"\ngain = 9\nshare = 0.5\nlength_m = 1.5\nedge_m = 0.2".to_owned(),
            vec!["effect[0].gain is 9"],
        ),
        (
            "kind = \"sun_patches\"\ngain = 2\nshare = 0.5\nlength_m = 1.5\nedge_m = 0".to_owned(),
            vec!["effect[0].edge_m is 0"],
        ),
        (
            "kind = \"optics\"\nstray_light = 0.9\nlateral_colour_px = 1".to_owned(),
            vec!["effect[0].stray_light is 0.9"],
        ),
        ("kind = \"exposure_hunting\"\namplitude = 1\nperiod_s = 2".to_owned(), vec!["effect[0].amplitude is 1"]),
        ("kind = \"exposure_hunting\"\namplitude = 0.4\nperiod_s = 0".to_owned(), vec!["effect[0].period_s is 0"]),
        (
            "kind = \"image_processing\"\ncolour_filter = true\nsharpening = 4".to_owned(),
            vec!["effect[0].sharpening is 4"],
        ),
        ("kind = \"calibration_error\"".to_owned(), vec!["effect[0] is a calibration_error of nothing"]),
        ("kind = \"calibration_error\"\nfocal_percent = 50".to_owned(), vec!["effect[0].focal_percent is 50"]),
    ] {
        let message = refused(&effect);
        assert!(words.iter().all(|word| message.contains(word)), "{effect}: {message}");
    }
}

#[test]
fn a_head_needs_an_imu_and_a_kidnapping_a_walk() {
    let head = "kind = \"head_motion\"\npan_amplitude_deg = 40\npan_period_s = 3\ntilt_amplitude_deg = 5\n\
                tilt_period_s = 2";
    let message = refusal(&with_effects(&plain(STRAIGHT).replace("[imu]\nrate_hz = 100.0", ""), &[head]));
    assert!(message.contains("effect[0].kind is head_motion") && message.contains("[imu]"), "{message}");
    let still = plain(STRAIGHT).replace(
        "kind = \"walk\"\nwaypoints = [[-2.9, 0.1], [2.9, 0.1]]\nspeed_m_s = 0.25\nturn_deg_s = 30.0",
        "kind = \"still\"\nposes = [[0, 0, 0]]\nhold_s = 1",
    );
    let taken = "kind = \"kidnapping\"\nto_m = [0, 0]\nto_yaw_deg = 0\nat_s = 0.5";
    let message = refusal(&with_effects(&still, &[taken]));
    assert!(message.contains("effect[0].kind is kidnapping") && message.contains("still"), "{message}");
}

const SWAY: &str = "kind = \"gait_sway\"\nroll_deg = 2\npitch_deg = 1\nlateral_m = 0.01\nvertical_m = 0.0\nstep_hz = 2";

#[test]
fn a_scene_that_contradicts_itself_is_refused_with_its_line() {
    let shutter = "kind = \"shutter\"\nexposure_ms = 5\nreadout_ms = 15";
    let fall = "kind = \"fall\"\nat_s = 5\ndirection = \"left\"";
    let taken = "kind = \"kidnapping\"\nto_m = [0, 0]\nto_yaw_deg = 0\nat_s = 5";
    let serial = "kind = \"serial_noise\"\nlost_share = 0.1";
    let base = plain(STRAIGHT);
    let silent = base.replace("[imu]\nrate_hz = 100.0", "").replace("[odometry]\nrate_hz = 50.0", "");
    for (base, effects, words) in [
        (&base, vec![shutter], ["kind is shutter", "without motion it shows nothing"]),
        (&base, vec![fall], ["kind is fall", "needs gait_sway"]),
        (&base, vec![SWAY, taken, fall], ["kind is fall", "interrupted once"]),
        (&silent, vec![serial], ["kind is serial_noise", "both are absent"]),
        (
            &base,
            vec![SWAY, "kind = \"sensor_noise\"\nread_noise_dn = 1\nshot_noise_factor = 0", shutter],
            ["kind is shutter", "then how it is exposed (shutter, optics, exposure_hunting), then what sensors add"],
        ),
        (
            &base,
            vec![serial, "kind = \"sensor_noise\"\nread_noise_dn = 1\nshot_noise_factor = 0"],
            ["kind is sensor_noise", "then what the wires do"],
        ),
    ] {
        let text = with_effects(base, &effects);
        let message = refusal(&text);
        assert!(words.iter().all(|word| message.contains(word)), "{message}");
        let wanted = words[0].replace("kind is ", "kind = \"") + "\"";
        let line = text.lines().position(|line| line == wanted).expect("its line") + 1;
        assert!(message.starts_with(&format!("line {line}: ")), "{line}: {message}");
    }
}

#[test]
fn the_impossible_is_refused_with_its_line_and_what_is_possible() {
    for (effect, words) in [
        ("kind = \"sensor_noise\"\nread_noise_dn = -1\nshot_noise_factor = 0", ["read_noise_dn is -1", "0 to 50"]),
        ("kind = \"light\"\ngain = 0", ["gain is 0", "0.01 to 3"]),
        ("kind = \"shutter\"\nexposure_ms = 0\nreadout_ms = 15", ["exposure_ms is 0", "0.01 to 200 ms"]),
        ("kind = \"fall\"\nat_s = 5\ndirection = \"left\"\nfall_s = 0", ["fall_s is 0", "0.2 to 10 s"]),
        ("kind = \"camera_fault\"\nunplugged = { from_s = 3, for_s = 0 }", ["unplugged.for_s is 0", "0.001 to 7200 s"]),
        ("kind = \"serial_noise\"\nlost_share = 1", ["lost_share is 1", "0 to 0.95"]),
        ("kind = \"serial_noise\"\nlost_share = 0", ["a serial_noise of nothing", "above 0"]),
        (
            "kind = \"bright_window\"\nwall = \"+x\"\ncentre_m = 0\nwidth_m = 2\nsill_m = 1\nheight_m = 2\nbrightness = 0",
            ["brightness is 0", "0.5 to 50"],
        ),
    ] {
        let text = with_effects(&plain(STRAIGHT), &[SWAY, effect]);
        let message = refusal(&text);
        assert!(words.iter().all(|word| message.contains(word)), "{message}");
        let line: usize = message.split(['e', ':']).nth(1).and_then(|line| line.trim().parse().ok()).expect(&message);
        let key = words[0].split([' ', '.']).next().expect("a key");
        let stands = text.lines().nth(line - 1).expect("a line");
        assert!(stands.contains(key) || stands == "[[effect]]", "{line}, {stands}: {message}");
    }
    let far = "kind = \"fall\"\nat_s = 500\ndirection = \"left\"";
    assert!(refusal(&with_effects(&plain(STRAIGHT), &[SWAY, far])).contains("the route takes 23.20 s"));
}

#[test]
fn unknown_effects_fields_and_lenses_are_named_with_those_there_are() {
    let load = |from: &str, to: &str| {
        let refused = realitysim::log_input::scene_source::parse(&STRAIGHT.replacen(from, to, 1), "s.toml");
        (refused.expect_err("must be refused").to_string(), STRAIGHT.lines().position(|line| line.contains(from)))
    };
    for (from, to, words) in [
        ("field = \"kid-2009\"", "field = \"moon\"", ["\"moon\"", "adult-2020, hsl-large-2026"]),
        ("lens = \"fisheye-640\"", "lens = \"eye\"", ["\"eye\"", "fisheye-640"]),
        ("kind = \"gait_sway\"", "kind = \"gait\"", ["unknown variant `gait`", "`gait_sway`, `head_motion`"]),
    ] {
        let (message, line) = load(from, to);
        assert!(words.iter().all(|word| message.contains(word)), "{message}");
        let line = line.expect("a line") + 1;
        assert!(
            message.starts_with("s.toml: ") && message.contains(&format!("line {line}")) || to.contains("gait"),
            "{message}"
        );
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
    let imu = "kind = \"imu_error\"\nroll_bias_deg = 1\npitch_bias_deg = 0\nnoise_deg = 0\ngyro_noise_deg_s = 0";
    let base = plain(STRAIGHT);
    let message = refusal(&with_effects(&base, &[noise, sway]));
    assert!(message.contains("effect[1].kind is gait_sway") && message.contains("physical order"), "{message}");
    let message = refusal(&with_effects(&base, &[noise, noise]));
    assert!(message.contains("effect[1].kind is sensor_noise") && message.contains("already"), "{message}");
    let without_imu = base.replace("[imu]\nrate_hz = 100.0", "");
    let message = refusal(&with_effects(&without_imu, &[imu]));
    assert!(message.contains("effect[0].kind is imu_error") && message.contains("[imu]"), "{message}");
    let still = base.replace(
        "kind = \"walk\"\nwaypoints = [[-2.9, 0.1], [2.9, 0.1]]\nspeed_m_s = 0.25\nturn_deg_s = 30.0",
        "kind = \"still\"\nposes = [[0, 0, 0]]\nhold_s = 1",
    );
    let message = refusal(&with_effects(&still, &[sway]));
    assert!(message.contains("effect[0].kind is gait_sway") && message.contains("still"), "{message}");
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

/// With the line of the effect or of its key.
fn refused_with_its_line(effects: &[&str], words: &[&str]) {
    let text = with_effects(&plain(STRAIGHT), effects);
    let message = refusal(&text);
    assert!(words.iter().all(|word| message.contains(word)), "{effects:?}: {message}");
    let line: usize = message.split(['e', ':']).nth(1).and_then(|line| line.trim().parse().ok()).expect(&message);
    assert!(line > plain(STRAIGHT).lines().count(), "{message}");
}

#[test]
fn what_would_never_come_about_is_refused() {
    let odometry = |rest: &str| {
        format!("kind = \"odometry_error\"\nscale_percent = 5\nyaw_drift_deg_per_m = 0\nnoise_m_per_m = 0\n{rest}")
    };
    let unplugged = |from: &str| format!("kind = \"camera_fault\"\nunplugged = {{ from_s = {from}, for_s = 100 }}");
    for (effect, words) in [
        (unplugged("23.5"), ["effect[0].unplugged.from_s is 23.5", "below 23.20 s, where the scene ends"]),
        (odometry("freeze = { from_s = 30, for_s = 1 }"), ["effect[0].freeze.from_s is 30", "below 23.20 s"]),
        (odometry("missing = { from_s = 30, for_s = 1 }"), ["effect[0].missing.from_s is 30", "below 23.20 s"]),
        (
            odometry("jump = { at_s = 30, x_m = 1, y_m = 0, yaw_deg = 0 }"),
            ["effect[0].jump.at_s is 30", "below 23.20 s"],
        ),
        (odometry("jump = { at_s = 0, x_m = 1, y_m = 0, yaw_deg = 0 }"), ["effect[0].jump.at_s is 0", "0.001 to"]),
        (
            odometry("freeze = { from_s = 3, for_s = 2 }\nmissing = { from_s = 4.5, for_s = 3 }"),
            ["effect[0].missing.from_s is 4.5 s", "frozen from 3 to 5 s"],
        ),
    ] {
        refused_with_its_line(&[&effect], &words);
    }
    let build = |effect: &str| super::common::straight_with(&[effect]);
    build(&unplugged("23"));
    build(&unplugged("0"));
    build(&odometry("freeze = { from_s = 3, for_s = 2 }\nmissing = { from_s = 5, for_s = 3 }"));
}

#[test]
fn a_shutter_longer_than_a_frame_or_without_motion_is_refused() {
    let shutter = |exposure: f64, readout: f64| {
        format!("kind = \"shutter\"\nexposure_ms = {exposure:?}\nreadout_ms = {readout:?}")
    };
    for (exposure, readout) in [(150.0, 0.0), (60.0, 41.0), (0.5, 100.0)] {
        let words = ["effect[1].exposure_ms, with readout_ms, is", "at most 100.00 ms together, at 10 images"];
        refused_with_its_line(&[SWAY, &shutter(exposure, readout)], &words);
    }
    super::common::straight_with(&[SWAY, &shutter(60.0, 40.0)]);
    let still = "kind = \"head_motion\"\npan_amplitude_deg = 0\npan_period_s = 3\ntilt_amplitude_deg = 0\n\
                 tilt_period_s = 2\nencoder_noise_deg = 1";
    refused_with_its_line(&[still, &shutter(5.0, 15.0)], &["effect[1].kind is shutter", "amplitude above 0"]);
}

#[test]
fn an_effect_that_does_nothing_is_refused() {
    for (effect, needed) in [
        ("kind = \"sensor_noise\"\nread_noise_dn = 0\nshot_noise_factor = 0", "read_noise_dn"),
        ("kind = \"worn_lines\"\nshare = 0\npatch_m = 0.3", "a share above 0"),
        ("kind = \"sun_patches\"\ngain = 1\nshare = 0.5\nlength_m = 1.5\nedge_m = 0.2", "a gain above 1"),
        ("kind = \"optics\"\nstray_light = 0\nlateral_colour_px = 0", "stray_light or lateral_colour_px above 0"),
        ("kind = \"exposure_hunting\"\namplitude = 0\nperiod_s = 2", "an amplitude above 0"),
        ("kind = \"image_processing\"\ncolour_filter = false\nsharpening = 0", "colour_filter, or sharpening above 0"),
        ("kind = \"light\"\ngain = 1", "a gain"),
        ("kind = \"light\"\ngain = 1.0\ncolour = [1, 1, 1]\ngradient_per_m = [0, -0.0]\ncamera_gain = 1", "a gain"),
        (
            "kind = \"gait_sway\"\nroll_deg = 0\npitch_deg = 0\nlateral_m = 0\nvertical_m = 0\nstep_hz = 2",
            "an amplitude above 0",
        ),
        (
            "kind = \"head_motion\"\npan_amplitude_deg = 0\npan_period_s = 3\ntilt_amplitude_deg = 0\ntilt_period_s = 2",
            "encoder_noise_deg",
        ),
        (
            "kind = \"imu_error\"\nroll_bias_deg = 0\npitch_bias_deg = 0\nnoise_deg = 0\ngyro_noise_deg_s = 0\n\
             mount_roll_deg = 0",
            "other than 0",
        ),
        (
            "kind = \"odometry_error\"\nscale_percent = 0\nyaw_drift_deg_per_m = 0\nnoise_m_per_m = 0\n\
             jump = { at_s = 3, x_m = 0, y_m = 0, yaw_deg = 0 }",
            "freeze, missing or jump",
        ),
        ("kind = \"calibration_error\"\nfocal_percent = 0", "other than 0"),
        ("kind = \"serial_noise\"\nlost_share = 0", "lost_share or corrupt_share above 0"),
    ] {
        refused_with_its_line(&[effect], &["of nothing: it does nothing: leave the entry out", needed]);
    }
}

/// The file's order is the order in which effects apply, where they act on the same thing.
#[test]
fn what_acts_on_the_same_thing_stands_in_the_order_in_which_it_applies() {
    let light = "kind = \"light\"\ngain = 0.5";
    let worn = "kind = \"worn_lines\"\nshare = 0.5\npatch_m = 0.3";
    let turf = "kind = \"turf\"\nblades = 0.14\nglint_share = 0.003\npaint = 0.4\nragged_mm = 3.5";
    let sun = "kind = \"sun_patches\"\ngain = 2\nshare = 0.5\nlength_m = 1.5\nedge_m = 0.2";
    let optics = "kind = \"optics\"\nstray_light = 0.1\nlateral_colour_px = 1";
    let hunting = "kind = \"exposure_hunting\"\namplitude = 0.4\nperiod_s = 2";
    let processing = "kind = \"image_processing\"\ncolour_filter = true\nsharpening = 1";
    let crowd = "kind = \"obstacles\"\nrandom = 2";
    let window = "kind = \"bright_window\"\nwall = \"+x\"\ncentre_m = 0\nwidth_m = 2\nsill_m = 1\nheight_m = 2\n\
                  brightness = 5";
    let noise = "kind = \"sensor_noise\"\nread_noise_dn = 1\nshot_noise_factor = 0";
    let taken = "kind = \"kidnapping\"\nto_m = [0, 0]\nto_yaw_deg = 0\nat_s = 5";
    let odometry = "kind = \"odometry_error\"\nscale_percent = 5\nyaw_drift_deg_per_m = 0\nnoise_m_per_m = 0";
    let imu = "kind = \"imu_error\"\nroll_bias_deg = 1\npitch_bias_deg = 0\nnoise_deg = 0\ngyro_noise_deg_s = 0";
    super::common::straight_with(&[
        SWAY, taken, turf, worn, sun, light, window, crowd, optics, hunting, odometry, noise, processing, imu,
    ]);
    for (effects, first, then) in [
        ([light, worn], "worn_lines", "light"),
        ([worn, turf], "turf", "worn_lines"),
        ([light, sun], "sun_patches", "light"),
        ([hunting, optics], "optics", "exposure_hunting"),
        ([processing, noise], "sensor_noise", "image_processing"),
        ([crowd, light], "light", "obstacles"),
        ([crowd, window], "bright_window", "obstacles"),
        ([window, light], "light", "bright_window"),
        ([taken, SWAY], "gait_sway", "kidnapping"),
        ([imu, odometry], "odometry_error", "imu_error"),
    ] {
        let words = [format!("effect[1].kind is {first}"), format!("it applies before {then}")];
        refused_with_its_line(&effects, &words.each_ref().map(String::as_str));
    }
}
