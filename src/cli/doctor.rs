//! Command `realitysim doctor`: checks whether a robot is ready to record.

use std::path::PathBuf;

use clap::Args;

use super::settings::SettingsArguments;
use super::{Outcome, output};
use crate::doctor::{Finding, estimate_delay, examine};

/// Try every part that a recording needs: config, camera, serial ports, clocks, disk
///
/// A line for each, + or -, and what to do. Not while a recorder runs: it has the devices. Exit code 1 if something is wrong.
#[derive(Args)]
#[command(after_long_help = "Example:\n  realitysim doctor --config robot.toml")]
pub struct DoctorArguments {
    /// Where captures will be kept
    #[arg(short, long, value_name = "CAPTURES_DIR", default_value = "/var/lib/realitysim/captures")]
    output: PathBuf,
    /// Only find out how late the camera's stamps are, from a recording in which head or body turns left and right for ten
    /// seconds: LOG, or the newest capture
    #[arg(long, value_name = "LOG", num_args = 0..=1)]
    estimate_delay: Option<Option<PathBuf>>,
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
