//! Command `realitysim scene`: renders scenes, checks their files, and applies their effects to stored images.

mod apply;
mod check;
mod render;

use clap::{Args, Subcommand};

use super::Outcome;

pub use render::render;

/// Render scenes, tell what they are made of and what that costs, apply their effects to stored images
#[derive(Args)]
#[command(after_long_help = "Example:\n  realitysim scene check replay/scenes/crowded.toml")]
pub struct SceneArguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Render(render::RenderArguments),
    Check(check::CheckArguments),
    Apply(apply::ApplyArguments),
}

pub fn run(arguments: &SceneArguments, json: bool) -> anyhow::Result<Outcome> {
    match &arguments.command {
        Command::Render(arguments) => render::run(arguments, json),
        Command::Check(arguments) => check::run(arguments, json),
        Command::Apply(arguments) => apply::run(arguments, json),
    }
}
