//! Command `realitysim scene`: checks scene files and applies their effects.

mod apply;
mod check;

use clap::{Args, Subcommand};

use super::Outcome;

/// What scenes are made of, what that costs, and the same on stored images
#[derive(Args)]
#[command(after_long_help = "Example:\n  realitysim scene check replay/scenes/crowded.toml")]
pub struct SceneArguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Check(check::CheckArguments),
    Apply(apply::ApplyArguments),
}

pub fn run(arguments: &SceneArguments, json: bool) -> anyhow::Result<Outcome> {
    match &arguments.command {
        Command::Check(arguments) => check::run(arguments, json),
        Command::Apply(arguments) => apply::run(arguments, json),
    }
}
