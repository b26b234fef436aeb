//! `realitysim sessions verify`

use clap::Args;
use serde_json::json;

use super::CapturesArguments;
use crate::cli::{Outcome, output};
use crate::recording::storage::Disk;
use crate::recording::{Loss, verify};

/// Compare every segment's bytes with the manifest's hash; changes nothing
#[derive(Args)]
pub struct VerifyArguments {
    /// Names or folders; none: all
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
                verified.push(session);
            }
            Err(error) => wrong.push(Loss::new(&path, error.to_string())),
        }
    }
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
