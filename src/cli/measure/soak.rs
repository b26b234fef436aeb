//! Command `realitysim measure soak`: load test of the recorder on this disk.

use std::io::Write;
use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use serde_json::json;

use crate::cli::settings::SettingsArguments;
use crate::cli::values::{any_number, whole};
use crate::cli::{Outcome, output};
use crate::soak::{SoakOptions, soak};

/// Record a made-up stream in real time: does this disk keep up, and what does recording cost?
///
/// Frames of the size of JPEGs (or raw ones), measurements and tags go through the recorder as on the robot; the session
/// stays in DIR. Ends with 3 if a frame was dropped, with 1 if it cost more than it may.
#[derive(Args)]
#[command(after_long_help = "Example:\n  realitysim measure soak -o captures/ --seconds 60")]
pub struct SoakArguments {
    /// Where the session is made
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// How long, in seconds
    #[arg(long, value_name = "S", default_value_t = 10.0, allow_negative_numbers = true, value_parser = any_number)]
    seconds: f64,
    /// Frames a second
    #[arg(long, value_name = "N", default_value_t = 60, value_parser = whole(1..=1000u32))]
    rate: u32,
    /// Of a frame: 80 as a JPEG of 640 x 480, 2400 raw pixels of 1280 x 960
    #[arg(long, value_name = "KIB", default_value_t = 80, value_parser = whole(1..=65_536u32))]
    frame_kb: u32,
    /// Inertial measurements a second
    #[arg(long, value_name = "N", default_value_t = 500, value_parser = whole(0..=10_000u32))]
    imu: u32,
    /// The most that it may cost, of one core
    #[arg(long, value_name = "PERCENT", value_parser = percent)]
    max_core_percent: Option<f64>,
    /// A line of JSON with the recorder's state, ten times a second
    #[arg(long)]
    states: bool,
    #[command(flatten)]
    settings: SettingsArguments,
}

/// Longest load test, seconds: a day.
const MAX_SECONDS: f64 = 86_400.0;

pub fn run(arguments: &SoakArguments, json: bool) -> anyhow::Result<Outcome> {
    let options = SoakOptions {
        captures: arguments.output.clone(),
        settings: arguments.settings.resolve()?,
        duration: Duration::from_secs_f64(arguments.seconds.clamp(0.0, MAX_SECONDS)),
        frames_per_s: arguments.rate,
        frame_bytes: arguments.frame_kb as usize * 1024,
        imu_per_s: arguments.imu,
    };
    let mut stdout = std::io::stdout();
    let report = soak(&options, &mut |state| {
        if arguments.states {
            // A closed standard output does not stop the test.
            let _ = writeln!(stdout, "{}", json!(state));
        }
    })?;
    let dropped = report.counts.all_dropped();
    if json {
        output::json(&report)?;
    } else {
        let recorder = &report.recorder;
        output::lines(&format!(
            "{}\n{:.0} s: {} frames captured, {} written, {dropped} dropped; {:.2} MB/s\n{:.1} % of a core; worst stall of the \
             disk {:.0} ms; a power cut would have cost {:.2} s at worst",
            report.session.display(),
            report.seconds,
            report.counts.captured,
            report.counts.written,
            report.bytes_per_s / 1e6,
            100.0 * report.core_share,
            recorder.worst_stall_ms,
            recorder.worst_unsynced_ms / 1e3,
        ))?;
    }
    let cost_percent = 100.0 * report.core_share;
    if let Some(most) = arguments.max_core_percent.filter(|most| cost_percent > *most) {
        eprintln!("realitysim: recording cost {cost_percent:.1} % of a core, and {most} % are allowed");
        return Ok(Outcome::NotReached);
    }
    Ok(if dropped > 0 || !report.counts.lost.is_empty() { Outcome::DataLost } else { Outcome::Whole })
}

fn percent(text: &str) -> Result<f64, String> {
    let percent: f64 = text.parse().map_err(|_| "not a number".to_owned())?;
    if percent > 0.0 { Ok(percent) } else { Err("more than 0".to_owned()) }
}
