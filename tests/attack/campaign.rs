//! Runs cases in processes until the time is over, and counts.

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, Command, ExitCode, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};

use realitysim::config::Settings;
use rustix::process::{Pid, Signal, kill_process_group};
use serde_json::Value;

use crate::WORKER;
use crate::case::Class;
use crate::judge::{self, Judge};
use crate::kinds::{self, KINDS, Kind};
use crate::support::own_log;
use crate::walks::{Walk, Walks, options, replayed};

const DOCUMENT: &str = include_str!("../../docs/explanation/attack.md");
/// Without being asked for more: what `cargo test` waits for.
const USUAL_S: u64 = 10;
/// A case that takes longer hangs. Where no frame can be placed a replay ends with a search for the cause, which takes seconds.
const MAX_CASE: Duration = Duration::from_secs(60);
/// A process renders its logs first.
const MAX_START: Duration = Duration::from_secs(60);
/// Cases of one process.
const ROUND: u64 = 400;

#[derive(Clone, Debug, Default)]
struct Counts {
    cases: u64,
    refused: u64,
    accepted: u64,
    findings: BTreeMap<String, u64>,
    took: Duration,
    slowest: Duration,
    most_mb: u64,
}

struct Campaign {
    seed: u64,
    until: Instant,
    next: AtomicU64,
    counts: Mutex<BTreeMap<&'static str, Counts>>,
}

fn wanted(name: &str) -> Option<u64> {
    let text = std::env::var(name).ok()?;
    Some(text.parse().unwrap_or_else(|_| panic!("{name}={text}: a whole number is wanted")))
}

/// Exit code 1 if there is a finding.
pub fn run() -> ExitCode {
    let seed = wanted("REALITYSIM_ATTACK_SEED").unwrap_or(1);
    let folder = tempfile::tempdir().expect("a folder");
    let (time, slots) = match wanted("REALITYSIM_ATTACK_SECONDS").unwrap_or(USUAL_S) {
        seconds if seconds <= USUAL_S => (seconds, 1),
        seconds => (seconds, std::thread::available_parallelism().map_or(1, usize::from)),
    };
    for Kind { name, .. } in &KINDS {
        assert!(DOCUMENT.contains(&format!("\n| {name} | ")), "docs/explanation/attack.md lacks a row of {name}");
    }
    sound_logs_are_tagged(folder.path());
    let campaign = Campaign {
        seed,
        until: Instant::now() + Duration::from_secs(time),
        next: AtomicU64::new(0),
        counts: Mutex::default(),
    };
    if let Some(number) = wanted("REALITYSIM_ATTACK_CASE") {
        // Its files are left to look at.
        let folder = folder.keep();
        println!("seed {seed}, case {number}, a {}, in {}", kinds::of(number).name, folder.display());
        campaign.cases(number, 1, &folder);
    } else {
        println!("seed {seed}, {time} s, {slots} at once");
        std::thread::scope(|scope| {
            for slot in 0..slots {
                let folder = folder.path().join(slot.to_string());
                let campaign = &campaign;
                scope.spawn(move || campaign.rounds(&folder));
            }
        });
    }
    campaign.told()
}

/// Otherwise no tag could be wrong, and nothing would be attacked.
fn sound_logs_are_tagged(folder: &Path) {
    for Walk { name, messages, truth } in &Walks::rendered(folder).all {
        let (log, captures) = (folder.join("sound.mcap"), folder.join(name));
        std::fs::write(&log, own_log(messages)).expect("the folder can be written");
        let report = replayed(&options(log, captures.clone(), Settings::default()));
        let judged =
            judge::replay(&report, &captures, Judge { truth: Some(truth), mirrored: *name == "unknown start" });
        assert!(judged.is_ok(), "{name}: {judged:?}");
        let (valid, frames) = report.map_or((0, 0), |report| (report.valid, report.frames));
        println!("{name}: {valid} of {frames} frames are tagged where they are sound");
        assert!(2 * valid > frames && frames >= 8, "{name}: {valid} of {frames}");
    }
}

impl Campaign {
    fn rounds(&self, folder: &Path) {
        while Instant::now() < self.until {
            let first = self.next.fetch_add(ROUND, Ordering::Relaxed);
            self.cases(first, ROUND, folder);
        }
    }

    /// These cases, in as many processes as it takes.
    fn cases(&self, first: u64, count: u64, folder: &Path) {
        std::fs::create_dir_all(folder).expect("a folder");
        let (mut next, end) = (first, first + count);
        while next < end && (Instant::now() < self.until || count == 1) {
            next = self.process(next, end - next, folder);
        }
    }

    /// One process; the number behind the last case that it has done or not survived.
    fn process(&self, first: u64, count: u64, folder: &Path) -> u64 {
        let mut worker = Worker::started(self.seed, first, count, folder);
        let (mut begun, mut began) = (None, Instant::now());
        loop {
            let patience = if begun.is_some() { MAX_CASE } else { MAX_START };
            match worker.lines.recv_timeout(patience) {
                Ok(line) => {
                    if let Some(number) = line["begin"].as_u64() {
                        (begun, began) = (Some(number), Instant::now());
                    } else if let Some(number) = line["end"].as_u64() {
                        self.count(number, began.elapsed(), &line);
                        begun = None;
                        if Instant::now() >= self.until && count > 1 {
                            return number + 1;
                        }
                    }
                }
                Err(reason) => {
                    let hangs = reason == RecvTimeoutError::Timeout;
                    let said = worker.ended(hangs);
                    let Some(number) = begun else {
                        assert!(said.starts_with("exit status: 0"), "a process ended before its case began: {said}");
                        return first + count;
                    };
                    let (class, what) = match () {
                        () if hangs => (Class::Hang, format!("longer than {} s", MAX_CASE.as_secs())),
                        () if said.contains("memory allocation of") => (Class::Memory, said),
                        () => (Class::Panic, said),
                    };
                    let line = serde_json::json!({"class": class.name(), "what": what});
                    self.count(number, began.elapsed(), &line);
                    return number + 1;
                }
            }
        }
    }

    fn count(&self, number: u64, took: Duration, line: &Value) {
        let kind = kinds::of(number).name;
        if let Some(class) = line["class"].as_str() {
            println!("case {number}, {kind}: {class}: {}", line["what"].as_str().unwrap_or_default());
        }
        let mut counts = self.counts.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        let counts = counts.entry(kind).or_default();
        counts.cases += 1;
        match line["taken"].as_str() {
            Some("refused") => counts.refused += 1,
            Some(_) => counts.accepted += 1,
            None => *counts.findings.entry(line["class"].as_str().unwrap_or_default().to_owned()).or_default() += 1,
        }
        counts.took += took;
        counts.slowest = counts.slowest.max(took);
        counts.most_mb = counts.most_mb.max(line["mb"].as_u64().unwrap_or(0));
    }

    /// The table.
    fn told(&self) -> ExitCode {
        let counts = self.counts.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        let classes = Class::ALL.map(Class::name);
        println!(
            "| kind | cases | refused | accepted | {} | mean, ms | slowest, ms | largest, MB |",
            classes.join(" | ")
        );
        println!("|{}", " --- |".repeat(7 + classes.len()));
        let mut all = Counts::default();
        for kind in &KINDS {
            let Some(counts) = counts.get(kind.name) else { continue };
            all.cases += counts.cases;
            all.refused += counts.refused;
            all.accepted += counts.accepted;
            counts.findings.iter().for_each(|(class, count)| *all.findings.entry(class.clone()).or_default() += count);
            all.took += counts.took;
            all.slowest = all.slowest.max(counts.slowest);
            all.most_mb = all.most_mb.max(counts.most_mb);
            println!("{}", row(kind.name, counts));
        }
        println!("{}", row("all", &all));
        let findings: u64 = all.findings.values().sum();
        if findings == 0 {
            return ExitCode::SUCCESS;
        }
        println!(
            "{findings} findings; one case alone: REALITYSIM_ATTACK_SEED={} REALITYSIM_ATTACK_CASE=NUMBER cargo test --release --test attack",
            self.seed
        );
        ExitCode::FAILURE
    }
}

fn row(name: &str, counts: &Counts) -> String {
    let findings = Class::ALL.map(|class| counts.findings.get(class.name()).copied().unwrap_or(0).to_string());
    format!(
        "| {name} | {} | {} | {} | {} | {} | {} | {} |",
        counts.cases,
        counts.refused,
        counts.accepted,
        findings.join(" | "),
        counts.took.as_millis() / u128::from(counts.cases.max(1)),
        counts.slowest.as_millis(),
        counts.most_mb
    )
}

/// A process that runs cases.
struct Worker {
    child: Child,
    lines: Receiver<Value>,
    errors: std::thread::JoinHandle<String>,
}

impl Worker {
    fn started(seed: u64, first: u64, count: u64, folder: &Path) -> Self {
        let mut child = Command::new(std::env::current_exe().expect("this binary"))
            .arg(WORKER)
            .args([seed, first, count].map(|number| number.to_string()))
            .arg(folder)
            // Each thread's own arena would take addresses for nothing.
            .env("MALLOC_ARENA_MAX", "2")
            .env("RUST_BACKTRACE", "0")
            // With what it has started itself, so that all of it can be ended.
            .process_group(0)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("this binary starts");
        let (out, err) = (child.stdout.take().expect("piped"), child.stderr.take().expect("piped"));
        let (send, lines) = channel();
        std::thread::spawn(move || {
            for line in BufReader::new(out).lines().map_while(Result::ok) {
                let Ok(line) = serde_json::from_str(&line) else { continue };
                if send.send(line).is_err() {
                    break;
                }
            }
        });
        // Only the end says why it died.
        let errors = std::thread::spawn(move || {
            let mut last = String::new();
            for line in BufReader::new(err).lines().map_while(Result::ok) {
                last = if last.len() > 2000 { line } else { last + " " + &line };
            }
            last
        });
        Self { child, lines, errors }
    }

    fn kill(&self) {
        if let Some(group) = Pid::from_raw(self.child.id() as i32) {
            let _ = kill_process_group(group, Signal::KILL);
        }
    }

    /// How it ended, and what it said at last.
    fn ended(&mut self, kill: bool) -> String {
        if kill {
            self.kill();
        }
        let status = self.child.wait().map_or_else(|error| error.to_string(), |status| status.to_string());
        let errors = std::mem::replace(&mut self.errors, std::thread::spawn(String::new));
        format!("{status}: {}", errors.join().unwrap_or_default())
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        self.kill();
        let _ = self.child.wait();
    }
}
