//! `realitysim explain`: why the tag of one frame is what it is.

use super::support::{IMAGE, Room, changed, walk};
use realitysim::ros2::messages::CompressedImage;

#[test]
fn a_frame_is_explained_in_words_numbers_and_a_picture() {
    let room = Room::with_walk();
    let told = room.run("explain log.mcap --frame 7 -o seven.png").succeeds().stdout;
    for words in ["frame 7 is valid", "brighter than the carpet", "line places fit", "the whole field", "seven.png"] {
        assert!(told.contains(words), "{words}: {told}");
    }
    let picture = image::open(room.path("seven.png")).expect("a picture");
    assert!(picture.width() > 1000 && picture.height() > 400, "{} x {}", picture.width(), picture.height());

    let said = room.run("explain log.mcap --frame 7 --json").succeeds().json();
    let tag = &walk().tags[7];
    let place = |axis: &str| said["camera_in_map"][axis].as_f64().expect("a number");
    let position = &tag.pose.pose.position;
    assert_eq!([place("x"), place("y"), place("z")], [position.x, position.y, position.z], "the tag of a replay");
    let evidence = &said["evidence"];
    let number = |key: &str| evidence[key].as_f64().expect("a number");
    assert!(number("digits") > 10.0 && number("foremost") > 0.9 && number("contrast") > number("noise"), "{evidence}");
    let count = |finding: &str| {
        let lines = evidence["lines"].as_array().expect("lines");
        lines.iter().filter(|line| line["finding"] == finding).count()
    };
    assert!(
        count("found") > 50 && count("missing") * 10 < count("found"),
        "{} and {}",
        count("found"),
        count("missing")
    );
    let best = &evidence["tried"][0];
    let off = |pose: [f64; 2]| f64::hypot(pose[0] - position.x, pose[1] - position.y);
    let at = [best["x"].as_f64().expect("x"), best["y"].as_f64().expect("y")];
    assert!(off(at).min(off([-at[0], -at[1]])) < 0.2, "the camera is less than 20 cm from the footprint: {best}");
}

#[test]
fn a_frame_that_is_not_there_is_told() {
    let frames = walk().frames();
    let last = format!("there is no frame {frames}; they are 0 to {}", frames - 1);
    Room::with_walk().run(&format!("explain log.mcap --frame {frames}")).fails(1, &[&last]);
}

#[test]
fn a_black_picture_is_named_and_a_replay_points_to_it() {
    let messages = changed::<CompressedImage>(&walk().messages, IMAGE, |image| {
        image.data.clear();
        let black = image::DynamicImage::ImageLuma8(image::GrayImage::new(320, 240));
        let mut data = std::io::Cursor::new(&mut image.data);
        black.write_to(&mut data, image::ImageFormat::Jpeg).expect("encodes");
    });
    let room = Room::with_log(&messages);
    let told = room.run("explain log.mcap --frame 3").succeeds().stdout;
    assert!(told.contains("frame 3 is invalid: too_dark") && told.contains("the picture is black"), "{told}");
    room.run("replay log.mcap -o captures").fails(1, &["as too_dark", "`realitysim explain log.mcap --frame 0`"]);
}
