//! Command `realitysim scene render`: renders a scene into a log with ground truth.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use clap::Args;
use serde::Serialize;

use crate::cli::paths::{cannot_write, check_output, check_replaceable};
use crate::cli::{Outcome, output};
use crate::log_input::scene_source::{self, SceneSource};
use crate::ros2::mcap_write::{LogWriter, RawChannel, WriteError};
use crate::scene::Scene;

/// Render a scene into a log with ground truth
///
/// A scene file names field, lens, camera mount, route and effects (replay/scenes/*.toml are examples). The log is
/// what a robot would have recorded, as ROS 2 MCAP, with the true poses on /ground_truth/camera_pose.
#[derive(Args)]
#[command(after_long_help = "Example:\n  realitysim scene render replay/scenes/straight.toml -o straight.mcap")]
pub struct RenderArguments {
    /// A scene file
    #[arg(value_name = "SCENE")]
    scene: String,
    /// The log to write
    #[arg(short, long, value_name = "LOG")]
    output: PathBuf,
}

#[derive(Serialize)]
pub struct Report {
    log: PathBuf,
    frames: u64,
    duration_s: f64,
    wall_s: f64,
}

pub fn run(arguments: &RenderArguments, json: bool) -> anyhow::Result<Outcome> {
    check_output(&arguments.output, &[Path::new(&arguments.scene)])?;
    let report = render(&scene_source::load(&arguments.scene)?, &arguments.output)?;
    if json {
        output::json(&report)?;
    } else {
        let Report { log, frames, duration_s, wall_s } = &report;
        output::lines(&format!(
            "{frames} frames, {duration_s:.1} s of walking, rendered in {wall_s:.1} s\n{}",
            log.display()
        ))?;
    }
    Ok(Outcome::Whole)
}

pub fn render(scene: &Scene, log: &Path) -> anyhow::Result<Report> {
    let started = std::time::Instant::now();
    let failed = |error| match error {
        WriteError::Io(error) => cannot_write(log, error),
        error => anyhow::Error::new(error).context(log.display().to_string()),
    };
    check_replaceable(log, mcap::MAGIC)?;
    let file = File::create(log).map_err(|error| cannot_write(log, error))?;
    let mut writer = LogWriter::new(BufWriter::with_capacity(1 << 20, file)).map_err(failed)?;
    let mut channels = BTreeMap::new();
    let mut progress = output::Progress::new("rendering");
    let mut frames = 0;
    for message in SceneSource::new(scene) {
        let message = message?;
        let channel = &message.channel;
        let id = match channels.get(&channel.id) {
            Some(id) => *id,
            None => {
                let id = writer.add_raw_channel(&RawChannel::from(channel.as_ref())).map_err(failed)?;
                channels.insert(channel.id, id);
                id
            }
        };
        writer
            .write(id, message.sequence, message.log_time_ns, message.publish_time_ns, &message.data)
            .map_err(failed)?;
        if channel.type_name.ends_with("Image") {
            frames += 1;
            progress.set(frames, Some(scene.frame_count()));
        }
    }
    writer.finish().map_err(failed)?;
    progress.finish();
    Ok(Report { log: log.to_owned(), frames, duration_s: scene.duration_s(), wall_s: started.elapsed().as_secs_f64() })
}
