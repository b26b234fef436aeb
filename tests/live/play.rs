//! A capture played back: its pictures into a file, its odometry over a pty, read by what reads a robot.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

use realitysim::devices::mavlink::Content;
use realitysim::devices::serial::{PortEvent, PortOptions, run};
use realitysim::ros2::Message;
use realitysim::ros2::messages::CompressedImage;

use crate::replay::support::{IMAGE, ODOMETRY, Room, on, read_capture, session_name};
use crate::serial::Cable;

#[test]
fn a_capture_is_played_to_a_file_and_a_serial_line() {
    let room = Room::with_walk();
    let replayed = room.replay("log.mcap");
    let session = session_name(&replayed);
    let cable = Cable::new();
    let (stop, steps) = (Arc::new(AtomicBool::new(false)), Arc::new(Mutex::new((0u64, 0u64, 0u64))));
    let (reader_stop, counted, device) = (Arc::clone(&stop), Arc::clone(&steps), cable.ends[1].clone());
    let reader = std::thread::spawn(move || {
        run(&PortOptions { device, baud: 115_200, system: 1, poses: None }, &reader_stop, |event| {
            if let PortEvent::Measured(measured) = event {
                let mut counted = counted.lock().expect("whole");
                match measured.content {
                    Content::Odometry(_) => counted.0 += 1,
                    Content::Attitude(_) => counted.1 += 1,
                    Content::Inertial(_) => counted.2 += 1,
                    _ => {}
                }
            }
        });
    });
    let run = room
        .run(&format!("log play {session} --video video.mjpeg --serial {} --speed 2 --json", cable.ends[0]))
        .succeeds();
    std::thread::sleep(std::time::Duration::from_millis(500));
    stop.store(true, Ordering::Relaxed);
    reader.join().expect("a reader");
    let played = run.json();
    let messages = read_capture(&replayed.session);
    let images: Vec<u8> = on(&messages, IMAGE)
        .flat_map(|message| CompressedImage::decode(&message.data).expect("an image").data)
        .collect();
    assert_eq!(std::fs::read(room.path("video.mjpeg")).expect("written"), images, "byte for byte");
    let odometry = on(&messages, ODOMETRY).count() as u64;
    assert_eq!(played["odometry"].as_u64(), Some(odometry), "{played}");
    let (steps, attitudes, rates) = *steps.lock().expect("whole");
    // The line's reader may have opened a moment late.
    assert!(
        steps + 5 >= odometry && attitudes > odometry && rates > odometry,
        "{steps} {attitudes} {rates} of {odometry}"
    );
    let (first, last) = (messages[0].log_time_ns, messages[messages.len() - 1].log_time_ns);
    let seconds = played["seconds"].as_f64().expect("seconds");
    let wanted = (last - first) as f64 * 1e-9 / 2.0;
    assert!(seconds > 0.8 * wanted, "{seconds} s in place of {wanted} s");
}

#[test]
fn a_way_through_a_database_is_played() {
    let room = Room::new();
    crate::service::add_images(&room, "images", &crate::service::PLACES);
    room.write(
        "way.csv",
        "t,x,y,z,yaw_deg,pitch_deg,roll_deg\n0,0.1,0.2,0.5,10,20,0\n0.1,0.2,0.2,0.5,10,20,0\n0.2,0.3,0.2,0.5,10,20,0\n",
    );
    let played = room.run("log play way.csv --db db --video video.mjpeg --json").succeeds().json();
    assert_eq!((&played["images"], &played["doubtful"], played["doubt"].is_null()), (&3.into(), &0.into(), true));
    room.write("far.csv", "t,x,y,z,yaw_deg,pitch_deg,roll_deg\n0,47,0.2,0.5,10,20,0\n");
    let far = room.run("log play far.csv --db db --video far.mjpeg --json").succeeds().json();
    assert!(far["doubtful"] == 1 && far["doubt"].as_str().is_some_and(|why| why.contains("farther than")), "{far}");
    let bytes = std::fs::read(room.path("video.mjpeg")).expect("written");
    assert_eq!(bytes.windows(3).filter(|three| *three == [0xff, 0xd8, 0xff]).count(), 3);
}

#[test]
fn nothing_is_played_into_what_it_is_read_from() {
    let room = Room::with_walk();
    let session = session_name(&room.replay("log.mcap"));
    crate::service::add_images(&room, "images", &crate::service::PLACES);
    room.write("way.csv", "t,x,y,z,yaw_deg,pitch_deg,roll_deg\n0,0.1,0.2,0.5,10,20,0\n");
    let segment = format!("{session}/0000.mcap");
    for (source, target) in [
        (session.as_str(), segment.as_str()),
        ("way.csv --db db", "way.csv"),
        ("way.csv --db db", "db/database.json"),
        ("way.csv --db db", "images/0.png"),
    ] {
        let before = std::fs::read(room.path(target)).expect("there");
        room.run(&format!("log play {source} --video {target}")).fails(2, &["choose another place"]);
        room.run(&format!("log play {source} --serial {target}")).fails(2, &["choose another place"]);
        assert_eq!(std::fs::read(room.path(target)).expect("there"), before, "{target}");
    }
}

#[test]
fn what_is_no_device_is_not_made_and_what_is_there_is_not_written_over() {
    let room = Room::with_walk();
    let session = session_name(&room.replay("log.mcap"));
    let device = std::path::Path::new("/dev/video-realitysim-test");
    room.run(&format!("log play {session} --video {}", device.display())).fails(2, &["there is no such device"]);
    assert!(!device.exists(), "a file among the devices");
    room.write("notes.txt", "mine");
    room.run(&format!("log play {session} --video notes.txt")).fails(1, &["no file is written over"]);
    std::fs::copy(concat!(env!("CARGO_MANIFEST_DIR"), "/replay/scenes/demo.toml"), room.path("demo.toml"))
        .expect("a scene");
    room.run("scene render demo.toml -o notes.txt").fails(2, &["notes.txt: is there already"]);
    room.run(&format!("log cut {session} --from 0 --to 1 -o notes.txt")).fails(2, &["notes.txt: is there already"]);
    room.run(&format!("export {session} --to tum -o notes.txt")).fails(2, &["notes.txt: is there already"]);
    assert_eq!(std::fs::read_to_string(room.path("notes.txt")).expect("there"), "mine");
}

#[test]
fn a_pipe_that_nobody_reads_is_waited_for_and_given_up() {
    let room = Room::with_walk();
    let session = session_name(&room.replay("log.mcap"));
    assert!(std::process::Command::new("mkfifo").arg(room.path("pipe")).status().expect("mkfifo").success());
    let mut playing = std::process::Command::new(env!("CARGO_BIN_EXE_realitysim"))
        .args(["log", "play", &session, "--video", "pipe"])
        .current_dir(room.path(""))
        .stdout(std::process::Stdio::null())
        .spawn()
        .expect("started");
    std::thread::sleep(std::time::Duration::from_secs(1));
    assert!(playing.try_wait().expect("a child").is_none(), "it waits");
    let id = rustix::process::Pid::from_raw(playing.id() as i32).expect("a process");
    rustix::process::kill_process(id, rustix::process::Signal::TERM).expect("alive");
    let asked = std::time::Instant::now();
    while playing.try_wait().expect("a child").is_none() {
        assert!(asked.elapsed() < std::time::Duration::from_secs(60), "it waits for ever");
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
}

#[test]
fn what_cannot_be_played_is_told() {
    let room = Room::new();
    room.run("log play none").fails(2, &["--video"]);
    room.run("log play none --video out").fails(1, &["session.json"]);
    room.write("way.csv", "t,x\n");
    room.run("log play way.csv --video out").fails(2, &["--db"]);
    room.run("log play way.csv --db db --video out").fails(2, &["line 1: the head is \"t,x\""]);
    room.write("way.csv", "t,x,y,z,yaw_deg,pitch_deg,roll_deg\n1,0,0,0.5,0,0,0\n0.5,0,0,0.5,0,0,0\n");
    room.run("log play way.csv --db db --video out").fails(2, &["line 3", "go up"]);
    room.write("way.csv", "t,x,y,z,yaw_deg,pitch_deg,roll_deg\n1,0,nan,0.5,0,0,0\n");
    room.run("log play way.csv --db db --video out").fails(2, &["line 2: seven finite numbers"]);
    for (way, words) in [("1,0,x,0,0.5,0,0,0", "seven finite numbers"), ("1e12,0,0,0.5,0,0,0", "lasts 86400 s at most")]
    {
        room.write("way.csv", format!("t,x,y,z,yaw_deg,pitch_deg,roll_deg\n{way}\n"));
        room.run("log play way.csv --db db --video out").fails(2, &["line 2", words]);
    }
    room.write("way.csv", "t,x,y,z,yaw_deg,pitch_deg,roll_deg\n1,0,0,0.5,0,0,0\n");
    room.run("log play way.csv --db db --video out").fails(1, &["there is no database here"]);
    room.run("log play way.csv --db db --video out --speed 0").fails(2, &["0.01 to 100"]);
}
