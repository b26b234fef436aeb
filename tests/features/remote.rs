//! Captures and databases in an object store: a real server of the protocol, with a proxy before it that makes requests fail.

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use serde_json::Value;

use crate::replay::support::{CAPTURES, Replayed, Room, Run, segments, session_name};

/// Names a Python interpreter that has moto with its server.
const INTERPRETER: &str = "REALITYSIM_PYTHON";
/// Where the captures go.
const STORE: &str = "s3://league/captures";

/// The server, and a room whose program reads from it.
struct Bucket {
    process: Child,
    commands: ChildStdin,
    said: BufReader<ChildStdout>,
    address: String,
    room: Room,
    replayed: Replayed,
}

impl Bucket {
    /// With the standard walk as a capture; `None` without an interpreter.
    fn new() -> Option<Self> {
        let Some(python) = std::env::var_os(INTERPRETER) else {
            println!("skipped: {INTERPRETER} names no interpreter");
            return None;
        };
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/features/s3_server.py");
        let mut server = Command::new(python);
        server.arg("-B").arg(script).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::null());
        let mut process = server.spawn().expect("python");
        let commands = process.stdin.take().expect("piped");
        let said = BufReader::new(process.stdout.take().expect("piped"));
        let room = Room::with_walk();
        let replayed = room.replay("log.mcap");
        let mut bucket = Self { process, commands, said, address: String::new(), room, replayed };
        bucket.address = bucket.line();
        assert!(bucket.address.starts_with("http://"), "moto is not installed: `./dev features` installs it");
        Some(bucket)
    }

    fn line(&mut self) -> String {
        let mut line = String::new();
        self.said.read_line(&mut line).expect("a line");
        line.trim().to_owned()
    }

    fn ask(&mut self, command: &str) -> Value {
        writeln!(self.commands, "{command}").expect("the server runs");
        serde_json::from_str(&self.line()).expect("JSON")
    }

    /// Numbers of the requests since the last call by method: GET, HEAD, and all others.
    fn requests(&mut self) -> [usize; 3] {
        let requests = self.ask("requests");
        let requests = requests.as_array().expect("a list");
        let of = |method: &str| requests.iter().filter(|request| request[0] == method).count();
        let [get, head] = [of("GET"), of("HEAD")];
        [get, head, requests.len() - get - head]
    }

    fn run(&self, arguments: &str) -> Run {
        let cache = self.room.path("cache").display().to_string();
        let variables = [
            ("AWS_ENDPOINT", self.address.as_str()),
            ("AWS_ALLOW_HTTP", "true"),
            ("AWS_REGION", "us-east-1"),
            ("AWS_ACCESS_KEY_ID", "test"),
            ("AWS_SECRET_ACCESS_KEY", "test"),
            ("REALITYSIM_CACHE", cache.as_str()),
        ];
        self.room.run_with(arguments, &variables)
    }

    fn upload(&self) -> Run {
        self.run(&format!("sync {CAPTURES} --to {STORE} --json"))
    }

    /// The name of the session.
    fn session(&self) -> String {
        self.replayed.session.file_name().unwrap().to_str().unwrap().to_owned()
    }

    /// Segments that the store has acknowledged.
    fn acknowledged(&self) -> usize {
        let Ok(files) = fs::read_dir(self.replayed.session.join("ack")) else { return 0 };
        files.map(|file| fs::read_to_string(file.unwrap().path()).unwrap().lines().count()).sum()
    }
}

impl Drop for Bucket {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

#[test]
fn what_a_store_acknowledges_was_read_back_from_it() {
    let Some(mut bucket) = Bucket::new() else { return };
    let count = segments(&bucket.replayed.session).len();
    let report = bucket.upload().succeeds().json();
    assert_eq!([&report["uploaded"], &report["already"]], [count, 0]);
    assert_eq!(bucket.acknowledged(), count);
    let [get, ..] = bucket.requests();
    assert!(get >= count, "{get} of {count} segments read back");
    let report = bucket.upload().succeeds().json();
    assert_eq!([&report["uploaded"], &report["already"]], [0, count]);
    // What somebody else overwrites is noticed, though its size is the same.
    let key = format!("captures/{}/0000.mcap", bucket.session());
    bucket.ask(&format!("change {key}"));
    assert_eq!(bucket.upload().succeeds().json()["uploaded"], 1);
    bucket.run(&format!("log info {STORE}/{}", bucket.session())).succeeds();
    // What the store loses is not acknowledged any more, and uploaded anew.
    bucket.ask(&format!("remove {key}"));
    let report = bucket.upload().succeeds().json();
    assert_eq!(report["uploaded"], 1);
    assert_eq!(bucket.acknowledged(), count);
    bucket.ask(&format!("remove {key}"));
    let segment = bucket.replayed.session.join("0000.mcap");
    let mut bytes = fs::read(&segment).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(&segment, bytes).unwrap();
    let report = bucket.upload().fails(3, &["0000.mcap", "not as it was recorded"]).json();
    assert_eq!([&report["uploaded"], &report["withdrawn"]], [0, 1]);
    assert_eq!(bucket.acknowledged(), count - 1);
}

#[test]
fn a_capture_in_a_store_is_read_by_the_same_commands() {
    let Some(bucket) = Bucket::new() else { return };
    bucket.upload().succeeds();
    let (there, here) = (format!("{STORE}/{}", bucket.session()), session_name(&bucket.replayed));
    let info = |capture: &str| {
        let mut info = bucket.run(&format!("log info {capture} --json")).succeeds().json();
        info.as_object_mut().expect("an object").retain(|key, _| !["source", "path", "log"].contains(&key.as_str()));
        info
    };
    assert_eq!(info(&there)["topics"], info(&here)["topics"]);
    // Both are one copy.
    bucket.run(&format!("eval {there} --truth {there}")).fails(1, &["no message on /ground_truth/camera_pose"]);
    for call in ["sessions prune --captures", "sessions pin", "refine"] {
        bucket.run(&format!("{call} {there}")).fails(2, &["folder or file of this machine"]);
    }
    bucket.run(&format!("log cut {here} --from 0 --to 1 --output={STORE}/cut.mcap")).fails(2, &["sync --to"]);
    let valid = |capture: &str| {
        bucket.run(&format!("eval {capture} --truth log.mcap --json")).succeeds().json()["valid"].clone()
    };
    assert_eq!(valid(&there), valid(&here));
    bucket.run(&format!("log info {STORE}/nothing")).fails(1, &["s3://league/captures/nothing: is not there"]);
    bucket
        .run(&format!("export {here} --to images -o {STORE}/out"))
        .fails(2, &["sync --to", "folder or file of this machine"]);
    bucket.run("log info s3://").fails(2, &["names no bucket"]);
}

#[test]
fn each_session_has_a_folder_of_its_own_whatever_its_name() {
    let Some(mut bucket) = Bucket::new() else { return };
    let odd = ["a#1", "b?x=1", "%2e%2e", "c%20d", "ein Gang"];
    for name in odd {
        let to = bucket.room.path(CAPTURES).join(name);
        fs::create_dir(&to).unwrap();
        for file in ["session.json", "manifest.jsonl", "0000.mcap"] {
            fs::copy(bucket.replayed.session.join(file), to.join(file)).unwrap();
        }
    }
    bucket.upload().succeeds();
    let keys = bucket.ask("keys");
    let keys: Vec<&str> = keys.as_array().unwrap().iter().map(|key| key.as_str().unwrap()).collect();
    for name in odd {
        assert!(keys.contains(&format!("captures/{name}/0000.mcap").as_str()), "{name}: {keys:?}");
    }
    assert!(keys.iter().all(|key| key.starts_with("captures/") && key.split('/').count() == 3), "{keys:?}");
    bucket.run(&format!("sync {CAPTURES} nobody --to {STORE}")).fails(2, &["no session that was asked for"]);
    bucket.run(&format!("sync {CAPTURES} --to file:///tmp")).fails(2, &["folder of this machine", "sync SOURCE -o"]);
}

#[test]
fn a_cold_view_asks_once_for_each_source_and_a_warm_one_not_at_all() {
    let Some(mut bucket) = Bucket::new() else { return };
    bucket.upload().succeeds();
    let there = format!("{STORE}/{}", bucket.session());
    bucket.run(&format!("db add {} --db here", session_name(&bucket.replayed))).succeeds();
    bucket.run(&format!("db add {there} --db away")).succeeds();
    fs::remove_dir_all(bucket.room.path("cache")).unwrap();
    let view = |bucket: &Bucket, db: &str| {
        let run =
            bucket.run(&format!("view --db {db} --x -1.95 --y 0.2 --z 0.5 --yaw 15 --pitch 20 -o {db}.png --json"));
        (run.succeeds().json(), fs::read(bucket.room.path(&format!("{db}.png"))).unwrap())
    };
    let (_, here) = view(&bucket, "here");
    bucket.requests();
    let (_, away) = view(&bucket, "away");
    assert!(here == away, "the same picture from both");
    let [get, head, others] = bucket.requests();
    assert!((1..=4).contains(&get) && head + others == 0, "{get} {head} {others}");
    assert!(view(&bucket, "away").1 == here);
    assert_eq!(bucket.requests(), [0; 3]);
    // Sources that are elsewhere are verified as those that are here.
    bucket.run("db verify --db away").succeeds();
    fs::remove_dir_all(bucket.room.path("cache")).unwrap();
    bucket.ask(&format!("change captures/{}/0000.mcap", bucket.session()));
    bucket.run("db verify --db away").fails(3, &["changed since it was indexed"]);
    bucket.run(&format!("log info {there}")).fails(1, &["0000.mcap", "not as its manifest says"]);
}

#[test]
fn a_store_that_fails_for_a_while_is_asked_again() {
    let Some(mut bucket) = Bucket::new() else { return };
    let count = segments(&bucket.replayed.session).len();
    bucket.ask("faults busy 3");
    assert_eq!(bucket.upload().succeeds().json()["uploaded"], count);
    let there = format!("{STORE}/{}", bucket.session());
    for fault in ["busy 2", "slow 2", "cut 2"] {
        let _ = fs::remove_dir_all(bucket.room.path("cache"));
        bucket.ask(&format!("faults {fault}"));
        bucket.run(&format!("log info {there}")).succeeds();
    }
    let _ = fs::remove_dir_all(bucket.room.path("cache"));
    bucket.ask("faults refused 9");
    bucket.run(&format!("log info {there}")).fails(1, &["refuses access", "AWS_ACCESS_KEY_ID"]);
}
