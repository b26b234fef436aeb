//! Command `realitysim log`: looks into logs, cuts pieces out of them, and plays them to devices.

mod cut;
mod info;
mod play;

use clap::{Args, Subcommand};

use super::Outcome;

/// Look into a log, cut a piece out of it, play it to devices
#[derive(Args)]
#[command(after_long_help = "Example:\n  realitysim log info my_bag/")]
pub struct LogArguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Info(info::InfoArguments),
    Cut(Box<cut::CutArguments>),
    Play(play::PlayArguments),
}

pub fn run(arguments: &LogArguments, json: bool) -> anyhow::Result<Outcome> {
    match &arguments.command {
        Command::Info(arguments) => info::run(arguments, json),
        Command::Cut(arguments) => cut::run(arguments, json),
        Command::Play(arguments) => play::run(arguments, json),
    }
}
