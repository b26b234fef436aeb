//! Databases that change under their readers, and folders that mean no good.

use std::fs;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use realitysim::config::Settings;
use realitysim::database::{DatabaseError, ImageDatabase, TagLimits, add, remove, stats};

use super::database::{CAMERA_INFO, POSES, walked};
use super::support::Room;

/// A folder of one image.
fn folder(room: &Room, name: &str, pose: &str) {
    fs::create_dir_all(room.path(name)).expect("a folder");
    let picture = image::RgbImage::from_fn(320, 240, |u, v| image::Rgb([u as u8, v as u8, 200]));
    picture.save(room.path(&format!("{name}/a.png"))).expect("saved");
    room.write(&format!("{name}/camera_info.yaml"), CAMERA_INFO);
    room.write(&format!("{name}/poses.csv"), format!("{POSES}a.png,{pose}\n"));
}

/// Programs that other tests start hold this one's lock for the moment between their fork and their exec.
fn patiently<T>(change: impl Fn() -> Result<T, DatabaseError>) {
    for _ in 0..200 {
        match change() {
            Err(DatabaseError::Busy { .. }) => std::thread::sleep(std::time::Duration::from_millis(10)),
            done => return drop(done.expect("changed")),
        }
    }
    panic!("the lock is never free");
}

/// Ends the others' loop, also when this one fails.
struct Done<'a>(&'a AtomicBool);

impl Drop for Done<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

#[test]
fn opening_never_meets_a_database_between_two_of_its_states() {
    let room = Room::new();
    folder(&room, "one", "0.1,0.2,0.5,10,20,0");
    folder(&room, "two", "0.3,0.2,0.5,10,20,0");
    room.run("db add one --db db --field kid-2009").succeeds();
    let (db, two) = (room.path("db"), room.path("two"));
    let (done, opened) = (AtomicBool::new(false), AtomicUsize::new(0));
    std::thread::scope(|scope| {
        scope.spawn(|| {
            let _done = Done(&done);
            // However slowly the other side opens, it meets some of the changes.
            for round in 0..1000 {
                if round >= 20 && opened.load(Ordering::Relaxed) > 2 {
                    return;
                }
                patiently(|| {
                    add(
                        &db,
                        std::slice::from_ref(&two),
                        None,
                        TagLimits { ambiguous: true, ..TagLimits::default() },
                        &mut |_| (),
                    )
                });
                patiently(|| remove(&db, &two));
            }
        });
        while !done.load(Ordering::Relaxed) {
            let images = ImageDatabase::open(&db, &Settings::default().views).expect("whole").index().len();
            assert!((1..=2).contains(&images));
            // Faster, and so more often between two states.
            for _ in 0..50 {
                assert!((1..=2).contains(&stats(&db).expect("whole").images));
            }
            opened.fetch_add(1, Ordering::Relaxed);
        }
        assert!(opened.load(Ordering::Relaxed) > 2);
    });
}

#[test]
fn poses_that_cannot_be_are_refused_by_name() {
    let room = Room::new();
    for (pose, words) in [
        ("1e300,0.2,0.5,10,20,0", "line 2: x is 1"),
        ("0.1,-101,0.5,10,20,0", "y is -101: -100 to 100"),
        ("0.1,0.2,-0.5,10,20,0", "z is -0.5: 0.02 to 20"),
        ("0.1,0.2,0.5,1e9,20,0", "yaw_deg is 1000000000: -3600 to 3600"),
        ("0.1,0.2,0.5,10,20,inf", "\"inf\" is no number"),
        ("0.1,0.2,0.5,10,20,0,0", "8 cells, and 7 are needed"),
    ] {
        folder(&room, "images", pose);
        room.run("db add images --db db --field kid-2009").fails(1, &[words]);
    }
    for (yaml, words) in [
        ("", "camera_info.yaml"),
        ("\u{0}\u{1}", "camera_info.yaml"),
        ("image_width: -5\n", "camera_info.yaml"),
        (&CAMERA_INFO.replace("102.5, 0, 160.75", "nan, 0, 160.75"), "camera_info.yaml"),
        (&CAMERA_INFO.replace("equidistant", "telepathic"), "telepathic"),
        (&CAMERA_INFO.replace("image_width: 320", "image_width: 999"), "999"),
    ] {
        folder(&room, "images", "0.1,0.2,0.5,10,20,0");
        room.write("images/camera_info.yaml", yaml);
        let run = room.run("db add images --db db --field kid-2009");
        assert!(matches!(run.code, Some(1 | 2)) && run.stderr.contains(words), "{yaml}: {run:?}");
    }
}

#[cfg(unix)]
#[test]
fn a_pipe_in_place_of_an_image_keeps_nobody_waiting() {
    let room = Room::new();
    folder(&room, "images", "0.1,0.2,0.5,10,20,0\nb.png,0.2,0.2,0.5,10,20,0");
    let pipe = |name: &str| {
        let made = std::process::Command::new("mkfifo").arg(room.path(name)).status().expect("mkfifo");
        assert!(made.success());
    };
    pipe("images/b.png");
    let run = room.run("db add images --db db --field kid-2009");
    assert!(run.code == Some(3) && run.stderr.contains("a plain file is needed"), "{run:?}");
    fs::remove_file(room.path("images/a.png")).expect("removed");
    pipe("images/a.png");
    let run = room.run("view --db db --x 0.1 --y 0.2 --z 0.5 --yaw 10 --pitch 20 -o out.png");
    assert!(run.code == Some(1) && run.stderr.contains("a plain file is needed"), "{run:?}");
    assert_eq!(room.run("db verify --db db").code, Some(3));
}

#[test]
fn folders_that_are_no_database_stay_as_they_are() {
    let room = Room::new();
    fs::create_dir(room.path("mine")).expect("a folder");
    for command in
        ["rebuild --db mine", "remove x --db mine", "stats --db mine", "verify --db mine", "coverage --db mine"]
    {
        room.run(&format!("db {command}")).fails(1, &["there is no database here"]);
    }
    assert_eq!(fs::read_dir(room.path("mine")).expect("there").count(), 0);
}

#[test]
fn sizes_that_no_machine_has_are_refused() {
    let (room, _) = walked();
    room.run("db coverage --db db --cell 0.02 --headings 360 -o x.png").fails(2, &["at most 20000000 are counted"]);
    room.run("db coverage --db db --cell 0.02 --headings 1 -o fine.png").succeeds();
    let (width, height) = image::image_dimensions(room.path("fine.png")).expect("a picture");
    assert!(width.max(height) <= 4096, "{width} x {height}");
    let here = "view --db db --x -1.5 --y 0.25 --z 0.5 --yaw 14 -o out.png";
    for (wrong, words) in [
        ("--max-distance nan", "a number from 0 to 1000 is needed"),
        ("--max-distance=-1", "a number from 0 to 1000 is needed"),
        ("--width 99999", "16 to 4096"),
        ("--frame 3", "--scene"),
        ("--figures omit", "--scene"),
    ] {
        let run = room.run(&format!("{here} {wrong}"));
        assert!(run.code == Some(2) && run.stderr.contains(words), "{wrong}: {run:?}");
    }
    room.run("view --db db --x 1e308 --y 0 --z 0.5 --yaw 0 -o out.png")
        .fails(2, &["a number from -100 to 100 is needed"]);
    room.run("measure gap --db db --apart nan").fails(2, &["a number from 0 to 1000 is needed"]);
    room.run("db add log.mcap --db other").fails(1, &["neither a capture (with session.json) nor a folder of images"]);
    room.run("serve --db db --token-file /dev/zero").fails(1, &["/dev/zero", "it is a device"]);
}

#[test]
fn images_of_another_size_than_their_lens_are_told() {
    let room = Room::with_walk();
    let session = room.replay("log.mcap").session;
    let path = session.join("session.json");
    let mut info: serde_json::Value = serde_json::from_slice(&fs::read(&path).expect("there")).expect("JSON");
    info["lens"]["width"] = 640.into();
    fs::write(&path, info.to_string()).expect("written");
    let run = room.run("db add captures --db db");
    run.fails(1, &["nothing was added", "images are not of the size of its lens, 640 x 240"]);
}

/// A wall of one colour: there is nothing to measure, and that is what is said.
#[test]
fn a_walk_of_views_without_lines_measures_nothing() {
    let room = Room::new();
    folder(&room, "one", "0.1,0.2,0.5,10,20,0");
    room.run("db add one --db db --field kid-2009").succeeds();
    let walk = "measure view-walk --db db --from 0.1,0.2,10 --to 0.12,0.2,10 --frames 2 -o walk";
    let said = room.run(walk).succeeds().stdout;
    assert!(said.contains("2 whose lines do not tell") && said.contains("position          -        -"), "{said}");
    let report = room.run(&format!("{walk} --json")).succeeds().json();
    assert!(report["position_cm"].is_null() && report["jump_cm"].is_null(), "{report}");
}
