//! Bad input that is no fault of a file: black frames, sensors that lie. A tag turns invalid or wide and says why; it is
//! never wrong and confident.

use realitysim::ros2::LogMessage;
use realitysim::ros2::messages::{CameraInfo, CompressedImage, Imu, Odometry, TFMessage};
use serde_json::Value;

use super::support::{
    CAMERA_INFO, IMAGE, IMU, ODOMETRY, Replayed, Room, TF_STATIC, TRUTH, changed, on, session_name, walk, without,
};

/// No valid tag is off by more than 10 cm, every invalid one says why, and at least this share is valid.
fn assert_never_wrong(room: &Room, replayed: &Replayed, least_valid: f64, what: &str) {
    let valid = replayed.tags.iter().filter(|tag| tag.valid).count() as f64 / replayed.tags.len() as f64;
    println!("{what}: {:.0} % valid: {}", 100.0 * valid, replayed.report["invalid"]);
    assert!(replayed.tags.iter().all(|tag| tag.valid == tag.reason.is_empty()), "{what}");
    assert!(valid >= least_valid, "{what}: {valid}");
    if valid > 0.0 {
        let judged = room.run(&format!("eval {} --truth log.mcap --json", session_name(replayed))).json();
        let worst = judged.pointer("/position_cm/max").and_then(Value::as_f64).expect("judged");
        assert!(worst < 10.0, "{what}: {worst} cm");
    }
}

fn black(image: &mut CompressedImage) {
    let black = image::GrayImage::new(320, 240);
    image.data.clear();
    image::DynamicImage::ImageLuma8(black)
        .write_to(&mut std::io::Cursor::new(&mut image.data), image::ImageFormat::Jpeg)
        .expect("encodes");
}

#[test]
fn black_frames_are_coasted_through_and_then_invalid() {
    let frames = walk().frames();
    let mut index = 0;
    let some = changed::<CompressedImage>(&walk().messages, IMAGE, |image| {
        index += 1;
        if (10..25).contains(&index) {
            black(image);
        }
    });
    let room = Room::with_log(&some);
    let replayed = room.replay("log.mcap");
    assert_never_wrong(&room, &replayed, (frames as f64 - 15.0) / frames as f64, "black for 1.5 s");
    assert!(!replayed.tags[22].valid, "a second without lines is too long");
    assert!(replayed.tags.last().expect("some").valid, "and it goes on afterwards");

    let room = Room::with_log(&changed::<CompressedImage>(&walk().messages, IMAGE, black));
    let replayed = room.replay("log.mcap");
    assert!(replayed.tags.iter().all(|tag| !tag.valid && !tag.reason.is_empty()), "nothing is ever seen");
    let none = format!("none of the {frames} tags is valid: ");
    assert!(replayed.run.code == Some(1) && replayed.run.stderr.contains(&none), "{:?}", replayed.run);
}

/// SplitMix64.
fn random_bytes(mut state: u64) -> impl Iterator<Item = u8> {
    core::iter::repeat_with(move || {
        state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mixed = (state ^ (state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (mixed ^ (mixed >> 31)).to_le_bytes()
    })
    .flatten()
}

/// What a camera with a broken cable sends, from the first frame on and in the middle of a walk.
#[test]
fn pictures_of_noise_give_no_valid_tag() {
    for (quality, channels, first) in [(90, 3, 0), (25, 1, 20)] {
        let mut index = 0;
        let messages = changed::<CompressedImage>(&walk().messages, IMAGE, |image| {
            index += 1;
            if index <= first {
                return;
            }
            let pixels = random_bytes(index as u64).take(320 * 240 * channels).collect();
            let picture = match channels {
                1 => image::DynamicImage::ImageLuma8(image::GrayImage::from_raw(320, 240, pixels).expect("fits")),
                _ => image::DynamicImage::ImageRgb8(image::RgbImage::from_raw(320, 240, pixels).expect("fits")),
            };
            image.data.clear();
            let data = std::io::Cursor::new(&mut image.data);
            image::codecs::jpeg::JpegEncoder::new_with_quality(data, quality).encode_image(&picture).expect("encodes");
        });
        let replayed = Room::with_log(&messages).replay("log.mcap");
        // A pose that was known is carried on for half a second.
        let carried = if first > 0 { first + 5 } else { 0 };
        let valid = replayed.tags[carried..].iter().filter(|tag| tag.valid).count();
        assert_eq!(
            valid, 0,
            "quality {quality}, {channels} channels, from frame {first}: {}",
            replayed.report["invalid"]
        );
        let said = replayed.report["warnings"].to_string();
        let blames = ["most probably", "the field is", "explain most"].iter().any(|words| said.contains(words));
        assert!(!blames && (first > 0 || said.contains("the pictures show no lines of a field")), "{said}");
    }
}

#[test]
fn an_imu_upside_down_gives_no_wrong_tags() {
    let upside_down = changed::<Imu>(&walk().messages, IMU, |imu| {
        // Half a turn about x: (x, y, z, w) times (1, 0, 0, 0).
        let q = imu.orientation;
        imu.orientation.x = q.w;
        imu.orientation.y = q.z;
        imu.orientation.z = -q.y;
        imu.orientation.w = -q.x;
        imu.angular_velocity.y *= -1.0;
        imu.angular_velocity.z *= -1.0;
    });
    let room = Room::with_log(&upside_down);
    assert_never_wrong(&room, &room.replay("log.mcap"), 0.0, "upside down");
}

#[test]
fn a_gyro_in_degrees_or_one_that_is_stuck_gives_no_wrong_tags() {
    type Lie = fn(&mut Imu);
    let lies: [(&str, Lie); 3] = [
        ("degrees", |imu| imu.angular_velocity.z = imu.angular_velocity.z.to_degrees()),
        ("stuck", |imu| imu.angular_velocity.z = 2.0),
        ("not a number", |imu| imu.angular_velocity.z = f64::NAN),
    ];
    for (what, lie) in lies {
        let room = Room::with_log(&changed::<Imu>(&walk().messages, IMU, lie));
        assert_never_wrong(&room, &room.replay("log.mcap"), 0.9, what);
    }
}

#[test]
fn odometry_that_freezes_jumps_or_falls_silent_gives_no_wrong_tags() {
    let messages = &walk().messages;
    let stamps: Vec<i64> = on(messages, ODOMETRY).map(|message| message.log_time_ns).collect();
    let (from, until) = (stamps[stamps.len() / 3], stamps[2 * stamps.len() / 3]);
    let mut held: Option<Odometry> = None;
    let frozen = changed::<Odometry>(messages, ODOMETRY, |odometry| {
        let stamp = odometry.header.stamp.to_nanoseconds();
        if (from..until).contains(&stamp) {
            let pose = held.get_or_insert_with(|| odometry.clone()).pose;
            odometry.pose = pose;
        }
    });
    let jumped = changed::<Odometry>(messages, ODOMETRY, |odometry| {
        if odometry.header.stamp.to_nanoseconds() > from {
            odometry.pose.pose.position.x += 100.0;
        }
    });
    let silent: Vec<_> = messages
        .iter()
        .filter(|message| message.channel.topic != ODOMETRY || !(from..until).contains(&message.log_time_ns))
        .cloned()
        .collect();
    let nan = changed::<Odometry>(messages, ODOMETRY, |odometry| odometry.pose.pose.position.y = f64::NAN);
    for (what, log, least_valid) in
        [("frozen", frozen, 0.9), ("jumped 100 m", jumped, 0.9), ("silent", silent, 0.6), ("not a number", nan, 0.0)]
    {
        let room = Room::with_log(&log);
        assert_never_wrong(&room, &room.replay("log.mcap"), least_valid, what);
    }
}

/// A lens of 75 degrees and no IMU: nothing but the lines says that the robot walks on, and they do not say it along them.
#[test]
fn frozen_odometry_with_a_narrow_lens_and_no_gyro_gives_no_wrong_tags() {
    let room = Room::new();
    room.write_scene("scene.toml", |text| {
        let without = |text: String, from: &str| {
            let start = text.find(from).expect("there");
            let end = start + 1 + text[start + 1..].find("[[effect]]").expect("an effect after it");
            format!("{}{}", &text[..start], &text[end..])
        };
        let text = text.replace("[[-2.0, 0.1], [-1.1, 0.3]]", "[[-1.26, 0.12], [-0.62, 0.29], [0.6, -1.22]]");
        let text = text.replace("scale_percent = 6.0", "scale_percent = 6.0\nfreeze = { from_s = 3.0, for_s = 4.0 }");
        without(without(text, "[imu]"), "[[effect]]\nkind = \"imu_error\"")
    });
    let narrow = "title = \"75 degrees\"\nwidth = 320\nheight = 240\nfx = 210.0\nfy = 210.0\ncx = 159.5\ncy = 119.5\n\
                  model = \"plumb_bob\"\nd = [0.0, 0.0, 0.0, 0.0, 0.0]\n";
    room.write("lens.toml", narrow);
    room.run("scene render scene.toml -o log.mcap").succeeds();
    assert_never_wrong(&room, &room.replay("log.mcap"), 0.5, "frozen before a narrow lens");
}

#[test]
fn without_an_imu_tags_stay_right() {
    let room = Room::with_log(&without(&walk().messages, IMU));
    assert_never_wrong(&room, &room.replay("log.mcap"), 0.9, "no IMU");
}

/// An attitude that is old says nothing; one that does not come any more is done without.
#[test]
fn an_imu_that_dies_is_done_without() {
    let began = walk().messages[0].log_time_ns;
    let heard = |message: &&LogMessage| message.channel.topic != IMU || message.log_time_ns < began + 800_000_000;
    let kept: Vec<_> = walk().messages.iter().filter(heard).cloned().collect();
    let room = Room::with_log(&kept);
    let replayed = room.replay("log.mcap");
    assert_never_wrong(&room, &replayed, 0.3, "IMU gone");
    assert!(replayed.tags.iter().any(|tag| tag.reason == "sensors_stale"));
    let last = replayed.tags.last().expect("tags");
    let silent_s = (last.header.stamp.to_nanoseconds() - began) as f64 * 1e-9 - 0.8;
    assert!(last.valid && silent_s > 2.5, "{} after {silent_s} s", last.reason);
    let warnings = replayed.report["warnings"].to_string();
    assert!(warnings.contains("none for 2 s"), "{warnings}");
}

/// For seconds nothing but lines says where it goes, and they say so in every frame.
#[test]
fn whom_only_lines_have_followed_keeps_its_half() {
    let walked = without(&walk().messages, IMU);
    let stamps: Vec<i64> = on(&walked, ODOMETRY).map(|message| message.log_time_ns).collect();
    let silent = stamps[stamps.len() / 3]..stamps[2 * stamps.len() / 3];
    assert!(silent.end - silent.start > 1_100_000_000, "longer than it takes to be carried");
    let kept: Vec<_> = walked
        .iter()
        .filter(|message| message.channel.topic != ODOMETRY || !silent.contains(&message.log_time_ns))
        .cloned()
        .collect();
    let room = Room::with_log(&kept);
    let replayed = room.replay("log.mcap");
    assert_never_wrong(&room, &replayed, 0.5, "lines alone");
    assert!(replayed.tags.iter().all(|tag| !tag.ambiguous));
    assert!(replayed.tags.iter().any(|tag| !tag.valid && tag.header.stamp.to_nanoseconds() > silent.start));
}

#[test]
fn a_truth_that_stops_half_way_is_told() {
    let (mut count, half) = (0, walk().frames() / 2);
    let stops: Vec<_> = walk()
        .messages
        .iter()
        .filter(|message| {
            count += usize::from(message.channel.topic == TRUTH);
            message.channel.topic != TRUTH || count <= half
        })
        .cloned()
        .collect();
    let room = Room::with_log(&stops);
    let replayed = room.replay("log.mcap");
    let judged = room.run(&format!("eval {} --truth log.mcap --json", session_name(&replayed))).json();
    let without_truth = judged["without_truth"].as_u64().expect("a count") as usize;
    assert_eq!(without_truth, walk().frames() - half, "{judged}");
    assert!(
        judged["position_cm"]["mean"].as_f64().is_some_and(|mean| mean < 5.0),
        "the other half is judged: {judged}"
    );
    let none = Room::with_log(&without(&walk().messages, TRUTH));
    let replayed = none.replay("log.mcap");
    none.run(&format!("eval {} --truth log.mcap", session_name(&replayed))).fails(1, &["no message", TRUTH]);
}

/// What a replay says of the cause when it could not place most frames.
fn cause(room: &Room, arguments: &str) -> String {
    let replayed = room.replay(arguments);
    let warnings = replayed.report["warnings"].as_array().expect("warnings");
    let said: Vec<&str> = warnings.iter().filter_map(Value::as_str).filter(|said| said.contains("placed")).collect();
    let [said] = said[..] else { panic!("{}, {warnings:?}", replayed.report["invalid"]) };
    println!("{said}");
    said.to_owned()
}

#[test]
fn the_wrong_field_is_told_and_the_right_one_named() {
    let said = cause(&Room::with_walk(), "log.mcap --set field=kid-2014");
    assert!(said.contains("most probably it is another field") && said.ends_with("try --field kid-2009"), "{said}");
}

#[test]
fn a_wrong_lens_is_told_and_is_no_wrong_field() {
    let messages = changed::<CameraInfo>(&walk().messages, CAMERA_INFO, |info| {
        info.k[0] *= 1.25;
        info.k[4] *= 1.25;
    });
    let said = cause(&Room::with_log(&messages), "log.mcap");
    assert!(said.contains("most probably the lens (camera_info, or --lens) is wrong"), "{said}");
    assert!(
        said.contains("the focal length is 0.76 times") || said.contains("the focal length is 0.82 times"),
        "{said}"
    );
}

#[test]
fn a_wrong_mount_is_told_and_is_no_wrong_field() {
    let messages = changed::<TFMessage>(&walk().messages, TF_STATIC, |constants| {
        let camera = constants.transforms.iter_mut().find(|transform| transform.child_frame_id == "camera_link");
        let turn = &mut camera.expect("the camera's mount").transform.rotation;
        // It looks ten degrees farther down than is said.
        let pitch = 2.0 * f64::atan2(turn.y, turn.w) - 10f64.to_radians();
        (turn.y, turn.w) = ((pitch / 2.0).sin(), (pitch / 2.0).cos());
    });
    let said = cause(&Room::with_log(&messages), "log.mcap");
    assert!(said.contains("most probably the mount of the camera (/tf_static, or [mount])"), "{said}");
    let down = ["8", "10", "12"].iter().any(|degrees| said.contains(&format!("looks {degrees} deg farther down")));
    assert!(down, "{said}");
}

#[test]
fn a_wrong_height_is_told_and_is_no_wrong_field() {
    let messages = changed::<TFMessage>(&walk().messages, TF_STATIC, |constants| {
        let camera = constants.transforms.iter_mut().find(|transform| transform.child_frame_id == "camera_link");
        camera.expect("the camera's mount").transform.translation.z += 0.1;
    });
    let said = cause(&Room::with_log(&messages), "log.mcap");
    assert!(said.contains("most probably the mount of the camera (/tf_static, or [mount])"), "{said}");
    let lower = ["0.76", "0.82", "0.87"].iter().any(|times| said.contains(&format!("is {times} times as high")));
    assert!(lower, "{said}");
}

/// Each pixel's red, green and blue times as much.
fn tinted(image: &mut CompressedImage, by: [f32; 3]) {
    let mut picture = image::load_from_memory(&image.data).expect("decodes").to_rgb8();
    for pixel in picture.pixels_mut() {
        pixel.0 = core::array::from_fn(|c| (f32::from(pixel.0[c]) * by[c]) as u8);
    }
    image.data.clear();
    let data = std::io::Cursor::new(&mut image.data);
    image::codecs::jpeg::JpegEncoder::new_with_quality(data, 90).encode_image(&picture).expect("encodes");
}

/// Lines are white to whoever sees them, and no obstacles.
#[test]
fn a_white_balance_that_was_set_in_another_hall_costs_no_tags() {
    for by in [[0.6, 0.8, 1.3], [0.75, 0.9, 1.2], [1.2, 0.85, 0.6], [1.3, 0.75, 0.5]] {
        let room = Room::with_log(&changed::<CompressedImage>(&walk().messages, IMAGE, |image| tinted(image, by)));
        let replayed = room.replay("log.mcap");
        assert!(replayed.tags.iter().all(|tag| tag.valid), "{by:?}: {}", replayed.report["invalid"]);
        let judged = room.run(&format!("eval {} --truth log.mcap --json", session_name(&replayed))).succeeds().json();
        println!("{by:?}: {}", judged["position_cm"]);
        // Images of 320 x 240 pixels show few samples of white: 0.3 to 0.6 cm, where white light has 0.13.
        assert!(judged.pointer("/position_cm/mean").and_then(Value::as_f64).is_some_and(|mean| mean < 0.8), "{judged}");
    }
}

/// A fisheye's picture ends within the image, and its lens does not say where.
fn beside_the_end_of_the_picture(route: &str, initial_pose: &str) -> Replayed {
    let room = Room::new();
    room.write(
        "scene.toml",
        format!(
            "[scene]\ntitle = \"Beside the end of the picture\"\ntask = \"Measure no line that is cut.\"\nseed = 1\n\
             field = \"kid-2009\"\ninitial_pose = {initial_pose}\n\n\
             [camera]\nlens = \"fisheye-640\"\nrate_hz = 10.0\njpeg_quality = 90\ntorso_height_m = 0.38\n\
             mount_xyz_m = [0.04, 0.0, 0.11]\nmount_pitch_deg = 17.0\n\n[route]\n{route}\n\n\
             [odometry]\nrate_hz = 50.0\n\n[imu]\nrate_hz = 100.0\n"
        ),
    );
    room.run("scene render scene.toml -o log.mcap").succeeds();
    let replayed = room.replay("log.mcap");
    let judged = room.run(&format!("eval {} --truth log.mcap --json", session_name(&replayed))).succeeds().json();
    println!("{judged:#}");
    let share = judged["ellipse95_share"].as_f64().expect("a share");
    assert!(share >= 0.9 && judged["position_cm"]["max"].as_f64().expect("a figure") < 2.5, "{judged:#}");
    replayed
}

#[test]
fn a_line_that_the_end_of_the_picture_cuts_is_not_measured() {
    let still = "kind = \"still\"\nposes = [[2.25, -1.69, -171.0]]\nhold_s = 2.0";
    assert!(beside_the_end_of_the_picture(still, "\"exact\"").tags.iter().all(|tag| tag.valid));
}

/// Lines that it does not show are not missing.
#[test]
fn who_walks_into_a_corner_may_see_too_little_and_is_not_lost() {
    let walk = "kind = \"walk\"\nwaypoints = [[2.75, 1.7], [2.95, 1.85]]\nspeed_m_s = 0.05\nturn_deg_s = 35.0";
    let told = "{ x_m = 0.05, y_m = -0.05, yaw_deg = 2.0 }";
    let reasons: Vec<_> = beside_the_end_of_the_picture(walk, told).tags.into_iter().map(|tag| tag.reason).collect();
    assert!(reasons.iter().all(|reason| reason.is_empty() || reason == "few_lines"), "{reasons:?}");
}
