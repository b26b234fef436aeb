//! Captures as pictures, a video and a log for 3D viewers.

use std::fs;
use std::process::Command;

use realitysim::ros2::messages::{CompressedImage, ImageAnnotations, MarkerArray, TFMessage};
use realitysim::ros2::topics::{CAMERA_TF, TAGGED_CAMERA, TAGGED_OPTICAL};
use serde_json::Value;

use super::support::{
    IMAGE, INITIAL, Room, TAG, assert_same, decode_all, on, read_capture, read_log, session_name, walk, without,
};

const INTERPRETER: &str = "REALITYSIM_PYTHON";

fn session() -> (Room, String) {
    let room = Room::with_walk();
    let session = session_name(&room.replay("log.mcap"));
    (room, session)
}

/// Number of pixels of a picture in which red stands far above green and blue: the lines of valid tags.
fn red_pixels(picture: &image::RgbImage) -> usize {
    let is_red = |pixel: &&image::Rgb<u8>| pixel.0[0] > 140 && pixel.0[1] < 110 && pixel.0[2] < 120;
    picture.pixels().filter(is_red).count()
}

#[test]
fn overlays_show_every_frame_with_the_lines_of_its_tag() {
    let (room, session) = session();
    let report = room.run(&format!("export {session} --to overlays -o shown --json")).succeeds().json();
    assert_eq!(report["written"], walk().frames());
    let tags = &walk().tags;
    for tag in [&tags[0], &tags[tags.len() - 1]] {
        let picture = image::open(room.path(&format!("shown/{:06}.jpg", tag.sequence))).unwrap().into_rgb8();
        assert_eq!((picture.width(), picture.height() % 2), (1280, 0), "a video needs even sides");
        assert_eq!(red_pixels(&picture) > 200, tag.valid, "frame {}: {}", tag.sequence, red_pixels(&picture));
    }
}

#[test]
fn a_route_is_a_picture_and_replaces_nothing_else() {
    let (room, session) = session();
    room.run(&format!("export {session} --to route -o route.png")).succeeds();
    let picture = image::open(room.path("route.png")).unwrap().into_rgb8();
    assert!(picture.width() == 1200 && red_pixels(&picture) > 100, "{}", red_pixels(&picture));
    room.write("thesis.png", "my thesis");
    room.run(&format!("export {session} --to route -o thesis.png")).fails(2, &["thesis.png", "remove it first"]);
    room.run(&format!("export {session} --to route -o route.tiff")).fails(2, &["route.tiff", ".png or .jpg"]);
}

#[test]
fn a_video_is_made_by_ffmpeg_or_it_is_said_what_is_missing() {
    let (room, session) = session();
    room.run(&format!("export {session} --to video -o walk.gif")).fails(2, &["walk.gif", ".mp4"]);
    room.write("walk.mp4", "my thesis");
    room.run(&format!("export {session} --to video -o walk.mp4")).fails(2, &["walk.mp4", "remove it first"]);
    let without = [("PATH", "")];
    let run = room.run_with(&format!("export {session} --to video -o new.mp4"), &without);
    run.fails(1, &["ffmpeg", "apt install", "--to overlays"]);
    if Command::new("ffmpeg").arg("-version").output().is_err() {
        println!("skipped: there is no ffmpeg");
        return;
    }
    room.run(&format!("export {session} --to video -o new.mp4")).succeeds();
    let video = fs::read(room.path("new.mp4")).unwrap();
    assert!(&video[4..8] == b"ftyp" && video.len() > 10_000, "{} bytes", video.len());
    let left: Vec<_> = fs::read_dir(room.path("")).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert!(left.iter().all(|name| !name.to_string_lossy().starts_with(".realitysim-")), "{left:?}");
}

#[test]
fn a_capture_has_one_tree_of_transforms_to_the_tagged_camera() {
    let (room, session) = session();
    let messages = read_capture(&room.path(&session));
    let transforms: Vec<TFMessage> = decode_all(&messages, CAMERA_TF);
    let valid: Vec<_> = walk().tags.iter().filter(|tag| tag.valid).collect();
    assert_eq!(transforms.len(), valid.len());
    for (TFMessage { transforms }, tag) in transforms.iter().zip(valid) {
        let [camera, optical] = &transforms[..] else { panic!("{transforms:?}") };
        assert_eq!((camera.header.frame_id.as_str(), camera.child_frame_id.as_str()), ("map", TAGGED_CAMERA));
        assert_eq!(
            (optical.header.frame_id.as_str(), optical.child_frame_id.as_str()),
            (TAGGED_CAMERA, TAGGED_OPTICAL)
        );
        assert_eq!(camera.header.stamp, tag.header.stamp);
        assert_eq!(camera.transform.translation.x, tag.pose.pose.position.x);
        assert_eq!(camera.transform.rotation, tag.pose.pose.orientation);
    }
    // No frame of the robot's own tree gets a second parent.
    let own: Vec<TFMessage> = [decode_all(&messages, "/tf"), decode_all(&messages, "/tf_static")].concat();
    let children = own.iter().flat_map(|message| &message.transforms).map(|transform| &transform.child_frame_id);
    assert!(children.clone().count() > 0 && children.clone().all(|child| !child.starts_with(TAGGED_CAMERA)));
    // A replay of the capture neither reads nor doubles them.
    let again = room.replay(&session);
    assert_same(&again.tags, &walk().tags, "of the capture");
    assert_eq!(on(&read_capture(&again.session), CAMERA_TF).count(), transforms.len());
}

#[test]
fn a_log_for_viewers_has_images_at_the_camera_lines_and_a_layout() {
    let (room, session) = session();
    room.run(&format!("export {session} --to foxglove -o shown")).succeeds();
    let messages = read_log(&room.path("shown/walk.mcap"));
    let images: Vec<CompressedImage> = decode_all(&messages, IMAGE);
    let source: Vec<CompressedImage> = decode_all(&walk().messages, IMAGE);
    assert_eq!(images.len(), source.len());
    for (shown, image) in images.iter().zip(&source) {
        assert_eq!((shown.header.frame_id.as_str(), shown.header.stamp), (TAGGED_OPTICAL, image.header.stamp));
        assert!(shown.data == image.data, "the pixels are untouched");
    }
    let lines: Vec<ImageAnnotations> = decode_all(&messages, "/camera/lines");
    assert_eq!((lines.len(), on(&messages, TAG).count()), (images.len(), images.len()));
    for (lines, tag) in lines.iter().zip(&walk().tags).filter(|(_, tag)| tag.valid) {
        assert!(lines.points.len() > 3 && lines.points.iter().all(|line| line.timestamp == tag.header.stamp));
        let inside = |point: &realitysim::ros2::messages::Point2| (-16.0..=336.0).contains(&point.x);
        assert!(lines.points.iter().flat_map(|line| &line.points).all(inside));
    }
    let [field] = &decode_all::<MarkerArray>(&messages, "/field/lines")[..] else { panic!("one field") };
    let marker = &field.markers[0];
    assert!(marker.points.len() % 2 == 0 && marker.header.frame_id == "map" && marker.scale.x == 0.05);
    let longest = marker.points.iter().map(|point| point.x).fold(0.0, f64::max);
    assert!((3.0..=3.025).contains(&longest), "half the length of kid-2009, up to the end of the paint: {longest}");
    let layout: Value = serde_json::from_slice(&fs::read(room.path("shown/layout.json")).unwrap()).unwrap();
    assert_eq!(layout["configById"]["Image!lines"]["imageMode"]["imageTopic"], IMAGE);
    check_with_python(&room);
}

/// Readers that other people wrote decode every message by the definitions in the log.
fn check_with_python(room: &Room) {
    let Some(python) = std::env::var_os(INTERPRETER) else {
        println!("skipped: {INTERPRETER} names no interpreter");
        return;
    };
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/replay/check_viewer_log.py");
    let output = Command::new(python).arg(script).arg(room.path("shown/walk.mcap")).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn the_lens_of_an_image_is_taken_from_a_capture() {
    let (room, session) = session();
    room.run(&format!("export {session} --to images -o frames")).succeeds();
    let known = "--attitude 0,17 --height 0.49 --field kid-2009 --json";
    let by = |lens: &str| {
        let mut report = room.run(&format!("tag frames/000002.jpg --lens {lens} {known}")).succeeds().json();
        report["image"] = Value::Null;
        report
    };
    let expected = by("frames/camera_info.yaml");
    assert_eq!(by(&session), expected);
    assert_eq!(by(&format!("{session}/0000.mcap")), expected);
    image::RgbImage::new(300, 300).save(room.path("square.png")).unwrap();
    let words = ["its lens is for images of 320 x 240", "300 x 300"];
    room.run(&format!("tag square.png --lens {session} {known}")).fails(1, &words);
}

#[test]
fn the_field_that_fits_is_named_if_the_one_that_was_said_does_not() {
    let (room, session) = session();
    room.run(&format!("export {session} --to images -o frames")).succeeds();
    let run = room
        .run(&format!("tag frames/000002.jpg --lens {session} --attitude 0,17 --height 0.49 --field hsl-large-2026"));
    run.fails(1, &["no pose found", "try --field kid-2009"]);
}

#[test]
fn a_required_share_of_valid_tags_decides_the_exit_code() {
    // Without a pose to begin with, the first frames are invalid.
    let room = Room::with_log(&without(&walk().messages, INITIAL));
    let report = room.run("replay log.mcap -o captures --require-valid 0 --json").succeeds().json();
    let share = report["valid"].as_f64().unwrap() / report["tagged"].as_f64().unwrap();
    assert!(0.1 < share && share < 1.0, "{share}");
    let required = |required: f64| room.run(&format!("replay log.mcap -o captures --require-valid {required}"));
    required(share - 0.01).succeeds();
    required(share + 0.01).fails(1, &["of the tags are valid, and --require-valid asks for"]);
    room.run("replay log.mcap -o captures --require-valid 80").fails(2, &["--require-valid", "0 to 1"]);
}

#[test]
fn an_export_says_its_field_and_another_one_may_be_stated() {
    let (room, session) = session();
    room.run(&format!("export {session} --to images -o frames")).succeeds();
    room.run("db add frames --db own").succeeds();
    room.run(&format!("db add {session} --db own")).succeeds();
    room.run("db add frames --db other --field kid-2014").succeeds();
    room.run(&format!("db add {session} --db other")).fails(1, &["field"]);
    room.write("frames/field.toml", "length_m = 9");
    room.run("db add frames --db third").fails(1, &["field.toml", "title"]);
}
