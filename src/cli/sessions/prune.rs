//! `realitysim sessions prune`

use std::fs::{self, File};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use clap::Args;
use serde::Serialize;

use super::{CapturesArguments, full_name};
use crate::cli::settings::UsageError;
use crate::cli::{Outcome, output, paths};
use crate::recording::catalogue::sessions_in;
use crate::recording::{ACK_ENDING, ACK_FOLDER, Session, receiver_of, saturating_sum, sync_folder, write_atomically};
use crate::sync::{Decision, Goal, Store, decide, is_as_recorded};

/// Delete sessions that another store has, whole and verified
///
/// Says what it would do; `--yes` does it. Oldest first, pinned ones only with --pinned and then last. Nothing goes that is open, or
/// that holds files which are not the session's; nothing of which no other store is known to have every segment, unless
/// forced.
#[derive(Args)]
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
    #[arg(long, value_name = "DAYS")]
    older_than: Option<u32>,
    /// Stop when so much is freed
    #[arg(long, value_name = "GB", allow_negative_numbers = true)]
    free: Option<f64>,
    /// Another folder of captures: what is found there whole, by its hash, may go here
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
    // Until all is done nobody else prunes here, nor in the copies: each would be the other's.
    let _alone = match arguments.yes {
        true => alone_in([folder.as_path()].into_iter().chain(arguments.copy.iter().map(PathBuf::as_path)))?,
        false => Vec::new(),
    };
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
    let has_copy = |session: &Session| arguments.copy.iter().any(|copy| is_whole_in(session, copy));
    let decisions = decide(&sessions, receiver_of(&folder).as_deref(), &has_copy, &goal);
    if arguments.yes {
        finish_earlier(&folder)?;
        for decision in decisions.iter().filter(|decision| decision.goes) {
            if let Some(session) = sessions.iter().find(|session| session.name == decision.session) {
                for copy in &arguments.copy {
                    take_back(session, &folder, copy, decision.relies_on_copy)?;
                }
                delete(session, &folder)?;
            }
        }
    }
    report(decisions, arguments.yes, json)
}

/// Before the session goes: what the copy may have relied on it for holds no longer; and if it goes because the copy was found
/// whole, the copy relies on nobody any more, since everybody else may rely on what goes.
fn take_back(session: &Session, captures: &Path, copy: &Path, relies_on_copy: bool) -> anyhow::Result<()> {
    // A folder without a name has given nobody its word.
    let own = receiver_of(captures).unwrap_or_default();
    let (others, _) = sessions_in(copy).map_err(|error| paths::cannot_read(copy, error))?;
    for other in others.iter().filter(|other| other.id == session.id) {
        let relied_on: Vec<&String> =
            other.acknowledged.iter().filter(|(_, acks)| !acks.is_empty()).map(|(who, _)| who).collect();
        if relies_on_copy && (!relied_on.is_empty() || other.hops() < session.hops()) {
            Store::open(copy)?.be_relied_on(other, session.hops())?;
        } else if relied_on.contains(&&own) {
            let path = other.folder.join(ACK_FOLDER).join(format!("{own}{ACK_ENDING}"));
            write_atomically(&path, b"")?;
        }
    }
    Ok(())
}

/// Gone from sight in one step, then file by file; a sync does not fetch it again unasked.
fn delete(session: &Session, captures: &Path) -> anyhow::Result<()> {
    if receiver_of(captures).is_some() {
        Store::open(captures)?.note_pruned(session)?;
    }
    let hidden = captures.join(format!("{HIDDEN}{}", session.id.as_str()));
    fs::rename(&session.folder, &hidden).map_err(|error| paths::cannot_write(&session.folder, error))?;
    sync_folder(captures)?;
    fs::remove_dir_all(&hidden).map_err(|error| paths::cannot_write(&hidden, error))
}

/// Locks on the folders, in an order that is the same for all.
fn alone_in<'a>(folders: impl Iterator<Item = &'a Path>) -> anyhow::Result<Vec<File>> {
    let mut open = Vec::new();
    for folder in folders {
        let file = File::open(folder).map_err(|error| paths::cannot_read(folder, error))?;
        let is = file.metadata().map_err(|error| paths::cannot_read(folder, error))?;
        open.push(((is.dev(), is.ino()), folder, file));
    }
    open.sort_by_key(|(is, ..)| *is);
    open.dedup_by_key(|(is, ..)| *is);
    for (_, folder, file) in &open {
        file.lock().map_err(|error| paths::cannot_read(folder, error))?;
    }
    Ok(open.into_iter().map(|(.., file)| file).collect())
}

const HIDDEN: &str = ".pruned-";

/// What a prune that was killed had begun to delete.
fn finish_earlier(captures: &Path) -> anyhow::Result<()> {
    for entry in fs::read_dir(captures).map_err(|error| paths::cannot_read(captures, error))?.flatten() {
        let is_folder = entry.file_type().is_ok_and(|kind| kind.is_dir());
        if is_folder && entry.file_name().to_string_lossy().starts_with(HIDDEN) {
            fs::remove_dir_all(entry.path()).map_err(|error| paths::cannot_write(&entry.path(), error))?;
        }
    }
    Ok(())
}

/// Whether every segment that is here lies in the other folder as it was recorded, and is another file.
fn is_whole_in(session: &Session, copy: &Path) -> bool {
    let Ok((others, _)) = sessions_in(copy) else { return false };
    let Some(other) = others.iter().find(|other| other.id == session.id) else { return false };
    let here = session.lines.iter().filter(|line| session.segments.contains_key(&line.name));
    let identity = |path: &Path| fs::metadata(path).ok().map(|is| (is.dev(), is.ino()));
    here.into_iter().all(|line| {
        let (own, copy) = (session.folder.join(&line.name), other.folder.join(&line.name));
        identity(&own) != identity(&copy) && is_as_recorded(&copy, line).is_ok_and(|whole| whole)
    })
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
