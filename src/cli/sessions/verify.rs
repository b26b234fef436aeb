//! Command `realitysim sessions verify`: compares segments with the hashes in their manifest.

use clap::Args;
use serde_json::json;

use super::CapturesArguments;
use crate::cli::{Outcome, output};
use crate::recording::sessions::session_at;
use crate::recording::storage::Disk;
use crate::recording::sync::{Store, SyncError};
use crate::recording::{Loss, Verified, receiver_of, verify};

/// Compare every segment's bytes with the manifest's hash
///
/// Changes nothing but, in a folder that is synced into, its own acknowledgement of what is not sound: the next sync
/// tells the source, and fetches it again.
#[derive(Args)]
#[command(after_long_help = "Example:\n  realitysim sessions verify --captures captures/")]
pub struct VerifyArguments {
    /// Names, or beginnings of which there is one, or folders; none: all
    #[arg(value_name = "SESSION")]
    sessions: Vec<String>,
    #[command(flatten)]
    captures: CapturesArguments,
}

pub fn run(arguments: &VerifyArguments, json: bool) -> anyhow::Result<Outcome> {
    let (mut verified, mut wrong) = (Vec::new(), Vec::<Loss>::new());
    for path in arguments.captures.paths(&arguments.sessions)? {
        match verify(&Disk, &path) {
            Ok(session) => {
                wrong.extend(session.wrong.iter().cloned());
                if let Err(error) = withdraw_acknowledgements(&session) {
                    wrong.push(Loss::new(&path, format!("its acknowledgement could not be taken back: {error}")));
                }
                verified.push(session);
            }
            Err(error) => wrong.push(Loss::new(&path, error.to_string())),
        }
    }
    wrong.extend(arguments.captures.headless(&arguments.sessions)?);
    if json {
        output::json(&json!({ "sessions": verified, "wrong": wrong }))?;
    } else {
        let whole = verified.iter().map(|session| {
            let state = if session.wrong.is_empty() { "sound" } else { "not sound" };
            let evicted =
                if session.evicted > 0 { format!(", {} removed after a sync", session.evicted) } else { String::new() };
            format!(
                "{}: {state}, {} segments, {} bytes{evicted}",
                session.session.display(),
                session.sound,
                session.bytes
            )
        });
        output::lines(&whole.chain(wrong.iter().map(|loss| format!("  {loss}"))).collect::<Vec<_>>().join("\n"))?;
    }
    Ok(Outcome::of(&wrong))
}

/// Withdraws this folder's acknowledgements of segments that are not sound, if it is synced into.
fn withdraw_acknowledgements(verified: &Verified) -> Result<(), SyncError> {
    let receives = verified.session.parent().filter(|captures| receiver_of(captures).is_some());
    let (Some(captures), Ok(session), false) = (receives, session_at(&verified.session), verified.wrong.is_empty())
    else {
        return Ok(());
    };
    let store = Store::open(captures)?;
    let mut acks = session.acknowledged.get(store.receiver()).cloned().unwrap_or_default();
    acks.retain(|ack| verified.wrong.iter().any(|wrong| wrong.file == verified.session.join(&ack.file)));
    if acks.is_empty() { Ok(()) } else { store.withdraw(&session.name, &acks) }
}
