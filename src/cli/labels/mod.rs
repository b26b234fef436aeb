//! Commands `realitysim labels`: annotations for the training of detectors, made out of tags, and what detectors make of them.

mod dataset;
mod make;
mod mine;
mod of_view;
mod png_form;
mod posed_images;
mod preview;
mod propagate;
mod yolo_set;

pub(super) use make::{Format, label_capture};
pub use of_view::label_view;

use anyhow::Context;
use clap::{Args, Subcommand};

use super::Outcome;

/// Make labels for the training of detectors out of a capture's or database's tags
///
/// The tag of a frame says where each line, crossing and goal post is in it, so that nobody has to draw them. Pixels so near to an edge
/// that the tag's covariance does not tell the side, and what stands on the carpet, are marked to be ignored.
///
/// coco: images/ and annotations.json: areas of line, carpet, goal frame, net, hall and own body, boxes, and keypoints of the field.
/// yolo: images/, labels/ and data.yaml with boxes around crossings, marks and goal posts. yolo-seg: outlines of lines. yolo-pose: the
/// field as one object with all its landmarks.
/// png: images/, classes/ (a gray picture for each image), depth/ (16 bits, millimetres, 0 is not known), keypoints.csv, border.csv (where
/// the carpet begins in each column). `realitysim view --labels` writes this form of a view.
/// Each has preview.jpg to look at.
#[derive(Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
#[command(after_long_help = concat!(
    "Examples:",
    "\n  realitysim labels captures/2026-11-21T10-00-00Z-robot --format coco -o labels/",
    "\n  realitysim labels images/ --format yolo --classes booster -o labels/",
))]
pub struct LabelsArguments {
    #[command(flatten)]
    make: Option<make::MakeArguments>,
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(Subcommand)]
enum Command {
    Propagate(propagate::PropagateArguments),
    Mine(mine::MineArguments),
}

pub fn run(arguments: &LabelsArguments, json: bool) -> anyhow::Result<Outcome> {
    match &arguments.command {
        Some(Command::Propagate(arguments)) => propagate::run(arguments, json),
        Some(Command::Mine(arguments)) => mine::run(arguments, json),
        None => make::run(arguments.make.as_ref().context("an input is needed")?, json),
    }
}
