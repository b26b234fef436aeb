//! Command `realitysim labels`: makes annotations for the training of detectors out of tags.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use serde::Serialize;

use super::super::export::frames::fill_own_folder;
use super::super::opened_database::OpenedDatabase;
use super::super::paths::check_output;
use super::super::settings::UsageError;
use super::super::values::number;
use super::super::{Outcome, output};
use super::dataset;
use crate::database::TagLimits;
use crate::labels::{BOOSTER_CLASSES, ClassList, LANDMARK_CLASSES};
use crate::recording::Loss;

/// What labels are made of, and in which form.
#[derive(Args)]
pub struct MakeArguments {
    /// A capture's folder, one of its segments, or a database's folder
    pub(super) input: PathBuf,
    /// Form of the labels
    #[arg(long)]
    pub(super) format: Format,
    /// Folder to write, outside of any capture
    #[arg(short, long)]
    pub(super) output: PathBuf,
    /// Of yolo: a class for each kind of landmark, or the classes of Booster's RoboCup demo [default: landmarks]
    #[arg(long)]
    pub(super) classes: Option<Classes>,
    /// Only images whose place is known this well: standard deviation along its longer axis, 0.001 to 1
    #[arg(long, value_name = "M", default_value_t = TagLimits::default().sigma_m, value_parser = number(0.001..=1.0))]
    pub(super) max_sigma: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
pub(in super::super) enum Format {
    Coco,
    Yolo,
    YoloSeg,
    YoloPose,
    Png,
}

#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
pub(super) enum Classes {
    Landmarks,
    Booster,
}

impl Classes {
    /// Names and numbers of the classes.
    pub(super) fn list(self) -> ClassList {
        match self {
            Self::Landmarks => LANDMARK_CLASSES,
            Self::Booster => BOOSTER_CLASSES,
        }
    }
}

#[derive(Serialize)]
pub(in super::super) struct Report {
    pub(in super::super) output: PathBuf,
    pub(in super::super) images: usize,
    /// Images whose place is not known well enough.
    pub(in super::super) imprecise: usize,
    /// Number of landmarks that can be seen, over all images.
    pub(in super::super) visible_landmarks: usize,
    /// Median standard deviation of these, pixels.
    pub(in super::super) sigma_px: Option<f64>,
    /// Share of the pixels that are ignored.
    pub(in super::super) ignored_share: f64,
    /// Images a second, pictures and labels written.
    pub(super) images_per_s: f64,
    pub(in super::super) lost: Vec<Loss>,
}

/// Labels a capture into a folder that is there, with all other arguments of the command as they are by default.
pub(in super::super) fn label_capture(
    capture: &Path,
    folder: &Path,
    format: Format,
    progress: &mut dyn FnMut(u64),
) -> anyhow::Result<Report> {
    let max_sigma = TagLimits::default().sigma_m;
    let (input, output) = (capture.to_owned(), folder.to_owned());
    let arguments = MakeArguments { input, format, output, classes: None, max_sigma };
    // Reading and labelling both take a look at each image.
    let mut read = 0;
    let opened = OpenedDatabase::read(capture, max_sigma, &mut |done| {
        read = done;
        progress(done);
    })?;
    dataset::label_all(&arguments, &opened, &mut |done, _| progress(read + done))
}

pub fn run(arguments: &MakeArguments, json: bool) -> anyhow::Result<Outcome> {
    let MakeArguments { input, output, max_sigma, .. } = arguments;
    check_output(output, &[input])?;
    if arguments.classes.is_some() && arguments.format != Format::Yolo {
        return Err(
            UsageError("--classes is for --format yolo: the other forms have classes of their own".to_owned()).into()
        );
    }
    let mut progress = output::Progress::new("labelling");
    let report = fill_own_folder(output, || {
        let opened = OpenedDatabase::of(input, *max_sigma)?;
        dataset::label_all(arguments, &opened, &mut |done, all| progress.set(done, Some(all)))
    })?;
    progress.finish();
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
