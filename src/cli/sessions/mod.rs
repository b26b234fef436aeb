//! `realitysim sessions`: what recordings there are, on a robot and on a dev machine alike.

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
use crate::recording::catalogue::session_at;
use crate::recording::storage::Disk;
use crate::recording::{Session, sessions_of};
use crate::sync::SERVICE_CAPTURES;

/// What recordings there are, on the robot and on the dev machine
#[derive(Args)]
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

/// Where sessions are.
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

    /// A session by its name in the folder, or by its path.
    fn session(&self, name: &str) -> anyhow::Result<Session> {
        session_at(&self.path(name)?).map_err(|why| UsageError(why.to_string()).into())
    }

    /// Of the sessions named, or of all that are there, whatever state they are in.
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

    fn path(&self, name: &str) -> anyhow::Result<PathBuf> {
        let path = if name.contains('/') { PathBuf::from(name) } else { self.folder()?.join(name) };
        Ok(std::path::absolute(&path)?)
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
