//! Command `realitysim record`, and the commands that talk to a running recorder.

use std::io::Write;
use std::path::PathBuf;

use clap::{Args, Subcommand};
use serde_json::Value;

use super::settings::{SettingsArguments, UsageError, check_initial, planar_pose};
use super::values::whole;
use super::{Outcome, output};
use crate::config::load_field;
use crate::geometry::{Field, Pose2};
use crate::live::{RecordOptions, ask, poses, record, stop_flag};
use crate::localization::Rejection;

/// Control socket of the service; a user's own recorder may have another.
const SOCKET: &str = "/run/realitysim/control.sock";

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
        check_initial(initial, &settings.field, &Field::new(load_field(&settings.field)?)?)?;
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
        output::lines(&for_people(&status))?;
    }
    Ok(if recorder_lost_data(&status) { Outcome::DataLost } else { Outcome::Whole })
}

/// Whether recorded data was lost in any of the recorder's sessions. Frames that the camera dropped do not count, data that
/// could not be written does.
fn recorder_lost_data(status: &Value) -> bool {
    let earlier = &status["earlier"];
    let lost = |counts: &Value| counts["lost"].as_object().is_some_and(|causes| !causes.is_empty());
    let refused = |recorder: &Value| recorder["frames_refused"].as_u64() > Some(0);
    !status["unfinished"].is_null()
        || earlier["unfinished"].as_u64() > Some(0)
        || lost(&status["counts"])
        || lost(&earlier["counts"])
        || refused(&status["recorder"])
        || refused(earlier)
}

/// Commands to a running recorder.
#[derive(Subcommand)]
pub enum RecorderCommand {
    /// How a running recorder is: rates, drops, ports and clocks, the last pose
    #[command(after_long_help = "Example:\n  realitysim status")]
    Status(SocketArguments),
    /// Put a note into the running log
    #[command(after_long_help = "Example:\n  realitysim mark \"second half begins\"")]
    Mark {
        /// What happened
        text: String,
        #[command(flatten)]
        at: SocketArguments,
    },
    /// Say where the robot is: `base_footprint` in `map`, as after kick-off or when it was carried
    #[command(after_long_help = "Example:\n  realitysim place 1.2,-0.3,90")]
    Place {
        /// Metres along and across the field from its centre, and the heading in degrees: on the field or at most 1 m off its
        /// carpet (else exit code 2)
        #[arg(value_name = "x,y,yaw_deg", value_parser = planar_pose, allow_hyphen_values = true)]
        pose: Pose2,
        #[command(flatten)]
        at: SocketArguments,
    },
    /// Begin a session in a recorder that runs
    #[command(after_long_help = "Example:\n  realitysim start")]
    Start(SocketArguments),
    /// End its session; the recorder goes on running
    #[command(after_long_help = "Example:\n  realitysim stop")]
    Stop(SocketArguments),
    /// Every tag as it is made, a line of JSON each
    #[command(after_long_help = "Example:\n  realitysim poses")]
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
        output::lines(&for_people(&answer))?;
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

fn for_people(status: &Value) -> String {
    let text = |key: &str| status[key].as_str().unwrap_or("-").to_owned();
    let counts = &status["counts"];
    let number = |key: &str| counts[key].as_u64().unwrap_or(0);
    let mut lines = vec![
        format!("{}  {}", text("state"), text("session")),
        format!(
            "{} captured, {} written, {} tagged, {} valid",
            number("captured"),
            number("written"),
            number("tagged"),
            number("valid")
        ),
    ];
    let earlier = &status["earlier"];
    if let Some(sessions @ 1..) = earlier["sessions"].as_u64() {
        let number = |key: &str| earlier["counts"][key].as_u64().unwrap_or(0);
        lines.push(format!(
            "before it {sessions} sessions: {} captured, {} written, {} tagged, {} valid; {} not whole",
            number("captured"),
            number("written"),
            number("tagged"),
            number("valid"),
            earlier["unfinished"]
        ));
    }
    let dropped = counts["dropped"].as_object().into_iter().flatten();
    let dropped: Vec<String> = dropped.map(|(cause, count)| format!("{count} {cause}")).collect();
    if !dropped.is_empty() {
        lines.push(format!("dropped: {}", dropped.join(", ")));
    }
    lines.extend(recorder_for_people(&status["recorder"]));
    match status["camera_lost"].as_str() {
        Some(cause) => lines.push(format!("camera: away ({cause})")),
        None => lines.push(format!("camera: {}", status["camera"]["card"].as_str().unwrap_or("none yet"))),
    }
    let rate = |key: &str| status["rates"][key].as_f64().unwrap_or(0.0);
    let budget = |key: &str| status["budget"][key].as_f64().unwrap_or(0.0);
    let allowed = match budget("budget_ms") {
        0.0 => String::new(),
        allowed => format!(" of {allowed} ms"),
    };
    lines.push(format!(
        "last second: {:.1} captured, {:.1} written, {:.1} tagged; {} of 16 frames wait to be taken",
        rate("captured_hz"),
        rate("written_hz"),
        rate("tagged_hz"),
        status["camera_waiting"]
    ));
    if status["validity"]["frames"].as_u64().is_none_or(|frames| frames == 0) {
        lines.push("tags: none yet".to_owned());
    } else {
        lines.push(format!("tags: {:.1} ms each, 1 % over {:.1} ms{allowed}", budget("p50_ms"), budget("p99_ms")));
        lines.push(format!("valid: {} of the last {}", status["validity"]["valid"], status["validity"]["frames"]));
        let filter = |key: &str| status["filter"][key].as_f64().unwrap_or(0.0);
        lines.push(format!(
            "filter: {:.0} particles, spread {:.1} cm, time was up in {:.0} % of the frames",
            filter("particles"),
            100.0 * filter("spread_m"),
            100.0 * filter("capped")
        ));
    }
    if let Some(passed_on) = status["republished"].as_object() {
        let lost = passed_on["lost"].as_str().map_or(String::new(), |why| format!(" ({why})"));
        let device = passed_on["device"].as_str().unwrap_or("-");
        lines.push(format!("{device}: {} passed on, {} missed{lost}", passed_on["passed"], passed_on["missed"]));
    }
    for (device, port) in status["ports"].as_object().into_iter().flatten() {
        if let Some(why) = port["closed"].as_str() {
            lines.push(format!("{device}: {why}"));
            continue;
        }
        if let Some(said) = port["trouble"]["said"].as_str() {
            lines.push(format!("{device}: TROUBLE: {said}"));
        }
        lines.push(format!(
            "{device}: {} messages, {} lost, {} checksums wrong, {} bytes skipped",
            port["frames"], port["lost"], port["crc_failures"], port["bytes_skipped"]
        ));
        for clock in port["clocks"].as_array().into_iter().flatten() {
            lines.push(format!(
                "  {}.{}: clock {:.6} s behind to {:.2} ms by {}, drift {:.1} ppm",
                clock["system"],
                clock["component"],
                clock["offset_ns"].as_f64().unwrap_or(0.0) * 1e-9,
                clock["uncertainty_ns"].as_f64().unwrap_or(0.0) * 1e-6,
                clock["source"].as_str().unwrap_or("-"),
                clock["drift_ppm"].as_f64().unwrap_or(0.0)
            ));
        }
    }
    if let Some(thinned @ 1..) = counts["thinned"].as_u64() {
        lines.push(format!("{thinned} thinned out, as recording.thinning asks"));
    }
    let coverage = &status["coverage"];
    if let Some(map) = coverage["map"].as_array() {
        let number = |key: &str| coverage[key].as_u64().unwrap_or(0);
        lines.push(format!(
            "images of {} of {} poses (cells of {} m, {} headings: a digit says of how many, # of all, . of none)",
            number("filled"),
            number("cells"),
            coverage["cell_m"],
            number("sectors")
        ));
        lines.extend(map.iter().filter_map(Value::as_str).map(|row| format!("  {row}")));
    }
    if let Some(tag) = status["last_tag"].as_object() {
        let float = |key: &str| tag[key].as_f64().unwrap_or(f64::NAN);
        let reason = tag["reason"].as_str();
        let is_predicted = reason == Some(Rejection::NoFrame.as_str());
        let what = match reason {
            Some(_) if is_predicted && tag["ambiguous"] == true => {
                "predicted, for want of frames; the mirror pose is as likely".to_owned()
            }
            Some(_) if is_predicted => "predicted, for want of frames".to_owned(),
            Some(reason) if tag["valid"] != true => format!("{reason}, {:.1} ms", float("elapsed_ms")),
            _ if tag["ambiguous"] == true => format!("valid up to the mirror, {:.1} ms", float("elapsed_ms")),
            _ => format!("valid, {:.1} ms", float("elapsed_ms")),
        };
        let age = match float("age_s") {
            old if old >= 1.0 => format!(", {old:.0} s ago"),
            _ => String::new(),
        };
        lines.push(format!(
            "x {:.2} m, y {:.2} m (±{:.1} cm), yaw {:.1} deg: {what}{age}",
            float("x_m"),
            float("y_m"),
            100.0 * float("sigma_m"),
            float("yaw_rad").to_degrees(),
        ));
    }
    lines.join("\n")
}

/// Describes the recorder's queue, what a power cut would cost, and the state of the disk.
fn recorder_for_people(recorder: &Value) -> Vec<String> {
    let ms = |key: &str| recorder[key].as_f64().unwrap_or(0.0);
    let mebibytes = |key: &str| recorder[key].as_f64().unwrap_or(0.0) / f64::from(1 << 20);
    let conserved = if recorder["conserved"] == true {
        "captured = written + thinned + dropped + waiting"
    } else {
        "FRAMES ARE UNACCOUNTED FOR"
    };
    let mut lines = vec![
        format!(
            "recorder: {} frames wait for the disk, {:.1} of {:.0} MiB; {:.0} MiB of the disk free; {conserved}",
            recorder["frames_waiting"],
            mebibytes("queue_bytes"),
            mebibytes("queue_limit_bytes"),
            mebibytes("free_bytes")
        ),
        match recorder["fault"].is_null() {
            true => format!(
                "a power cut costs at most {:.2} s (worst stall {:.0} ms; worst so far {:.2} s)",
                ms("loss_bound_ms") / 1e3,
                ms("worst_stall_ms"),
                ms("worst_unsynced_ms") / 1e3
            ),
            false => "a power cut costs all that waits for the disk: it refuses".to_owned(),
        },
    ];
    if let Some(cause) = recorder["stopped"]["cause"].as_str() {
        let what = if recorder["stopped"]["frames_only"] == true { "frames are not" } else { "nothing is" };
        lines.push(format!("DISK: {cause}: {what} recorded"));
    }
    if let Some(fault) = recorder["fault"].as_object() {
        lines.push(format!(
            "DISK: {}: {}",
            fault["cause"].as_str().unwrap_or("-"),
            fault["said"].as_str().unwrap_or("-")
        ));
    }
    let faults = recorder["faults"].as_object().into_iter().flatten();
    let faults: Vec<String> = faults.map(|(cause, count)| format!("{count} {cause}")).collect();
    if !faults.is_empty() {
        lines.push(format!("disk errors: {}; {} segments given up", faults.join(", "), recorder["segments_given_up"]));
    }
    lines
}
