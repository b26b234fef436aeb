//! Wrong config and wrong arguments: exit code 2, and a message that names the key and what would be right.

use super::support::Room;

#[test]
fn an_unknown_key_of_a_config_file_is_named() {
    let room = Room::with_walk();
    room.write("robot.toml", "[filter]\nparticels = 5\n");
    room.run("replay log.mcap -o captures --config robot.toml").fails(2, &["robot.toml", "particels", "particles"]);
    room.run("replay log.mcap -o captures --config none.toml").fails(2, &["none.toml"]);
    assert!(!room.path("captures").exists());
}

#[test]
fn an_impossible_value_is_named_with_what_is_possible() {
    let room = Room::with_walk();
    room.write("robot.toml", "[filter]\nparticles = 0\n");
    room.run("replay log.mcap -o captures --config robot.toml")
        .fails(2, &["robot.toml", "filter.particles is 0", "1 to"]);
    for (arguments, words) in [
        ("--particles 0", ["filter.particles is 0", "1 to"]),
        ("--set filter.valid_share=2", ["filter.valid_share is 2", "0 to 1"]),
        ("--set recording.segment_s=0", ["recording.segment_s is 0", "1 to"]),
        ("--set filter.jitter_shrink=nan", ["filter.jitter_shrink is NaN", "0 to 1"]),
        ("--set robot=../x", ["robot is", "letters"]),
    ] {
        room.run(&format!("replay log.mcap -o captures {arguments}")).fails(2, &words);
    }
}

#[test]
fn an_argument_that_makes_no_sense_is_named() {
    let room = Room::with_walk();
    for (arguments, words) in [
        ("--set nonsense", vec!["nonsense", "KEY=VALUE"]),
        ("--set filter.particels=5", vec!["filter.particels", "particles"]),
        ("--set filter.model=cubic", vec!["filter.model=cubic", "gauss", "distance"]),
        ("--model cubic", vec!["cubic", "gauss", "distance"]),
        ("--field moon", vec!["moon", "kid-2009", "spl-2020"]),
        ("--lens moon", vec!["moon", "fisheye-640"]),
        ("--initial 1,2", vec!["--initial", "x,y,yaw_deg"]),
        ("--initial 1,2,north", vec!["--initial", "x,y,yaw_deg"]),
        ("--initial 1,2,nan", vec!["--initial", "x,y,yaw_deg"]),
        ("--initial 1,2,1e300", vec!["--initial", "x,y,yaw_deg"]),
        ("--initial 9,0,0", vec!["--initial is 9,0", "kid-2009 reaches from -3.70 to 3.70 m in x", "1 m"]),
        ("--initial 0,-3.8,0", vec!["--initial is 0,-3.8", "from -2.70 to 2.70 m in y"]),
        ("--field adult-2020 --initial 90,0,0", vec!["--initial is 90,0", "adult-2020 reaches"]),
        ("--threads many", vec!["--threads", "many", "1 to 64"]),
        ("--threads 0", vec!["--threads", "0", "1 to 64"]),
        ("--threads 100000", vec!["--threads", "100000", "1 to 64"]),
        ("--frobnicate", vec!["--frobnicate"]),
    ] {
        room.run(&format!("replay log.mcap -o captures {arguments}")).fails(2, &words);
        assert!(!room.path("captures").exists(), "{arguments}");
    }
    room.run("replay log.mcap").fails(2, &["--output"]);
}

#[test]
fn the_start_on_a_scene_is_held_to_the_scene_s_field() {
    let room = Room::new();
    room.write_scene("scene.toml", |text| text);
    room.write("robot.toml", "field = \"adult-2020\"\n");
    let run = room.run("replay scene.toml -o captures --config robot.toml --initial 6,0,0");
    run.fails(2, &["--initial is 6,0", "kid-2009"]);
}

#[test]
fn a_message_ends_where_its_words_end() {
    let room = Room::with_walk();
    room.write("robot.toml", "[filter]\nparticels = 5\n");
    let run = room.run("replay log.mcap -o captures --config robot.toml").fails(2, &["particels"]);
    assert!(!run.stderr.ends_with("\n\n"), "{run:?}");
    room.write("field.toml", "lenth_m = 9\n");
    let run = room.run("replay log.mcap -o captures --field ./field.toml").fails(2, &["lenth_m"]);
    assert!(!run.stderr.ends_with("\n\n"), "{run:?}");
}

#[test]
fn a_body_mask_that_cannot_be_used_is_named() {
    let room = Room::with_walk();
    room.write("robot.toml", "[[camera.body_mask]]\npng = \"mask.png\"\n");
    room.run("replay log.mcap -o captures --config robot.toml").fails(2, &["mask.png"]);
    image::GrayImage::new(640, 480).save(room.path("mask.png")).unwrap();
    room.run("replay log.mcap -o captures --config robot.toml").fails(2, &["mask.png", "640 x 480", "320 x 240"]);
}

#[test]
fn where_the_robot_starts_can_be_said_on_the_command_line() {
    let room = Room::with_walk();
    let replayed = room.replay("log.mcap --initial -2.0,0.1,12.5");
    assert!(replayed.tags[2..].iter().all(|tag| tag.valid), "{}", replayed.report);
    let far = room.replay("log.mcap --initial 2.5,-1.5,170").tags;
    assert!((far[0].pose.pose.position.x - 2.5).abs() < 1.0, "it counts, and not what the log announces");
}

#[test]
fn a_field_size_that_makes_no_sense_is_named() {
    let room = Room::with_walk();
    room.write_scene("scene.toml", |text| text);
    for (arguments, words) in [
        ("log.mcap --field-size 5.9", vec!["--field-size", "LENGTHxWIDTH", "5.90x4.02"]),
        ("log.mcap --field-size 5.9xwide", vec!["--field-size", "LENGTHxWIDTH"]),
        (
            "log.mcap --field-size 4.02x5.9",
            vec!["--field-size", "the length, from goal line to goal line, comes first"],
        ),
        ("log.mcap --field-size nanx4", vec!["--field-size", "1 to 200 m"]),
        ("log.mcap --field-size 6x2", vec!["6 x 2 m is no size for the field kid-2009", "goal_area.width_m is 2.2"]),
        ("log.mcap --set field_size_m=[6,2]", vec!["no size for the field kid-2009"]),
        ("log.mcap --field-size 8x6 --initial 6,0,0", vec!["--initial is 6,0", "from -4.70 to 4.70 m in x"]),
        ("scene.toml --field-size 5.9x4.02", vec!["--field-size", "scene, which names its field itself"]),
    ] {
        room.run(&format!("replay {arguments} -o captures")).fails(2, &words);
    }
    room.run("tag frame.jpg --lens lens.toml --field-size 6x4").fails(2, &["--field"]);
}
