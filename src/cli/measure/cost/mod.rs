//! Command `realitysim measure cost`: measures what accuracy costs in time, and recommends settings.

mod files;
mod report;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;

use crate::cli::doc_section::Section;
use crate::cli::settings::{SettingsArguments, check_initial, planar_pose};
use crate::cli::values::{above_zero, whole};
use crate::cli::{Outcome, host_info, output, paths};
use crate::config::{MIN_BUDGET_MS, Settings};
use crate::evaluation::capture::{EvaluationError, read_truth};
use crate::evaluation::compare::truth_at;
use crate::evaluation::cost::{self, Requirements, SweepPoint};
use crate::evaluation::truth;
use crate::geometry::{Isometry, Pose2};
use crate::log_input::{InputSource, scene_source};
use crate::recording::ReadoutError;
use crate::tagging::{FrameCache, FrameCacheOptions, Trial};
use crate::vision::automatic_reduction;
use report::{Report, TruthSource};

/// Find out what accuracy costs in time, and which settings to use
///
/// Tries about 40 settings (model, particles, iterations, line points, image scale, refinement) on the same frames of a log
/// or scene, with several seeds and in one thread, from the decoded image to the tag as in a replay. Times are p50 and p99,
/// errors those of valid tags against the log's ground truth, or against a long reference run if it has none.
///
/// Recommends the cheapest settings within noise of the best under --budget-ms, or the cheapest that reach --accuracy-cm,
/// and writes cost.csv, cost.svg and cost.toml, which --config of other commands takes. Exit code 1 when nothing that was
/// asked for can be had. Measure on a machine that does nothing else.
#[derive(Args)]
#[command(after_long_help = "Example:\n  realitysim measure cost my_bag/ --budget-ms 8 --field kid-2020")]
pub struct CostArguments {
    /// A log or a scene, as for replay
    #[arg(value_name = "LOG|SCENE")]
    source: PathBuf,
    /// A frame may take this long (p99); 8 if neither this nor --accuracy-cm is given
    #[arg(long, value_name = "MS", value_parser = above_zero, allow_negative_numbers = true)]
    budget_ms: Option<f64>,
    /// The mean position error that is good enough
    #[arg(long, value_name = "CM", value_parser = above_zero, allow_negative_numbers = true)]
    accuracy_cm: Option<f64>,
    /// Where cost.csv, cost.svg and cost.toml go
    #[arg(short, long, value_name = "DIR", default_value = "cost")]
    output: PathBuf,
    /// Leave out this many seconds at the start; they are tracked, not measured
    #[arg(long = "from", value_name = "S", default_value_t = 0.0, value_parser = not_below_zero, allow_negative_numbers = true)]
    from_s: f64,
    /// Use this many seconds; without it, and at most, 300 frames
    #[arg(long = "for", value_name = "S", value_parser = above_zero, allow_negative_numbers = true)]
    for_s: Option<f64>,
    /// Seeds that every setting is tried with
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = whole(1..=20u64))]
    seeds: u64,
    /// A log with the true poses, if they are not in LOG itself
    #[arg(long, value_name = "LOG")]
    truth: Option<PathBuf>,
    /// Pose of base_footprint at the first frame, in place of what the log announces
    #[arg(long, value_name = "x,y,yaw_deg", value_parser = planar_pose, allow_hyphen_values = true)]
    initial: Option<Pose2>,
    /// Put the front into a document, between its marks <!-- begin: realitysim measure cost --> and <!-- end: realitysim measure cost -->
    #[arg(long, value_name = "FILE")]
    write_docs: Option<PathBuf>,
    #[command(flatten)]
    settings: SettingsArguments,
}

const DEFAULT_BUDGET_MS: f64 = 8.0;

pub fn run(arguments: &CostArguments, json: bool) -> anyhow::Result<Outcome> {
    let started = Instant::now();
    let configured = arguments.settings.resolve()?;
    let section = arguments.write_docs.as_deref().map(|path| Section::open(path, "measure cost")).transpose()?;
    let named = arguments.settings.files();
    let inputs = named.iter().chain([&arguments.source]).chain(&arguments.truth).map(PathBuf::as_path);
    paths::check_output(&arguments.output, &inputs.collect::<Vec<_>>())?;
    paths::make_folder(&arguments.output)?;
    let requirements = match (arguments.budget_ms, arguments.accuracy_cm) {
        (None, None) => Requirements { budget_ms: Some(DEFAULT_BUDGET_MS), accuracy_cm: None },
        (budget_ms, accuracy_cm) => Requirements { budget_ms, accuracy_cm },
    };
    let options = FrameCacheOptions {
        source: arguments.source.clone(),
        settings: configured.clone(),
        initial: arguments.initial,
        from_s: arguments.from_s,
        for_s: arguments.for_s,
    };
    let mut progress = output::Progress::new("reading");
    let cache = FrameCache::load(&options, &mut |done, total| progress.set(done, total))?;
    progress.finish();
    if let Some(initial) = &arguments.initial {
        check_initial(initial, &cache.settings().field, cache.field())?;
    }
    let known = known_truth(arguments, &configured)?;

    let mut trials = Trials::new(&cache, arguments.seeds);
    let (truth_source, truth) = trials.truth_source(known)?;
    let mut rows = trials.sweep(&truth)?;
    if let Some(budget_ms) =
        requirements.budget_ms.filter(|asked| *asked >= MIN_BUDGET_MS && cost::is_exceeded(&rows, *asked))
    {
        rows.extend(trials.sweep_capped(&rows, budget_ms, &truth)?);
        rows.sort_by(|a, b| a.p99_ms.total_cmp(&b.p99_ms));
    }
    let busy = trials.finish();

    let seeds = arguments.seeds as usize;
    let noise_cm = cost::noise_cm(&rows, seeds);
    let advice = cost::advise(&rows, noise_cm, &requirements);
    let Some(advice) = advice else {
        anyhow::bail!(
            "{}: no setting gave a valid tag that could be judged on these {} frames ({}): nothing to compare",
            arguments.source.display(),
            cache.frames(),
            trials.reasons()
        );
    };
    let report = Report {
        source: name_of(&arguments.source),
        frames: cache.frames(),
        is_cut: cache.is_cut(),
        truth_source,
        frames_judged: cache.stamps_ns().filter(|stamp_ns| truth_at(&truth, *stamp_ns).is_some()).count(),
        seeds,
        automatic_reduction: trials.automatic,
        configured: SweepPoint::of(&configured),
        rows,
        noise_cm,
        requirements,
        advice,
        machine: host_info::describe(configured.filter.simd),
        command: command(),
        warnings: busy.into_iter().collect(),
        losses: cache.losses().to_vec(),
        wall_s: started.elapsed().as_secs_f64(),
        output: arguments.output.clone(),
    };
    files::write(&report, &configured)?;
    if let Some(section) = &section {
        paths::write(&section.beside("cost.svg"), &report.chart())?;
        section.write(&report.markdown())?;
    }
    output::losses(&report.losses);
    report.warnings.iter().for_each(|warning| eprintln!("realitysim: {warning}"));
    if json {
        output::json(&report.as_json())?;
    } else {
        output::lines(&report.for_people())?;
    }
    Ok(if report.advice.fails() { Outcome::NotReached } else { Outcome::of(&report.losses) })
}

/// Returns the true poses of the source, or of the log named for them; an empty list if there are none.
fn known_truth(arguments: &CostArguments, settings: &Settings) -> anyhow::Result<Vec<(i64, Isometry)>> {
    let topic = &settings.topics.ground_truth;
    if let Some(log) = &arguments.truth {
        return Ok(read_truth(log, topic)?.found);
    }
    if InputSource::is_scene(&arguments.source) {
        return Ok(truth::of_scene(&scene_source::load(&arguments.source)?));
    }
    match read_truth(&arguments.source, topic) {
        Err(EvaluationError::Readout(ReadoutError::NoMessages { .. })) => Ok(Vec::new()),
        truth => Ok(truth?.found),
    }
}

/// A sweep under way: the frames, the settings to try on them, and its progress.
struct Trials<'a> {
    cache: &'a FrameCache,
    plan: Vec<SweepPoint>,
    seeds: Vec<u64>,
    automatic: usize,
    progress: output::Progress,
    done: u64,
    total: u64,
    /// Counts of the reasons for invalid tags.
    reasons: BTreeMap<String, u64>,
    started: Instant,
    waited_s: Option<f64>,
}

impl<'a> Trials<'a> {
    fn new(cache: &'a FrameCache, seeds: u64) -> Self {
        let settings = cache.settings();
        let automatic = automatic_reduction(cache.lens());
        let plan = cost::plan(SweepPoint::of(settings), automatic);
        Self {
            total: plan.len() as u64 * seeds * cache.frames() as u64,
            seeds: (0..seeds).map(|index| settings.filter.seed.wrapping_add(index)).collect(),
            cache,
            plan,
            automatic,
            progress: output::Progress::new("sweeping"),
            done: 0,
            reasons: BTreeMap::new(),
            started: Instant::now(),
            waited_s: host_info::waited_s(),
        }
    }

    /// Returns the truth if it covers some of these frames, else the tags of a long run.
    fn truth_source(&mut self, known: Vec<(i64, Isometry)>) -> anyhow::Result<(TruthSource, Vec<(i64, Isometry)>)> {
        if self.cache.stamps_ns().any(|stamp_ns| truth_at(&known, stamp_ns).is_some()) {
            return Ok((TruthSource::GroundTruth, known));
        }
        let reference = cost::reference(SweepPoint::of(self.cache.settings()));
        self.total += self.cache.frames() as u64;
        let run = self.run(&reference, self.seeds.first().copied().unwrap_or_default())?;
        let elsewhere = !known.is_empty();
        Ok((TruthSource::Reference { settings: reference, elsewhere }, cost::as_truth(&run)))
    }

    fn sweep(&mut self, truth: &[(i64, Isometry)]) -> anyhow::Result<Vec<cost::Row>> {
        // The first frames of a process are slower, since they allocate memory that later ones reuse.
        let (plan, seeds) = (self.plan.clone(), self.seeds.clone());
        cost::sweep(&plan, &seeds, truth, &mut |sweep_point, seed| self.run(sweep_point, seed))
    }

    /// Repeats the best rows with the budget in force, so that each frame ends in time. They compete by the number of
    /// frames tagged: a search that takes several frames costs tags, and nothing else keeps the budget.
    fn sweep_capped(
        &mut self,
        rows: &[cost::Row],
        budget_ms: f64,
        truth: &[(i64, Isometry)],
    ) -> anyhow::Result<Vec<cost::Row>> {
        let plan = cost::capped(rows, budget_ms);
        self.total += (plan.len() * self.seeds.len() * self.cache.frames()) as u64;
        let seeds = self.seeds.clone();
        cost::sweep(&plan, &seeds, truth, &mut |sweep_point, seed| self.run(sweep_point, seed))
    }

    fn run(&mut self, sweep_point: &SweepPoint, seed: u64) -> anyhow::Result<Vec<Trial>> {
        let settings = sweep_point.set(self.cache.settings(), seed);
        let Self { progress, done, total, .. } = self;
        let attempts = self.cache.try_out(&settings, &mut |_| {
            *done += 1;
            progress.set(*done, Some(*total));
        })?;
        for attempt in attempts.iter().filter(|attempt| !attempt.tag.valid) {
            *self.reasons.entry(attempt.tag.reason.clone()).or_default() += 1;
        }
        Ok(attempts)
    }

    /// Returns a warning if the machine was too busy for the times to be trusted.
    fn finish(&mut self) -> Option<String> {
        self.progress.finish();
        let waited_s = host_info::waited_s().zip(self.waited_s).map(|(now, before)| now - before);
        host_info::busy_warning(waited_s, self.started.elapsed().as_secs_f64())
    }

    /// The most frequent reasons for invalid tags, at most three.
    fn reasons(&self) -> String {
        let mut reasons: Vec<(&String, &u64)> = self.reasons.iter().collect();
        reasons.sort_by_key(|(_, count)| std::cmp::Reverse(**count));
        let told: Vec<String> = reasons.iter().take(3).map(|(reason, count)| format!("{count} x {reason}")).collect();
        if told.is_empty() { "all are valid, but none has a truth".to_owned() } else { told.join(", ") }
    }
}

/// The command line without the folder of the program.
fn command() -> String {
    let arguments = std::env::args().skip(1);
    std::iter::once("realitysim".to_owned()).chain(arguments).collect::<Vec<_>>().join(" ")
}

fn name_of(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

fn not_below_zero(text: &str) -> Result<f64, String> {
    let value = text.parse::<f64>().ok().filter(|value| value.is_finite() && *value >= 0.0);
    value.ok_or_else(|| "expected 0 or a number above".to_owned())
}
