//! What views and their database cost: `cargo bench --bench views`. `-- --quick` takes seconds, `-- --write docs/explanation/views.md` puts the
//! tables between that document's marks.
//!
//! OpenCV's `remap` does the same map in the same run, taking turns, if `REALITYSIM_PYTHON` names an interpreter that has it
//! (`opencv-python-headless`): times differ from machine to machine, and with what else it does; their ratio does not.

mod database;
mod opencv;
mod scale;
mod setting;
mod speed;

use std::fmt::Write;
use std::path::PathBuf;

/// Times in milliseconds, sorted.
pub struct Times(Vec<f64>);

impl Times {
    pub fn of(mut times: Vec<f64>) -> Self {
        times.sort_by(f64::total_cmp);
        Self(times)
    }

    pub fn at(&self, share: f64) -> f64 {
        self.0[((self.0.len() - 1) as f64 * share).round() as usize]
    }
}

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    let quick = arguments.iter().any(|argument| argument == "--quick");
    let write = arguments
        .iter()
        .position(|argument| argument == "--write")
        .and_then(|at| arguments.get(at + 1))
        .map(PathBuf::from);
    let rounds = if quick { 20 } else { 300 };
    let mut text = String::new();
    scale::run(quick, &mut text);
    let _ = writeln!(text);
    speed::run(rounds, &mut text);
    let _ = writeln!(text);
    database::run(rounds, &mut text);
    print!("{text}");
    if let Some(path) = write {
        let document = std::fs::read_to_string(&path).expect("the document");
        let marks = ["<!-- begin: bench views -->", "<!-- end: bench views -->"];
        let [begin, end] = marks.map(|mark| document.find(mark).expect("a mark"));
        let whole = format!("{}\n\n{}\n\n{}", &document[..begin + marks[0].len()], text.trim(), &document[end..]);
        std::fs::write(path, whole).expect("written");
    }
}
