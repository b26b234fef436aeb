//! Command `realitysim log play`: plays a capture or trajectory to a robot's devices.

use std::path::{Path, PathBuf};

use clap::Args;
use glam::DVec3;

use crate::cli::paths::{cannot_read, check_output};
use crate::cli::settings::UsageError;
use crate::cli::values::{any_whole, whole};
use crate::cli::{Outcome, output};
use crate::config::{Settings, plain_file};
use crate::geometry::{Euler, Isometry};
use crate::live::stop_flag;
use crate::playback::{PlayOptions, PlaySource, Played, play};

/// Play a capture, or a way through a database, to where a robot's devices are
///
/// Images go to a V4L2 output (v4l2loopback, vivid), a new file or a pipe; odometry and attitude as MAVLink to a serial line or pty: software made
/// for the robot runs on them unchanged. In the time of the recording, gaps cut to two seconds.
#[derive(Args)]
#[command(after_long_help = concat!(
    "Examples:",
    "\n  realitysim log play captures/2026-11-21T10-00-00Z-robot --video /dev/video10",
    "\n  realitysim log play way.csv --db images/ --video frames.mjpeg",
))]
pub struct PlayArguments {
    /// A capture, or a .csv with the head t,x,y,z,yaw_deg,pitch_deg,roll_deg: seconds and poses of camera_link in map
    source: PathBuf,
    /// Images go here: /dev/videoN, or a pipe or a new file, which gets one JPEG after the other
    #[arg(long, value_name = "PATH", required_unless_present = "serial")]
    video: Option<PathBuf>,
    /// Odometry and attitude go here, as MAVLink
    #[arg(long, value_name = "DEVICE")]
    serial: Option<String>,
    /// Speed of the serial line
    #[arg(long, value_name = "BAUD", default_value_t = 921_600, value_parser = any_whole::<u32>)]
    baud: u32,
    /// Of a .csv: the database that its images come from
    #[arg(long, value_name = "DIR")]
    db: Option<PathBuf>,
    /// Times as fast as it was, 0.01 to 100
    #[arg(long, value_name = "TIMES", default_value_t = 1.0, value_parser = speed_factor)]
    speed: f64,
    /// MAVLink's number of the robot
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = whole(1..=255u8))]
    system: u8,
    /// Robot config, for its section [views]
    #[arg(long, value_name = "FILE")]
    config: Option<String>,
}

/// Longest trajectory, seconds: a day.
const MAX_S: f64 = 86_400.0;
const HEAD: &str = "t,x,y,z,yaw_deg,pitch_deg,roll_deg";

fn speed_factor(text: &str) -> Result<f64, String> {
    let value: Option<f64> = text.parse().ok().filter(|value| (0.01..=100.0).contains(value));
    value.ok_or_else(|| "0.01 to 100".to_owned())
}

pub fn run(arguments: &PlayArguments, json: bool) -> anyhow::Result<Outcome> {
    let PlayArguments { source, video, serial, baud, db, speed, system, config } = arguments;
    let settings = config.as_deref().map_or(Ok(Settings::default()), Settings::load)?;
    for output in [video.clone(), serial.as_ref().map(PathBuf::from)].into_iter().flatten() {
        let read = [Some(source.as_path()), db.as_deref(), config.as_deref().map(Path::new)];
        check_output(&output, &read.into_iter().flatten().collect::<Vec<_>>())?;
    }
    let source = match (source.extension().is_some_and(|ending| ending == "csv"), db) {
        (false, None) => PlaySource::Capture(source.clone()),
        (true, Some(db)) => {
            PlaySource::Trajectory { poses: read_trajectory(source)?, database: db.clone(), settings: settings.views }
        }
        (true, None) => {
            return Err(UsageError("a way needs the database that its images come from: --db".to_owned()).into());
        }
        (false, Some(_)) => {
            return Err(UsageError("--db is for a way (.csv); a capture has its own images".to_owned()).into());
        }
    };
    let serial = serial.as_ref().map(|device| (device.clone(), *baud));
    let options = PlayOptions { source, video: video.clone(), serial, speed: *speed, system: *system };
    let played = play(&options, &*stop_flag()?)?;
    if json {
        output::json(&played)?;
    } else {
        let Played { images, odometry, attitudes, lost, late, doubtful, doubt, seconds } = &played;
        output::lines(&format!(
            "{images} images, {odometry} odometry, {attitudes} attitudes in {seconds:.1} s; {lost} lost, {late} late"
        ))?;
        if let Some(why) = doubt {
            output::lines(&format!("{doubtful} of the images are to be doubted, the first because {why}"))?;
        }
    }
    Ok(if played.lost > 0 { Outcome::DataLost } else { Outcome::Whole })
}

/// Largest file of a trajectory, enough for a million poses.
const MAX_TABLE_BYTES: u64 = 256 << 20;

fn read_trajectory(path: &Path) -> anyhow::Result<Vec<(f64, Isometry)>> {
    let text = plain_file::read_text(path, MAX_TABLE_BYTES).map_err(|error| cannot_read(path, error))?;
    let wrong = |line: usize, what: String| UsageError(format!("{}: line {line}: {what}", path.display()));
    let mut lines = text.trim_start_matches('\u{feff}').lines().enumerate().map(|(i, line)| (i + 1, line.trim()));
    match lines.next() {
        Some((_, HEAD)) => {}
        found => {
            return Err(wrong(
                1,
                format!("the head is {:?}, and {HEAD:?} is needed", found.map_or("", |(_, head)| head)),
            )
            .into());
        }
    }
    let mut poses: Vec<(f64, Isometry)> = Vec::new();
    for (line, text) in lines.filter(|(_, text)| !text.is_empty()) {
        let number = |cell: &str| cell.trim().parse().ok().filter(|x: &f64| x.is_finite());
        let numbers: Option<Vec<f64>> = text.split(',').map(number).collect();
        let Some([t, x, y, z, yaw, pitch, roll]) =
            numbers.as_deref().and_then(|numbers| <[f64; 7]>::try_from(numbers).ok())
        else {
            return Err(wrong(line, format!("seven finite numbers are needed: {HEAD}")).into());
        };
        if t > MAX_S {
            return Err(wrong(line, format!("t is {t}: a way lasts {MAX_S} s at most")).into());
        }
        if t < poses.last().map_or(0.0, |(before, _)| *before) {
            return Err(wrong(line, format!("t is {t}: times begin at 0 or later and go up")).into());
        }
        let euler = Euler { yaw: yaw.to_radians(), pitch: pitch.to_radians(), roll: roll.to_radians() };
        poses.push((t, Isometry::from_euler(euler, DVec3::new(x, y, z))));
    }
    if poses.is_empty() {
        return Err(wrong(2, "there is no pose".to_owned()).into());
    }
    Ok(poses)
}
