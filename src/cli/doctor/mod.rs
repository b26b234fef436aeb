//! Command `realitysim doctor`: checks whether a robot is ready to record.

mod calibration;

use std::path::PathBuf;

use clap::Args;

use super::settings::SettingsArguments;
use super::{Outcome, output};
use crate::doctor::{Finding, estimate_delay, examine};

/// Try every part that a recording needs: config, camera, serial ports, clocks, disk
///
/// A line for each, + or -, and what to do. Not while a recorder runs: it has the devices. Exit code 1 if something is wrong.
#[derive(Args)]
#[command(after_long_help = concat!(
    "Examples:",
    "\n  realitysim doctor --config robot.toml",
    "\n  realitysim doctor --calibration",
    "\n  realitysim doctor --calibration today/ --since tuesday/",
))]
pub struct DoctorArguments {
    /// Where captures will be kept
    #[arg(short, long, value_name = "CAPTURES_DIR", default_value = "/var/lib/realitysim/captures")]
    output: PathBuf,
    /// Only find out how late the camera's stamps are, from a recording in which head or body turns left and right for ten
    /// seconds: LOG, or the newest capture
    #[arg(long, value_name = "LOG", num_args = 0..=1)]
    estimate_delay: Option<Option<PathBuf>>,
    /// Only find out whether lens and mount are still as calibrated, from 20 seconds in which the robot stands on the field and looks
    /// around: LOG, or the newest capture
    #[arg(long, value_name = "LOG|CAPTURE", num_args = 0..=1, conflicts_with = "estimate_delay")]
    calibration: Option<Option<PathBuf>>,
    /// With --calibration: compare with an earlier recording instead of the calibration
    #[arg(long, value_name = "LOG|CAPTURE", requires = "calibration")]
    since: Option<PathBuf>,
    #[command(flatten)]
    settings: SettingsArguments,
}

pub fn run(arguments: &DoctorArguments, json: bool) -> anyhow::Result<Outcome> {
    if let Some(log) = &arguments.estimate_delay {
        let report = estimate_delay(log.as_ref().unwrap_or(&arguments.output), &arguments.settings.resolve()?)?;
        if json {
            output::json(&report)?;
        } else {
            output::lines(&format!(
                "{}: capture.delay_ms = {:.1} (to {:.1} ms, from {} turns, correlation {:.2}; recorded with {:.1})",
                report.log.display(),
                report.delay_ms,
                report.uncertainty_ms,
                report.turns,
                report.correlation,
                report.configured_ms
            ))?;
        }
        return Ok(Outcome::Whole);
    }
    if let Some(recording) = &arguments.calibration {
        let recording = recording.as_ref().unwrap_or(&arguments.output);
        let report = calibration::check(recording, arguments.since.as_deref(), &arguments.settings)?;
        output::losses(&report.losses);
        if json {
            output::json(&report)?;
        } else {
            output::lines(&report.text(for_people))?;
        }
        return Ok(if report.still_valid { Outcome::of(&report.losses) } else { Outcome::NotReached });
    }
    let findings = examine(&arguments.settings.resolve()?, &arguments.output);
    if json {
        output::json(&findings)?;
    } else {
        output::lines(&findings.iter().map(for_people).collect::<Vec<_>>().join("\n"))?;
    }
    Ok(if findings.iter().all(|finding| finding.good) { Outcome::Whole } else { Outcome::NotReached })
}

fn for_people(finding: &Finding) -> String {
    let Finding { what, good, said, remedy } = finding;
    let said = output::reword_system_errors(said);
    // The device's name stands in `what` already, as in `camera /dev/video0`.
    let alone = what.split_once(' ').and_then(|(_, device)| said.strip_prefix(device)?.strip_prefix(": "));
    let said = alone.unwrap_or(&said);
    if *good { format!("+ {what}: {said}") } else { format!("- {what}: {said}\n    {remedy}") }
}
