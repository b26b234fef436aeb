//! `realitysim doctor --calibration`: whether lens and mount are still as calibrated, as findings.

use std::path::Path;

use serde::Serialize;

use crate::cli::calibrate::mount_text;
use crate::cli::output;
use crate::cli::paths::temporary;
use crate::cli::settings::{SettingsArguments, UsageError};
use crate::doctor::{Finding, newest_capture};
use crate::geometry::Euler;
use crate::localization::smoothing::Constants;
use crate::recording::{Loss, SessionInfo};
use crate::tagging::ReplayOptions;
use crate::tagging::calibration_check::{CalibrationCheck, CheckedConstant, Drift, check_calibration};

/// Result of `realitysim doctor --calibration`.
#[derive(Serialize)]
pub(super) struct CalibrationReport {
    recording: String,
    /// When it was recorded, RFC 3339.
    started: String,
    /// What it was compared with.
    since: String,
    /// Frames that took part.
    frames: usize,
    /// Whether nothing has changed that matters, and the recording tells as much of the mount.
    pub(super) still_valid: bool,
    verdict: String,
    pub(super) findings: Vec<Finding>,
    constants: Vec<Constant>,
    #[serde(skip)]
    pub(super) losses: Vec<Loss>,
}

#[derive(Serialize)]
struct Constant {
    name: &'static str,
    unit: &'static str,
    deviation: f64,
    sigma: f64,
    drift: &'static str,
}

/// Number of standard deviations that are stated as "to".
const STATED_SIGMAS: f64 = 2.0;
const LOOK_AROUND: &str = "stand at a corner of the penalty area and turn the head for 20 s, so that lines are seen near and far, left and right";

/// Checks the calibration by a recording, against the settings of the recording or against an `earlier` one.
pub(super) fn check(
    recording: &Path,
    earlier: Option<&Path>,
    settings: &SettingsArguments,
) -> anyhow::Result<CalibrationReport> {
    let recording = newest_capture(recording)?;
    let now = check_one(&recording, settings)?;
    let then = earlier.map(|earlier| check_one(earlier, settings)).transpose()?;
    if let Some(then) = &then {
        check_same_calibration(&now.info, &then.info, earlier.unwrap_or(&recording))?;
    }
    let constants = then.as_ref().map_or_else(|| now.constants.clone(), |then| now.since(then));
    let since = match &then {
        Some(then) => format!("since {}", date(&then.info.started)),
        None => "since the calibration".to_owned(),
    };
    let change = constants.iter().fold([0.0; 2], turned);
    let findings = findings(&now, &constants, change, &since);
    let still_valid = findings.iter().all(|finding| finding.good);
    Ok(CalibrationReport {
        recording: recording.display().to_string(),
        started: now.info.started.clone(),
        frames: now.frames,
        verdict: verdict(&constants, still_valid, &since),
        still_valid,
        since,
        findings,
        constants: constants.iter().map(Constant::of).collect(),
        losses: now.losses,
    })
}

fn check_one(recording: &Path, settings: &SettingsArguments) -> anyhow::Result<CalibrationCheck> {
    let temporary = temporary()?;
    let options = ReplayOptions {
        source: recording.to_owned(),
        captures: temporary.path().to_owned(),
        settings: settings.resolve_for(recording)?,
        initial: None,
        threads: std::thread::available_parallelism().map_or(1, usize::from),
        realtime: false,
        warm_start: false,
    };
    let mut progress = output::Progress::new("checking the calibration");
    let found = check_calibration(&options, &mut |done, all| progress.set(done, Some(all)))?;
    progress.finish();
    Ok(found)
}

/// Two recordings can be compared if both were tagged with the same lens and mount.
fn check_same_calibration(now: &SessionInfo, then: &SessionInfo, earlier: &Path) -> Result<(), UsageError> {
    if now.lens == then.lens && now.settings.mount == then.settings.mount {
        return Ok(());
    }
    Err(UsageError(format!(
        "{}: it was recorded with another lens or mount: without --since, the new recording is compared with its own calibration",
        earlier.display()
    )))
}

impl Constant {
    fn of(constant: &CheckedConstant) -> Self {
        let (name, unit) = constant.name();
        let drift = match constant.drift() {
            Drift::None => "none",
            Drift::Changed => "changed",
            Drift::Unknown => "unknown",
        };
        Self { name, unit, deviation: constant.deviation, sigma: constant.sigma, drift }
    }
}

/// Adds a constant to the tilt about the camera's x and z axes if it is one of these.
fn turned([x, z]: [f64; 2], constant: &CheckedConstant) -> [f64; 2] {
    match constant.name().0 {
        "tilt about the camera's x" => [x + constant.deviation, z],
        "tilt about the camera's z" => [x, z + constant.deviation],
        _ => [x, z],
    }
}

/// One finding each for tilt, height, lens and clock.
fn findings(now: &CalibrationCheck, constants: &[CheckedConstant], [x, z]: [f64; 2], since: &str) -> Vec<Finding> {
    let of = |part: &str| constants.iter().filter(|constant| constant.name().0.starts_with(part)).collect::<Vec<_>>();
    let (tilt, height, clock) = (of("tilt"), of("height"), of("delay"));
    let lens = [of("focal"), of("centre")].concat();
    let tilt_said =
        format!("{} (to {:.2} degrees)", direction(x, z), STATED_SIGMAS * largest_sigma(&tilt).to_degrees());
    let height_said =
        format!("{:+.1} cm (to {:.1} cm)", 100.0 * sum(&height), 100.0 * STATED_SIGMAS * largest_sigma(&height));
    let clock_said = format!("{:+.1} ms (to {:.1} ms)", 1e3 * sum(&clock), 1e3 * STATED_SIGMAS * largest_sigma(&clock));
    // Once is enough, though tilt and height both call for it.
    let mut mend = Some(format!("the corrected mount:\n{}", indented(&mount_text(&now.info, &now.corrections))));
    let delay_ms = now.info.settings.capture.delay_ms + 1e3 * now.corrections.delay_s;
    let mend_lens = "`realitysim calibrate --walk` or `--board` finds the lens anew".to_owned();
    let mut mount = |what: &str, parts: &[&CheckedConstant], said: String| {
        let remedy = if has(parts, Drift::Changed) { mend.take().unwrap_or_default() } else { LOOK_AROUND.to_owned() };
        finding(what, !has(parts, Drift::Changed) && !has(parts, Drift::Unknown), format!("{said} {since}"), remedy)
    };
    vec![
        mount("tilt of the camera", &tilt, tilt_said),
        mount("height of the camera", &height, height_said),
        // A lens and a clock that are not seen better than this have no reason to be doubted: nothing hits them as it does a mount.
        finding("lens", !has(&lens, Drift::Changed), lens_said(&lens), mend_lens),
        finding(
            "clock of the camera",
            !has(&clock, Drift::Changed),
            clock_said,
            format!("capture.delay_ms = {delay_ms:.1}"),
        ),
    ]
}

fn finding(what: &str, good: bool, said: String, remedy: String) -> Finding {
    Finding { what: what.to_owned(), good, said, remedy: if good { String::new() } else { remedy } }
}

fn has(constants: &[&CheckedConstant], drift: Drift) -> bool {
    constants.iter().any(|constant| constant.drift() == drift)
}

fn sum(constants: &[&CheckedConstant]) -> f64 {
    constants.iter().map(|constant| constant.deviation).sum()
}

fn largest_sigma(constants: &[&CheckedConstant]) -> f64 {
    constants.iter().map(|constant| constant.sigma).fold(0.0, f64::max)
}

fn lens_said(constants: &[&CheckedConstant]) -> String {
    let each = constants.iter().map(|constant| {
        let (times, unit) = if constant.name().1 == "share" { (100.0, "%") } else { (1.0, "px") };
        let (value, to) = (times * constant.deviation, times * STATED_SIGMAS * constant.sigma);
        format!("{} {value:+.2} {unit} (to {to:.2})", constant.name().0)
    });
    each.collect::<Vec<_>>().join(", ")
}

/// The change of where the camera looks, in words: `camera_link` against what was believed.
fn direction(x: f64, z: f64) -> String {
    let turn = Constants { tilt_x: x, tilt_z: z, ..Constants::default() }.corrected_link(glam::DQuat::IDENTITY);
    let Euler { pitch, roll, .. } = Euler::from_rotation(turn);
    let side = |value: f64, positive: &str, negative: &str| {
        format!("{:.2} degrees {}", value.to_degrees().abs(), if value < 0.0 { negative } else { positive })
    };
    format!("looks {} and leans {}", side(pitch, "lower", "higher"), side(roll, "to its right", "to its left"))
}

fn verdict(constants: &[CheckedConstant], still_valid: bool, since: &str) -> String {
    let all: Vec<&CheckedConstant> = constants.iter().collect();
    let of =
        |part: &str| all.iter().copied().filter(|constant| constant.name().0.starts_with(part)).collect::<Vec<_>>();
    let tilt = of("tilt");
    if still_valid {
        return "the calibration is still valid".to_owned();
    }
    let mut changes = Vec::new();
    if has(&tilt, Drift::Changed) {
        let angle = tilt.iter().map(|constant| constant.deviation.powi(2)).sum::<f64>().sqrt();
        changes.push(format!("the mount has turned by {:.1} degrees {since}", angle.to_degrees()));
    }
    for (part, what) in [
        ("height", "the camera's height"),
        ("focal", "the lens"),
        ("centre", "the lens's centre"),
        ("delay", "the camera's delay"),
    ] {
        if has(&of(part), Drift::Changed) {
            changes.push(format!("{what} has changed {since}"));
        }
    }
    match changes.is_empty() {
        true => "not enough was seen to tell whether the mount has moved".to_owned(),
        false => changes.join("; "),
    }
}

/// The day of a time in RFC 3339, for people.
fn date(started: &str) -> String {
    let time = started.parse::<jiff::Timestamp>().map(|time| time.to_zoned(jiff::tz::TimeZone::UTC));
    time.map_or_else(|_| started.to_owned(), |time| time.strftime("%A, %-d %B %Y, %H:%M UTC").to_string())
}

fn indented(text: &str) -> String {
    text.trim().lines().map(|line| format!("    {line}")).collect::<Vec<_>>().join("\n")
}

impl CalibrationReport {
    /// The report for people.
    pub(super) fn text(&self, for_people: impl Fn(&Finding) -> String) -> String {
        let lines = self.findings.iter().map(for_people).collect::<Vec<_>>().join("\n");
        let Self { recording, started, frames, verdict, .. } = self;
        format!("{recording}: {frames} frames of {}\n{lines}\n{verdict}", date(started))
    }
}
