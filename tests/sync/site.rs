//! A robot's captures, dev machines' captures, and a road between them.

use std::collections::BTreeMap;
use std::fs::{self, OpenOptions};
use std::io::Write;
use std::net::TcpListener;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant, SystemTime};

use jiff::Timestamp;
use realitysim::recording::Acknowledgement;
use serde_json::{Value, json};
use tempfile::TempDir;

pub struct Site {
    folder: TempDir,
    sshd: Option<Sshd>,
}

/// What a sync ended with.
#[derive(Debug)]
pub struct Synced {
    pub code: Option<i32>,
    pub stdout: String,
    pub stderr: String,
}

impl Synced {
    pub fn of(output: Output) -> Self {
        Self {
            code: output.status.code(),
            stdout: String::from_utf8(output.stdout).expect("text"),
            stderr: String::from_utf8(output.stderr).expect("text"),
        }
    }

    pub fn ends(self, code: i32) -> Self {
        assert_eq!(self.code, Some(code), "{self:?}");
        assert!(!self.stderr.contains("panicked"), "{self:?}");
        self
    }

    pub fn says(self, words: &str) -> Self {
        assert!(self.stderr.contains(words), "{words:?} is missing: {self:?}");
        self
    }

    pub fn json(&self) -> Value {
        serde_json::from_str(&self.stdout).unwrap_or_else(|error| panic!("{error}: {self:?}"))
    }
}

impl Site {
    /// Over a plain folder; `None` where there is no rsync.
    pub fn new() -> Option<Self> {
        let site = Self { folder: TempDir::new().expect("a folder"), sshd: None };
        has("rsync", &["--version"]).then_some(site)
    }

    /// Over a real sshd of our own, on loopback; `None` where there is none.
    pub fn with_ssh() -> Option<Self> {
        let mut site = Self::new()?;
        if !has("/usr/sbin/sshd", &["-V"]) || !has("perl", &["-v"]) {
            return None;
        }
        site.sshd = Some(Sshd::start(&site.path("ssh")));
        Some(site)
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// A recorder's finished session with these segments.
    pub fn session(&self, robot: &str, name: &str, segments: &[Vec<u8>]) -> PathBuf {
        let folder = self.begin(robot, name);
        for (index, bytes) in segments.iter().enumerate() {
            finish_segment(&folder, index, bytes);
        }
        folder
    }

    /// The same, of a robot whose clock is ahead by so many hours: name, start, times in the recording and of the files.
    pub fn session_by_a_clock(&self, robot: &str, ahead_h: i64, segments: &[Vec<u8>]) -> PathBuf {
        let started = Timestamp::from_second(1_763_719_200 + 3_600 * ahead_h).expect("a time");
        let name = format!("{}-r1", started.to_string().replace(':', "-"));
        let folder = self.session(robot, &name, segments);
        let rewrite = |name: &str, change: &dyn Fn(&mut Value)| {
            let text = fs::read_to_string(folder.join(name)).expect("read");
            let changed = text.lines().map(|line| {
                let mut value: Value = serde_json::from_str(line).expect("JSON");
                change(&mut value);
                value.to_string() + "\n"
            });
            fs::write(folder.join(name), changed.collect::<String>()).expect("written");
        };
        rewrite("session.json", &|head| head["started"] = started.to_string().into());
        rewrite("manifest.jsonl", &|line| {
            for key in ["first_ns", "last_ns"] {
                line[key] = (line[key].as_i64().expect("a time") + 3_600_000_000_000 * ahead_h).into();
            }
        });
        for entry in fs::read_dir(&folder).expect("read").map(|entry| entry.expect("an entry")) {
            let file = fs::File::options().write(true).open(entry.path()).expect("opened");
            file.set_modified(SystemTime::from(started)).expect("set");
        }
        folder
    }

    /// One without segments yet.
    pub fn begin(&self, robot: &str, name: &str) -> PathBuf {
        let folder = self.path(robot).join(name);
        fs::create_dir_all(&folder).expect("made");
        let id = &blake3::hash(format!("{robot}/{name}").as_bytes()).to_hex()[..32];
        let machine = &blake3::hash(robot.as_bytes()).to_hex()[..32];
        let head = json!({ "format": 1, "robot": "r1", "started": "2026-11-21T10:00:00Z", "id": id,
            "live": { "robot_id": machine }, "settings": { "a_key": "of a later version" } });
        fs::write(folder.join("session.json"), head.to_string()).expect("written");
        fs::write(folder.join("manifest.jsonl"), "").expect("written");
        folder
    }

    /// As the argument of `--ssh`.
    pub fn ssh(&self) -> &str {
        &self.sshd.as_ref().expect("over ssh").command
    }

    /// As the argument of `sync`.
    pub fn source(&self, robot: &str) -> String {
        match self.sshd {
            Some(_) => format!("127.0.0.1:{}", self.path(robot).display()),
            None => robot.to_owned(),
        }
    }

    pub fn sync(&self, robot: &str, dev: &str, more: &[&str]) -> Synced {
        Synced::of(self.command(robot, dev, more).output().expect("ran"))
    }

    pub fn command(&self, robot: &str, dev: &str, more: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_realitysim"));
        command.current_dir(self.folder.path()).arg("sync").arg(self.source(robot)).args(["-o", dev]);
        if let Some(sshd) = &self.sshd {
            command.arg("--ssh").arg(&sshd.command);
        }
        command.args(more).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }

    pub fn run(&self, arguments: &str) -> Synced {
        let mut command = Command::new(env!("CARGO_BIN_EXE_realitysim"));
        command.args(arguments.split_whitespace()).current_dir(self.folder.path());
        Synced::of(command.output().expect("ran"))
    }

    /// What the next calls of ssh do to the bytes that come from the robot: one line each, `cut N`, `flip N`, `slow MS`, `pass`,
    /// `fill FILE`: all but three megabytes of its disk, or `do COMMAND` before it is called.
    pub fn mangles(&self, what: &[String]) {
        let sshd = self.sshd.as_ref().expect("over ssh");
        fs::write(sshd.folder.join("mangle"), what.join("\n") + "\n").expect("written");
    }

    /// The law: what is acknowledged at the robot is on that dev machine, whole; and what bears a segment's name there is
    /// what was recorded. The number of acknowledged segments.
    pub fn holds(&self, robot: &str, devs: &[&str]) -> usize {
        let mut acknowledged = 0;
        let recorded = self.recorded(robot);
        for dev in devs {
            let receiver = fs::read_to_string(self.path(dev).join(".sync/receiver")).unwrap_or_default();
            let here = contents(&self.path(dev));
            for ((session, name), bytes) in &here {
                // Another robot's.
                let id = session_id(&self.path(dev).join(session));
                let Some((hash, _)) = recorded.get(&(id, name.clone())) else { continue };
                assert_eq!(&hash_of(bytes), hash, "{session}/{name} at {dev} is not what was recorded");
            }
            for session in sessions(&self.path(robot)) {
                let ack = session.join("ack").join(format!("{}.jsonl", receiver.trim()));
                let Ok(text) = fs::read_to_string(&ack) else { continue };
                for ack in Acknowledgement::parse_all(&text) {
                    acknowledged += 1;
                    let id = session_id(&session);
                    let there = here.iter().find(|((folder, name), _)| {
                        *name == ack.file && session_id(&self.path(dev).join(folder)) == id
                    });
                    let (_, bytes) = there.unwrap_or_else(|| panic!("{ack:?} is acknowledged and not at {dev}"));
                    assert_eq!((hash_of(bytes), bytes.len() as u64), (ack.blake3.clone(), ack.bytes), "{ack:?}");
                }
            }
        }
        acknowledged
    }

    /// Hash and size by session's number and file, of all manifests at the robot.
    fn recorded(&self, robot: &str) -> BTreeMap<(String, String), (String, u64)> {
        let mut all = BTreeMap::new();
        for session in sessions(&self.path(robot)) {
            let text = fs::read_to_string(session.join("manifest.jsonl")).unwrap_or_default();
            for line in text.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok()) {
                let text = |key: &str| line[key].as_str().expect("text").to_owned();
                all.insert(
                    (session_id(&session), text("name")),
                    (text("blake3"), line["bytes"].as_u64().expect("bytes")),
                );
            }
        }
        all
    }
}

/// Footer, name, line, in the recorder's order.
pub fn finish_segment(folder: &Path, index: usize, bytes: &[u8]) {
    let name = format!("{index:04}.mcap");
    fs::write(folder.join(format!("{name}.active")), bytes).expect("written");
    fs::rename(folder.join(format!("{name}.active")), folder.join(&name)).expect("renamed");
    append(&folder.join("manifest.jsonl"), &line(&name, index, bytes).to_string());
}

pub fn line(name: &str, index: usize, bytes: &[u8]) -> Value {
    // A minute each, from a clock that is a day off; places along the field.
    let first = 1_900_000_000_000_000_000_i64 + index as i64 * 60_000_000_000;
    let x = index as f64;
    json!({ "name": name, "bytes": bytes.len(), "blake3": hash_of(bytes), "first_ns": first,
        "last_ns": first + 59_000_000_000_i64, "messages": 10, "poses": { "x": [x, x + 0.5], "y": [0.0, 0.5] },
        "frames": { "captured": 4, "written": 4, "tagged": 4, "valid": index.min(4), "dropped": {} } })
}

pub fn append(path: &Path, line: &str) {
    let mut file = OpenOptions::new().append(true).create(true).open(path).expect("opened");
    writeln!(file, "{line}").expect("written");
}

/// Bytes that no compression and no luck makes alike.
pub fn noise(seed: u64, length: usize) -> Vec<u8> {
    let mut bytes = vec![0; length];
    blake3::Hasher::new().update(&seed.to_le_bytes()).finalize_xof().fill(&mut bytes);
    bytes
}

/// Files with segments' names, by session's folder and name.
pub fn contents(captures: &Path) -> BTreeMap<(String, String), Vec<u8>> {
    let mut all = BTreeMap::new();
    for session in sessions(captures) {
        for entry in fs::read_dir(&session).expect("read").map(|entry| entry.expect("an entry").path()) {
            if entry.extension().is_some_and(|ending| ending == "mcap") {
                let name = |path: &Path| path.file_name().expect("a name").to_str().expect("text").to_owned();
                all.insert((name(&session), name(&entry)), fs::read(&entry).expect("read"));
            }
        }
    }
    all
}

fn sessions(captures: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(captures).into_iter().flatten().map(|entry| entry.expect("an entry").path());
    entries.filter(|path| path.join("session.json").is_file()).collect()
}

fn session_id(session: &Path) -> String {
    let head: Value = serde_json::from_slice(&fs::read(session.join("session.json")).expect("read")).expect("JSON");
    head["id"].as_str().map_or_else(|| session.display().to_string(), str::to_owned)
}

pub fn hash_of(bytes: &[u8]) -> String {
    blake3::hash(bytes).to_hex().to_string()
}

/// Whether a program is there; in continuous integration it must be.
fn has(program: &str, arguments: &[&str]) -> bool {
    let found = Command::new(program).args(arguments).stdout(Stdio::null()).stderr(Stdio::null()).status().is_ok();
    assert!(found || std::env::var_os("CI").is_none(), "{program} is missing: `./dev test` installs it");
    if !found {
        println!("skipped: {program} is missing (Debian: apt-get install rsync openssh-server)");
    }
    found
}

/// An sshd with its own keys and settings, as the user who runs the test.
struct Sshd {
    process: Child,
    folder: PathBuf,
    /// What `--ssh` gets.
    command: String,
}

const MANGLE: &str = r#"
my ($what, $at, @ssh) = @ARGV;
my $ssh = open(my $from, "-|", @ssh) or exit 255;
binmode $from; binmode STDOUT;
my ($seen, $bytes) = (0);
while (my $length = sysread($from, $bytes, 65536)) {
    if ($what eq "cut" && $seen + $length > $at) {
        syswrite(STDOUT, substr($bytes, 0, $at - $seen));
        kill "KILL", $ssh;
        exit 255;
    }
    if ($what eq "flip" && $at >= $seen && $at < $seen + $length) {
        substr($bytes, $at - $seen, 1) ^= "\x01";
    }
    for (my $sent = 0; $sent < $length;) {
        my $more = syswrite(STDOUT, $bytes, $length - $sent, $sent);
        if (!$more) { kill "KILL", $ssh; exit 255 }
        $sent += $more;
    }
    $seen += $length;
    select(undef, undef, undef, $at / 1000) if $what eq "slow";
}
close $from;
exit($? >> 8);
"#;

impl Sshd {
    fn start(folder: &Path) -> Self {
        fs::create_dir_all(folder).expect("made");
        fs::set_permissions(folder, fs::Permissions::from_mode(0o700)).expect("set");
        let shown = folder.display();
        for key in ["host", "user"] {
            let made =
                Command::new("ssh-keygen").args(["-q", "-t", "ed25519", "-N", "", "-f"]).arg(folder.join(key)).status();
            assert!(made.expect("ssh-keygen").success());
        }
        fs::copy(folder.join("user.pub"), folder.join("authorized")).expect("copied");
        // Where sshd run by root drops its rights; others do not need it.
        let _ = fs::create_dir_all("/run/sshd");
        let port = TcpListener::bind("127.0.0.1:0").and_then(|free| free.local_addr()).expect("a port").port();
        let config = format!(
            "Port {port}\nListenAddress 127.0.0.1\nHostKey {shown}/host\nAuthorizedKeysFile {shown}/authorized\n\
             PidFile none\nStrictModes no\nUsePAM no\nPasswordAuthentication no\nMaxStartups 100\n"
        );
        fs::write(folder.join("config"), config).expect("written");
        let log = fs::File::create(folder.join("log")).expect("made");
        let process =
            Command::new("/usr/sbin/sshd").args(["-D", "-e", "-f"]).arg(folder.join("config")).stderr(log).spawn();
        fs::write(folder.join("mangle.pl"), MANGLE).expect("written");
        // The first line of `mangle` says what happens to this call; without one nothing does. The shell gives way to what it calls:
        // nobody else then holds the pipe that is cut.
        let ssh = format!(
            "ssh -F /dev/null -p {port} -i {shown}/user -o StrictHostKeyChecking=no -o UserKnownHostsFile=/dev/null \
             -o LogLevel=ERROR -o BatchMode=yes"
        );
        let script = format!(
            "#!/bin/sh\nwhat=$(head -n 1 {shown}/mangle 2>/dev/null)\n[ -z \"$what\" ] || sed -i 1d {shown}/mangle\n\
             case $what in\ncut*|flip*|slow*) exec perl {shown}/mangle.pl $what {ssh} \"$@\" ;;\nfill*) cat /dev/zero 2>/dev/null \
             >\"${{what#fill }}\"; truncate -s -3M \"${{what#fill }}\" ;;\ndo*) eval \"${{what#do }}\" ;;\nesac\nexec {ssh} \"$@\"\n"
        );
        let command = folder.join("ssh");
        fs::write(&command, script).expect("written");
        fs::set_permissions(&command, fs::Permissions::from_mode(0o700)).expect("set");
        let began = Instant::now();
        while std::net::TcpStream::connect(("127.0.0.1", port)).is_err() {
            let log = fs::read_to_string(folder.join("log")).unwrap_or_default();
            assert!(began.elapsed() < Duration::from_secs(60), "sshd does not answer: {log}");
            std::thread::sleep(Duration::from_millis(20));
        }
        let command = command.to_str().expect("text").to_owned();
        Self { process: process.expect("sshd"), folder: folder.to_owned(), command }
    }
}

impl Drop for Sshd {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
