//! Every frame with its tag as a video, encoded by ffmpeg.

use std::ffi::OsString;
use std::io::{ErrorKind, Write};
use std::path::Path;
use std::process::{Child, Command, Stdio};

use anyhow::bail;

use super::super::paths::check_old;
use super::super::settings::UsageError;
use super::frames::each_drawn_frame;
use super::overlays::TagSheets;
use crate::recording::Loss;
use crate::ros2::mcap_read::LogMessage;
use crate::ros2::messages::FrameTag;

/// Names of files that ffmpeg is asked for: formats for video that players and browsers show.
const ENDINGS: [&str; 4] = ["mp4", "mkv", "mov", "webm"];
/// Smallest and largest rate of a video, frames a second.
const RATES_HZ: [f64; 2] = [1.0, 120.0];
/// Rate of a video of a single frame.
const RATE_OF_ONE_HZ: f64 = 10.0;

/// Writes the video at the rate of the camera. Returns the number of frames, and what was lost.
pub(super) fn video(capture: &Path, tags: &[FrameTag], path: &Path) -> anyhow::Result<(usize, Vec<Loss>)> {
    check_name(path)?;
    check_old(path, is_video)?;
    let sheets = TagSheets::new(capture, tags)?;
    let mut encoder = Encoder::start(path, rate_hz(tags))?;
    let draw = |tag: &FrameTag, message: &LogMessage| sheets.draw(tag, message);
    let written = each_drawn_frame(capture, tags, draw, |_, picture| encoder.write(&picture));
    let written = match written {
        Ok(written) => written,
        Err(error) => {
            encoder.abandon();
            return Err(error);
        }
    };
    encoder.finish()?;
    Ok(written)
}

fn check_name(path: &Path) -> Result<(), UsageError> {
    let ending = path.extension().and_then(|ending| ending.to_str()).map(str::to_ascii_lowercase);
    if ending.is_some_and(|ending| ENDINGS.contains(&ending.as_str())) {
        return Ok(());
    }
    Err(UsageError(format!("{}: the name of a video must end in .{}", path.display(), ENDINGS.join(", ."))))
}

/// Whether a file begins as an MP4 or QuickTime file, or as Matroska and WebM (EBML).
fn is_video(old: &[u8]) -> bool {
    old.get(4..8) == Some(b"ftyp") || old.starts_with(&[0x1a, 0x45, 0xdf, 0xa3])
}

/// Rate of the frames: the inverse of the median time between two.
fn rate_hz(tags: &[FrameTag]) -> f64 {
    let stamps: Vec<i64> = tags.iter().map(|tag| tag.header.stamp.to_nanoseconds()).collect();
    let mut steps: Vec<i64> = stamps.windows(2).map(|pair| pair[1].saturating_sub(pair[0])).collect();
    steps.sort_unstable();
    let median_s = steps.get(steps.len() / 2).map_or(1.0 / RATE_OF_ONE_HZ, |step| 1e-9 * *step as f64);
    (1.0 / median_s.max(1e-6)).clamp(RATES_HZ[0], RATES_HZ[1])
}

/// A running ffmpeg that takes JPEGs.
struct Encoder {
    ffmpeg: Child,
    /// File that ffmpeg writes: the video takes its place once it is whole.
    path: std::path::PathBuf,
    /// Folder of the unfinished video, beside its place; it is removed when this is dropped.
    unfinished: tempfile::TempDir,
}

impl Encoder {
    fn start(path: &Path, rate_hz: f64) -> anyhow::Result<Self> {
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let unfinished = tempfile::Builder::new().prefix(".realitysim-").tempdir_in(folder);
        let unfinished = unfinished.map_err(|error| super::super::paths::cannot_write(path, error.kind().into()))?;
        let mut command = Command::new("ffmpeg");
        command.args([
            "-hide_banner",
            "-loglevel",
            "error",
            "-nostdin",
            "-f",
            "image2pipe",
            "-c:v",
            "mjpeg",
            "-framerate",
        ]);
        command.arg(format!("{rate_hz:.3}"));
        command.args(["-i", "pipe:0", "-pix_fmt", "yuv420p", "-threads", "2"]).arg(target(unfinished.path(), path));
        let started = command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::piped()).spawn();
        match started {
            Ok(ffmpeg) => Ok(Self { ffmpeg, path: path.to_owned(), unfinished }),
            Err(error) if error.kind() == ErrorKind::NotFound => bail!(
                "a video needs the program ffmpeg, which is not installed (`sudo apt install ffmpeg`); `--to overlays` writes the same \
                 pictures without it"
            ),
            Err(error) => bail!("ffmpeg cannot be started: {error}"),
        }
    }

    fn write(&mut self, jpeg: &[u8]) -> anyhow::Result<()> {
        let Some(stdin) = &mut self.ffmpeg.stdin else { return Ok(()) };
        // What is wrong is said by ffmpeg itself, when it ends.
        if stdin.write_all(jpeg).is_err() { self.end() } else { Ok(()) }
    }

    /// Waits for the end of ffmpeg. That it ends otherwise than well is an error, in its own words.
    fn end(&mut self) -> anyhow::Result<()> {
        drop(self.ffmpeg.stdin.take());
        let mut said = String::new();
        if let Some(stderr) = &mut self.ffmpeg.stderr {
            let _ = std::io::Read::read_to_string(stderr, &mut said);
        }
        let status = self.ffmpeg.wait()?;
        if status.success() {
            return Ok(());
        }
        let last = said.lines().rev().find(|line| !line.trim().is_empty()).unwrap_or("it does not say why");
        bail!("{}: ffmpeg made no video of it: {last}", self.path.display())
    }

    fn finish(mut self) -> anyhow::Result<()> {
        self.end()?;
        std::fs::rename(target(self.unfinished.path(), &self.path), &self.path)
            .map_err(|error| super::super::paths::cannot_write(&self.path, error))
    }

    /// Ends ffmpeg after an error of ours.
    fn abandon(mut self) {
        let _ = self.ffmpeg.kill();
        let _ = self.ffmpeg.wait();
    }
}

/// Name of the unfinished video: its ending tells ffmpeg the format.
fn target(folder: &Path, path: &Path) -> OsString {
    let mut name = OsString::from("video.");
    name.push(path.extension().unwrap_or_default().to_ascii_lowercase());
    folder.join(name).into_os_string()
}
