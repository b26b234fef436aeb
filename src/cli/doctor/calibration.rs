//! `realitysim doctor --calibration`: whether lens and mount are still as calibrated, as findings.

use std::path::Path;

use serde::Serialize;

use crate::cli::calibrate::mount_text;
use crate::cli::host_info::cores;
use crate::cli::output;
use crate::cli::paths::temporary;
use crate::cli::settings::{SettingsArguments, UsageError};
use crate::doctor::{Finding, newest_capture};
use crate::geometry::Euler;
use crate::localization::smoothing::Constants;
use crate::recording::{Loss, SessionInfo};
use crate::tagging::ReplayOptions;
use crate::tagging::calibration_check::{CalibrationCheck, CameraPart, CheckedConstant, Drift, check_calibration};

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
    let findings = findings(&now, &constants, &since);
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
        losses: now.losses.into_iter().chain(then.map(|then| then.losses).unwrap_or_default()).collect(),
    })
}

fn check_one(recording: &Path, settings: &SettingsArguments) -> anyhow::Result<CalibrationCheck> {
    let temporary = temporary()?;
    let options = ReplayOptions {
        source: recording.to_owned(),
        captures: temporary.path().to_owned(),
        settings: settings.resolve_for(recording)?,
        initial: None,
        threads: cores(),
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

/// One finding each for tilt, height, lens and clock.
fn findings(now: &CalibrationCheck, constants: &[CheckedConstant], since: &str) -> Vec<Finding> {
    let [tilt, height, lens, clock] =
        [CameraPart::Tilt, CameraPart::Height, CameraPart::Lens, CameraPart::Clock].map(|part| of(constants, part));
    let tilt_said =
        format!("{} (to {:.2} degrees)", direction(&tilt), STATED_SIGMAS * largest_sigma(&tilt).to_degrees());
    let said = |parts: &[CheckedConstant], times: f64, unit: &str| {
        let each = parts.iter().map(|part| {
            format!("{:+.1} {unit} (to {:.1} {unit})", times * part.deviation, times * STATED_SIGMAS * part.sigma)
        });
        each.collect::<Vec<_>>().join(", ")
    };
    // Once is enough, though tilt and height both call for it.
    let mut mend = Some(format!("the corrected mount:\n{}", indented(&mount_text(&now.info, &now.corrections))));
    let delay_ms = now.info.settings.capture.delay_ms + 1e3 * now.corrections.delay_s;
    let mend_lens = "`realitysim calibrate --walk` or `--board` finds the lens anew".to_owned();
    let mut mount = |what: &str, parts: &[CheckedConstant], said: String| {
        let remedy = if has(parts, Drift::Changed) { mend.take().unwrap_or_default() } else { LOOK_AROUND.to_owned() };
        finding(what, !has(parts, Drift::Changed) && !has(parts, Drift::Unknown), format!("{said} {since}"), remedy)
    };
    vec![
        mount("tilt of the camera", &tilt, tilt_said),
        mount("height of the camera", &height, said(&height, 100.0, "cm")),
        // A lens and a clock that are not seen better than this have no reason to be doubted: nothing hits them as it does a mount.
        finding("lens", !has(&lens, Drift::Changed), lens_said(&lens), mend_lens),
        finding(
            "clock of the camera",
            !has(&clock, Drift::Changed),
            said(&clock, 1e3, "ms"),
            format!("capture.delay_ms = {delay_ms:.1}"),
        ),
    ]
}

/// The constants of a part.
fn of(constants: &[CheckedConstant], part: CameraPart) -> Vec<CheckedConstant> {
    constants.iter().filter(|constant| constant.part == part).copied().collect()
}

fn finding(what: &str, good: bool, said: String, remedy: String) -> Finding {
    Finding { what: what.to_owned(), good, said, remedy: if good { String::new() } else { remedy } }
}

fn has(constants: &[CheckedConstant], drift: Drift) -> bool {
    constants.iter().any(|constant| constant.drift() == drift)
}

fn largest_sigma(constants: &[CheckedConstant]) -> f64 {
    constants.iter().map(|constant| constant.sigma).fold(0.0, f64::max)
}

fn lens_said(constants: &[CheckedConstant]) -> String {
    let each = constants.iter().map(|constant| {
        let (name, unit) = constant.name();
        let (times, unit) = if unit == "share" { (100.0, "%") } else { (1.0, unit) };
        let (value, to) = (times * constant.deviation, times * STATED_SIGMAS * constant.sigma);
        format!("{name} {value:+.2} {unit} (to {to:.2})")
    });
    each.collect::<Vec<_>>().join(", ")
}

/// The change of where the camera looks, in words: `camera_link` against what was believed. The tilts are about the camera's x and z axes.
fn direction(tilt: &[CheckedConstant]) -> String {
    let [tilt_x, tilt_z] = [0, 1].map(|axis| tilt.get(axis).map_or(0.0, |tilt| tilt.deviation));
    let turn = Constants { tilt_x, tilt_z, ..Constants::default() }.corrected_link(glam::DQuat::IDENTITY);
    let Euler { pitch, roll, .. } = Euler::from_rotation(turn);
    let side = |value: f64, positive: &str, negative: &str| {
        format!("{:.2} degrees {}", value.to_degrees().abs(), if value < 0.0 { negative } else { positive })
    };
    format!("looks {} and leans {}", side(pitch, "lower", "higher"), side(roll, "to its right", "to its left"))
}

fn verdict(constants: &[CheckedConstant], still_valid: bool, since: &str) -> String {
    if still_valid {
        return "the calibration is still valid".to_owned();
    }
    let parts = [CameraPart::Tilt, CameraPart::Height, CameraPart::Lens, CameraPart::Clock];
    let changes = parts.into_iter().filter_map(|part| change(part, &of(constants, part)));
    let changes = changes.map(|change| format!("{change} {since}")).collect::<Vec<_>>();
    match changes.is_empty() {
        true => "not enough was seen to tell whether the mount has moved".to_owned(),
        false => changes.join("; "),
    }
}

/// What has changed, if the part has.
fn change(part: CameraPart, constants: &[CheckedConstant]) -> Option<String> {
    if !has(constants, Drift::Changed) {
        return None;
    }
    Some(match part {
        CameraPart::Tilt => {
            let angle = constants.iter().map(|constant| constant.deviation.powi(2)).sum::<f64>().sqrt();
            format!("the mount has turned by {:.1} degrees", angle.to_degrees())
        }
        CameraPart::Height => "the camera's height has changed".to_owned(),
        CameraPart::Lens => "the lens has changed".to_owned(),
        CameraPart::Clock => "the camera's delay has changed".to_owned(),
    })
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
