//! Commands `realitysim sessions pin` and `unpin`: protect sessions from deletion, or no longer.

use std::fs;
use std::io::ErrorKind;

use clap::Args;
use serde::Serialize;

use super::CapturesArguments;
use crate::cli::{Outcome, output, paths};
use crate::recording::{PIN_FILE, Session, sync_folder, write_atomically};

/// Keep sessions: `prune` leaves them alone unless told otherwise, and the recorder deletes them last
///
/// A recorder that is out of room removes what a dev machine has acknowledged, oldest first, and pinned sessions only when
/// nothing else is left.
#[derive(Args)]
#[command(after_long_help = "Example:\n  realitysim sessions pin 2026-11-21T10")]
pub struct PinArguments {
    /// Names, or beginnings of which there is one, or folders
    #[arg(required = true, value_name = "SESSION")]
    sessions: Vec<String>,
    #[command(flatten)]
    captures: CapturesArguments,
}

/// Let sessions go again
#[derive(Args)]
#[command(after_long_help = "Example:\n  realitysim sessions unpin 2026-11-21T10")]
pub struct UnpinArguments {
    /// Names, or beginnings of which there is one, or folders
    #[arg(required = true, value_name = "SESSION")]
    sessions: Vec<String>,
    #[command(flatten)]
    captures: CapturesArguments,
}

#[derive(Serialize)]
struct Report {
    pinned: bool,
    sessions: Vec<String>,
}

pub fn pin(arguments: &PinArguments, json: bool) -> anyhow::Result<Outcome> {
    let sessions = find_all(&arguments.captures, &arguments.sessions)?;
    for session in &sessions {
        write_atomically(&session.folder.join(PIN_FILE), b"")?;
    }
    report(true, &sessions, json)
}

pub fn unpin(arguments: &UnpinArguments, json: bool) -> anyhow::Result<Outcome> {
    let sessions = find_all(&arguments.captures, &arguments.sessions)?;
    for session in &sessions {
        let path = session.folder.join(PIN_FILE);
        match fs::remove_file(&path) {
            Ok(()) => sync_folder(&session.folder)?,
            Err(error) if error.kind() == ErrorKind::NotFound => {}
            Err(error) => return Err(paths::cannot_write(&path, error)),
        }
    }
    report(false, &sessions, json)
}

/// Finds all sessions before anything is done to one.
fn find_all(captures: &CapturesArguments, names: &[String]) -> anyhow::Result<Vec<Session>> {
    names.iter().map(|name| captures.session(name)).collect()
}

fn report(pinned: bool, sessions: &[Session], json: bool) -> anyhow::Result<Outcome> {
    let sessions: Vec<String> = sessions.iter().map(|session| session.name.clone()).collect();
    if json {
        output::json(&Report { pinned, sessions })?;
    } else {
        let what = if pinned { "pinned" } else { "no longer pinned" };
        output::lines(&sessions.iter().map(|name| format!("{name}: {what}")).collect::<Vec<_>>().join("\n"))?;
    }
    Ok(Outcome::Whole)
}
