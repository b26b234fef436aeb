//! The process that runs cases: with a bound on its memory, and a line before and after each.

use std::fs;
use std::io::Write;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::Mutex;

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use serde_json::json;

use crate::case::{Case, Class, Finding, Taken};
use crate::draw::Draw;
use crate::kinds;
use crate::walks::Walks;

/// Of addresses, not all of which are ever touched.
const MAX_ADDRESSES: u64 = 1_300 << 20;
/// What a case may touch.
pub const MAX_MEMORY_MB: u64 = 1_000;

/// What panicked in whatever thread, though somebody may have caught it.
static PANICS: Mutex<Vec<String>> = Mutex::new(Vec::new());

/// Arguments: seed, first number, how many, folder.
pub fn run(arguments: &[String]) {
    let [seed, first, count, folder] = arguments else { panic!("seed, first number, count, folder") };
    let [seed, first, count] = [seed, first, count].map(|text| text.parse::<u64>().expect("a number"));
    let folder = Path::new(folder);
    let walks = Walks::rendered(folder);
    let limit = Rlimit { current: Some(MAX_ADDRESSES), maximum: getrlimit(Resource::As).maximum };
    setrlimit(Resource::As, limit).expect("a process may bound itself");
    std::panic::set_hook(Box::new(|panic| {
        let what = panic.to_string().split_whitespace().collect::<Vec<_>>().join(" ");
        PANICS.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).push(what);
    }));
    let only = std::env::var("REALITYSIM_ATTACK_KIND").ok();
    for number in
        (first..first + count).filter(|number| only.as_ref().is_none_or(|only| kinds::of(*number).name == only))
    {
        if say(&json!({"begin": number})).is_err() {
            // Nobody wants to know any more.
            return;
        }
        let case_folder = folder.join("case");
        let _ = fs::remove_dir_all(&case_folder);
        fs::create_dir_all(&case_folder).expect("the folder can be written");
        forget_peak();
        let mut case = Case { draw: Draw::new(seed, number), folder: &case_folder, walks: &walks, story: Vec::new() };
        let outcome = catch_unwind(AssertUnwindSafe(|| (kinds::of(number).run)(&mut case)));
        let panics = std::mem::take(&mut *PANICS.lock().unwrap_or_else(|poisoned| poisoned.into_inner()));
        let peak_mb = peak_mb();
        let outcome = match outcome {
            _ if !panics.is_empty() => Err(Finding::new(Class::Panic, panics.join("; "))),
            Ok(Ok(_)) if peak_mb > MAX_MEMORY_MB => Err(Finding::new(Class::Memory, format!("{peak_mb} MB"))),
            Ok(outcome) => outcome,
            Err(_) => Err(Finding::new(Class::Panic, "something panicked without a word")),
        };
        let mut line = json!({"end": number, "mb": peak_mb});
        match outcome {
            Ok(Taken::Refused) => line["taken"] = json!("refused"),
            Ok(Taken::Accepted) => line["taken"] = json!("accepted"),
            Err(Finding { class, what }) => {
                line["class"] = json!(class.name());
                line["what"] = json!(format!("{what}; damage: {}", case.story.join(", ")));
            }
        }
        let _ = say(&line);
    }
}

fn say(line: &serde_json::Value) -> std::io::Result<()> {
    let mut out = std::io::stdout().lock();
    writeln!(out, "{line}")?;
    out.flush()
}

/// The largest memory is counted anew from here on, where the kernel lets it.
pub fn forget_peak() {
    let _ = fs::write("/proc/self/clear_refs", "5");
}

fn peak_mb() -> u64 {
    peak_mb_of("self")
}

/// Of a process, by its number.
pub fn peak_mb_of(process: &str) -> u64 {
    let status = fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    line.and_then(|line| line.split_whitespace().next()?.parse::<u64>().ok()).unwrap_or(0) / 1024
}
