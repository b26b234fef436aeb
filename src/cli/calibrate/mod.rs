//! Command `realitysim calibrate`: a lens from pictures of a board; lens, mount and field from one walk.

mod board;
mod board_images;
mod files;
mod image_report;
mod maps;
mod report;

use std::path::{Path, PathBuf};

use clap::Args;

use super::paths::{check_output, make_folder, temporary};
use super::settings::{SettingsArguments, UsageError, planar_pose};
use super::{Outcome, output};
use crate::cli::host_info::cores;
use crate::config::Settings;
use crate::geometry::Pose2;
use crate::log_input::InputSource;
use crate::recording::SESSION_FILE;
use crate::tagging::ReplayOptions;
use crate::tagging::walk_calibration::calibrate;
use report::Report;

pub(in crate::cli) use files::mount_text;

/// Find lens, mount and field size from one walk over the lines, or the lens from a calibration board
///
/// --walk: the walk is tagged, everything is fitted at once, and it is tagged again with what was found until nothing changes: lens with
/// distortion, tilt of the mount, height, delay and readout of the camera, scale of odometry, length and width of the field. A lens of
/// which only the angle of view is known (--lens equidistant:180deg) is start enough. Writes into DIR: lens.toml, robot.toml (a
/// robot config), report.txt, report.json, and maps of the image as pictures. What the walk does not determine is named and not
/// written. A capture is calibrated with its own settings.
///
/// --board: pictures of an AprilGrid or ChArUco board (a folder, a video or a log), the board held still in many places until its
/// corners fill the image, at the rim as well. Writes lens.toml, report.txt, report.json and the maps. Of the settings it uses the lens to
/// start from and topics.image.
#[derive(Args)]
#[command(after_long_help = concat!(
    "Examples:",
    "\n  realitysim calibrate --walk my_bag/ --field kid-2020 --lens equidistant:180deg -o calibration/",
    "\n  realitysim calibrate --walk captures/2026-11-21T10-00-00Z-robot -o calibration/",
    "\n  realitysim calibrate --board aprilgrid.yaml pictures/ --lens equidistant:180deg -o calibration/",
))]
pub struct CalibrateArguments {
    /// A log or a capture of a robot that walks, turns and looks around on a field
    #[arg(long, value_name = "LOG|CAPTURE", required_unless_present = "board", conflicts_with = "board")]
    walk: Option<PathBuf>,
    /// A board file: the YAML of Kalibr's aprilgrid, or the same for a ChArUco board (docs/reference/formats.md)
    #[arg(long, value_name = "FILE", requires = "pictures", conflicts_with = "initial")]
    board: Option<PathBuf>,
    /// With --board: pictures of it, as a folder of PNG and JPEG files, a video or a log
    #[arg(value_name = "FOLDER|VIDEO|LOG", requires = "board")]
    pictures: Option<PathBuf>,
    /// Folder for lens, config, report and maps
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Pose of base_footprint at the first frame, in place of what the log announces
    #[arg(long, value_name = "x,y,yaw_deg", value_parser = planar_pose, allow_hyphen_values = true)]
    initial: Option<Pose2>,
    #[command(flatten)]
    settings: SettingsArguments,
}

pub fn run(arguments: &CalibrateArguments, json: bool) -> anyhow::Result<Outcome> {
    let CalibrateArguments { walk, board, pictures, output: folder, initial, settings } = arguments;
    if let (Some(board), Some(pictures)) = (board, pictures) {
        return board::run(board, pictures, folder, &settings.resolve()?, json);
    }
    // The parser of the command line asks for one or the other.
    let walk = walk.as_ref().ok_or_else(|| UsageError("give --walk or --board".to_owned()))?;
    check_output(folder, &[walk])?;
    if InputSource::is_scene(walk) {
        let scene = walk.display();
        return Err(UsageError(format!(
            "{scene}: a log or a capture is needed, and this is a scene: `realitysim scene render {scene} -o walk.mcap` makes a log of it"
        ))
        .into());
    }
    let settings = settings.resolve_for(walk)?;
    check_settings(walk, &settings)?;
    let temporary = temporary()?;
    let options = ReplayOptions {
        source: walk.clone(),
        captures: temporary.path().to_owned(),
        settings,
        initial: *initial,
        threads: cores(),
        realtime: false,
        warm_start: false,
    };
    let mut progress = output::Progress::new("calibrating");
    let found = calibrate(&options, &mut |done, all| progress.set(done, Some(all)))?;
    progress.finish();
    let report = Report::of(&found);
    make_folder(folder)?;
    files::write_all(&found, &report, folder)?;
    output::losses(&found.losses);
    if json {
        output::json(&report)?;
    } else {
        output::lines(&format!("{}{}", report.text(), folder.display()))?;
    }
    Ok(Outcome::of(&found.losses))
}

/// Refuses settings for a capture, which would be ignored.
fn check_settings(walk: &Path, settings: &Settings) -> Result<(), UsageError> {
    if !walk.join(SESSION_FILE).is_file() || *settings == Settings::default() {
        return Ok(());
    }
    let walk = walk.display();
    Err(UsageError(format!("{walk}: a capture is calibrated with its own settings: leave others out, or name the log")))
}
