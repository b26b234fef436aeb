//! Command `realitysim job`: does one step with each session of a folder, as a part of the work of many machines.

mod pool;
mod report;
mod result_folder;
mod shard;
mod step;

use std::path::{Path, PathBuf};

use anyhow::ensure;
use clap::{Args, ValueEnum};

use super::Outcome;
use super::host_info::cores;
use super::labels::Format;
use super::paths::{check_output, make_folder};
use super::replay::MAX_THREADS;
use super::sessions_where::{Chosen, WhereArguments};
use super::settings::UsageError;
use super::values::whole;
use crate::recording::sessions::session_at;
use crate::recording::sessions_of;
use crate::recording::storage::Disk;
use report::Report;
use shard::{Shard, parse_shard};
use step::{Step, TagSettings};

/// Do one step with each session of a folder, once
///
/// Each session has a result of its own in DIR/STEP, a folder that is named by the session and by a hash of its recording, of this
/// program's version and of the settings. A result that is there is not made again; one that is not whole has no name. So a job that was
/// killed goes on if it is started again, and the same call on many machines, each with a shard of its own, does the whole folder. The
/// recordings are only read.
///
/// tag: tags.mcap, all tags made anew. refine: refined/, to be copied into the capture. labels: what `realitysim labels` writes. depth: images/, a
/// database of the session alone with the walls of its hall. check: segments against the hashes in their manifest, and how many tags are valid. docs/howto/league.md has job files for Slurm and Kubernetes.
///
/// Exit code 1 if a session failed, which is named, and the others are done; 3 if all are done, but data was lost.
#[derive(Args)]
#[command(after_long_help = concat!(
    "Examples:",
    "\n  realitysim job captures/ --step refine -o results/",
    "\n  realitysim job captures/ --step labels --format yolo --shard 3/16 -o results/",
    "\n  realitysim job catalogue/ --step check -o results/",
))]
pub struct JobArguments {
    /// Folder with captures, or a catalogue of them
    captures: PathBuf,
    /// What is done with each session
    #[arg(long)]
    step: StepName,
    /// The part of the sessions that is done here: I of N, from 1/N to N/N. A session's name alone tells to which part it belongs
    #[arg(long, value_name = "I/N", default_value = "1/1", value_parser = parse_shard)]
    shard: Shard,
    #[command(flatten)]
    condition: WhereArguments,
    /// Folder of the results
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Sessions at a time; without it as many as there are cores
    #[arg(long, value_name = "N", value_parser = whole(1..=MAX_THREADS))]
    workers: Option<usize>,
    /// Of tag: a robot config in place of the settings that each session was recorded with
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Of labels: form of the labels [default: coco]
    #[arg(long)]
    format: Option<Format>,
}

#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
enum StepName {
    Tag,
    Refine,
    Labels,
    Depth,
    Check,
}

pub fn run(arguments: &JobArguments, json: bool) -> anyhow::Result<Outcome> {
    let JobArguments { captures, shard, output, workers, .. } = arguments;
    let step = step(arguments)?;
    check_output(output, &[captures])?;
    let (all, sessions) = sessions(captures, *shard, &arguments.condition.chosen(captures)?)?;
    let results = output.join(step.name());
    make_folder(&results)?;
    let workers = workers.unwrap_or_else(|| cores().min(MAX_THREADS));
    let units = pool::run_all(&step, &sessions, &results, workers);
    let report = Report { step: step.name(), shard: shard.to_string(), sessions: all, results, units };
    report.print(json)?;
    Ok(report.outcome())
}

fn step(arguments: &JobArguments) -> anyhow::Result<Step> {
    let JobArguments { step, config, format, .. } = arguments;
    let refused = |what: &str| Err(UsageError(what.to_owned()).into());
    match (step, config, format) {
        (StepName::Refine | StepName::Labels | StepName::Depth | StepName::Check, Some(_), _) => {
            refused("--config is for --step tag: the other steps go by the settings of each session")
        }
        (StepName::Tag | StepName::Refine | StepName::Depth | StepName::Check, _, Some(_)) => {
            refused("--format is for --step labels")
        }
        (StepName::Tag, config, _) => {
            Ok(Step::Tag(config.as_deref().map(TagSettings::load).transpose()?.map(Box::new)))
        }
        (StepName::Refine, ..) => Ok(Step::Refine),
        (StepName::Labels, _, format) => Ok(Step::Labels(format.unwrap_or(Format::Coco))),
        (StepName::Depth, ..) => Ok(Step::Depth),
        (StepName::Check, ..) => Ok(Step::Check),
    }
}

/// The number of all sessions in a folder, and those of a shard by name. Only chosen ones count.
fn sessions(captures: &Path, shard: Shard, chosen: &Chosen) -> anyhow::Result<(usize, Vec<PathBuf>)> {
    let mut sessions = sessions_of(&Disk, captures);
    if sessions.is_empty() {
        sessions = captures_of_catalogue(captures)?;
    }
    ensure!(
        !sessions.is_empty(),
        "{}: holds no capture: name the folder that `realitysim record`, `replay` or `sync` writes captures into, or a catalogue of them",
        captures.display()
    );
    chosen.keep(&mut sessions, |session| Some(session_at(session).ok()?.id));
    let all = sessions.len();
    sessions.retain(|session| shard.has(&session_name(session)));
    sessions.sort();
    Ok((all, sessions))
}

/// The captures that a catalogue in a folder has rows of; none if there is no catalogue.
#[cfg(feature = "catalogue")]
fn captures_of_catalogue(folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    if !crate::catalogue::is_catalogue(folder) {
        return Ok(Vec::new());
    }
    Ok(crate::catalogue::captures_in(folder)?)
}

/// Without the feature no catalogue can be read.
#[cfg(not(feature = "catalogue"))]
fn captures_of_catalogue(_folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    Ok(Vec::new())
}

/// The name of a session's folder.
fn session_name(session: &Path) -> String {
    // A path such as `.` has no name of its own.
    let path = session.canonicalize().unwrap_or_else(|_| session.to_owned());
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}
