//! Command `realitysim export`: writes tags or frames in formats of other programs, and as pictures for people.

mod foxglove;
pub(super) mod frames;
mod images;
mod overlays;
mod route;
mod trainers;
mod tum;
mod video;

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use serde::Serialize;

use super::paths::check_output;
use super::settings::UsageError;
use super::values::number;
use super::{Outcome, output};
use crate::recording::{Loss, Readout, read_tags};
use trainers::Trainer;

/// Write a capture's tags or frames in a form that other programs read, or as pictures
///
/// tum: a text file, `stamp tx ty tz qx qy qz qw` of camera_link in map, valid tags only (evo reads it).
/// images: a folder with one file per frame, tags.csv and tags.jsonl; JPEG and PNG are copied byte for byte, raw
/// frames become PNG. With poses.csv (valid poses that know their half of the field), camera_info.yaml and field.toml it is a
/// folder of images for `db add`.
/// overlays: a folder with a picture per frame: thin lines where its tag puts the field, orange if the tag is invalid, and below
/// where the camera stands, the ellipse that holds it in 95 of 100 cases, and why a tag is invalid.
/// video: the same pictures as a video, made by ffmpeg, in the format of the output's name.
/// foxglove: a folder with a log for Foxglove, Lichtblick, Rerun and RViz, with the camera on the field in 3D and the lines of each tag
/// over its image, and with a layout for the first two.
/// colmap, nerfstudio: a folder from which a program learns the scene (3D Gaussian splatting, NeRF): images, masks of what stands still,
/// lens, poses, seed points and a list of images to be held out; of one image for each 5 cm and 3 degrees. A database may be named
/// instead of a capture.
/// route: a picture of the field with the route, coloured by why tags are invalid, and ellipses.
///
/// What a damaged or incomplete capture no longer holds is named, and the rest written (exit code 3).
#[derive(Args)]
#[command(after_long_help = concat!(
    "Examples:",
    "\n  realitysim export captures/2026-11-21T10-00-00Z-robot --to images -o frames/",
    "\n  realitysim export captures/2026-11-21T10-00-00Z-robot --to video -o walk.mp4",
))]
pub struct ExportArguments {
    /// A capture's folder, or one of its segments; of colmap and nerfstudio also a database's folder
    capture: PathBuf,
    /// What to write
    #[arg(long)]
    to: Format,
    /// File (tum, video, route) or folder (the others) to write, outside of any capture
    #[arg(short, long)]
    output: PathBuf,
    /// Of colmap and nerfstudio: only images whose place is known this well, standard deviation, 0.001 to 1 [default: 0.01]
    #[arg(long, value_name = "M", value_parser = number(0.001..=1.0))]
    max_sigma: Option<f64>,
}

/// Standard deviation of the place of images for training: more blurs what is learnt, metres.
pub const TRAINING_SIGMA_M: f64 = 0.01;

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum Format {
    Tum,
    Images,
    Overlays,
    Video,
    Route,
    Foxglove,
    Colmap,
    Nerfstudio,
}

#[derive(Serialize)]
struct Report {
    output: PathBuf,
    written: usize,
    lost: Vec<Loss>,
}

pub fn run(arguments: &ExportArguments, json: bool) -> anyhow::Result<Outcome> {
    let ExportArguments { capture, output, to, max_sigma } = arguments;
    check_output(output, &[capture])?;
    if max_sigma.is_some() && ![Format::Colmap, Format::Nerfstudio].contains(to) {
        return Err(
            UsageError("--max-sigma is for --to colmap and nerfstudio: the others write all tags".to_owned()).into()
        );
    }
    let max_sigma_m = max_sigma.unwrap_or(TRAINING_SIGMA_M);
    let tags = || read_tags(capture);
    let (written, lost) = match to {
        Format::Tum => tags().map(|Readout { found, losses, .. }| Ok((tum::tum(&found, output)?, losses)))?,
        Format::Route => {
            tags().map(|Readout { found, losses, .. }| Ok((route::route(capture, &found, output)?, losses)))?
        }
        Format::Images => images::images(capture, &tags()?.found, output),
        Format::Overlays => overlays::overlays(capture, &tags()?.found, output),
        Format::Video => video::video(capture, &tags()?.found, output),
        Format::Foxglove => foxglove::foxglove(capture, &tags()?.found, output),
        Format::Colmap => trainers::training_set(capture, Trainer::Colmap, max_sigma_m, output),
        Format::Nerfstudio => trainers::training_set(capture, Trainer::Nerfstudio, max_sigma_m, output),
    }?;
    output::losses(&lost);
    let report = Report { output: output.clone(), written, lost };
    if json {
        output::json(&report)?;
    } else {
        output::lines(&format!("{written} written to {}", report.output.display()))?;
    }
    Ok(Outcome::of(&report.lost))
}
