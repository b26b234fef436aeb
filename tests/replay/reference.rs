//! Tags held to those of an earlier replay.

use std::fs;

use realitysim::ros2::messages::{CompressedImage, Odometry};

use super::support::{IMAGE, ODOMETRY, Room, changed, walk, without};

fn blessed() -> Room {
    let room = Room::with_walk();
    room.run("replay log.mcap --check tags.jsonl --bless").succeeds();
    room
}

#[test]
fn what_was_blessed_is_the_same_again_on_any_number_of_threads() {
    let room = blessed();
    for arguments in ["", "--threads 1", "--threads 5", "--simd scalar"] {
        let run = room.run(&format!("replay log.mcap --check tags.jsonl {arguments}")).succeeds();
        assert!(run.stdout.contains("bit for bit"), "{run:?}");
    }
    let other = room.run("replay log.mcap --check tags.jsonl --simd scalar").succeeds();
    assert!(other.stdout.contains("filter.simd is \"scalar\", was \"auto\""), "{other:?}");
    assert_eq!(fs::read_dir(room.path("")).unwrap().count(), 2, "no capture is left that nobody asked for");
    let kept = room.run("replay log.mcap --check tags.jsonl -o captures --json").succeeds().json();
    assert_eq!(kept["same"], true, "{kept}");
    assert!(room.path("captures").exists());
}

#[test]
fn the_smallest_change_of_a_tag_is_reported_by_field_and_fails() {
    let room = blessed();
    let text = fs::read_to_string(room.path("tags.jsonl")).unwrap();
    // The last digit of the first number of the fourth frame.
    let lines: Vec<String> = text.lines().map(str::to_owned).collect();
    let columns: serde_json::Value = serde_json::from_str(&lines[0]).unwrap();
    let column = columns["columns"].as_array().unwrap().iter().position(|name| name == "yaw").unwrap();
    let mut values: Vec<serde_json::Value> = serde_json::from_str(&lines[4]).unwrap();
    let yaw = values[column].as_f64().unwrap();
    values[column] = f64::from_bits(yaw.to_bits() + 1).into();
    let mut changed = lines.clone();
    changed[4] = serde_json::to_string(&values).unwrap();
    room.write("tags.jsonl", changed.join("\n"));
    let run = room.run("replay log.mcap --check tags.jsonl --junit out.xml").fails(1, &[]);
    for word in ["1 frames differ", "yaw", "--bless"] {
        assert!(run.stdout.contains(word), "{word}: {run:?}");
    }
    assert!(!run.stdout.contains("pitch"), "{run:?}");
    let junit = fs::read_to_string(room.path("out.xml")).unwrap();
    assert!(junit.contains("failures=\"1\"") && junit.contains("name=\"pitch\"") && junit.contains("name=\"frames\""));
    let report = room.run("replay log.mcap --check tags.jsonl --json").json();
    assert_eq!(
        (&report["differences"][0]["field"], &report["differences"][0]["first_frame"]),
        (&"yaw".into(), &3.into())
    );

    room.run("replay log.mcap --check tags.jsonl --bless --tolerance yaw=1e-9").succeeds();
    let tolerant = fs::read_to_string(room.path("tags.jsonl")).unwrap().replace(lines[4].as_str(), &changed[4]);
    room.write("tags.jsonl", tolerant);
    let run = room.run("replay log.mcap --check tags.jsonl").succeeds();
    assert!(run.stdout.contains("within the tolerance"), "{run:?}");
}

#[test]
fn a_reference_of_another_log_seed_or_version_is_named_and_not_compared() {
    let room = blessed();
    let fails = |arguments: &str, words: &[&str]| {
        let run = room.run(&format!("replay {arguments} --check tags.jsonl")).fails(1, &["tags.jsonl: not compared"]);
        assert!(words.iter().all(|word| run.stderr.contains(word)), "{run:?}");
    };
    fails("log.mcap --seed 77", &["seed 1", "seed 77"]);
    fails("log.mcap --initial=-2.0,0.1,10", &["where the log says", "--initial"]);
    let other = changed::<Odometry>(&walk().messages, ODOMETRY, |odometry| odometry.pose.pose.position.x *= 1.01);
    room.write("other.mcap", super::support::own_log(&other));
    fails("other.mcap", &["another log", "log.mcap", "other.mcap"]);
    let text = fs::read_to_string(room.path("tags.jsonl")).unwrap();
    room.write("tags.jsonl", text.replacen("realitysim 0", "realitysim 9", 1));
    fails("log.mcap", &["made by realitysim 9"]);
    room.write("tags.jsonl", text.replacen("\"realitysim_reference\":1", "\"realitysim_reference\":3", 1));
    fails("log.mcap", &["format 3"]);
}

#[test]
fn an_empty_or_unexercised_log_is_no_reference_and_passes_no_gate() {
    let room = blessed();
    room.write("empty.mcap", super::support::own_log(&without(&walk().messages, IMAGE)));
    room.run("replay empty.mcap --check new.jsonl --bless").fails(1, &["image"]);
    let black = changed::<CompressedImage>(&walk().messages, IMAGE, |image| image.data.truncate(10));
    room.write("black.mcap", super::support::own_log(&black));
    let run = room.run("replay black.mcap --check new.jsonl --bless");
    run.fails(1, &["nothing was exercised", "none of", "tags is valid"]);
    assert!(!room.path("new.jsonl").exists());
    let text = fs::read_to_string(room.path("tags.jsonl")).unwrap();
    room.write("cut.jsonl", text.lines().take(3).collect::<Vec<_>>().join("\n"));
    room.run("replay log.mcap --check cut.jsonl").fails(1, &["cut.jsonl", "is it whole?"]);
    room.write("noise.jsonl", "hello\n");
    room.run("replay log.mcap --check noise.jsonl").fails(1, &["noise.jsonl", "no reference", "--bless"]);
    room.run("replay log.mcap --check none.jsonl").fails(1, &["none.jsonl", "no such file"]);
}

#[test]
fn arguments_that_do_not_go_together_are_refused() {
    let room = Room::with_walk();
    room.run("replay log.mcap --bless").fails(2, &["--check"]);
    room.run("replay log.mcap --check t --tolerance yaw=1").fails(2, &["--bless"]);
    room.run("replay log.mcap --check t --bless --tolerance yaw=-1").fails(2, &["above 0"]);
    room.run("replay log.mcap --check t --bless --tolerance yew=1").fails(2, &["yew", "yaw"]);
    room.run("replay log.mcap --check log.mcap --bless").fails(2, &["log.mcap", "is read"]);
    assert_eq!(fs::read(room.path("log.mcap")).unwrap(), walk().log);
}

/// Bits on this machine as on the one that made the reference: rendering, compression, vision and filter.
#[test]
fn the_demo_gives_the_tags_of_the_committed_reference() {
    let here = env!("CARGO_MANIFEST_DIR");
    let room = Room::new();
    let arguments = format!("replay {here}/replay/scenes/demo.toml --check {here}/replay/references/demo.jsonl");
    room.run(&arguments).succeeds();
}

#[test]
fn a_result_is_not_written_over_what_a_gate_reads() {
    let room = blessed();
    room.write("robot.toml", "robot = \"r\"\n");
    let files = ["log.mcap", "tags.jsonl", "robot.toml"];
    let before = files.map(|file| fs::read(room.path(file)).unwrap());
    for file in files {
        let run = room.run(&format!("replay log.mcap --check tags.jsonl --config robot.toml --junit {file}"));
        run.fails(2, &[file, "is read"]);
    }
    room.run("replay log.mcap --check none.jsonl --junit none.jsonl").fails(2, &["none.jsonl", "to be read"]);
    assert_eq!(files.map(|file| fs::read(room.path(file)).unwrap()), before);
    room.run("replay log.mcap --check tags.jsonl --bless --junit out.xml").fails(2, &["--junit", "--bless"]);
}

#[test]
fn a_gate_that_cannot_judge_leaves_no_passing_result() {
    let room = blessed();
    let text = fs::read_to_string(room.path("tags.jsonl")).unwrap();
    room.write("cut.jsonl", text.lines().take(3).collect::<Vec<_>>().join("\n"));
    for (arguments, code, word) in [
        ("log.mcap --check none.jsonl", 1, "none.jsonl"),
        ("log.mcap --check cut.jsonl", 1, "is it whole?"),
        ("log.mcap --seed 77 --check tags.jsonl", 1, "seed 77"),
        ("none.mcap --check tags.jsonl", 1, "none.mcap"),
        ("log.mcap --check tags.jsonl --set filter.particles=0", 2, "particles"),
    ] {
        room.run("replay log.mcap --check tags.jsonl --junit out.xml").succeeds();
        assert!(fs::read_to_string(room.path("out.xml")).unwrap().contains("failures=\"0\""));
        room.run(&format!("replay {arguments} --junit out.xml")).fails(code, &[word]);
        let junit = fs::read_to_string(room.path("out.xml")).unwrap();
        assert!(junit.contains("failures=\"1\"") && junit.contains(word), "{arguments}: {junit}");
    }
}

#[test]
fn a_reference_of_another_start_or_field_is_named() {
    let room = blessed();
    room.run("replay log.mcap --check tags.jsonl --warm-start -o captures").fails(2, &["--warm-start", "--check"]);
    let field = fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/config/fields/kid-2009.toml")).unwrap();
    room.write("field.toml", &field);
    room.run("replay log.mcap --field field.toml --check own.jsonl --bless").succeeds();
    room.run("replay log.mcap --field field.toml --check own.jsonl").succeeds();
    let line = field.lines().find(|line| line.starts_with("mark_size_m")).expect("a key of the field").to_owned();
    room.write("field.toml", field.replace(&line, "mark_size_m = 0.11"));
    let run = room.run("replay log.mcap --field field.toml --check own.jsonl");
    assert!(run.stdout.contains("field_content.mark_size_m is 0.11, was 0.1"), "{run:?}");
}

#[test]
fn a_reference_that_somebody_has_edited_is_checked() {
    let room = blessed();
    let text = fs::read_to_string(room.path("tags.jsonl")).unwrap();
    for (tolerance, words) in [
        ("{\"yew\":0.1}", ["line 1", "tolerance.yew", "yaw"]),
        ("{\"reason\":0.1}", ["line 1", "tolerance.reason", "yaw"]),
        ("{\"yaw\":-0.1}", ["line 1", "tolerance.yaw is -0.1", "0 or more"]),
    ] {
        let edited = text.replacen("\"tolerance\":{}", &format!("\"tolerance\":{tolerance}"), 1);
        assert_ne!(edited, text);
        room.write("edited.jsonl", edited);
        room.run("replay log.mcap --check edited.jsonl").fails(1, &words);
    }
    room.write("edited.jsonl", text + "\n\n");
    room.run("replay log.mcap --check edited.jsonl").succeeds();
}
