//! The image database from end to end: captures and folders in, images out.

use std::fs;

use realitysim::config::Settings;
use realitysim::database::Gallery;
use realitysim::ros2::messages::CompressedImage;
use realitysim::ros2::{LogMessage, Message};

use super::support::{IMAGE, Room, read_capture};

const POSES: &str = "file,x,y,z,yaw_deg,pitch_deg,roll_deg\n";
const CAMERA_INFO: &str = "image_width: 320\nimage_height: 240\ncamera_name: test\ncamera_matrix:\n  rows: 3\n  cols: 3\n  data: \
    [102.5, 0, 160.75, 0, 102.5, 117.75, 0, 0, 1]\ndistortion_model: equidistant\ndistortion_coefficients:\n  rows: 1\n  cols: \
    4\n  data: [-0.012, 0.003, -0.0008, 0.0]\n";

/// A database `db` of the short walk; the capture's images in its order.
fn walked() -> (Room, Vec<LogMessage>) {
    let room = Room::with_walk();
    let replayed = room.replay("log.mcap");
    let session = replayed.session.strip_prefix(room.path("")).expect("inside").display().to_string();
    let run = room.run(&format!("db add {session} --db db --json")).succeeds();
    let valid = replayed.tags.iter().filter(|tag| tag.valid).count();
    assert_eq!(run.json()["images"].as_u64(), Some(valid as u64));
    let images = read_capture(&replayed.session).into_iter().filter(|message| message.channel.topic == IMAGE).collect();
    (room, images)
}

fn at(gallery: &Gallery, number: usize) -> (String, i64) {
    let record = gallery.index().record(number);
    let (pose, euler) = (record.pose(), record.pose().euler());
    let [yaw, pitch, roll] = [euler.yaw, euler.pitch, euler.roll].map(f64::to_degrees);
    let p = pose.translation;
    (format!("--x {} --y {} --z {} --yaw {yaw} --pitch {pitch} --roll {roll}", p.x, p.y, p.z), record.stamp_ns)
}

fn open(room: &Room) -> Gallery {
    Gallery::open(&room.path("db"), &Settings::default().views).expect("a database")
}

#[test]
fn a_stored_image_comes_out_byte_for_byte() {
    let (room, images) = walked();
    let gallery = open(&room);
    for number in [0, gallery.index().len() / 2, gallery.index().len() - 1] {
        let (pose, stamp_ns) = at(&gallery, number);
        let run = room.run(&format!("view --db db {pose} -o out.jpg --json")).succeeds();
        assert_eq!(run.json()["made"], "stored");
        let stamp = |message: &LogMessage| {
            let image = CompressedImage::decode(&message.data).expect("an image");
            (image.header.stamp.to_nanoseconds(), image.data)
        };
        let (_, bytes) = images.iter().map(stamp).find(|(stamp, _)| *stamp == stamp_ns).expect("its frame");
        assert_eq!(fs::read(room.path("out.jpg")).expect("written"), bytes);
    }
}

#[test]
fn a_view_says_what_it_is_made_of() {
    let (room, _) = walked();
    let run = room
        .run("view --db db --x -1.5 --y 0.25 --z 0.5 --yaw 14 --pitch 17 -o out.png --mask mask.png --json")
        .succeeds();
    let report = run.json();
    assert!(
        report["made"] == "composed" && report["sources"].as_array().is_some_and(|sources| sources.len() > 1),
        "{report}"
    );
    assert!(report["valid_share"].as_f64() > Some(0.9) && report["expected_error_px"].as_f64() < Some(3.0), "{report}");
    for picture in ["out.png", "mask.png"] {
        let picture = image::open(room.path(picture)).expect("a picture");
        assert_eq!((picture.width(), picture.height()), (320, 240));
    }
    room.run("view --db db --x -1.5 --y 0.25 --z 0.5 --yaw 14 --pitch 17 -o side.png --side-by-side").succeeds();
    let run = room.run("view --db db --x 2.5 --y 0 --z 0.5 --yaw 14 --pitch 17 -o out.png --max-distance 1");
    assert_eq!(run.code, Some(1));
    assert!(run.stderr.contains("farther than the 1.00 m that are allowed"), "{run:?}");
    let run = room.run("view --db db --x nan --y 0 --z 0.5 --yaw 14 -o out.png");
    assert!(run.code == Some(2) && run.stderr.contains("--x is NaN"), "{run:?}");
}

#[test]
fn what_changed_or_vanished_after_indexing_is_told_and_the_rest_is_used() {
    let (room, _) = walked();
    let gallery = open(&room);
    let record = gallery.index().record(3);
    let file = gallery.catalogue().sources[0].file(record.file).expect("its file");
    let mut bytes = fs::read(&file).expect("a segment");
    bytes[record.offset as usize + 500] ^= 1;
    fs::write(&file, &bytes).expect("written");
    let run = room.run("db verify --db db --json");
    assert_eq!(run.code, Some(3));
    assert_eq!(run.json()["sound"].as_u64(), Some(gallery.index().len() as u64 - 1));
    assert!(run.stderr.contains("changed since it was indexed"), "{run:?}");
    let (pose, _) = at(&gallery, 3);
    let run = room.run(&format!("view --db db {pose} -o out.png --json"));
    assert_eq!(run.code, Some(3), "made of its neighbours");
    assert!(run.json()["made"] != "stored" && run.json()["unreadable"].to_string().contains("changed"), "{run:?}");
    fs::remove_file(&file).expect("removed");
    let run = room.run(&format!("view --db db {pose} -o out.png"));
    assert!(run.code == Some(1) && run.stderr.contains("gone since it was indexed"), "{run:?}");
}

#[test]
fn a_gallery_goes_on_while_the_database_changes() {
    let (room, _) = walked();
    let before = open(&room);
    let count = before.index().len();
    assert!(before.reopened().expect("readable").is_none());
    let source = before.catalogue().sources[0].path.display().to_string();
    let run = room.run(&format!("db add {source} --db db"));
    assert!(run.code == Some(1) && run.stderr.contains("there already"), "{run:?}");
    room.run(&format!("db remove {source} --db db")).succeeds();
    // The old index is gone by name, and still whole for who has it open.
    assert!(before.image(0).is_ok() && before.index().is_sound() && before.index().len() == count);
    let after = before.reopened().expect("readable").expect("changed");
    assert_eq!(after.index().len(), 0);
    let run = room.run("view --db db --x 0 --y 0 --z 0.5 --yaw 0 -o out.png");
    assert!(run.code == Some(1) && run.stderr.contains("the database has no image"), "{run:?}");
    room.run(&format!("db add {source} --db db")).succeeds();
    room.run("db rebuild --db db").succeeds();
    assert_eq!(open(&room).index().len(), count);
    let run = room.run("db remove elsewhere --db db");
    assert!(run.code == Some(1) && run.stderr.contains("not in the database, which holds"), "{run:?}");
    let run = room.run("db coverage --db db -o coverage.png --json").succeeds();
    assert!(run.json()["filled"].as_u64() > Some(3));
    assert_eq!(room.run("db stats --db db --json").json()["images"].as_u64(), Some(count as u64));
}

#[test]
fn a_folder_of_images_is_read_and_its_mistakes_are_named() {
    let room = Room::new();
    fs::create_dir(room.path("images")).expect("a folder");
    let picture = image::RgbImage::from_fn(320, 240, |u, v| image::Rgb([u as u8, v as u8, 200]));
    picture.save(room.path("images/a.png")).expect("saved");
    picture.save(room.path("images/b.png")).expect("saved");
    room.write("images/poses.csv", format!("{POSES}a.png,0.1,0.2,0.5,10,20,0\nb.png,0.3,0.2,0.5,10,20,0\n"));
    let refused = |arguments: &str, words: &str| {
        let run = room.run(arguments);
        assert!(run.code != Some(0) && run.stderr.contains(words), "{words}: {run:?}");
    };
    refused("view --db db --x 0 --y 0 --z 0.5 --yaw 0 -o out.png", "there is no database here");
    refused("db add images --db db --field kid-2009", "without camera_info.yaml");
    room.write("images/camera_info.yaml", CAMERA_INFO);
    refused("db add images --db db", "name it with --field");
    room.run("db add images --db db --field kid-2009").succeeds();
    let run = room.run("view --db db --x 0.1 --y 0.2 --z 0.5 --yaw 10 --pitch 20 -o out.png --json").succeeds();
    assert_eq!(run.json()["made"], "stored");
    assert_eq!(fs::read(room.path("out.png")).expect("written"), fs::read(room.path("images/a.png")).expect("there"));
    for (table, words) in [
        ("file,x\n", "line 1: the head is \"file,x\""),
        ("a.png,0.1,0.2,0.5,10,20\n", "line 2: 6 cells"),
        ("a.png,0.1,nan,0.5,10,20,0\n", "\"nan\" is no number"),
        ("../images/a.png,0.1,0.2,0.5,10,20,0\n", "does not lie in this folder"),
    ] {
        let head = if table.starts_with("file") { "" } else { POSES };
        room.write("images/poses.csv", format!("{head}{table}"));
        refused("db add images --db other --field kid-2009", words);
    }
    fs::create_dir(room.path("more")).expect("a folder");
    fs::copy(room.path("images/a.png"), room.path("more/a.png")).expect("copied");
    room.write("more/camera_info.yaml", CAMERA_INFO);
    room.write("more/poses.csv", format!("{POSES}a.png,0.1,0.2,0.5,10,20,0\ngone.png,0.1,0.2,0.5,10,20,0\n"));
    refused("db add more --db db --field spl-2020", "a database is of one field");
    let run = room.run("db add more --db db");
    assert!(run.code == Some(3) && run.stderr.contains("gone.png"), "{run:?}");
}
