//! Command `realitysim measure`: how good tags, views and recorder are, and under what conditions they fail.

mod accuracy;
mod contrast;
mod cost;
mod falsify;
mod gap;
mod paper;
mod soak;
mod view_walk;
mod views;

use clap::{Args, Subcommand};

use super::Outcome;

/// Measure how good tags, views and recorder are
#[derive(Args)]
#[command(after_long_help = "Example:\n  realitysim measure cost my_bag/ --budget-ms 8 --field kid-2020")]
pub struct MeasureArguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Accuracy(accuracy::AccuracyArguments),
    Cost(Box<cost::CostArguments>),
    Contrast(contrast::ContrastArguments),
    Falsify(falsify::FalsifyArguments),
    Paper(paper::PaperArguments),
    Views(views::ViewsArguments),
    ViewWalk(view_walk::ViewWalkArguments),
    Gap(gap::GapArguments),
    Soak(Box<soak::SoakArguments>),
}

pub fn run(arguments: &MeasureArguments, json: bool) -> anyhow::Result<Outcome> {
    match &arguments.command {
        Command::Accuracy(arguments) => accuracy::run(arguments, json),
        Command::Cost(arguments) => cost::run(arguments, json),
        Command::Contrast(arguments) => contrast::run(arguments, json),
        Command::Falsify(arguments) => falsify::run(arguments, json),
        Command::Paper(arguments) => paper::run(arguments, json),
        Command::Views(arguments) => views::run(arguments, json),
        Command::ViewWalk(arguments) => view_walk::run(arguments, json),
        Command::Gap(arguments) => gap::run(arguments, json),
        Command::Soak(arguments) => soak::run(arguments, json),
    }
}
