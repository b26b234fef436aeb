//! `realitysim sessions pin`, `unpin`

use std::fs;
use std::io::ErrorKind;

use clap::Args;
use serde::Serialize;

use super::CapturesArguments;
use crate::cli::{Outcome, output, paths};
use crate::recording::{PIN_FILE, Session, sync_folder, write_atomically};

/// Keep sessions: neither the recorder nor `prune` deletes them unasked
#[derive(Args)]
pub struct PinArguments {
    /// Names or folders
    #[arg(required = true, value_name = "SESSION")]
    sessions: Vec<String>,
    #[command(flatten)]
    captures: CapturesArguments,
}

/// Let sessions go again
#[derive(Args)]
pub struct UnpinArguments {
    /// Names or folders
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
    for session in all(&arguments.captures, &arguments.sessions)? {
        write_atomically(&session.folder.join(PIN_FILE), b"")?;
    }
    report(true, &arguments.sessions, json)
}

pub fn unpin(arguments: &UnpinArguments, json: bool) -> anyhow::Result<Outcome> {
    for session in all(&arguments.captures, &arguments.sessions)? {
        let path = session.folder.join(PIN_FILE);
        match fs::remove_file(&path) {
            Ok(()) => sync_folder(&session.folder)?,
            Err(error) if error.kind() == ErrorKind::NotFound => {}
            Err(error) => return Err(paths::cannot_write(&path, error)),
        }
    }
    report(false, &arguments.sessions, json)
}

/// All of them, before anything is done to one.
fn all(captures: &CapturesArguments, names: &[String]) -> anyhow::Result<Vec<Session>> {
    names.iter().map(|name| captures.session(name)).collect()
}

fn report(pinned: bool, sessions: &[String], json: bool) -> anyhow::Result<Outcome> {
    if json {
        output::json(&Report { pinned, sessions: sessions.to_vec() })?;
    }
    Ok(Outcome::Whole)
}
