//! Command `realitysim record`, and the commands that talk to a running recorder.

use std::io::Write;
use std::path::PathBuf;

use clap::{Args, Subcommand};

use super::settings::{SettingsArguments, UsageError, check_initial, planar_pose};
use super::status_text::status_text;
use super::values::whole;
use super::{Outcome, output};
use crate::geometry::{Field, Pose2};
use crate::live::{RecordOptions, Status, ask, poses, record, stop_flag};

/// Control socket of the service; a user's own recorder may have another.
pub(super) const SOCKET: &str = "/run/realitysim/control.sock";

/// Record a live camera and tag every frame, on the robot
///
/// Camera, serial ports, lens and mount come from the config. Ends with SIGINT or SIGTERM, with a whole capture. Devices that go
/// away are waited for.
#[derive(Args)]
#[command(after_long_help = "Example:\n  realitysim record -o captures/ --config robot.toml --initial 0,0,0")]
pub struct RecordArguments {
    /// Where captures are kept
    #[arg(short, long, value_name = "CAPTURES_DIR")]
    output: PathBuf,
    /// Threads for decoding and looking at frames; each more makes tags come a frame or two later
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = whole(1..=super::replay::MAX_THREADS))]
    threads: usize,
    /// Pose of base_footprint at the start
    #[arg(long, value_name = "x,y,yaw_deg", value_parser = planar_pose, allow_hyphen_values = true)]
    initial: Option<Pose2>,
    /// Go on from where the last recording into CAPTURES_DIR ended; invalid until lines confirm it
    #[arg(long)]
    warm_start: bool,
    /// Where `status`, `mark` and the others find this recorder
    #[arg(long, value_name = "PATH", default_value = SOCKET)]
    socket: PathBuf,
    #[command(flatten)]
    settings: SettingsArguments,
}

pub fn run(arguments: &RecordArguments, json: bool) -> anyhow::Result<Outcome> {
    let settings = arguments.settings.resolve()?;
    if let Some(initial) = &arguments.initial {
        check_initial(initial, &settings.field, &Field::new(settings.field_dimensions()?)?)?;
    }
    let options = RecordOptions {
        captures: arguments.output.clone(),
        settings,
        initial: arguments.initial,
        threads: arguments.threads,
        warm_start: arguments.warm_start,
        socket: arguments.socket.clone(),
    };
    let stop = stop_flag()?;
    let status = record(&options, &stop, &mut output::say)?;
    if json {
        output::json(&status)?;
    } else {
        output::lines(&status_text(&status))?;
    }
    Ok(if recorder_lost_data(&status) { Outcome::DataLost } else { Outcome::Whole })
}

/// Whether recorded data was lost in any of the recorder's sessions. Frames that the camera dropped do not count, data that
/// could not be written does.
fn recorder_lost_data(status: &Status) -> bool {
    let earlier = &status.earlier;
    status.unfinished.is_some()
        || earlier.unfinished > 0
        || !status.counts.lost.is_empty()
        || !earlier.counts.lost.is_empty()
        || status.recorder.frames_refused > 0
        || earlier.frames_refused > 0
}

/// Ask a running recorder, or tell it something
#[derive(Args)]
#[command(after_long_help = "Example:\n  realitysim recorder status")]
pub struct RecorderArguments {
    #[command(subcommand)]
    pub command: RecorderCommand,
}

/// Commands to a running recorder.
#[derive(Subcommand)]
pub enum RecorderCommand {
    /// How a running recorder is: rates, drops, ports and clocks, the last pose
    #[command(after_long_help = "Example:\n  realitysim recorder status")]
    Status(SocketArguments),
    /// Put a note into the running log
    #[command(after_long_help = "Example:\n  realitysim recorder mark \"second half begins\"")]
    Mark {
        /// What happened
        text: String,
        #[command(flatten)]
        at: SocketArguments,
    },
    /// Say where the robot is: `base_footprint` in `map`, as after kick-off or when it was carried
    #[command(after_long_help = "Example:\n  realitysim recorder place 1.2,-0.3,90")]
    Place {
        /// Metres along and across the field from its centre, and the heading in degrees: on the field or at most 1 m off its
        /// carpet (else exit code 2)
        #[arg(value_name = "x,y,yaw_deg", value_parser = planar_pose, allow_hyphen_values = true)]
        pose: Pose2,
        #[command(flatten)]
        at: SocketArguments,
    },
    /// Begin a session in a recorder that runs
    #[command(after_long_help = "Example:\n  realitysim recorder start")]
    Start(SocketArguments),
    /// End its session; the recorder goes on running
    #[command(after_long_help = "Example:\n  realitysim recorder stop")]
    Stop(SocketArguments),
    /// Every tag as it is made, a line of JSON each
    #[command(after_long_help = "Example:\n  realitysim recorder poses")]
    Poses(SocketArguments),
}

#[derive(Args)]
pub struct SocketArguments {
    /// The recorder's socket
    #[arg(long, value_name = "PATH", default_value = SOCKET)]
    socket: PathBuf,
}

pub fn send_command(command: &RecorderCommand, json: bool) -> anyhow::Result<Outcome> {
    let (line, at) = match command {
        RecorderCommand::Status(at) => ("status".to_owned(), at),
        RecorderCommand::Mark { text, at } => (format!("mark {text}"), at),
        RecorderCommand::Place { pose, at } => (format!("place {},{},{}", pose.x, pose.y, pose.yaw.to_degrees()), at),
        RecorderCommand::Start(at) => ("start".to_owned(), at),
        RecorderCommand::Stop(at) => ("stop".to_owned(), at),
        RecorderCommand::Poses(at) => {
            let stop = std::sync::atomic::AtomicBool::new(false);
            let mut stdout = std::io::stdout().lock();
            let mut printed = Ok(());
            let listened = poses(&at.socket, &stop, |line| {
                printed = writeln!(stdout, "{line}").and_then(|()| stdout.flush());
                if printed.is_err() { Err(std::io::ErrorKind::Interrupted.into()) } else { Ok(()) }
            });
            match (printed, listened) {
                // The reader of the output has ended.
                (Err(error), _) if error.kind() == std::io::ErrorKind::BrokenPipe => {}
                (Err(error), _) => anyhow::bail!("standard output: {error}"),
                (Ok(()), listened) => listened.map_err(|error| unreachable_recorder(at, &error))?,
            }
            return Ok(Outcome::Whole);
        }
    };
    let answer = ask(&at.socket, &line).map_err(|error| unreachable_recorder(at, &error))?;
    match answer["error"].as_str() {
        Some(error) if answer["usage"] == true => return Err(UsageError(error.to_owned()).into()),
        Some(error) => anyhow::bail!("{error}"),
        None => {}
    }
    if json {
        output::json(&answer)?;
    } else if matches!(command, RecorderCommand::Status(_)) {
        let status: Status = serde_json::from_value(answer.clone())
            .map_err(|error| anyhow::anyhow!("{}: the recorder is of another version: {error}", at.socket.display()))?;
        output::lines(&status_text(&status))?;
    } else if let Some(session) = answer["session"].as_str() {
        output::lines(session)?;
    }
    match answer["unfinished"].as_str().filter(|_| matches!(command, RecorderCommand::Stop(_))) {
        None => Ok(Outcome::Whole),
        Some(why) => {
            eprintln!("realitysim: the session is not whole: {why}");
            Ok(Outcome::DataLost)
        }
    }
}

fn unreachable_recorder(at: &SocketArguments, error: &std::io::Error) -> anyhow::Error {
    let socket = at.socket.display();
    match error.kind() {
        std::io::ErrorKind::NotFound | std::io::ErrorKind::ConnectionRefused => {
            anyhow::anyhow!("{socket}: no recorder is running there (systemctl status realitysim)")
        }
        std::io::ErrorKind::PermissionDenied => {
            anyhow::anyhow!("{socket}: no permission: your user must be in the group realitysim")
        }
        _ => anyhow::anyhow!("{socket}: {error}"),
    }
}
