//! Scenes on the command line: checked, told what they cost, and their effects on stored images.

use std::fs;

use std::sync::atomic::{AtomicBool, Ordering};

use realitysim::evaluation::calibration::REFERENCE_MS;
use realitysim::ros2::messages::DiagnosticArray;

use super::support::{IMAGE, ODOMETRY, Room, assert_same, decode_all, on, read_capture, read_log};

const DRAWN: &str = "/scene/drawn";

/// The walk's scene with one effect more, at the end.
fn room_with(effect: &str) -> Room {
    let room = Room::new();
    room.write_scene("scene.toml", |text| {
        let plain = text.split("[[effect]]").next().unwrap().to_owned();
        if effect.is_empty() { plain } else { format!("{plain}\n[[effect]]\n{effect}\n") }
    });
    room
}

#[test]
fn check_tells_effects_numbers_and_costs() {
    let room = Room::new();
    room.write_scene("scene.toml", |text| {
        text + "\n[[effect]]\nkind = \"serial_noise\"\nrole = \"filler\"\nlost_share = { uniform = [0.1, 0.2], per = \"episode\" }\n"
    });
    let report = room.run("scene check scene.toml --json").succeeds().json();
    let effects = report["effects"].as_array().unwrap();
    let last = effects.last().unwrap();
    assert_eq!((&last["kind"], &last["role"], &last["ms"]), (&"serial_noise".into(), &"filler".into(), &().into()));
    assert!((0.1..0.2).contains(&last["values"]["lost_share"].as_f64().unwrap()), "{last}");
    assert!(report["bare_ms"].as_f64().unwrap() > 0.0 && report["total_ms"].as_f64().unwrap() > 0.0);
    let run = room.run("scene check scene.toml --max-ms 100000").succeeds();
    assert!(run.stdout.contains("serial_noise") && run.stdout.contains("lost_share = 0.1"), "{run:?}");
    room.run("scene check scene.toml --max-ms 0.0001").fails(1, &["scene.toml: a frame takes", "allowed are 0.0001"]);
}

/// A limit in a CI file is for every machine that runs it.
#[test]
fn a_limit_of_time_is_kept_or_broken_whatever_else_the_machine_does() {
    let room = room_with("kind = \"obstacles\"\nrandom = 4");
    let report = || room.run("scene check scene.toml --json").succeeds().json();
    let number = |report: &serde_json::Value, key: &str| report[key].as_f64().unwrap();
    let idle = report();
    let reference_ms = number(&idle, "reference_ms");
    let expected = number(&idle, "total_ms") * REFERENCE_MS / number(&idle, "loop_ms");
    assert!((reference_ms / expected - 1.0).abs() < 1e-9, "{idle}");

    let stop = AtomicBool::new(false);
    let threads = 4 * std::thread::available_parallelism().map_or(1, usize::from);
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                while !stop.load(Ordering::Relaxed) {
                    std::hint::spin_loop();
                }
            });
        }
        let busy = report();
        let limits = [0.5 * reference_ms, 2.0 * reference_ms];
        let runs = limits.map(|limit| room.run(&format!("scene check scene.toml --max-ms {limit}")));
        stop.store(true, Ordering::Relaxed);
        assert!((0.5..2.0).contains(&(number(&busy, "reference_ms") / reference_ms)), "{idle} {busy}");
        let [broken, kept] = runs;
        broken.fails(1, &["ms of the reference machine"]);
        kept.succeeds();
    });
}

#[test]
fn a_wrong_scene_is_refused_with_its_line_wherever_it_is_used() {
    let room = room_with("kind = \"sensor_noise\"\nread_noise_dn = -3\nshot_noise_factor = 0.1");
    for command in [
        "scene check scene.toml",
        "sim scene.toml -o log.mcap",
        "replay scene.toml -o captures",
        "scene apply scene.toml --image in.png -o out.png",
    ] {
        let line = fs::read_to_string(room.path("scene.toml")).unwrap();
        let line = line.lines().position(|line| line.starts_with("read_noise_dn")).unwrap() + 1;
        room.run(command).fails(2, &[&format!("scene.toml: line {line}: effect[0].read_noise_dn is -3: 0 to 50 DN")]);
    }
}

#[test]
fn what_was_drawn_is_in_the_log_and_in_its_capture() {
    let room = room_with(
        "kind = \"light\"\ngain = { uniform = [0.5, 0.9], per = \"frame\" }\n\
         camera_gain = { uniform = [1, 1.5], per = \"episode\" }",
    );
    room.run("sim scene.toml -o log.mcap").succeeds();
    let told: Vec<DiagnosticArray> = decode_all(&read_log(&room.path("log.mcap")), DRAWN);
    let replayed = room.replay("log.mcap");
    assert_eq!(told.len(), 1 + replayed.tags.len(), "once for all, and with each frame");
    let value = |array: &DiagnosticArray, key: &str| -> f64 {
        let values = &array.status[0].values;
        values
            .iter()
            .find(|value| value.key == key)
            .unwrap_or_else(|| panic!("{key}: {values:?}"))
            .value
            .parse()
            .unwrap()
    };
    assert!((1.0..1.5).contains(&value(&told[0], "light.camera_gain")));
    for (array, tag) in told[1..].iter().zip(&replayed.tags) {
        assert_eq!(array.header.stamp, tag.header.stamp);
        assert!((0.5..0.9).contains(&value(array, "light.gain")));
    }
    let kept: Vec<DiagnosticArray> = decode_all(&read_capture(&replayed.session), DRAWN);
    assert_eq!(kept, told);
    let plain = room_with("");
    plain.run("sim scene.toml -o log.mcap").succeeds();
    assert_eq!(decode_all::<DiagnosticArray>(&read_log(&plain.path("log.mcap")), DRAWN), []);
}

fn stored(room: &Room) -> Vec<u8> {
    let picture = image::RgbImage::from_fn(64, 48, |x, y| image::Rgb([x as u8 * 3, y as u8 * 4, 90]));
    picture.save(room.path("in.png")).unwrap();
    fs::read(room.path("in.png")).unwrap()
}

#[test]
fn an_empty_chain_returns_the_stored_bytes() {
    let sway = "kind = \"gait_sway\"\nroll_deg = 2\npitch_deg = 1\nlateral_m = 0.01\nvertical_m = 0\nstep_hz = 2";
    for (effect, left_out) in [("", "left out: nothing"), (sway, "left out: gait_sway")] {
        let room = room_with(effect);
        let bytes = stored(&room);
        let run = room.run("scene apply scene.toml --image in.png -o out.png").succeeds();
        assert!(run.stdout.contains("applied: nothing") && run.stdout.contains(left_out), "{run:?}");
        assert_eq!(fs::read(room.path("out.png")).unwrap(), bytes);
    }
}

#[test]
fn effects_on_a_stored_image_are_those_of_a_frame() {
    let room = room_with(
        "kind = \"worn_lines\"\nshare = 0.5\npatch_m = 0.5\n[[effect]]\nkind = \"light\"\ngain = 0.5\n\
         [[effect]]\nkind = \"sensor_noise\"\nread_noise_dn = 2\nshot_noise_factor = 0.1",
    );
    stored(&room);
    let run = room.run("scene apply scene.toml --image in.png -o out.png --frame 5").succeeds();
    assert!(run.stdout.contains("applied: light, sensor_noise; left out: worn_lines"), "{run:?}");
    let open = |name: &str| image::open(room.path(name)).unwrap().to_rgb8();
    let (before, after) = (open("in.png"), open("out.png"));
    let errors: Vec<f64> = before.iter().zip(after.iter()).map(|(a, b)| f64::from(*b) - 0.5 * f64::from(*a)).collect();
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    assert!(mean.abs() < 0.6 && errors.iter().any(|error| error.abs() > 2.0), "{mean}");
    room.run("scene apply scene.toml --image in.png -o again.png --frame 5").succeeds();
    room.run("scene apply scene.toml --image in.png -o other.png --frame 6").succeeds();
    assert_eq!(open("again.png"), after);
    assert_ne!(open("other.png"), after);
    room.run("scene apply scene.toml --image in.png -o out.jpg").succeeds();
    assert_eq!(open("out.jpg").dimensions(), (64, 48));
    room.run("scene apply scene.toml --image in.png -o out.gif").fails(2, &["out.gif", ".png or .jpg"]);
    room.run("scene apply scene.toml --image none.png -o out.png").fails(1, &["none.png", "no such file"]);
    room.run("scene apply scene.toml --image scene.toml -o x.png").fails(1, &["scene.toml"]);
}

#[test]
fn a_scene_that_loses_its_first_odometry_gives_the_tags_of_its_log() {
    let room = room_with("kind = \"serial_noise\"\nlost_share = 0.6");
    for seed in 1..20 {
        let text = fs::read_to_string(room.path("scene.toml")).unwrap();
        let line = text.lines().find(|line| line.starts_with("seed = ")).unwrap().to_owned();
        room.write("scene.toml", text.replace(&line, &format!("seed = {seed}")));
        room.run("sim scene.toml -o log.mcap").succeeds();
        let messages = read_log(&room.path("log.mcap"));
        let first = |topic: &str| on(&messages, topic).next().unwrap().log_time_ns;
        if first(ODOMETRY) > first(IMAGE) {
            let [scene, log] = ["scene.toml", "log.mcap"].map(|source| room.replay(source));
            return assert_same(&scene.tags, &log.tags, "the scene");
        }
    }
    panic!("no seed loses it");
}

#[test]
fn check_shows_what_changes_with_every_frame_as_a_range() {
    let room = room_with(
        "kind = \"light\"\ngain = { uniform = [0.8, 1.2], per = \"frame\" }\n\
         colour = [1.0, { uniform = [0.5, 1.0], per = \"frame\" }, 1.0]\n\
         camera_gain = { uniform = [1.5, 1.75], per = \"episode\" }",
    );
    let run = room.run("scene check scene.toml").succeeds();
    for words in ["gain = 0.8 to 1.2 each frame", "0.5 to 1.0 each frame", "camera_gain = 1."] {
        assert!(run.stdout.contains(words), "{words}: {run:?}");
    }
    let report = room.run("scene check scene.toml --json").succeeds().json();
    assert_eq!(report["effects"][0]["values"]["gain"]["per"], "frame", "{report}");
    for wrong in ["nan", "0", "-1", "inf", "x"] {
        room.run(&format!("scene check scene.toml --max-ms={wrong}")).fails(2, &["--max-ms", "above 0"]);
    }
}

#[test]
fn what_is_no_scene_file_is_told_as_such() {
    let room = Room::new();
    fs::create_dir(room.path("folder.toml")).unwrap();
    room.write("latin.toml", b"[scene]\ntitle = \"\xe9\"\n");
    for command in ["scene check", "sim -o log.mcap", "replay -o captures"] {
        room.run(&format!("{command} folder.toml")).fails(1, &["folder.toml: it is a folder"]);
        room.run(&format!("{command} latin.toml")).fails(1, &["latin.toml: it is not UTF-8"]);
    }
}
