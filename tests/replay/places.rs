//! Where results may go: never into a capture, never over what is read; and the words when they cannot be written.

use std::fs;

use super::support::{Room, session_name, walk};

#[test]
fn nothing_is_exported_into_a_capture() {
    let room = Room::with_walk();
    let session = session_name(&room.replay("log.mcap"));
    let names = || {
        let entries = fs::read_dir(room.path(&session)).unwrap().map(|entry| entry.unwrap().file_name());
        let mut names: Vec<_> = entries.collect();
        names.sort();
        names
    };
    let before = names();
    let words = [session.as_str(), "lies in the capture", "choose another place"];
    for output in [&session, &format!("{session}/frames"), &format!("{session}/0000.mcap")] {
        for form in ["tum", "images"] {
            room.run(&format!("export {session} --to {form} -o {output}")).fails(2, &words);
        }
        room.run(&format!("demo -o {output}")).fails(2, &words);
    }
    room.write_scene("scene.toml", |text| text);
    room.run(&format!("scene render scene.toml -o {session}/0000.mcap")).fails(2, &words);
    assert_eq!(names(), before);
}

#[test]
fn nothing_is_written_over_what_is_read() {
    let room = Room::with_walk();
    let session = session_name(&room.replay("log.mcap"));
    room.write("part.mcap", fs::read(room.path(&session).join("0000.mcap")).unwrap());
    room.write_scene("scene.toml", |text| text);
    image::RgbImage::new(320, 240).save(room.path("image.png")).unwrap();
    let words = ["would be written over", "choose another place"];
    let tag = "tag image.png --lens lens.toml --attitude 0,20 --height 0.5";
    for (command, file) in [
        ("export part.mcap --to tum -o part.mcap", "part.mcap"),
        ("scene render scene.toml -o scene.toml", "scene.toml"),
        (&format!("{tag} --overlay image.png"), "image.png"),
        (&format!("{tag} --overlay lens.toml"), "lens.toml"),
    ] {
        let before = fs::read(room.path(file)).unwrap();
        room.run(command).fails(2, &words).fails(2, &[file]);
        assert!(fs::read(room.path(file)).unwrap() == before, "{command}");
    }
}

/// By whatever way a command comes to read it.
#[test]
fn nothing_is_written_over_what_an_input_names() {
    let room = Room::with_walk();
    room.write_scene("scene.toml", |text| text.replace("\"kid-2009\"", "\"field.toml\""));
    room.write("field.toml", include_str!("../../config/fields/kid-2009.toml"));
    room.write("robot.toml", "camera = { lens = \"lens.toml\", body_mask = [{ png = \"body.png\" }] }\n");
    image::RgbImage::from_pixel(320, 240, image::Rgb([255; 3])).save(room.path("body.png")).unwrap();
    image::RgbImage::new(8, 8).save(room.path("image.png")).unwrap();
    let limits = "limits = { mean_cm = 100.0 }\n";
    let case = |source: &str, rest: &str| format!("{limits}[[case]]\nsource = \"{source}\"\n{rest}");
    room.write("scenes.toml", case("scene.toml", ""));
    room.write("logs.toml", case("log.mcap", "config = \"robot.toml\"\n"));
    let gate = "replay log.mcap --check";
    for (command, file) in [
        ("scene render scene.toml -o lens.toml", "lens.toml"),
        ("scene render scene.toml -o field.toml", "field.toml"),
        ("scene apply scene.toml --image image.png -o scene.toml", "scene.toml"),
        ("check scenes.toml --junit lens.toml", "lens.toml"),
        ("check scenes.toml --junit ./field.toml", "field.toml"),
        ("check logs.toml --junit lens.toml", "lens.toml"),
        ("check logs.toml --junit body.png", "body.png"),
        (&format!("{gate} lens.toml --bless --config robot.toml"), "lens.toml"),
        (&format!("{gate} body.png --bless --config robot.toml"), "body.png"),
        (&format!("{gate} field.toml --bless --set field=field.toml"), "field.toml"),
        (&format!("{gate} lens.toml --bless --lens lens.toml#cam0"), "lens.toml"),
        (&format!("{gate} tags.jsonl --junit lens.toml --set camera.lens=lens.toml"), "lens.toml"),
        ("replay scene.toml --check lens.toml --bless", "lens.toml"),
        ("log cut log.mcap --from 1 --to 2 --config robot.toml -o lens.toml", "lens.toml"),
    ] {
        let before = fs::read(room.path(file)).unwrap();
        room.run(command).fails(2, &["would be written over", "choose another place"]).fails(2, &[file]);
        assert!(fs::read(room.path(file)).unwrap() == before, "{command}");
    }
    room.run("replay log.mcap --check tags.jsonl --bless").succeeds();
    // What is not understood may name anything: its failure is told, and nothing is lost.
    room.write_scene("scene.toml", |text| text + "nonsense");
    room.write("robot.toml", "camera = { lens = \"lens.toml\", nonsense = 1 }\n");
    let before = fs::read(room.path("lens.toml")).unwrap();
    for command in ["replay scene.toml --check tags.jsonl", "replay log.mcap --config robot.toml --check tags.jsonl"] {
        room.run(&format!("{command} --junit lens.toml")).fails(2, &["nonsense", "lens.toml: not written"]);
        assert!(fs::read(room.path("lens.toml")).unwrap() == before, "{command}");
    }
}

#[test]
fn a_place_that_cannot_be_written_is_named_with_what_to_do() {
    let room = Room::with_walk();
    let session = session_name(&room.replay("log.mcap"));
    room.write_scene("scene.toml", |text| text);
    room.write("taken", "a file where a folder should go");
    fs::create_dir(room.path("folder")).unwrap();
    for (command, words) in [
        (format!("export {session} --to tum -o none/x.tum"), ["none/x.tum: cannot be written", "make it first"]),
        (format!("export {session} --to tum -o folder"), ["folder: cannot be written", "name a file"]),
        (format!("export {session} --to images -o taken"), ["taken: cannot be written", "name a folder"]),
        (format!("export {session} --to images -o taken/x"), ["taken/x: cannot be written", "not a folder"]),
        ("scene render scene.toml -o none/log.mcap".to_owned(), ["none/log.mcap: cannot be written", "make it first"]),
        ("demo -o taken".to_owned(), ["taken: cannot be written", "name a folder"]),
        ("tag none.jpg --lens lens.toml".to_owned(), ["none.jpg: cannot be read", "there is no such file"]),
    ] {
        let run = room.run(&command).fails(1, &words);
        assert!(!run.stderr.contains("os error"), "{run:?}");
    }
    room.run("tag folder --lens lens.toml").fails(2, &["folder: it holds no JPEG or PNG file"]);
}

/// The machine's own device for that.
#[test]
fn a_full_disk_behind_standard_output_is_told() {
    let Ok(full) = fs::OpenOptions::new().write(true).open("/dev/full") else { return };
    let room = Room::with_walk();
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_realitysim"))
        .args(["log", "info", "log.mcap"])
        .current_dir(room.path(""))
        .stdout(full)
        .output()
        .unwrap();
    let told = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{told}");
    assert!(told.contains("standard output cannot be written"), "{told}");
}

#[test]
fn the_demo_needs_no_repository_around_it() {
    let room = Room::new();
    let report = room.run("demo --json").succeeds().json();
    assert!(report["eval"]["position_cm"]["mean"].as_f64().unwrap() < 10.0, "{report}");
    assert!(room.path("demo/demo.png").is_file() && room.path("demo/walk.mcap").is_file());
    assert!(walk().frames() > 0);
}
