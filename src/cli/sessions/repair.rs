//! What a crash has left becomes a whole capture.

use std::path::PathBuf;

use clap::Args;
use serde_json::json;

use crate::cli::{Outcome, output};
use crate::recording::repair_all;
use crate::recording::storage::Disk;

/// Finish what a crash or a power cut has left unfinished; a second run changes nothing
///
/// Torn segments are cut behind the last chunk that is sound, get index and footer and their final name; the manifest
/// and metadata.yaml list them. A session that is being recorded is left alone.
#[derive(Args)]
pub struct RepairArguments {
    /// A folder of captures, or one session
    #[arg(value_name = "DIR", default_value = "captures")]
    captures: PathBuf,
}

pub fn run(arguments: &RepairArguments, json: bool) -> anyhow::Result<Outcome> {
    anyhow::ensure!(arguments.captures.is_dir(), "{}: no such folder", arguments.captures.display());
    let (mut repaired, mut failed) = (Vec::new(), Vec::new());
    for session in repair_all(&Disk, &arguments.captures) {
        match session {
            Ok(session) => repaired.push(session),
            Err(error) => failed.push(error.to_string()),
        }
    }
    if json {
        output::json(&json!({ "sessions": repaired, "failed": failed }))?;
    } else {
        output::lines(&repaired.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n"))?;
    }
    let lost: Vec<_> = repaired.iter().flat_map(|session| session.lost.clone()).collect();
    if let [first, ..] = failed.as_slice() {
        anyhow::bail!(
            "{first}{}",
            if failed.len() > 1 { format!("; and {} more", failed.len() - 1) } else { String::new() }
        );
    }
    Ok(Outcome::of(&lost))
}
