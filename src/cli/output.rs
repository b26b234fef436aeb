//! Output of the commands: progress and tables for people, JSON for programs.

use std::io::{self, IsTerminal, Write};
use std::time::Duration;

use anyhow::Context;
use indicatif::{HumanDuration, ProgressBar, ProgressDrawTarget, ProgressState, ProgressStyle};
use serde::Serialize;

use crate::evaluation::Summary;
use crate::recording::Loss;

/// Progress in frames, on standard error: a bar on a terminal, a line now and then elsewhere.
pub struct Progress {
    bar: ProgressBar,
    plain: bool,
    told: std::time::Instant,
}

const REPORT_INTERVAL: Duration = Duration::from_secs(5);

impl Progress {
    pub fn new(what: &'static str) -> Self {
        let plain = !io::stderr().is_terminal();
        let bar = ProgressBar::with_draw_target(Some(0), ProgressDrawTarget::stderr());
        let style = ProgressStyle::with_template("{msg} {wide_bar} {pos}/{len} frames {per_sec} {eta}");
        if let Ok(style) = style {
            bar.set_style(style);
        }
        bar.set_message(what);
        Self { bar, plain, told: std::time::Instant::now() }
    }

    pub fn set(&mut self, done: u64, total: Option<u64>) {
        self.bar.set_length(total.unwrap_or(done));
        self.bar.set_position(done);
        if self.plain && self.told.elapsed() > REPORT_INTERVAL {
            self.told = std::time::Instant::now();
            let of = total.map_or(String::new(), |total| format!(" of {total}"));
            eprintln!("{}: {done}{of} frames", self.bar.message());
        }
    }

    /// Prints a line beside the bar.
    pub fn line(&self, text: &str) {
        self.bar.suspend(|| eprintln!("{text}"));
    }

    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

/// Progress of a transfer, with rate and time left, on standard error: a bar on a terminal, a line now and then elsewhere.
pub struct Transfer {
    bar: ProgressBar,
    plain: bool,
    told: std::time::Instant,
    /// Time of the first report and the bytes done by then, which do not count towards the rate.
    began: Option<(std::time::Instant, u64)>,
}

impl Transfer {
    pub fn new() -> Self {
        let plain = !io::stderr().is_terminal();
        let bar = ProgressBar::with_draw_target(Some(0), ProgressDrawTarget::stderr());
        if let Ok(style) = ProgressStyle::with_template("{wide_bar} {bytes}/{total_bytes} {bytes_per_sec} {left}") {
            // The time left is unknown until bytes arrive.
            bar.set_style(style.with_key("left", |state: &ProgressState, text: &mut dyn std::fmt::Write| {
                if state.per_sec() >= 1.0 {
                    let _ = write!(text, "{:#} left", HumanDuration(state.eta()));
                }
            }));
        }
        Self { bar, plain, told: std::time::Instant::now(), began: None }
    }

    /// Prints a message beside the bar.
    pub fn say(&self, what: &str) {
        self.bar.suspend(|| say(what));
    }

    pub fn set(&mut self, done: u64, total: u64) {
        let (began, before) = *self.began.get_or_insert_with(|| (std::time::Instant::now(), done));
        self.bar.set_length(total);
        self.bar.set_position(done);
        if self.plain && self.told.elapsed() > REPORT_INTERVAL {
            self.told = std::time::Instant::now();
            let rate = done.saturating_sub(before) as f64 / began.elapsed().as_secs_f64().max(1e-3);
            let left = (rate >= 1.0).then(|| (total.saturating_sub(done)) as f64 / rate);
            let left = left.map_or_else(String::new, |left| format!(", {left:.0} s left"));
            eprintln!("{} of {}, {}/s{left}", size(done), size(total), size(rate as u64));
        }
    }

    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

/// Replaces control characters in a text from elsewhere, so that it moves no cursor and changes no colour.
pub fn without_control_characters(text: &str) -> String {
    text.chars().map(|c| if c.is_control() { char::REPLACEMENT_CHARACTER } else { c }).collect()
}

/// A number of bytes with a unit, for people.
pub fn size(bytes: u64) -> String {
    match bytes {
        0..1_000_000 => format!("{:.1} kB", bytes as f64 * 1e-3),
        1_000_000..1_000_000_000 => format!("{:.1} MB", bytes as f64 * 1e-6),
        _ => format!("{:.2} GB", bytes as f64 * 1e-9),
    }
}

/// Error text when standard output cannot be written, as when its disk is full.
const STDOUT: &str = "standard output cannot be written";

/// Prints one JSON object on one line.
pub fn json<T: Serialize>(value: &T) -> anyhow::Result<()> {
    let mut stdout = io::stdout().lock();
    serde_json::to_writer(&mut stdout, value).context(STDOUT)?;
    writeln!(stdout).context(STDOUT)
}

/// Prints lines for people on standard output.
pub fn lines(text: &str) -> anyhow::Result<()> {
    writeln!(io::stdout().lock(), "{text}").context(STDOUT)
}

/// Prints what was lost, on standard error.
pub fn losses(losses: &[Loss]) {
    for loss in losses {
        say(&loss.to_string());
    }
}

/// Prints a message for people on standard error.
pub fn say(text: &str) {
    eprintln!("realitysim: {}", reword_system_errors(text));
}

/// Common error texts of the operating system, with our wording.
const SYSTEM_WORDING: [(&str, &str); 7] = [
    ("No such file or directory (os error 2)", "there is no such file or folder"),
    ("Permission denied (os error 13)", "its permissions do not allow that"),
    ("Not a directory (os error 20)", "a part of its path is a file, not a folder"),
    ("Is a directory (os error 21)", "it is a folder, and a file is needed"),
    ("No space left on device (os error 28)", "the disk is full"),
    ("Read-only file system (os error 30)", "the disk can only be read"),
    ("File name too long (os error 36)", "its name is longer than any file's can be"),
];

/// Replaces the operating system's wording by ours.
pub fn reword_system_errors(text: &str) -> String {
    SYSTEM_WORDING.iter().fold(text.to_owned(), |text, (theirs, ours)| text.replace(theirs, ours))
}

/// A row of an error table; `None` if nothing was measured.
pub fn row(name: &str, unit: &str, summary: Option<&Summary>) -> String {
    let number = |of: fn(&Summary) -> f64| summary.map_or("-".to_owned(), |summary| format!("{:.2}", of(summary)));
    let [mean, median, p95, max] = [number(|s| s.mean), number(|s| s.median), number(|s| s.p95), number(|s| s.max)];
    format!("  {name:<10} {mean:>8} {median:>8} {p95:>8} {max:>8}  {unit}")
}

/// Whether the reader of standard output has gone, which is no error of the program.
pub fn is_broken_pipe(error: &anyhow::Error) -> bool {
    error.chain().any(|cause| {
        let io = cause.downcast_ref::<io::Error>().map(io::Error::kind);
        let json = cause.downcast_ref::<serde_json::Error>().and_then(serde_json::Error::io_error_kind);
        io.or(json) == Some(io::ErrorKind::BrokenPipe)
    })
}
