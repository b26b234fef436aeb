//! Numbers that a scene leaves open.

use realitysim::scene::{Drawn, START_STAMP_NS, Scene, SceneEvent, SceneEventKind, SceneFile};

use super::common::{STRAIGHT, fisheye_640, image, kid_2009, plain, scene, straight_with as build, with_effects};

const LIGHT: &str = "kind = \"light\"\ngain = { uniform = [0.4, 0.9], per = \"episode\" }";
const FLICKER: &str = "kind = \"light\"\ngain = { uniform = [0.4, 0.9], per = \"frame\" }";
const NOISE: &str =
    "kind = \"sensor_noise\"\nread_noise_dn = { uniform = [1, 5], per = \"frame\" }\nshot_noise_factor = 0.1";
const WORN: &str = "kind = \"worn_lines\"\nshare = { uniform = [0.1, 0.6], per = \"episode\" }\npatch_m = 0.3";
const ODOMETRY: &str = "kind = \"odometry_error\"\nscale_percent = { uniform = [-20, 20], per = \"episode\" }\n\
                        yaw_drift_deg_per_m = 0\nnoise_m_per_m = 0.05";

fn value(drawn: &[Drawn], name: &str) -> f64 {
    drawn.iter().find(|drawn| drawn.name == name).unwrap_or_else(|| panic!("{name}: {drawn:?}")).value
}

fn refusal(effect: &str) -> String {
    let toml = with_effects(&plain(STRAIGHT), &[effect]);
    let built = SceneFile::from_toml(&toml).and_then(|file| Scene::build(file, kid_2009(), fisheye_640()));
    built.expect_err("must be refused").to_string()
}

/// What is drawn is as good as written, to the last bit.
#[test]
fn a_drawn_number_acts_as_if_it_stood_in_the_file() {
    let open = build(&[LIGHT, ODOMETRY]);
    let (gain, scale) = (value(&open.drawn(), "light.gain"), value(&open.drawn(), "odometry_error.scale_percent"));
    assert!((0.4..0.9).contains(&gain) && (-20.0..20.0).contains(&scale));
    let written = build(&[
        &format!("kind = \"light\"\ngain = {gain:?}"),
        &ODOMETRY.replace("{ uniform = [-20, 20], per = \"episode\" }", &format!("{scale:?}")),
    ]);
    assert!(open.events().eq(written.events()));
    assert_eq!(image(&open, 9), image(&written, 9));
    assert!(written.drawn().is_empty() && open.drawn_for(3).is_empty());
}

#[test]
fn adding_an_effect_changes_nothing_that_another_draws() {
    let alone = build(&[LIGHT]).drawn();
    let beside = build(&[WORN, LIGHT, ODOMETRY]);
    assert_eq!(value(&alone, "light.gain"), value(&beside.drawn(), "light.gain"));
    let noise = "kind = \"sensor_noise\"\nread_noise_dn = 1\nshot_noise_factor = 0";
    let reordered = build(&[SWAY, WORN, LIGHT, noise, ODOMETRY]);
    for name in ["light.gain", "worn_lines.share", "odometry_error.scale_percent"] {
        assert_eq!(value(&beside.drawn(), name), value(&reordered.drawn(), name));
    }
    let other_seed = scene(&with_effects(&plain(STRAIGHT), &[LIGHT]).replace("seed = 20130601", "seed = 6"));
    assert_ne!(value(&alone, "light.gain"), value(&other_seed.drawn(), "light.gain"));
}

#[test]
fn per_frame_is_drawn_anew_for_each_frame_and_the_same_each_time() {
    let scene = build(&[FLICKER, NOISE]);
    let gains: Vec<f64> = (0..200).map(|frame| value(&scene.drawn_for(frame), "light.gain")).collect();
    let noises: Vec<f64> = (0..200).map(|frame| value(&scene.drawn_for(frame), "sensor_noise.read_noise_dn")).collect();
    assert!(gains.windows(2).all(|pair| pair[0] != pair[1]));
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    assert!((mean(&gains) - 0.65).abs() < 0.04 && (mean(&noises) - 3.0).abs() < 0.3, "the middle of the ranges");
    let together: f64 = gains.iter().zip(&noises).map(|(a, b)| (a - 0.65) * (b - 3.0)).sum();
    assert!((together / 200.0 / (0.144 * 1.155)).abs() < 0.25, "they have nothing to do with each other");
    // The frame is as if its numbers stood in the file.
    let written = build(&[
        &format!("kind = \"light\"\ngain = {:?}", gains[7]),
        &format!("kind = \"sensor_noise\"\nread_noise_dn = {:?}\nshot_noise_factor = 0.1", noises[7]),
    ]);
    assert_eq!(image(&scene, 7), image(&written, 7));
    assert_ne!(image(&scene, 8), image(&written, 8));
    assert!(scene.drawn().is_empty());
}

#[test]
fn numbers_within_lists_and_tables_can_be_open() {
    let scene = build(&[
        "kind = \"light\"\ngain = 1.0\ncolour = [1.0, { uniform = [0.5, 1.0], per = \"episode\" }, 1.0]",
        &format!("{ODOMETRY}\nfreeze = {{ from_s = {{ uniform = [2, 9], per = \"episode\" }}, for_s = 1.0 }}"),
    ]);
    assert!((0.5..1.0).contains(&value(&scene.drawn(), "light.colour[1]")));
    assert!((2.0..9.0).contains(&value(&scene.drawn(), "odometry_error.freeze.from_s")));
}

#[test]
fn a_range_that_could_draw_the_impossible_is_refused_with_its_line() {
    let range = |range: &str| LIGHT.replace("{ uniform = [0.4, 0.9], per = \"episode\" }", range);
    let first = plain(STRAIGHT).lines().count() + 3;
    for (effect, words) in [
        (range("{ uniform = [0.4, 9.0], per = \"episode\" }"), vec!["effect[0].gain is 9", "0.01 to 3"]),
        (range("{ uniform = [0.0, 0.9], per = \"episode\" }"), vec!["effect[0].gain is 0", "0.01 to 3"]),
        (range("{ uniform = [0.9, 0.4], per = \"episode\" }"), vec!["effect[0].gain is no range", "[low, high]"]),
        (range("{ uniform = [0.4], per = \"episode\" }"), vec!["no range"]),
        (range("{ uniform = [0.4, nan], per = \"episode\" }"), vec!["no range"]),
        (range("{ uniform = [0.4, 0.9], per = \"day\" }"), vec!["no range", "per = \"frame\""]),
        (range("{ uniform = [0.4, 0.9] }"), vec!["no range"]),
        (range("{ uniform = [0.4, 0.9], per = \"frame\", mean = 1 }"), vec!["no range"]),
        (range("{ normal = [0.4, 0.9] }"), vec!["a number is needed, and this is a table", "line"]),
        (WORN.replace("\"episode\"", "\"frame\""), vec!["drawn per frame", "of worn_lines nothing can change"]),
    ] {
        let message = refusal(&effect);
        assert!(words.iter().all(|word| message.contains(word)), "{effect}: {message}");
        let lines = [first - 1, first, first + 1, first + 2].map(|line| format!("line {line}"));
        assert!(lines.iter().any(|line| message.contains(line)), "{lines:?}: {message}");
    }
}

const SWAY: &str =
    "kind = \"gait_sway\"\nroll_deg = 2\npitch_deg = 1.3\nlateral_m = 0.018\nvertical_m = 0.006\nstep_hz = 2.4";

/// An effect with one number for every frame, and the same with the number that a frame has drawn.
fn per_frame_and_written(kind: &str, key: &str, ends: [f64; 2], rest: &str) -> (String, impl Fn(f64) -> String) {
    let (kind, rest) = (kind.to_owned(), rest.to_owned());
    let open = format!("kind = \"{kind}\"\n{key} = {{ uniform = {ends:?}, per = \"frame\" }}\n{rest}");
    let key = key.to_owned();
    (open, move |value| format!("kind = \"{kind}\"\n{key} = {value:?}\n{rest}"))
}

#[test]
fn window_and_shutter_may_change_with_every_frame() {
    const WINDOW: &str = "wall = \"+x\"\ncentre_m = 0\nwidth_m = 3\nsill_m = 1\nheight_m = 2.5\nsun_elevation_deg = 20";
    for (kind, key, ends, rest) in [
        ("bright_window", "brightness", [0.5, 1.1], WINDOW),
        ("bright_window", "glare", [0.0, 0.5], &format!("{WINDOW}\nbrightness = 8")),
        ("bright_window", "sun_gain", [1.0, 3.0], &format!("{WINDOW}\nbrightness = 8")),
        ("shutter", "exposure_ms", [5.0, 95.0], "readout_ms = 0"),
        ("sensor_noise", "shot_noise_factor", [0.0, 3.0], "read_noise_dn = 0"),
        ("light", "camera_gain", [1.0, 4.0], "gain = 0.3"),
    ] {
        let (open, written) = per_frame_and_written(kind, key, ends, rest);
        let scene = build(&[SWAY, &open]);
        let drawn = |frame| value(&scene.drawn_for(frame), &format!("{kind}.{key}"));
        for frame in [13, 14] {
            let written = build(&[SWAY, &written(drawn(frame))]);
            assert!(image(&scene, frame) == image(&written, frame), "{kind}.{key}");
        }
        let other = build(&[SWAY, &written(drawn(14))]);
        assert!(image(&scene, 13) != image(&other, 13), "{kind}.{key} changes nothing");
    }
}

/// Messages have the numbers of the frame before them, until the next one is due.
#[test]
fn messages_have_the_numbers_of_the_last_frame() {
    let imu = |scene: &Scene, frame: u64| -> Vec<SceneEventKind> {
        let [from, until] = [frame, frame + 1].map(|frame| scene.frame_time_s(frame));
        let time = |event: &SceneEvent| (event.stamp_ns - START_STAMP_NS) as f64 * 1e-9;
        let within = scene.events().filter(|event| time(event) > from + 1e-6 && time(event) < until - 1e-6);
        within.map(|event| event.kind).filter(|kind| matches!(kind, SceneEventKind::Imu(_))).collect()
    };
    let rest = "pitch_bias_deg = 0.5\nnoise_deg = 0.2\ngyro_noise_deg_s = 1.0";
    let (open, written) = per_frame_and_written("imu_error", "roll_bias_deg", [-20.0, 20.0], rest);
    let scene = build(&[&open]);
    for frame in [0, 1, 8] {
        let bias = value(&scene.drawn_for(frame), "imu_error.roll_bias_deg");
        let expected = imu(&build(&[&written(bias)]), frame);
        assert!(expected.len() > 2 && imu(&scene, frame) == expected, "frame {frame}");
        assert_ne!(imu(&scene, frame + 1), imu(&build(&[&written(bias)]), frame + 1));
    }
    let rest = "yaw_drift_deg_per_m = 0\nnoise_m_per_m = 0";
    let (open, _) = per_frame_and_written("odometry_error", "scale_percent", [-50.0, 50.0], rest);
    let scene = build(&[&open]);
    let odometry: Vec<(f64, f64)> = scene
        .events()
        .filter_map(|event| match event.kind {
            SceneEventKind::Odometry(odometry) => {
                Some(((event.stamp_ns - START_STAMP_NS) as f64 * 1e-9, odometry.odom_from_base_footprint.x))
            }
            _ => None,
        })
        .collect();
    for ((before, from), (time, to)) in odometry.iter().zip(&odometry[1..]).skip(50).take(100) {
        let frame = (0..).take_while(|frame| scene.frame_time_s(*frame) <= time + 1e-9).last().unwrap_or(0);
        let scale = 1.0 + value(&scene.drawn_for(frame), "odometry_error.scale_percent") / 100.0;
        let walked = scene.truth(*time).map_from_base_footprint.x - scene.truth(*before).map_from_base_footprint.x;
        assert!(((to - from).abs() - walked.abs() * scale).abs() < 1e-9, "at {time}: {}", to - from);
    }
}

#[test]
fn what_cannot_change_with_every_frame_is_refused_by_name() {
    for (effect, words) in [
        ("kind = \"worn_lines\"\nshare = OPEN\npatch_m = 0.3", "of worn_lines nothing can change"),
        ("kind = \"shutter\"\nexposure_ms = 1\nreadout_ms = OPEN", "of shutter only exposure_ms can change"),
        ("kind = \"calibration_error\"\nfocal_percent = OPEN", "of calibration_error nothing can change"),
        ("kind = \"camera_fault\"\nunplugged = { from_s = OPEN, for_s = 1 }", "of camera_fault nothing can change"),
        (
            "kind = \"odometry_error\"\nscale_percent = 0\nyaw_drift_deg_per_m = OPEN\nnoise_m_per_m = 0",
            "of odometry_error only scale_percent, noise_m_per_m can change",
        ),
    ] {
        let open = effect.replace("OPEN", "{ uniform = [0.1, 0.9], per = \"frame\" }");
        let toml = with_effects(&plain(STRAIGHT), &[SWAY, &open]);
        let built = SceneFile::from_toml(&toml).and_then(|file| Scene::build(file, kid_2009(), fisheye_640()));
        let message = built.expect_err("must be refused").to_string();
        assert!(message.contains(words) && message.contains("line ") && message.contains("effect[1]."), "{message}");
    }
}

#[test]
fn both_ends_of_a_range_are_held_to_the_route_whatever_is_drawn() {
    let taken =
        "kind = \"kidnapping\"\nto_m = [0, 0]\nto_yaw_deg = 0\nat_s = { uniform = [5, 400], per = \"episode\" }";
    let far = "kind = \"kidnapping\"\nto_m = [{ uniform = [-2, 4], per = \"episode\" }, 0]\nto_yaw_deg = 0\nat_s = 5";
    let late = "kind = \"camera_fault\"\nunplugged = { from_s = { uniform = [3, 60], per = \"episode\" }, for_s = 1 }";
    let jump = "jump = { at_s = { uniform = [3, 23.5], per = \"episode\" }, x_m = 1, y_m = 0, yaw_deg = 0 }";
    let jump = format!("{ODOMETRY}\n{jump}");
    let slow = "kind = \"shutter\"\nexposure_ms = { uniform = [5, 60], per = \"frame\" }\n\
                readout_ms = { uniform = [10, 41], per = \"episode\" }";
    for seed in 0..12 {
        for (effects, words) in [
            (vec![taken], ["effect[0].at_s is 400", "the route takes 23.20 s"]),
            (vec![far], ["effect[0]: the route", "4.7 m in x"]),
            (vec![late], ["effect[0].unplugged.from_s is 60", "below 23.20 s"]),
            (vec![jump.as_str()], ["effect[0].jump.at_s is 23.5", "below 23.20 s"]),
            (vec![SWAY, slow], ["effect[1].exposure_ms, with readout_ms, is 101", "at most 100.00 ms"]),
        ] {
            let toml = with_effects(&plain(STRAIGHT), &effects).replace("seed = 20130601", &format!("seed = {seed}"));
            let built = SceneFile::from_toml(&toml).and_then(|file| Scene::build(file, kid_2009(), fisheye_640()));
            let message = built.expect_err("must be refused").to_string();
            assert!(words.iter().all(|word| message.contains(word)), "{effects:?}: {message}");
            assert!(message.starts_with("line "), "{message}");
        }
    }
}

/// Where the ends allow it and what is between them does not.
#[test]
fn a_range_is_held_to_the_route_between_its_ends_whatever_is_drawn() {
    let open = |low: f64, high: f64| format!("{{ uniform = [{low}, {high}], per = \"episode\" }}");
    let taken =
        |at: &str, yaw: &str| format!("kind = \"kidnapping\"\nto_m = [-2.5, 1.5]\nto_yaw_deg = {yaw}\nat_s = {at}");
    // Along the touchline at either end; half-way over it, by more than a metre.
    let turned = taken("10", &open(-360.0, 0.0));
    let both = taken(&open(8.0, 10.0), &open(0.0, 359.0));
    let fallen = format!(
        "{SWAY}\n[[effect]]\nkind = \"fall\"\nat_s = 12\ndirection = \"left\"\nmoved_m = [0, 1.5]\nturned_deg = {}",
        open(-180.0, 180.0)
    );
    let passing = format!(
        "{ODOMETRY}\nfreeze = {{ from_s = 10, for_s = 1 }}\nmissing = {{ from_s = {}, for_s = 1 }}",
        open(3.0, 20.0)
    );
    for seed in 0..12 {
        for (effects, words) in [
            (&turned, ["effect[0]: the route", "may be drawn: to_yaw_deg = "]),
            (&both, ["effect[0]: the route", "may be drawn: "]),
            (&fallen, ["effect[1]: the route", "may be drawn: turned_deg = "]),
            (&passing, ["cannot be frozen and missing at the same time", "may be drawn: "]),
        ] {
            let toml = with_effects(&plain(STRAIGHT), &[effects]).replace("seed = 20130601", &format!("seed = {seed}"));
            let built = SceneFile::from_toml(&toml).and_then(|file| Scene::build(file, kid_2009(), fisheye_640()));
            let message = built.map(drop).expect_err(effects).to_string();
            assert!(words.iter().all(|word| message.contains(word)), "{effects:?}: {message}");
            assert!(message.starts_with("line "), "{message}");
        }
    }
}

#[test]
fn of_a_count_whole_numbers_are_drawn_both_ends_among_them() {
    let crowd = |ends: &str| format!("kind = \"obstacles\"\nrandom = {{ uniform = {ends}, per = \"episode\" }}");
    let mut seen = [0; 3];
    for seed in 0..60 {
        let toml = with_effects(&plain(STRAIGHT), &[&crowd("[2, 4]")]);
        let drawn = scene(&toml.replace("seed = 20130601", &format!("seed = {seed}"))).drawn();
        let count = value(&drawn, "obstacles.random");
        assert!(count.fract() == 0.0 && (2.0..=4.0).contains(&count), "{count}");
        seen[count as usize - 2] += 1;
    }
    assert!(seen.iter().all(|count| *count > 8), "{seen:?}");
    let message = refusal(&crowd("[2.5, 4]"));
    assert!(message.contains("effect[0].random is from 2.5 to 4") && message.contains("whole numbers"), "{message}");
}

/// Nothing may be an end of a range; only what was drawn must do something.
#[test]
fn a_range_may_begin_at_nothing() {
    build(&["kind = \"worn_lines\"\nshare = { uniform = [0, 0.5], per = \"episode\" }\npatch_m = 0.3"]);
    build(&["kind = \"serial_noise\"\nlost_share = { uniform = [0, 0.5], per = \"frame\" }"]);
}
