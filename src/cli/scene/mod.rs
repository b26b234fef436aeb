//! `realitysim scene`

mod check;

use clap::{Args, Subcommand};

use super::Outcome;

/// Look at scenes: what they are made of and what that costs
#[derive(Args)]
pub struct SceneArguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Check(check::CheckArguments),
}

pub fn run(arguments: &SceneArguments, json: bool) -> anyhow::Result<Outcome> {
    match &arguments.command {
        Command::Check(arguments) => check::run(arguments, json),
    }
}
