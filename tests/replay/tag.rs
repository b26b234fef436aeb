//! `tag`: the pose of one image, how far it may be trusted, and what makes no sense.

use realitysim::ros2::messages::CompressedImage;
use serde_json::Value;

use super::support::{IMAGE, LENS, Room, decode_all, walk};

const KNOWN: &str = "--lens lens.toml --attitude 0,17 --height 0.49";

/// With the walk's first frame, a black image and one of noise.
fn room() -> Room {
    let room = Room::new();
    room.write("lens.toml", LENS);
    let images: Vec<CompressedImage> = decode_all(&walk().messages, IMAGE);
    room.write("frame.jpg", &images[0].data);
    image::RgbImage::new(320, 240).save(room.path("black.png")).unwrap();
    let mut state = 1u32;
    let noise = image::RgbImage::from_fn(320, 240, |_, _| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        image::Rgb([(state >> 24) as u8, (state >> 16) as u8, (state >> 8) as u8])
    });
    noise.save(room.path("noise.png")).unwrap();
    room
}

#[test]
fn a_frame_of_the_walk_is_found() {
    let room = room();
    let report = room.run(&format!("tag frame.jpg {KNOWN} --field kid-2009 --json")).succeeds().json();
    assert!(report["fit"] == "good" || report["fit"] == "doubtful", "{report}");
    let place = |pose: &Value| [pose["x"].as_f64().unwrap(), pose["y"].as_f64().unwrap()];
    let tagged = &walk().tags[0].pose.pose.position;
    let off = |[x, y]: [f64; 2]| (x - tagged.x).hypot(y - tagged.y);
    let nearest = off(place(&report["best"]["pose"])).min(off(place(&report["mirror"])));
    assert!(nearest < 0.3, "{nearest} m off: {report}");
    let near = room.run(&format!("tag frame.jpg {KNOWN} --field kid-2009 --initial -1.9,0.2,10 --json"));
    assert_eq!(near.succeeds().json()["fit"], "good");
}

#[test]
fn an_image_that_nothing_fits_has_no_pose() {
    let room = room();
    for image in ["black.png", "noise.png"] {
        for field in ["", "--field kid-2009", "--initial 0,0,0"] {
            let run =
                room.run(&format!("tag {image} {KNOWN} {field}")).fails(1, &[image, "no pose found", "--attitude"]);
            assert_eq!(run.stdout, "", "no pose is printed that somebody might use");
            let report = room.run(&format!("tag {image} {KNOWN} {field} --json")).fails(1, &["no pose found"]).json();
            assert_eq!(report["fit"], "none");
        }
    }
}

#[test]
fn what_cannot_be_is_named() {
    let room = room();
    let lens = "--lens lens.toml";
    for (arguments, words) in [
        (format!("{lens} --attitude 0,200 --height 0.5"), ["--attitude", "pitch_deg is 200: it must be -90 to 90"]),
        (format!("{lens} --attitude -181,0 --height 0.5"), ["--attitude", "roll_deg is -181: it must be -180 to 180"]),
        (format!("{lens} --attitude 0,20 --height 0"), ["--height is 0", "0.01 to 100 m"]),
        (format!("{lens} --attitude 0,20 --height 500"), ["--height is 500", "0.01 to 100 m"]),
        (format!("{lens} --attitude 0,20"), ["--height is missing", "lens.toml"]),
        (
            format!("{KNOWN} --initial 9,0,0 --field kid-2009"),
            ["--initial is 9,0", "kid-2009 reaches from -3.70 to 3.70"],
        ),
        (format!("{KNOWN} --initial 90,0,0"), ["--initial is 90,0", "reaches from"]),
        (format!("{KNOWN} --overlay out.txt"), ["out.txt", ".png"]),
    ] {
        room.run(&format!("tag frame.jpg {arguments}")).fails(2, &words);
    }
}
