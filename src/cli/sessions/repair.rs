//! Command `realitysim sessions repair`: completes sessions that a crash left unfinished.

use clap::Args;
use serde_json::json;

use super::CapturesArguments;
use crate::cli::{Outcome, output};
use crate::recording::repair;
use crate::recording::storage::Disk;

/// Finish what a crash or a power cut has left unfinished; a second run changes nothing
///
/// Torn segments are cut behind the last chunk that is sound, get index and footer and their final name; the manifest
/// and metadata.yaml list them. A session that is being recorded is left alone.
#[derive(Args)]
#[command(after_long_help = "Example:\n  realitysim sessions repair --captures captures/")]
pub struct RepairArguments {
    /// Names, or beginnings of which there is one, or folders; none: all
    #[arg(value_name = "SESSION")]
    sessions: Vec<String>,
    #[command(flatten)]
    captures: CapturesArguments,
}

pub fn run(arguments: &RepairArguments, json: bool) -> anyhow::Result<Outcome> {
    let (mut repaired, mut failed) = (Vec::new(), Vec::new());
    for session in arguments.captures.paths(&arguments.sessions)? {
        match repair(&Disk, &session) {
            Ok(session) => repaired.push(session),
            Err(error) => failed.push(error.to_string()),
        }
    }
    let headless = arguments.captures.headless(&arguments.sessions)?;
    if json {
        output::json(&json!({ "sessions": repaired, "failed": failed, "wrong": headless }))?;
    } else {
        let shown = repaired.iter().map(ToString::to_string).chain(headless.iter().map(ToString::to_string));
        output::lines(&shown.collect::<Vec<_>>().join("\n"))?;
    }
    let mut lost: Vec<_> = repaired.iter().flat_map(|it| it.lost.iter().chain(&it.wrong).cloned()).collect();
    lost.extend(headless);
    if let [first, ..] = failed.as_slice() {
        anyhow::bail!(
            "{first}{}",
            if failed.len() > 1 { format!("; and {} more", failed.len() - 1) } else { String::new() }
        );
    }
    Ok(Outcome::of(&lost))
}
