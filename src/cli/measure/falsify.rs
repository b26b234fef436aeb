//! Command `realitysim measure falsify`: counts valid tags under false assumptions.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, mpsc};
use std::thread;

use clap::Args;
use serde::Serialize;

use crate::cli::doc_section::Section;
use crate::cli::host_info::cores;
use crate::cli::settings::{SettingsArguments, UsageError};
use crate::cli::values::{above_zero, whole};
use crate::cli::{Outcome, output};
use crate::config::Settings;
use crate::evaluation::capture::{EvaluationError, read_truth};
use crate::evaluation::contrast::WRONG_CM;
use crate::evaluation::falsify::{Control, Falsehood, falsehoods};
use crate::evaluation::truth;
use crate::geometry::Isometry;
use crate::log_input::{InputSource, scene_source};
use crate::recording::ReadoutError;
use crate::tagging::{FrameCache, FrameCacheOptions};

/// Find out whether tags can be wrong and valid
///
/// Tags the frames of each log or scene while something false is said of them: the robot walks on another field (each that is
/// shipped), its lens has another focal length, its camera stands higher or lower; or with pictures that are shifted, scaled,
/// turned, scrambled or noise. Each is tried with the start that the log announces, and without. Counts the tags that are valid
/// and more than 12 cm off the log's ground truth: there should be none, and exit code 1 says that there are. The first line
/// says what the truth gives.
#[derive(Args)]
#[command(after_long_help = "Example:\n  realitysim measure falsify my_bag/ replay/scenes/loop.toml --field kid-2020")]
pub struct FalsifyArguments {
    /// Logs or scenes, as for replay; a log needs ground truth
    #[arg(value_name = "LOG|SCENE", required = true)]
    sources: Vec<PathBuf>,
    /// Use only the first seconds of each
    #[arg(long = "for", value_name = "S", value_parser = above_zero, allow_negative_numbers = true)]
    for_s: Option<f64>,
    /// How many falsehoods are tried at once; as many as the machine has processors if nothing is said
    #[arg(long, value_name = "N", value_parser = whole(1..=64u64))]
    threads: Option<u64>,
    /// Put the table into a document, between its marks <!-- begin: realitysim measure falsify --> and <!-- end: realitysim measure falsify -->
    #[arg(long, value_name = "FILE")]
    write_docs: Option<PathBuf>,
    #[command(flatten)]
    settings: SettingsArguments,
}

#[derive(Serialize)]
struct Report {
    sources: Vec<Source>,
    wrong_cm: f64,
    /// Sums over all falsehoods.
    frames: usize,
    valid: usize,
    wrong: usize,
}

#[derive(Serialize)]
struct Source {
    source: String,
    /// Frames of the walk.
    frames: usize,
    controls: Vec<Control>,
}

pub fn run(arguments: &FalsifyArguments, json: bool) -> anyhow::Result<Outcome> {
    let settings = arguments.settings.resolve()?;
    let section = arguments.write_docs.as_deref().map(|path| Section::open(path, "measure falsify")).transpose()?;
    let threads = match arguments.threads {
        Some(threads) => threads as usize,
        None => cores(),
    };
    let mut sources = Vec::new();
    for source in &arguments.sources {
        sources.push(controls(arguments, source, &settings, threads)?);
    }
    let report = Report::of(sources);
    if let Some(section) = &section {
        section.write(&report.markdown(arguments))?;
    }
    if json {
        output::json(&report)?;
    } else {
        output::lines(&report.for_people())?;
    }
    Ok(if report.wrong > 0 { Outcome::NotReached } else { Outcome::Whole })
}

fn controls(arguments: &FalsifyArguments, path: &Path, settings: &Settings, threads: usize) -> anyhow::Result<Source> {
    let options = FrameCacheOptions {
        source: path.to_owned(),
        settings: settings.clone(),
        initial: None,
        from_s: 0.0,
        for_s: arguments.for_s,
    };
    let truth = truth_of(path, settings)?;
    let cache = FrameCache::load(&options, &mut |_, _| {})?;
    let falsehoods = falsehoods(cache.field(), cache.lens());
    let tasks: Vec<(&Falsehood, bool)> =
        [false, true].iter().flat_map(|unknown| falsehoods.iter().map(|said| (said, *unknown))).collect();
    let source = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
    let mut progress = output::Progress::new("tagging");
    let total = (tasks.len() * cache.frames()) as u64;
    let (next, found) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    let (say, heard) = mpsc::channel();
    thread::scope(|scope| {
        for _ in 0..threads.min(tasks.len()) {
            let say = say.clone();
            let (tasks, next, found, cache, truth) = (&tasks, &next, &found, &cache, &truth);
            scope.spawn(move || {
                loop {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    let Some((said, unknown)) = tasks.get(index) else { return };
                    // The receiver may be gone; the frames are tagged all the same.
                    let run = said.tag(cache, cache.settings(), *unknown, &mut |_| {
                        let _ = say.send(());
                    });
                    let control = run.map(|run| Control::of(said, *unknown, &run, truth));
                    found.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).push((index, control));
                }
            });
        }
        drop(say);
        heard.iter().enumerate().for_each(|(done, ())| progress.set(done as u64 + 1, Some(total)));
    });
    progress.finish();
    let mut found = found.into_inner().unwrap_or_else(|poisoned| poisoned.into_inner());
    found.sort_by_key(|(index, _)| *index);
    let controls = found.into_iter().map(|(_, control)| control).collect::<Result<Vec<_>, _>>()?;
    Ok(Source { source, frames: cache.frames(), controls })
}

fn truth_of(path: &Path, settings: &Settings) -> anyhow::Result<Vec<(i64, Isometry)>> {
    if InputSource::is_scene(path) {
        return Ok(truth::of_scene(&scene_source::load(path)?));
    }
    match read_truth(path, &settings.topics.ground_truth) {
        Err(EvaluationError::Readout(ReadoutError::NoMessages { .. })) => Err(UsageError(format!(
            "{}: it has no ground truth on {}, against which valid tags could be judged; a scene has one",
            path.display(),
            settings.topics.ground_truth
        ))
        .into()),
        truth => Ok(truth?.found),
    }
}

impl Report {
    fn of(sources: Vec<Source>) -> Self {
        let (mut frames, mut valid, mut wrong) = (0, 0, 0);
        for control in sources.iter().flat_map(|source| &source.controls).filter(|control| !control.is_true) {
            frames += control.frames;
            valid += control.valid;
            wrong += control.wrong;
        }
        Self { sources, wrong_cm: WRONG_CM, frames, valid, wrong }
    }

    fn summary(&self) -> String {
        let Self { frames, valid, wrong, .. } = self;
        format!("something false said of {frames} frames: {valid} valid tags, {wrong} of them more than 12 cm off")
    }

    fn for_people(&self) -> String {
        let mut text = String::new();
        for Source { source, frames, controls } in &self.sources {
            text.push_str(&format!(
                "{source}, {frames} frames\n{:<34} {:>7} {:>7} {:>9}   start unknown {:>7} {:>7} {:>9}\n",
                "what is said", "valid", "wrong", "max, cm", "valid", "wrong", "max, cm"
            ));
            for (told, untold) in pairs(controls) {
                let cells = |c: &Control| format!("{:>7} {:>7} {:>9}", c.valid, c.wrong, largest(c));
                text.push_str(&format!("{:<34} {}                 {}\n", told.said, cells(told), cells(untold)));
            }
        }
        text + &self.summary()
    }

    /// Table with a row for each walk, counting the valid and wrong tags of its falsehoods.
    fn markdown(&self, arguments: &FalsifyArguments) -> String {
        let mut words: Vec<String> = arguments.sources.iter().map(|source| source.display().to_string()).collect();
        words.extend(arguments.for_s.map(|seconds| format!("--for {seconds}")));
        let mut text = format!(
            "    realitysim measure falsify {} --write-docs docs/explanation/lines.md\n\n| walk | frames | falsehoods | frames in all | valid | wrong |\n\
             | --- | --- | --- | --- | --- | --- |\n",
            words.join(" ")
        );
        for Source { source, frames, controls } in &self.sources {
            let false_ones: Vec<&Control> = controls.iter().filter(|control| !control.is_true).collect();
            let sum = |of: &dyn Fn(&Control) -> usize| false_ones.iter().map(|control| of(control)).sum::<usize>();
            text.push_str(&format!(
                "| `{source}` | {frames} | {} | {} | {} | {} |\n",
                false_ones.len(),
                sum(&|control| control.frames),
                sum(&|control| control.valid),
                sum(&|control| control.wrong)
            ));
        }
        let Self { frames, valid, wrong, .. } = self;
        let falsehoods: usize = self.sources.iter().map(|s| s.controls.iter().filter(|c| !c.is_true).count()).sum();
        text + &format!("| all | | {falsehoods} | {frames} | {valid} | {wrong} |")
    }
}

/// Pairs the result with the announced start and that without it, for each statement.
fn pairs(controls: &[Control]) -> impl Iterator<Item = (&Control, &Control)> {
    let (told, untold) = controls.split_at(controls.len() / 2);
    told.iter().zip(untold)
}

fn largest(control: &Control) -> String {
    if control.valid > 0 { format!("{:.1}", control.max_cm) } else { "-".to_owned() }
}
