//! What must hold of whatever came out, whatever went in.

use std::fs;
use std::path::{Path, PathBuf};

use realitysim::ros2::messages::{DiagnosticArray, FrameTag};
use realitysim::ros2::{LogMessage, LogReader, Message, Selection};
use realitysim::tagging::ReplayReport;
use realitysim::tagging::warm_start::last_state;

use crate::case::{Class, Finding, Outcome, Taken};
use crate::fields::fields;
use crate::numerics::unsound;
use crate::support::{POSE, TAG};
use crate::walks::Truth;

/// A valid tag may be off by this much, or by so many of its standard deviations.
const TRUSTED_M: f64 = 0.1;
const SIGMAS: f64 = 5.0;
const OUTPUTS: [&str; 4] = [POSE, TAG, "/predicted_tag", "/diagnostics"];

/// Where the camera was at each frame, and whether the field's other half, which looks the same, is as good.
#[derive(Clone, Copy)]
pub struct Judge<'a> {
    pub truth: Option<&'a Truth>,
    pub mirrored: bool,
}

/// Of a replay, whatever it said and whatever it left.
pub fn replay(report: &Result<ReplayReport, String>, captures: &Path, judge: Judge) -> Outcome {
    for session in sessions(captures) {
        let mut messages = Vec::new();
        for segment in files(&session, "mcap") {
            messages.extend(outputs(&segment)?);
        }
        messages.iter().try_for_each(|message| of_output(message, judge))?;
    }
    last_state(captures).map_err(|what| Finding::new(Class::NotFinite, format!("the state that is kept: {what}")))?;
    match report {
        Ok(report) => {
            let q = &report.filter_ms;
            if ![q.p50, q.p99, q.max, report.wall_s].iter().all(|value| value.is_finite()) {
                return Err(Finding::new(Class::NotFinite, format!("the report: {report:?}")));
            }
            Ok(Taken::Accepted)
        }
        Err(_) => Ok(Taken::Refused),
    }
}

fn outputs(segment: &Path) -> Result<Vec<LogMessage>, Finding> {
    let broken = |what: String| Finding::new(Class::Silent, format!("the capture cannot be read: {what}"));
    let file = fs::File::open(segment).map_err(|error| broken(error.to_string()))?;
    let log = LogReader::open(std::io::BufReader::new(file), Selection::topics(OUTPUTS));
    let messages: Result<Vec<LogMessage>, _> = log.map_err(|error| broken(error.to_string()))?.collect();
    messages.map_err(|error| broken(error.to_string()))
}

fn of_output(message: &LogMessage, judge: Judge) -> Result<(), Finding> {
    let topic = &message.channel.topic;
    match topic.as_str() {
        // Robots have their own entries there, which are passed on.
        "/diagnostics" => return of_diagnostics(message),
        TAG | "/predicted_tag" => {
            let Ok(tag) = FrameTag::decode(&message.data) else { return Ok(()) };
            if let Some(what) = unsound(&tag) {
                return Err(Finding::new(Class::NotFinite, format!("{topic}, frame {}: {what}", tag.sequence)));
            }
            if topic == TAG && tag.valid {
                of_valid(&tag, judge)?;
            }
        }
        _ => {}
    }
    let wild =
        fields(message).into_iter().find(|field| field.float(&message.data).is_some_and(|value| !value.is_finite()));
    wild.map_or(Ok(()), |field| Err(Finding::new(Class::NotFinite, format!("{topic}: {} is not finite", field.name))))
}

fn of_diagnostics(message: &LogMessage) -> Result<(), Finding> {
    let Ok(array) = DiagnosticArray::decode(&message.data) else { return Ok(()) };
    for status in array.status.iter().filter(|status| status.name.starts_with("realitysim: ")) {
        if let Some(pair) = status.values.iter().find(|pair| matches!(pair.value.as_str(), "NaN" | "inf" | "-inf")) {
            return Err(Finding::new(Class::NotFinite, format!("/diagnostics: {} is {}", pair.key, pair.value)));
        }
    }
    Ok(())
}

fn of_valid(tag: &FrameTag, Judge { truth, mirrored }: Judge) -> Result<(), Finding> {
    let stamp = tag.header.stamp.to_nanoseconds();
    let Some([x, y, z]) = truth.and_then(|truth| truth.get(&stamp)) else { return Ok(()) };
    let p = &tag.pose.pose.position;
    let off = |sign: f64| f64::hypot(p.x - sign * x, p.y - sign * y);
    let off_m = if mirrored || tag.ambiguous { off(1.0).min(off(-1.0)) } else { off(1.0) };
    let off_m = off_m.max((p.z - z).abs());
    let c = &tag.pose.covariance;
    let sigma_m = c[0].max(c[7]).max(c[14]).max(0.0).sqrt();
    if off_m <= TRUSTED_M.max(SIGMAS * sigma_m) {
        return Ok(());
    }
    let what =
        format!("frame {} at {stamp} is valid and {off_m:.3} m off, with a deviation of {sigma_m:.4} m", tag.sequence);
    Err(Finding::new(Class::Wrong, what))
}

fn sessions(captures: &Path) -> Vec<PathBuf> {
    listed(captures).into_iter().filter(|path| path.is_dir()).collect()
}

pub fn files(folder: &Path, ending: &str) -> Vec<PathBuf> {
    listed(folder).into_iter().filter(|path| path.extension().is_some_and(|found| found == ending)).collect()
}

fn listed(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
    paths.sort();
    paths
}
