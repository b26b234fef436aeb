//! `realitysim explain`: why the tag of one frame is what it is.

use super::support::{IMAGE, LENS, Room, changed, decode_all, walk};
use realitysim::ros2::messages::CompressedImage;

const PHOTO: &str = "--lens lens.toml --attitude 0,17 --height 0.49 --field kid-2009";

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
    assert!(number("explained_in_view") > 0.97, "ridges lie on painted lines, however far: {evidence}");
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

#[test]
fn a_single_image_is_explained_as_it_is_tagged() {
    let room = Room::new();
    room.write("lens.toml", LENS);
    let images: Vec<CompressedImage> = decode_all(&walk().messages, IMAGE);
    room.write("frame.JPG", &images[0].data);
    let told = room.run(&format!("explain frame.JPG {PHOTO} -o why.png")).succeeds().stdout;
    for words in ["the fit is", "line places fit", "the whole field", "why.png"] {
        assert!(told.contains(words), "{words}: {told}");
    }
    let is_doubtful = told.contains("the fit is doubtful");
    assert_eq!(is_doubtful, told.contains("explains the lines nearly as well"), "a rival is named: {told}");
    let near = room.run(&format!("explain frame.JPG {PHOTO} --initial=-1.9,0.2,10")).succeeds().stdout;
    assert!(near.contains("the fit is good"), "{near}");
    let picture = image::open(room.path("why.png")).expect("a picture");
    assert!(picture.width() > 1000 && picture.height() > 400, "{} x {}", picture.width(), picture.height());

    let tagged = room.run(&format!("tag frame.JPG {PHOTO} --json")).succeeds().json();
    let said = room.run(&format!("explain frame.JPG {PHOTO} --json")).succeeds().json();
    assert_eq!(said["fit"], tagged["fit"]);
    for axis in ["x", "y"] {
        assert_eq!(said["camera_in_map"][axis], tagged["best"]["pose"][axis]);
        assert_eq!(said["evidence"]["tried"][0][axis], tagged["best"]["pose"][axis]);
    }
    assert_eq!(said["evidence"]["digits"], tagged["best"]["digits"]);
}

#[test]
fn an_image_without_a_pose_says_why() {
    let room = Room::new();
    room.write("lens.toml", LENS);
    image::RgbImage::new(320, 240).save(room.path("black.png")).expect("saves");
    let told = room.run(&format!("explain black.png {PHOTO} -o why.png")).succeeds().stdout;
    assert!(told.contains("no pose found") && told.contains("there is no line of a field"), "{told}");
    assert!(told.contains("no picture was written"), "{told}");
    room.run(&format!("explain black.png {PHOTO} --frame 3")).fails(2, &["--frame is of a log"]);
    room.run("explain black.png --attitude 0,17 --height 0.49").fails(2, &["--lens is missing"]);
    room.write("log.mcap", b"");
    room.run("explain log.mcap").fails(2, &["--frame is missing", "log.mcap"]);
    room.run("explain log.mcap --frame 0 --height 0.5").fails(2, &["--height is of an image"]);
}
