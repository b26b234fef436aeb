//! Command `realitysim check`: judges the tags of a suite of logs and scenes against limits.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;

use super::junit::{self, TestCase};
use super::values::whole;
use super::{Outcome, output, paths};
use crate::cli::host_info::cores;
use crate::evaluation::Summary;
use crate::evaluation::reference::Difference;
use crate::evaluation::suite::{self, Broken, CaseReport, LOWER_LIMITS, Options, Suite, Watcher};

/// Run a suite of logs and scenes and hold their tags to limits
///
/// SUITE is a TOML file (replay/shelf.toml is one): cases, each a log or a scene, with limits for position, angles, share
/// of valid tags, recovery, and time. Cases run side by side; those with a limit of time run once more afterwards, alone, and
/// their time is stated as a ratio to a fixed loop, so that it holds on other machines.
///
/// Exit code 1 when a limit is broken or a case cannot be run; each is named. Exit code 3 when all limits are kept, but a log
/// is damaged or incomplete.
#[derive(Args)]
#[command(after_long_help = "Example:\n  realitysim check suite.toml --junit report.xml")]
pub struct CheckArguments {
    /// A suite file
    suite: PathBuf,
    /// Cases at a time; without it as many as there are cores
    #[arg(short, long, value_name = "N", value_parser = whole(1..=64u16))]
    jobs: Option<u16>,
    /// Only cases whose name has this in it; can be given several times
    #[arg(long, value_name = "TEXT")]
    only: Vec<String>,
    /// Keep the captures there, numbered as the cases; without it they are removed
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Write what CI servers show: a test for each case
    #[arg(long, value_name = "FILE")]
    junit: Option<PathBuf>,
}

#[derive(Serialize)]
struct Report {
    passed: bool,
    cases: Vec<CaseReport>,
    wall_s: f64,
}

pub fn run(arguments: &CheckArguments, json: bool) -> anyhow::Result<Outcome> {
    let suite = Suite::load(&arguments.suite);
    for output in arguments.junit.iter().chain(&arguments.output) {
        paths::check_output(output, &[&arguments.suite])?;
    }
    arguments.junit.as_deref().map_or(Ok(()), junit::check_folder)?;
    let outcome = suite.map_err(anyhow::Error::from).and_then(|suite| run_suite(arguments, suite, json));
    if let (Some(junit), Err(error)) = (&arguments.junit, &outcome) {
        junit::write_failure(junit, JUNIT_NAME, error);
    }
    outcome
}

const JUNIT_NAME: &str = "realitysim check";

fn run_suite(arguments: &CheckArguments, mut suite: Suite, json: bool) -> anyhow::Result<Outcome> {
    let started = std::time::Instant::now();
    if !arguments.only.is_empty() {
        suite.cases.retain(|case| arguments.only.iter().any(|text| case.name.contains(text)));
        if suite.cases.is_empty() {
            let wanted = arguments.only.join(", ");
            let message = format!("--only {wanted}: no case of {} has that in its name", arguments.suite.display());
            return Err(super::settings::UsageError(message).into());
        }
    }
    // A temporary folder is removed when this goes out of scope.
    let mut temporary = None;
    let captures = match &arguments.output {
        Some(folder) => {
            paths::make_folder(folder)?;
            folder.clone()
        }
        None => temporary.insert(paths::temporary()?).path().to_owned(),
    };
    let cores = cores();
    let options = Options { captures, jobs: arguments.jobs.map_or(cores, usize::from) };
    let mut cases = suite::run(&suite, &options, &ProgressPrinter);
    if temporary.is_some() {
        cases.iter_mut().for_each(|case| case.capture = None);
    }
    let passed = cases.iter().all(CaseReport::passed);
    let kept = cases.iter().all(|case| case.outcome == suite::Outcome::Kept);
    if let Some(path) = &arguments.junit {
        let tests: Vec<TestCase> = cases.iter().map(test_case).collect();
        paths::write(path, &junit::document(JUNIT_NAME, &tests))?;
    }
    let report = Report { passed, cases, wall_s: started.elapsed().as_secs_f64() };
    if json {
        output::json(&report)?;
    } else {
        output::lines(&for_people(&report))?;
    }
    for case in &report.cases {
        case.warnings.iter().for_each(|warning| eprintln!("realitysim: warning: {}: {warning}", case.name));
        faults(case).iter().for_each(|fault| output::say(&format!("{}: {fault}", case.name)));
    }
    Ok(match (passed, kept) {
        (true, _) => Outcome::Whole,
        (false, true) => Outcome::DataLost,
        (false, false) => Outcome::NotReached,
    })
}

struct ProgressPrinter;

impl Watcher for ProgressPrinter {
    fn done(&self, done: usize, total: usize, report: &CaseReport) {
        eprintln!("{done}/{total}  {}  {} ({:.1} s)", report.name, verdict(report), report.wall_s);
    }

    fn timing(&self, name: &str) {
        eprintln!("timing alone: {name}");
    }
}

fn verdict(case: &CaseReport) -> &'static str {
    match case.outcome {
        suite::Outcome::Kept if !case.lost.is_empty() => "ok, DATA LOST",
        suite::Outcome::Kept => "ok",
        suite::Outcome::Broken => "BROKEN",
        suite::Outcome::Failed => "FAILED",
    }
}

/// Describes each broken limit, or what went wrong, in a line.
fn faults(case: &CaseReport) -> Vec<String> {
    let broken = case.broken.iter().map(|Broken { limit, value, allowed }| {
        let value = value.map_or_else(|| "not there".to_owned(), |value| format!("{value:.4}"));
        let bound = if LOWER_LIMITS.contains(limit) { "at least" } else { "at most" };
        let c = &case.judged.comparison;
        let why = match *limit {
            "judged_share" => {
                format!(": {} of {} valid tags have no truth near their time", c.without_truth, c.valid)
            }
            _ => String::new(),
        };
        format!("{limit} is {value}, allowed is {bound} {allowed}{why}")
    });
    let lost = case.lost.iter().map(ToString::to_string);
    case.error.iter().cloned().chain(broken).chain(describe_reference_difference(case)).chain(lost).collect()
}

fn describe_reference_difference(case: &CaseReport) -> Option<String> {
    let verdict = case.reference.as_ref().filter(|verdict| !verdict.same)?;
    if verdict.frames != verdict.frames_of_reference {
        return Some(format!("reference: {} frames, it has {}", verdict.frames, verdict.frames_of_reference));
    }
    let Difference { field, first_frame, first: [then, now], .. } = verdict.differences.first()?;
    let more = verdict.differences.len() - 1;
    Some(format!(
        "reference: {} frames differ, the first is {first_frame}: {field} was {then}, is {now} ({more} fields more differ)",
        verdict.frames_differ
    ))
}

fn test_case(case: &CaseReport) -> TestCase {
    TestCase { name: case.name.clone(), seconds: case.wall_s, faults: faults(case) }
}

fn for_people(report: &Report) -> String {
    let width = report.cases.iter().map(|case| case.name.chars().count()).max().unwrap_or(0).max(4);
    let mut text = format!(
        "{:<width$}  frames  valid %  mean cm  median     p95     max  yaw deg  no truth  again s  p99 ratio\n",
        "case"
    );
    for case in &report.cases {
        let (judged, c) = (&case.judged, &case.judged.comparison);
        let recovered = match (judged.recoveries.is_empty(), judged.slowest_recovery_s()) {
            (true, _) => "-".to_owned(),
            (false, None) => "never".to_owned(),
            (false, Some(seconds)) => format!("{seconds:.1}"),
        };
        let or_none = |value: Option<f64>, digits: usize| {
            value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
        };
        let error = |value: f64, digits: usize| or_none((c.judged > 0).then_some(value), digits);
        let Summary { mean, median, p95, max } = c.position_cm;
        text.push_str(&format!(
            "{:<width$}  {:>6} {:>8} {:>8} {:>7} {:>7} {:>7} {:>8} {:>9} {recovered:>8} {:>10}  {}\n",
            case.name,
            c.frames,
            or_none(judged.valid_share.map(|share| 100.0 * share), 1),
            error(mean, 2),
            error(median, 2),
            error(p95, 2),
            error(max, 2),
            error(c.yaw_deg.median, 3),
            c.without_truth,
            or_none(case.p99_ratio, 2),
            verdict(case)
        ));
    }
    let kept = report.cases.iter().filter(|case| case.outcome == suite::Outcome::Kept).count();
    text.push_str(&format!("\n{kept} of {} cases keep their limits, {:.0} s", report.cases.len(), report.wall_s));
    text
}
