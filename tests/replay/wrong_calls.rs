//! What a new user types first: each call that is wrong has its exit code, and a message that says what would be right.

use std::fs;

use super::support::{CAPTURES, Room, session_name};

/// The call, its exit code, and what the message says.
type Wrong = (&'static str, i32, &'static [&'static str]);

const WRONG: [Wrong; 64] = [
    // Names.
    ("replya log.mcap -o out", 2, &["unrecognized subcommand 'replya'", "replay"]),
    ("replay log.mcap -o out --feild kid-2009", 2, &["--feild", "--field"]),
    ("replay log.mcap -o out --field kid2009", 2, &["kid2009", "did you mean kid-2009?", "spl-2020"]),
    ("replay log.mcap -o out --lens fisheye640", 2, &["did you mean fisheye-640?"]),
    ("replay log.mcap -o out --config mistyped.toml", 2, &["line 2", "`particels`: did you mean `particles`?"]),
    ("replay log.mcap -o out --config of_type.toml", 2, &["a whole number, 0 or more, is needed", "the text \"many\""]),
    ("replay log.mcap -o out --set fitler.particles=3", 2, &["`fitler`: did you mean `filter`?"]),
    ("replay log.mcap -o out --set filter.particles=many", 2, &["a whole number, 0 or more, is needed"]),
    ("replay log.mcap -o out --set filter.model=gaus", 2, &["did you mean `gauss`?"]),
    ("replay log.mcap -o out --model gaus", 2, &["--model", "did you mean `gauss`?"]),
    ("replay scene_mistyped.toml -o out", 2, &["scene_mistyped.toml", "`sead`: did you mean `seed`?"]),
    ("check suite_mistyped.toml", 2, &["`limts`: did you mean `limits`?"]),
    ("replay scene_mistyped.toml -o out --field kid-2009", 2, &["--field is of a log", "names its field itself"]),
    (
        "explain scene_mistyped.toml --frame 1 --set field=kid-2009",
        2,
        &["--field is of a log", "names its field itself"],
    ),
    // Numbers.
    ("replay log.mcap -o out --particles many", 2, &["--particles", "a whole number, 0 or more, is needed"]),
    ("replay log.mcap -o out --seed -1", 2, &["-1"]),
    ("replay log.mcap -o out --alpha x", 2, &["--alpha", "a number is needed"]),
    ("replay log.mcap -o out --threads 0", 2, &["--threads", "1 to 64"]),
    ("replay log.mcap -o out --initial 1,2", 2, &["x,y,yaw_deg", "3 numbers, and there are 2"]),
    ("log cut log.mcap --from x --to 2 -o out.mcap", 2, &["--from", "a number is needed"]),
    ("log cut log.mcap --from 0 --to 2 -o out.mcap --jpeg-quality 101", 2, &["a whole number from 1 to 100 is needed"]),
    ("view --db db --x 101 --y 0 --z 0.5 --yaw 0 -o out.png", 2, &["--x", "a number from -100 to 100 is needed"]),
    ("view --db db --x 0 --y 0 --z 0 --yaw 0 -o out.png", 2, &["--z", "a number from 0.02 to 20 is needed"]),
    ("view --db db --x 0 --y 0 --z 1 --yaw 0 -o out.png --width 9", 2, &["a whole number from 16 to 4096 is needed"]),
    ("record -o out --threads 100", 2, &["--threads", "a whole number from 1 to 64 is needed"]),
    ("sessions list --captures . --where valid", 2, &["--where", "realitysim catalogue rebuild"]),
    ("serve", 2, &["--db", "--captures"]),
    ("serve --db db --listen 80", 2, &["--listen", "an address and a port are needed, as in 127.0.0.1:8765"]),
    ("serve --db db --threads 65", 2, &["a whole number from 1 to 64 is needed"]),
    ("tag picture.jpg --lens fisheye-640 --attitude 0,20 --height x", 2, &["--height", "a number is needed"]),
    ("measure soak -o out --seconds x", 2, &["--seconds", "a number is needed"]),
    ("db coverage --db db --headings 0", 2, &["a whole number from 1 to 360 is needed"]),
    ("sessions prune --older-than x", 2, &["--older-than", "a whole number, 0 or more, is needed"]),
    // What a file is.
    ("replay picture.jpg -o out", 1, &["picture.jpg", "is a JPEG picture", "`realitysim tag`"]),
    ("log info picture.jpg", 1, &["is a JPEG picture", "`realitysim tag`"]),
    ("replay text.txt -o out", 1, &["text.txt: an MCAP log is needed, and this file is a text"]),
    ("replay archive.zip -o out", 1, &["a ZIP archive: unpack it first"]),
    ("replay old.bag -o out", 1, &["a bag of ROS 1", "rosbags-convert"]),
    ("replay noise.bin -o out", 1, &["its first bytes are 00 01 02 03"]),
    ("tag log.mcap --lens fisheye-640 --attitude 0,20 --height 0.5", 1, &["an MCAP log: `realitysim replay`"]),
    ("tag text.txt --lens fisheye-640 --attitude 0,20 --height 0.5", 1, &["neither JPEG nor PNG, it is a text"]),
    // Which of them.
    ("eval captures --truth log.mcap", 1, &["name the capture or bag in it, captures/2"]),
    ("export captures --to tum -o out.txt", 1, &["name the capture or bag in it, captures/2"]),
    ("replay captures -o out", 1, &["name the capture or bag in it, captures/2"]),
    ("refine captures", 1, &["session.json; name the capture in it, captures/2"]),
    ("log play captures --video out.mjpeg", 1, &["name the capture in it, captures/2"]),
    ("replay folder -o out", 1, &["the folder holds no .mcap file", "a capture's"]),
    (
        "eval captures/SESSION --truth log.mcap --truth-topic /nope",
        1,
        &["no message on /nope", "it holds poses on", "/odom"],
    ),
    (
        "eval captures/SESSION --truth log.mcap --poses /nope",
        1,
        &["no message on /nope", "it holds poses on", "/camera/pose"],
    ),
    ("sessions show 1999", 2, &["1999"]),
    // What is not there.
    ("replay none.mcap -o out", 1, &["none.mcap: there is no such file or folder"]),
    ("eval none --truth log.mcap", 1, &["none: there is no such file or folder"]),
    ("scene render none.toml -o out.mcap", 1, &["none.toml: there is no such file or folder"]),
    ("check none.toml", 2, &["none.toml: there is no such file or folder"]),
    ("measure cost none.mcap", 1, &["none.mcap: there is no such file or folder"]),
    ("replay log.mcap -o out --config none.toml", 2, &["none.toml", "there is no such file"]),
    ("sessions list --captures none", 2, &["there is no such folder"]),
    ("db stats --db none", 1, &["there is no database here", "realitysim db add"]),
    ("recorder status --socket none.sock", 1, &["no recorder is running there"]),
    // Where nothing can be made.
    ("replay log.mcap -o /proc/x", 1, &["/proc/x: no folder can be made there"]),
    ("demo -o /proc/x", 1, &["/proc/x: cannot be written: no folder can be made there"]),
    ("replay log.mcap -o text.txt/x", 1, &["text.txt", "not a folder"]),
    ("export captures --to tum -o none/out.txt", 1, &["captures"]),
    ("scene render scene.toml -o none/out.mcap", 1, &["none/out.mcap", "make it first"]),
];

#[test]
fn a_wrong_call_is_told_what_would_be_right() {
    let room = Room::with_walk();
    let session = session_name(&room.replay("log.mcap"));
    assert!(session.starts_with(&format!("{CAPTURES}/2")), "{session}");
    room.write("mistyped.toml", "[filter]\nparticels = 5\n");
    room.write("of_type.toml", "[filter]\nparticles = \"many\"\n");
    room.write("suite_mistyped.toml", "[limts]\nmean_cm = 1\n");
    room.write_scene("scene.toml", |text| text);
    room.write_scene("scene_mistyped.toml", |text| text.replace("seed = ", "sead = "));
    room.write("text.txt", "hoo hoo\n");
    room.write("archive.zip", b"PK\x03\x04and so on");
    room.write("old.bag", b"#ROSBAG V2.0\nand so on");
    room.write("noise.bin", [0, 1, 2, 3, 4, 5, 6, 7, 8]);
    fs::create_dir(room.path("folder")).expect("a folder");
    image::RgbImage::new(32, 24).save(room.path("picture.jpg")).expect("saved");
    for (call, code, words) in WRONG {
        let run = room.run(&call.replace("captures/SESSION", &session)).fails(code, words);
        for never in ["os error", "usize", "invalid digit", "invalid float", "socket address syntax", "[7", "[f"] {
            assert!(!run.stderr.contains(never), "{never:?} in {run:?}");
        }
    }
    assert!(!room.path("out").exists(), "nothing is begun by a wrong call");
}
