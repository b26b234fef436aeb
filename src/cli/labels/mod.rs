//! Command `realitysim labels`: makes annotations for the training of detectors out of tags.

mod dataset;
mod of_view;
mod png_form;
mod preview;

pub use of_view::label_view;

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use serde::Serialize;

use super::export::frames::{clear_folder, own_folder};
use super::opened_database::OpenedDatabase;
use super::paths::check_output;
use super::settings::UsageError;
use super::values::number;
use super::{Outcome, output};
use crate::database::TagLimits;
use crate::recording::Loss;

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
#[command(after_long_help = concat!(
    "Examples:",
    "\n  realitysim labels captures/2026-11-21T10-00-00Z-robot --format coco -o labels/",
    "\n  realitysim labels images/ --format yolo --classes booster -o labels/",
))]
pub struct LabelsArguments {
    /// A capture's folder, one of its segments, or a database's folder
    input: PathBuf,
    /// Form of the labels
    #[arg(long)]
    format: Format,
    /// Folder to write, outside of any capture
    #[arg(short, long)]
    output: PathBuf,
    /// Of yolo: a class for each kind of landmark, or the classes of Booster's RoboCup demo [default: landmarks]
    #[arg(long)]
    classes: Option<Classes>,
    /// Only images whose place is known this well: standard deviation along its longer axis, 0.001 to 1
    #[arg(long, value_name = "M", default_value_t = TagLimits::default().sigma_m, value_parser = number(0.001..=1.0))]
    max_sigma: f64,
}

/// Folder of the images, from which YOLO's programs find the labels.
const IMAGES: &str = "images";

#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
enum Format {
    Coco,
    Yolo,
    YoloSeg,
    YoloPose,
    Png,
}

#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
enum Classes {
    Landmarks,
    Booster,
}

#[derive(Serialize)]
struct Report {
    output: PathBuf,
    images: usize,
    /// Images whose place is not known well enough.
    imprecise: usize,
    /// Number of landmarks that can be seen, over all images.
    visible_landmarks: usize,
    /// Median standard deviation of these, pixels.
    sigma_px: Option<f64>,
    /// Share of the pixels that are ignored.
    ignored_share: f64,
    /// Images a second, pictures and labels written.
    images_per_s: f64,
    lost: Vec<Loss>,
}

pub fn run(arguments: &LabelsArguments, json: bool) -> anyhow::Result<Outcome> {
    let LabelsArguments { input, output, max_sigma, .. } = arguments;
    check_output(output, &[input])?;
    if arguments.classes.is_some() && arguments.format != Format::Yolo {
        return Err(
            UsageError("--classes is for --format yolo: the other forms have classes of their own".to_owned()).into()
        );
    }
    own_folder(output)?;
    let report = OpenedDatabase::of(input, *max_sigma).and_then(|opened| dataset::label_all(arguments, &opened));
    if report.is_err() {
        clear_folder(output);
    }
    let report = report?;
    output::losses(&report.lost);
    if json {
        output::json(&report)?;
    } else {
        let Report { images, imprecise, visible_landmarks, sigma_px, ignored_share, images_per_s, .. } = &report;
        let sigma = sigma_px.map_or(String::new(), |sigma| format!(", known to {sigma:.2} px (median)"));
        output::lines(&format!(
            "{images} images labelled in {}, {images_per_s:.0} a second; {imprecise} left out, whose place is not known well enough\n\
             {visible_landmarks} landmarks to be seen{sigma}; {:.1} % of the pixels are to be ignored",
            report.output.display(),
            100.0 * ignored_share
        ))?;
    }
    Ok(Outcome::of(&report.lost))
}
