//! What lies in a folder of captures.

mod repair;
mod verify;

use clap::{Args, Subcommand};

use super::Outcome;

/// Look after recorded sessions
#[derive(Args)]
pub struct SessionsArguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Repair(repair::RepairArguments),
    Verify(verify::VerifyArguments),
}

pub fn run(arguments: &SessionsArguments, json: bool) -> anyhow::Result<Outcome> {
    match &arguments.command {
        Command::Repair(arguments) => repair::run(arguments, json),
        Command::Verify(arguments) => verify::run(arguments, json),
    }
}
