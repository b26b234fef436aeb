//! Scenes on the command line: checked, told what they cost, and their effects on stored images.

use std::fs;

use std::process::{Command, Stdio};
use std::time::Duration;

use realitysim::evaluation::cpu_calibration::REFERENCE_MS;
use realitysim::ros2::messages::DiagnosticArray;
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

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

/// A limit in a CI file is for every machine that runs it: here one that lets the program work a third of the time.
#[test]
fn a_limit_of_time_does_not_count_what_else_the_machine_does() {
    let room = room_with("kind = \"obstacles\"\nrandom = 4");
    let number = |report: &Value, key: &str| report[key].as_f64().unwrap();
    let free = room.run("scene check scene.toml --json").succeeds().json();
    let reference_ms = number(&free, "reference_ms");
    let expected = number(&free, "total_ms") * REFERENCE_MS / number(&free, "loop_ms");
    assert!((reference_ms / expected - 1.0).abs() < 1e-9, "{free}");

    let mut command = Command::new(env!("CARGO_BIN_EXE_realitysim"));
    command.args(["scene", "check", "scene.toml", "--json", "--max-ms", &(2.0 * reference_ms).to_string()]);
    let mut child = command.current_dir(room.path("")).stdout(Stdio::piped()).spawn().unwrap();
    let pid = Pid::from_child(&child);
    while child.try_wait().unwrap().is_none() {
        for (signal, for_ms) in [(Signal::STOP, 6), (Signal::CONT, 3)] {
            // It may be gone by now.
            let _ = kill_process(pid, signal);
            std::thread::sleep(Duration::from_millis(for_ms));
        }
    }
    let output = child.wait_with_output().unwrap();
    let held_up: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(output.status.success(), "{free} {held_up}");
}

#[test]
fn a_wrong_scene_is_refused_with_its_line_wherever_it_is_used() {
    let room = room_with("kind = \"sensor_noise\"\nread_noise_dn = -3\nshot_noise_factor = 0.1");
    for command in [
        "scene check scene.toml",
        "scene render scene.toml -o log.mcap",
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
    room.run("scene render scene.toml -o log.mcap").succeeds();
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
    plain.run("scene render scene.toml -o log.mcap").succeeds();
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
        room.run("scene render scene.toml -o log.mcap").succeeds();
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

/// As a suite's paths: the file means the same whoever reads it from where.
#[test]
fn paths_in_a_scene_start_at_its_folder() {
    let room = Room::new();
    fs::create_dir_all(room.path("robot/scenes")).unwrap();
    room.write_scene("robot/scenes/walk.toml", |text| {
        text.replace("\"lens.toml\"", "\"../lens.toml\"").replace("\"kid-2009\"", "\"field.toml\"")
    });
    fs::rename(room.path("lens.toml"), room.path("robot/lens.toml")).unwrap();
    room.write("robot/scenes/field.toml", include_str!("../../config/fields/kid-2009.toml"));
    room.write("robot/suite.toml", "[[case]]\nsource = \"scenes/walk.toml\"\nlimits = { mean_cm = 5.0 }\n");
    room.run("scene render robot/scenes/walk.toml -o log.mcap").succeeds();
    room.run("check robot/suite.toml").succeeds();
    for file in ["robot/lens.toml", "robot/scenes/field.toml"] {
        room.run(&format!("scene render robot/scenes/walk.toml -o {file}")).fails(2, &["would be written over"]);
    }
    fs::rename(room.path("robot/lens.toml"), room.path("lens.toml")).unwrap();
    room.run("scene check robot/scenes/walk.toml").fails(2, &["line 9: robot/scenes/../lens.toml: cannot be read"]);
}

#[test]
fn what_is_no_scene_file_is_told_as_such() {
    let room = Room::new();
    fs::create_dir(room.path("folder.toml")).unwrap();
    room.write("latin.toml", b"[scene]\ntitle = \"\xe9\"\n");
    for command in ["scene check", "scene render -o log.mcap", "replay -o captures"] {
        room.run(&format!("{command} folder.toml")).fails(1, &["folder.toml: it is a folder"]);
        room.run(&format!("{command} latin.toml")).fails(1, &["latin.toml: it is not UTF-8"]);
    }
}
