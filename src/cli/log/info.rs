//! Command `realitysim log info`: lists the contents of a log, or the formats of a camera.

use std::path::{Path, PathBuf};

use clap::Args;
use serde::Serialize;

use crate::cli::{Outcome, output};
use crate::config::Settings;
use crate::log_input::log;
use crate::log_input::topic_resolution::{ResolvedTopics, TopicChoice, TopicTypes};
use crate::recording::{Loss, missing_parts};
use crate::ros2::mcap_read::{LogMessage, Survey};
use crate::tagging::log_scan;
use crate::tagging::setup::SetupError;

/// What a log, bag or capture holds, or what a camera offers
///
/// Of a log: topics, types, rates and damage (exit code 3 if there is any); every byte is read and checked. Of a
/// capture also whether all segments of its manifest are there. Of a camera (/dev/video0): formats, sizes and rates.
#[derive(Args)]
#[command(after_long_help = "Example:\n  realitysim log info my_bag/")]
pub struct InfoArguments {
    /// An MCAP file, a folder of them, or a camera's device
    file: PathBuf,
    /// Believe a log's index and do not check what it leads to: at once, even for a large log
    #[arg(long)]
    quick: bool,
}

#[derive(Serialize)]
struct Info {
    /// Every byte was read, as opposed to the index alone.
    checked: bool,
    files: Vec<FileInfo>,
    /// Segments of a capture's manifest that are missing or not as they were written.
    lost: Vec<Loss>,
    duration_s: f64,
    messages: u64,
    topics: Vec<TopicInfo>,
    /// The topics that a replay would read, with the reason for each, as far as they can be told.
    read: Vec<TopicChoice>,
    /// Why a replay cannot tell which topics to read.
    unclear: Option<String>,
}

#[derive(Serialize)]
struct FileInfo {
    file: PathBuf,
    indexed: bool,
    compression: Vec<String>,
    attachments: Vec<String>,
    torn: bool,
    bad_chunks: u64,
    bad_records: u64,
    bytes_skipped: u64,
    first_error: Option<String>,
    /// Null if that was not checked.
    chunks_without_checksum: Option<u64>,
    #[serde(skip)]
    damage: Option<String>,
}

#[derive(Clone, Serialize)]
struct TopicInfo {
    topic: String,
    #[serde(rename = "type")]
    type_name: String,
    messages: u64,
    rate_hz: Option<f64>,
    #[serde(skip)]
    span_ns: Option<(i64, i64)>,
}

pub fn run(arguments: &InfoArguments, json: bool) -> anyhow::Result<Outcome> {
    if is_device(&arguments.file) {
        return camera(&arguments.file, json);
    }
    let files = log::files_of(&arguments.file)?;
    let checked = !arguments.quick;
    let surveys = if checked { log::examinations(&files)? } else { log::surveys(&files)? };
    let lost = missing_parts(&arguments.file);
    let mut topics: Vec<TopicInfo> = Vec::new();
    for topic in surveys.iter().flat_map(|survey| &survey.topics) {
        let span = topic.first_log_time_ns.zip(topic.last_log_time_ns);
        match topics.iter_mut().find(|known| known.topic == topic.topic) {
            Some(known) => {
                known.messages += topic.messages;
                known.span_ns = joined(known.span_ns, span);
            }
            None => topics.push(TopicInfo {
                topic: topic.topic.clone(),
                type_name: topic.type_name.clone(),
                messages: topic.messages,
                rate_hz: None,
                span_ns: span,
            }),
        }
    }
    topics.sort_by(|a, b| a.topic.cmp(&b.topic));
    for topic in &mut topics {
        topic.rate_hz = topic.span_ns.and_then(|(first, last)| {
            let seconds = last.saturating_sub(first) as f64 * 1e-9;
            (topic.messages > 1 && seconds > 0.0).then(|| (topic.messages - 1) as f64 / seconds)
        });
    }
    let whole = topics.iter().fold(None, |span, topic| joined(span, topic.span_ns));
    let damaged = surveys.iter().any(|survey| !survey.damage.is_none());
    let (read, unclear) = match read_topics(files.clone(), &log::topic_types(&surveys)) {
        Ok(resolved) => (resolved.choices, None),
        Err(error) => (Vec::new(), Some(error.to_string())),
    };
    let outcome = if damaged || !lost.is_empty() { Outcome::DataLost } else { Outcome::Whole };
    let info = Info {
        checked,
        files: files.iter().zip(&surveys).map(|(file, survey)| file_info(file, survey, checked)).collect(),
        lost,
        duration_s: whole.map_or(0.0, |(first, last)| last.saturating_sub(first) as f64 * 1e-9),
        messages: topics.iter().map(|topic| topic.messages).sum(),
        topics,
        read,
        unclear,
    };
    if json {
        output::json(&info)?
    } else {
        output::lines(&for_people(&info))?
    }
    Ok(outcome)
}

/// Messages of a log that are looked at for what they say about topics: the transforms of some minutes.
const MAX_LOOKED_AT: usize = 100_000;

/// The topics that a replay with default settings would read.
fn read_topics(files: Vec<PathBuf>, types: &TopicTypes) -> Result<ResolvedTopics, SetupError> {
    let messages = move |selection| -> Box<dyn Iterator<Item = Result<LogMessage, log::LogError>>> {
        Box::new(log::LogSource::new(files.clone(), selection).take(MAX_LOOKED_AT))
    };
    log_scan::topics_of(&Settings::default(), types, &messages)
}

fn file_info(file: &Path, survey: &Survey, checked: bool) -> FileInfo {
    let damage = &survey.damage;
    FileInfo {
        file: file.to_owned(),
        indexed: survey.indexed,
        compression: survey.compressions.iter().cloned().collect(),
        attachments: survey.attachments.clone(),
        torn: damage.torn,
        bad_chunks: damage.bad_chunks,
        bad_records: damage.bad_records,
        bytes_skipped: damage.bytes_skipped,
        first_error: damage.first_error.clone(),
        chunks_without_checksum: checked.then_some(survey.unprotected_chunks),
        damage: (!damage.is_none()).then(|| Loss::of_damage(file, damage).what),
    }
}

/// Whether the path is a device, or, if nothing is there, lies under `/dev`.
fn is_device(path: &Path) -> bool {
    use std::os::unix::fs::FileTypeExt;
    std::fs::metadata(path).map_or(path.starts_with("/dev"), |metadata| metadata.file_type().is_char_device())
}

#[cfg(feature = "v4l2")]
fn camera(path: &Path, json: bool) -> anyhow::Result<Outcome> {
    let offer = crate::devices::v4l2::offer(path)?;
    if json {
        output::json(&offer)?;
        return Ok(Outcome::Whole);
    }
    let mut text = format!("{} ({}, {})\n", offer.card, offer.driver, offer.bus);
    for format in &offer.formats {
        text.push_str(&format!("\n  {}  {}\n", format.fourcc, format.description));
        for size in &format.sizes {
            let rates: Vec<String> = size.rates_hz.iter().map(|rate| format!("{rate:.0}")).collect();
            text.push_str(&format!("    {:>4} x {:<4}  {} Hz\n", size.width, size.height, rates.join(", ")));
        }
    }
    output::lines(text.trim_end())?;
    Ok(Outcome::Whole)
}

#[cfg(not(feature = "v4l2"))]
fn camera(path: &Path, _json: bool) -> anyhow::Result<Outcome> {
    anyhow::bail!("{}: this program was built without the feature v4l2", path.display())
}

fn joined(a: Option<(i64, i64)>, b: Option<(i64, i64)>) -> Option<(i64, i64)> {
    match (a, b) {
        (Some((a0, a1)), Some((b0, b1))) => Some((a0.min(b0), a1.max(b1))),
        (a, b) => a.or(b),
    }
}

fn for_people(info: &Info) -> String {
    let mut text = String::new();
    for file in &info.files {
        let index = if file.indexed { "indexed" } else { "no index" };
        let attached = match file.attachments.is_empty() {
            true => String::new(),
            false => format!(", attached: {}", file.attachments.join(", ")),
        };
        let chunks = match file.compression.is_empty() {
            true => "no chunks, and so no checksums".to_owned(),
            false => format!("chunks: {}", file.compression.join(", ")),
        };
        text.push_str(&format!("{}: {index}, {chunks}{attached}\n", file.file.display()));
        if let Some(damage) = &file.damage {
            text.push_str(&format!("  {damage}\n"));
        }
        if let Some(chunks @ 1..) = file.chunks_without_checksum {
            text.push_str(&format!(
                "  {chunks} of its chunks have no checksum: a wrong value in them cannot be seen\n"
            ));
        }
    }
    for loss in &info.lost {
        text.push_str(&format!("{loss}\n"));
    }
    if !info.checked && info.files.iter().any(|file| file.indexed) {
        text.push_str("by the index only: messages were not checked (leave out --quick)\n");
    }
    text.push_str(&format!("{:.1} s, {} messages\n\n", info.duration_s, info.messages));
    for topic in &info.topics {
        let rate = topic.rate_hz.map_or(String::new(), |rate| format!("{rate:.1} Hz"));
        text.push_str(&format!("  {:<30} {:<44} {:>8} {rate:>10}\n", topic.topic, topic.type_name, topic.messages));
    }
    if !info.read.is_empty() {
        text.push_str("\na replay reads:\n");
    }
    for choice in &info.read {
        text.push_str(&format!("  {:<12} {:<46} {}\n", choice.measurement, choice.topic, choice.reason));
    }
    if let Some(unclear) = &info.unclear {
        text.push_str(&format!("\na replay needs to be told: {unclear}\n"));
    }
    text.trim_end().to_owned()
}
