//! `realitysim sessions`: lists and maintains recorded sessions, on a robot and on a development machine alike.

mod list;
mod pin;
mod prune;
mod repair;
mod show;
mod verify;

use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};

use super::Outcome;
use super::settings::UsageError;
use crate::recording::sessions::session_at;
use crate::recording::storage::{Disk, Kind, Storage};
use crate::recording::sync::SERVICE_CAPTURES;
use crate::recording::{ACTIVE, Loss, MANIFEST_FILE, SESSION_FILE, Session, is_segment_name, sessions_of};

/// What recordings there are, on the robot and on the dev machine
#[derive(Args)]
#[command(after_long_help = "Example:\n  realitysim sessions list --captures captures/")]
pub struct SessionsArguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    List(list::ListArguments),
    Show(show::ShowArguments),
    Pin(pin::PinArguments),
    Unpin(pin::UnpinArguments),
    Prune(prune::PruneArguments),
    Repair(repair::RepairArguments),
    Verify(verify::VerifyArguments),
}

/// Folder in which sessions are looked for.
#[derive(Args)]
struct CapturesArguments {
    /// Where captures are kept; without it the service's folder on a robot, `captures` elsewhere
    #[arg(long, value_name = "CAPTURES_DIR")]
    captures: Option<PathBuf>,
}

impl CapturesArguments {
    fn folder(&self) -> Result<PathBuf, UsageError> {
        let folder = self.captures.clone().unwrap_or_else(|| {
            let service = Path::new(SERVICE_CAPTURES);
            if service.is_dir() { service.to_owned() } else { PathBuf::from("captures") }
        });
        if folder.is_dir() {
            return Ok(folder);
        }
        Err(UsageError(format!("{}: there is no such folder: name the captures with --captures", folder.display())))
    }

    /// Returns a session by its path, its name in the folder, or the beginning of its name.
    fn session(&self, name: &str) -> anyhow::Result<Session> {
        session_at(&self.path(name)?).map_err(|why| UsageError(why.to_string()).into())
    }

    /// Paths of the named sessions, or of all sessions in any state.
    fn paths(&self, names: &[String]) -> anyhow::Result<Vec<PathBuf>> {
        if names.is_empty() {
            return Ok(sessions_of(&Disk, &self.folder()?));
        }
        let paths = names.iter().map(|name| self.path(name)).collect::<anyhow::Result<Vec<_>>>()?;
        match paths.iter().find(|path| !path.is_dir()) {
            Some(path) => Err(UsageError(format!("{}: no such session", path.display())).into()),
            None => Ok(paths),
        }
    }

    /// Reports folders that look like sessions but lack a usable session.json, so that no command handles them. With names
    /// given, `path` has reported them.
    fn headless(&self, names: &[String]) -> anyhow::Result<Vec<Loss>> {
        if !names.is_empty() {
            return Ok(Vec::new());
        }
        let captures = self.folder()?;
        let folders = Disk.list(&captures).unwrap_or_default().into_iter().filter(|entry| entry.kind == Kind::Folder);
        let said = |folder: &Path| {
            let inside = Disk.list(folder).unwrap_or_default();
            let there = |name: &str| inside.iter().find(|entry| entry.name == name).map(|entry| entry.kind);
            match there(SESSION_FILE) {
                Some(Kind::File(_)) => None,
                Some(_) => Some(format!("its {SESSION_FILE} is no plain file: nothing is done to it")),
                None => {
                    let is_recorded =
                        |name: &str| name == MANIFEST_FILE || is_segment_name(name.trim_end_matches(ACTIVE));
                    let is_session = inside.iter().any(|entry| is_recorded(&entry.name));
                    is_session.then(|| format!("has no {SESSION_FILE}: nothing is done to it"))
                }
            }
        };
        let folders = folders.filter(|entry| !entry.name.starts_with('.')).map(|entry| captures.join(entry.name));
        Ok(folders.filter_map(|folder| Some(Loss::new(&folder, said(&folder)?))).collect())
    }

    fn path(&self, name: &str) -> anyhow::Result<PathBuf> {
        let path = if name.contains('/') {
            PathBuf::from(name)
        } else {
            let folder = self.folder()?;
            let sessions = sessions_of(&Disk, &folder);
            let names = sessions.iter().filter_map(|path| path.file_name()?.to_str());
            folder.join(full_name(name, names)?.unwrap_or(name))
        };
        Ok(std::path::absolute(&path)?)
    }
}

/// Returns the only name that equals or begins with the text; `None` if there is none.
fn full_name<'a>(asked: &str, names: impl Iterator<Item = &'a str> + Clone) -> Result<Option<&'a str>, UsageError> {
    if let Some(exact) = names.clone().find(|name| *name == asked) {
        return Ok(Some(exact));
    }
    let meant: Vec<&str> = names.filter(|name| !asked.is_empty() && name.starts_with(asked)).collect();
    match meant.as_slice() {
        [] => Ok(None),
        [name] => Ok(Some(name)),
        several => Err(UsageError(format!("{asked}: which of them? {}", several.join(", ")))),
    }
}

pub fn run(arguments: &SessionsArguments, json: bool) -> anyhow::Result<Outcome> {
    match &arguments.command {
        Command::List(arguments) => list::run(arguments, json),
        Command::Show(arguments) => show::run(arguments, json),
        Command::Pin(arguments) => pin::pin(arguments, json),
        Command::Unpin(arguments) => pin::unpin(arguments, json),
        Command::Prune(arguments) => prune::run(arguments, json),
        Command::Repair(arguments) => repair::run(arguments, json),
        Command::Verify(arguments) => verify::run(arguments, json),
    }
}
