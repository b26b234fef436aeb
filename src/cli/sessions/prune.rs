//! Command `realitysim sessions prune`: deletes sessions that another store has.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;

use super::{CapturesArguments, full_name};
use crate::cli::settings::UsageError;
use crate::cli::values::{any_number, any_whole};
use crate::cli::{Outcome, output, paths};
use crate::recording::saturating_sum;
use crate::recording::sessions::sessions_in;
use crate::recording::sync::{Decision, Goal, Removal};

/// Delete sessions that another store has, whole and verified
///
/// Says what it would do; `--yes` does it. Oldest first, pinned ones only with --pinned and then last. Nothing goes that is open, or
/// that holds files which are not the session's; nothing of which no other store is known to have every segment, unless
/// forced.
#[derive(Args)]
#[command(after_long_help = "Example:\n  realitysim sessions prune --captures captures/ --free 20")]
pub struct PruneArguments {
    /// Names, or beginnings of which there is one; none: all
    #[arg(value_name = "SESSION")]
    sessions: Vec<String>,
    #[command(flatten)]
    captures: CapturesArguments,
    /// Do it
    #[arg(long)]
    yes: bool,
    /// Only sessions that began more than so many days ago, by this machine's clock
    #[arg(long, value_name = "DAYS", value_parser = any_whole::<u32>)]
    older_than: Option<u32>,
    /// Stop when so much is freed
    #[arg(long, value_name = "GB", allow_negative_numbers = true, value_parser = any_number)]
    free: Option<f64>,
    /// Another folder of captures, on other storage: what is found there whole, by its hash, may go here
    #[arg(long, value_name = "CAPTURES_DIR")]
    copy: Vec<PathBuf>,
    /// Pinned ones too
    #[arg(long)]
    pinned: bool,
    /// Also what is nowhere else: it is gone then
    #[arg(long)]
    force: bool,
}

#[derive(Serialize)]
struct Report {
    done: bool,
    freed_bytes: u64,
    sessions: Vec<Decision>,
}

pub fn run(arguments: &PruneArguments, json: bool) -> anyhow::Result<Outcome> {
    let folder = arguments.captures.folder()?;
    for copy in &arguments.copy {
        paths::check_output(copy, &[&folder])?;
    }
    let (sessions, strange) = sessions_in(&folder).map_err(|error| paths::cannot_read(&folder, error))?;
    let mut asked = Vec::new();
    for name in &arguments.sessions {
        let names = sessions.iter().map(|session| session.name.as_str());
        asked.push(full_name(name, names)?.map(str::to_owned).ok_or_else(|| {
            let why = strange.iter().find(|it| it.path == folder.join(name)).map(|it| it.why.as_str());
            UsageError(format!("{}: {}", folder.join(name).display(), why.unwrap_or("no such session")))
        })?);
    }
    if arguments.free.is_some_and(|gb| !(gb.is_finite() && gb >= 0.0)) {
        return Err(UsageError("--free: gigabytes, 0 or more".to_owned()).into());
    }
    let before = arguments.older_than.map(|days| {
        let then = jiff::Timestamp::now().as_second().saturating_sub(86_400 * i64::from(days));
        jiff::Timestamp::from_second(then).unwrap_or_default().to_string()
    });
    let goal = Goal {
        sessions: asked,
        before,
        bytes: arguments.free.map(|gb| (gb * 1e9) as u64),
        pinned: arguments.pinned,
        force: arguments.force,
    };
    let mut removal = Removal::plan(&folder, &arguments.copy, &sessions, &goal);
    if arguments.yes {
        removal.carry_out()?;
    }
    report(removal.decisions, arguments.yes, json)
}

fn report(decisions: Vec<Decision>, done: bool, json: bool) -> anyhow::Result<Outcome> {
    let freed_bytes = saturating_sum(decisions.iter().filter(|decision| decision.goes).map(|decision| decision.bytes));
    if json {
        output::json(&Report { done, freed_bytes, sessions: decisions })?;
        return Ok(Outcome::Whole);
    }
    let mut text = String::new();
    for Decision { session, bytes, goes, why, .. } in &decisions {
        let what = match (goes, done) {
            (true, true) => "gone",
            (true, false) => "would go",
            (false, _) => "stays",
        };
        text.push_str(&format!("{what:<9} {session:<34} {:>10}  {why}\n", output::size(*bytes)));
    }
    let end = if done { "freed" } else { "would be freed; --yes does it" };
    text.push_str(&format!("{} {end}", output::size(freed_bytes)));
    output::lines(&text)?;
    Ok(Outcome::Whole)
}
