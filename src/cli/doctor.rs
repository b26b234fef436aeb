//! `realitysim doctor`

use std::path::PathBuf;

use clap::Args;

use super::settings::SettingsArguments;
use super::{Outcome, output};
use crate::agent::doctor::{Finding, examine};

/// Try every part that a recording needs: config, camera, serial ports, clocks, disk
///
/// A line for each, + or -, and what to do. Not while a recorder runs: it has the devices. Exit code 1 if something is wrong.
#[derive(Args)]
pub struct DoctorArguments {
    /// Where captures will be kept
    #[arg(short, long, value_name = "CAPTURES_DIR", default_value = "/var/lib/realitysim/captures")]
    output: PathBuf,
    #[command(flatten)]
    settings: SettingsArguments,
}

pub fn run(arguments: &DoctorArguments, json: bool) -> anyhow::Result<Outcome> {
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
    if *good { format!("+ {what}: {said}") } else { format!("- {what}: {said}\n    {remedy}") }
}
