//! Command `realitysim log cut`: cuts a piece out of a log so that it replays to the same tags.

use std::path::{Path, PathBuf};

use clap::Args;

use crate::cli::host_info::cores;
use crate::cli::settings::{SettingsArguments, UsageError};
use crate::cli::values::{any_number, whole};
use crate::cli::{Outcome, output, paths};
use crate::recording::{read_info, session_holding};
use crate::tagging::cut::{self, CutOptions};

/// Cut a piece out of a long recording, as a log that replays to the same tags
///
/// Takes along what a replay needs: calibration, transforms, the filter's state at the start, and the true poses if there
/// are any. The piece begins up to a second earlier than asked for. What was recorded with a config of its own is cut, and
/// later replayed, with that config; a capture knows its own.
#[derive(Args)]
#[command(after_long_help = concat!(
    "Example:",
    "\n  realitysim log cut captures/2026-11-21T10-00-00Z-robot --from 12 --to 20 -o fall.mcap",
))]
pub struct CutArguments {
    /// A capture, a log or a folder of logs
    #[arg(value_name = "CAPTURE|LOG")]
    source: PathBuf,
    /// Where the piece begins, in seconds after the first message
    #[arg(long, value_name = "S", allow_negative_numbers = true, value_parser = any_number)]
    from: f64,
    /// Where it ends, in seconds after the first message
    #[arg(long, value_name = "S", allow_negative_numbers = true, value_parser = any_number)]
    to: f64,
    /// The log to write
    #[arg(short, long, value_name = "LOG")]
    output: PathBuf,
    /// Encode the images anew with this JPEG quality, 1 to 100, where that makes them smaller. The piece is a test of its own
    /// then: its tags are near those of the recording, but not the same
    #[arg(long, value_name = "Q", value_parser = whole(1..=100u8))]
    jpeg_quality: Option<u8>,
    #[command(flatten)]
    settings: SettingsArguments,
}

pub fn run(arguments: &CutArguments, json: bool) -> anyhow::Result<Outcome> {
    let CutArguments { source, from, to, .. } = arguments;
    // Written so that a NaN is refused, too.
    if !(*from >= 0.0 && to > from && to.is_finite()) {
        return Err(UsageError(format!(
            "--from {from} --to {to}: the piece must begin at 0 or later, and end after that"
        ))
        .into());
    }
    let named = arguments.settings.files();
    let inputs: Vec<&Path> = named.iter().map(PathBuf::as_path).chain([source.as_path()]).collect();
    paths::check_output(&arguments.output, &inputs)?;
    paths::check_replaceable(&arguments.output, mcap::MAGIC)?;
    let settings = match session_holding(source) {
        Some(session) => read_info(&session)?.settings,
        None => arguments.settings.resolve()?,
    };
    let temporary = paths::temporary()?;
    let options = CutOptions {
        source: source.clone(),
        output: arguments.output.clone(),
        temporary: temporary.path().to_owned(),
        settings,
        from_s: *from,
        to_s: *to,
        jpeg_quality: arguments.jpeg_quality,
        threads: cores(),
    };
    let mut progress = output::Progress::new("tracking");
    let report = cut::cut(&options, &mut |done, total| progress.set(done, total))?;
    progress.finish();
    if json {
        output::json(&report)?;
    } else {
        output::lines(&format!(
            "{} frames, {:.2} to {:.2} s, {:.1} MB\n{}",
            report.frames,
            report.from_s,
            report.to_s,
            report.bytes as f64 / 1e6,
            report.log.display()
        ))?;
    }
    Ok(Outcome::Whole)
}
