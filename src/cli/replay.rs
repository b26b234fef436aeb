//! Command `realitysim replay`: tags every frame of a log or scene.

use std::path::{Path, PathBuf};

use clap::Args;

use super::reference_check::ReferenceArguments;
use super::settings::{SettingsArguments, check_initial, planar_pose};
use super::values::number;
use super::{Outcome, output, paths};
use crate::cli::host_info::cores;
use crate::config::{Settings, load_field};
use crate::geometry::{Field, Pose2};
use crate::log_input::{InputSource, scene_source};
use crate::recording::{read_info, session_holding};
use crate::tagging::{ReplayOptions, ReplayReport, replay, warnings};

/// Most threads; more would only wait for each other.
pub(super) const MAX_THREADS: usize = 64;

/// Tag every frame of a log or scene and write a capture
///
/// LOG is a ROS 2 MCAP file, a folder of them (a bag or a capture) or one segment of a capture; SCENE is a scene file
/// (replay/scenes/*.toml). Makes CAPTURES_DIR/<session>/ and prints its path. Camera bytes are passed through
/// untouched; /camera/pose, /camera/tf, /frame_tag and /diagnostics are added. Ground truth in the log is never read.
///
/// With --check REFERENCE the tags are held to those of an earlier replay of the same log, which --bless wrote: a gate for
/// continuous integration.
///
/// Older rosbag2 .db3 files: convert them first, `pip install rosbags && rosbags-convert --src BAG --dst NEW
/// --dst-storage mcap`.
#[derive(Args)]
#[command(after_long_help = concat!(
    "Examples:",
    "\n  realitysim replay my_bag/ -o captures/ --field kid-2020",
    "\n  realitysim replay walk.mcap --check walk.tags.json",
))]
pub struct ReplayArguments {
    /// A log or a scene
    #[arg(value_name = "LOG|SCENE")]
    source: PathBuf,
    /// Where captures are kept; with --check none is without it
    #[arg(short, long, value_name = "CAPTURES_DIR", required_unless_present = "reference")]
    output: Option<PathBuf>,
    /// Threads for decoding and looking at frames, 1 to 64; without it as many as there are cores. The tags do not
    /// depend on it
    #[arg(long, value_name = "N", value_parser = threads)]
    threads: Option<usize>,
    /// Pose of base_footprint at the first frame, in place of what the log announces; on the field or at most 1 m off
    /// its carpet
    #[arg(long, value_name = "x,y,yaw_deg", value_parser = planar_pose, allow_hyphen_values = true)]
    initial: Option<Pose2>,
    /// Pace by the log's times
    #[arg(long)]
    realtime: bool,
    /// Go on from where the last replay into CAPTURES_DIR ended; invalid until lines confirm it. Not with --check: a
    /// reference is of a log alone, not of what a folder happens to hold
    #[arg(long, conflicts_with = "reference")]
    warm_start: bool,
    /// Exit code 1 unless at least this share of the tags is valid, 0 to 1
    #[arg(long, value_name = "SHARE", value_parser = number(0.0..=1.0))]
    require_valid: Option<f64>,
    #[command(flatten)]
    gate: ReferenceArguments,
    #[command(flatten)]
    settings: SettingsArguments,
}

pub fn run(arguments: &ReplayArguments, json: bool) -> anyhow::Result<Outcome> {
    let named = arguments.settings.files();
    let inputs: Vec<&Path> = named.iter().map(PathBuf::as_path).chain([arguments.source.as_path()]).collect();
    arguments.gate.check_outputs(&inputs)?;
    let outcome = replay_and_report(arguments, json);
    outcome.inspect_err(|error| arguments.gate.write_failure(error))
}

fn replay_and_report(arguments: &ReplayArguments, json: bool) -> anyhow::Result<Outcome> {
    let cores = cores().min(MAX_THREADS);
    let settings = arguments.settings.resolve_for(&arguments.source)?;
    if let Some(initial) = &arguments.initial {
        let (name, field) = source_field(&arguments.source, &settings)?;
        check_initial(initial, &name, &field)?;
    }
    let gate = arguments.gate.open()?;
    let assumed_field = assumed_field(arguments, &settings);
    // A temporary folder is removed when this goes out of scope.
    let mut temporary = None;
    let captures = match &arguments.output {
        Some(folder) => folder.clone(),
        None => temporary.insert(paths::temporary()?).path().to_owned(),
    };
    let options = ReplayOptions {
        source: arguments.source.clone(),
        captures,
        settings,
        initial: arguments.initial,
        threads: arguments.threads.unwrap_or(cores),
        realtime: arguments.realtime,
        warm_start: arguments.warm_start,
    };
    let mut progress = output::Progress::new("tagging");
    let mut report = replay(&options, &mut |done, total| progress.set(done, total))?;
    progress.finish();
    report.warnings.splice(0..0, assumed_field);
    print_problems(&report);
    if let Some(gate) = gate {
        let judged = gate.judge(&arguments.source, &report, arguments.initial, json)?;
        let own = outcome(&report, arguments.require_valid);
        return Ok(if judged == Outcome::Whole { own } else { judged });
    }
    if json {
        output::json(&report)?
    } else {
        output::lines(&for_people(&report))?
    }
    if !json && let Some((reason, count, frame)) = main_reason(&report) {
        eprintln!(
            "realitysim: {count} of {} tags are invalid as {reason}: `realitysim explain {} --frame {frame}`, with the same settings, shows why",
            report.tagged,
            arguments.source.display()
        );
    }
    Ok(outcome(&report, arguments.require_valid))
}

/// If more than one tag in this many is invalid, the program points at `realitysim explain`.
const MANY_INVALID_DIVISOR: u64 = 5;

/// Outcome of a replay; without a valid tag, or with too few of them, its goal is not reached.
fn outcome(report: &ReplayReport, required: Option<f64>) -> Outcome {
    let share = report.valid as f64 / report.tagged.max(1) as f64;
    let too_few = required.filter(|required| share < *required);
    if let Some(required) = too_few {
        let [percent, required] = [share, required].map(|share| 100.0 * share);
        output::say(&format!("{percent:.1} % of the tags are valid, and --require-valid asks for {required:.1} %"));
    }
    match (report.is_in_vain() || too_few.is_some(), report.data_was_lost()) {
        (true, _) => Outcome::NotReached,
        (false, true) => Outcome::DataLost,
        (false, false) => Outcome::Whole,
    }
}

fn threads(text: &str) -> Result<usize, String> {
    let threads = text.parse().ok().filter(|threads| (1..=MAX_THREADS).contains(threads));
    threads.ok_or_else(|| format!("it must be 1 to {MAX_THREADS}"))
}

/// The source's field and its name: a scene has its own.
pub(super) fn source_field(source: &Path, settings: &Settings) -> anyhow::Result<(String, Field)> {
    let (name, dimensions) = match InputSource::of(source) {
        InputSource::Scene => {
            let name = scene_source::load(source)?.file().scene.field.clone();
            let dimensions = load_field(&name)?;
            (name, dimensions)
        }
        InputSource::Log => (settings.field.clone(), settings.field_dimensions()?),
    };
    Ok((name, Field::new(dimensions)?))
}

/// The warning of a replay whose field nobody named; `None` if somebody did, or if the capture that is replayed was
/// recorded on the same field.
///
/// A scene names its field itself.
fn assumed_field(arguments: &ReplayArguments, settings: &Settings) -> Option<String> {
    if arguments.settings.names_field() || InputSource::is_scene(&arguments.source) {
        return None;
    }
    let dimensions = settings.field_dimensions().ok()?;
    let capture = session_holding(&arguments.source).and_then(|session| read_info(&session).ok());
    if capture.as_ref().is_some_and(|info| info.field.is_same_as(&dimensions)) {
        return None;
    }
    let recorded_on = capture.as_ref().map(|info| (info.settings.field.as_str(), &info.field));
    Some(warnings::assumed_field(&settings.field, &dimensions, recorded_on))
}

pub fn for_people(report: &ReplayReport) -> String {
    let ReplayReport { session, frames, tagged, valid, particles, iterations, threads, filter_ms, wall_s, .. } = report;
    let up_to = if report.adaptive { "up to " } else { "" };
    let capped = if report.capped > 0 { format!(", {} frames cut short", report.capped) } else { String::new() };
    let mut text = format!(
        "{frames} frames, {tagged} tagged, {valid} valid in {wall_s:.1} s\n\
         {up_to}{particles} particles x {iterations} iterations, image to tag: p50 {:.1} ms, p99 {:.1} ms, max {:.1} ms \
         ({threads} threads{capped})\n",
        filter_ms.p50, filter_ms.p99, filter_ms.max
    );
    if !report.read.is_empty() {
        let topics: Vec<String> = report.read.iter().map(ToString::to_string).collect();
        text.push_str(&format!("read: {}\n", topics.join(", ")));
    }
    if report.thinned > 0 {
        text.push_str(&format!("{} more frames tagged and not written, as recording.thinning asks\n", report.thinned));
    }
    if !report.invalid.is_empty() {
        text.push_str(&format!("invalid: {}\n", reasons(report)));
    }
    if report.predicted > 0 {
        text.push_str(&format!("{} poses predicted while there were no frames\n", report.predicted));
    }
    match report.warnings.len() {
        0 => {}
        1 => text.push_str("1 warning, on standard error\n"),
        warnings => text.push_str(&format!("{warnings} warnings, on standard error\n")),
    }
    text.push_str(&session.display().to_string());
    text
}

/// Most frequent reason for invalid tags, its count and its first frame, if many tags are invalid.
fn main_reason(report: &ReplayReport) -> Option<(&str, u64, u64)> {
    let invalid: u64 = report.invalid.values().sum();
    let (reason, count) = report.invalid.iter().max_by_key(|(_, count)| **count)?;
    (MANY_INVALID_DIVISOR * invalid > report.tagged)
        .then(|| (reason.as_str(), *count, report.first_invalid.get(reason).copied().unwrap_or(0)))
}

/// Reasons for invalid tags with their counts, the most frequent first.
fn reasons(report: &ReplayReport) -> String {
    let mut reasons: Vec<(&String, &u64)> = report.invalid.iter().collect();
    reasons.sort_by_key(|(_, count)| std::cmp::Reverse(**count));
    let reasons: Vec<String> = reasons.into_iter().map(|(reason, count)| format!("{count} {reason}")).collect();
    reasons.join(", ")
}

/// Prints warnings and losses on standard error.
fn print_problems(report: &ReplayReport) {
    if report.is_in_vain() {
        eprintln!("realitysim: none of the {} tags is valid: {}", report.tagged, reasons(report));
    }
    for warning in &report.warnings {
        eprintln!("realitysim: warning: {warning}");
    }
    output::losses(&report.lost);
    for damage in &report.damage {
        eprintln!("realitysim: {} is {damage}; the rest was replayed", damage.file.display());
    }
    if report.bad_messages > 0 {
        eprintln!(
            "realitysim: {} messages are not what their type says; they were recorded as they are",
            report.bad_messages
        );
    }
    if report.late_measurements > 0 {
        eprintln!(
            "realitysim: {} measurements came more than a second after later ones: recorded, but not used",
            report.late_measurements
        );
    }
    if let Some(image) = &report.first_bad_image {
        eprintln!("realitysim: {image} (first of its kind; such frames are tagged invalid)");
    }
    for (cause, count) in &report.untagged {
        eprintln!(
            "realitysim: {count} frames do not even say when they were exposed: recorded without a tag ({cause})"
        );
    }
}
