//! Reads a recorded log: one MCAP file, or a folder of them (a ROS 2 bag, a capture).

use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use thiserror::Error;

use super::conversion::{MessageConverter, ros2_type_name};
use super::file_kind::{FileKind, START_BYTES};
use super::topic_resolution::{FOXGLOVE_PACKAGE, TopicTypes};
use realitysim_config::plain_file;
use realitysim_ros2::mcap_read::{
    Damage, LogMessage, LogReader, ReadError, Selection, Survey, attachments, examine, survey,
};
use realitysim_ros2::messages::{DiagnosticArray, DiagnosticStatus, Message};
use realitysim_ros2::topics;

/// Why a log cannot be read.
#[derive(Debug, Error)]
pub enum LogError {
    /// A file's content cannot be read as MCAP.
    #[error("{path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// What the reader found.
        source: ReadError,
    },
    /// A file or folder cannot be opened.
    #[error("{path}: {source}")]
    Open {
        /// The file or folder.
        path: PathBuf,
        /// What the operating system says.
        source: std::io::Error,
    },
    /// A file is of another kind.
    #[error("{path}: an MCAP log is needed, and this file is {kind}")]
    NoLog {
        /// The file.
        path: PathBuf,
        /// The kind of the file, by its first bytes.
        kind: FileKind,
    },
    /// A folder holds no MCAP file.
    #[error("{path}: the folder holds no .mcap file: {}", instead_of(within))]
    NoFiles {
        /// The folder.
        path: PathBuf,
        /// The folders in it that hold MCAP files.
        within: Vec<PathBuf>,
    },
}

/// Largest number of folders that an error lists.
const MAX_NAMED: usize = 5;

/// Says what to name instead of a folder without logs; `within` are the folders in it that hold some.
fn instead_of(within: &[PathBuf]) -> String {
    let [first, ..] = within else {
        return "name an MCAP file, a ROS 2 bag's folder or a capture's".to_owned();
    };
    let names: Vec<String> = within.iter().take(MAX_NAMED).map(|path| path.display().to_string()).collect();
    let more = match within.len().saturating_sub(MAX_NAMED) {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    if within.len() == 1 {
        return format!("name the capture or bag in it, {}", first.display());
    }
    format!("name one of the captures or bags in it: {}{more}", names.join(", "))
}

/// Lists the MCAP files of a log in the order of their numbers, which in bags and captures is the order of time.
///
/// `path` is one file, or a folder whose `.mcap` and `.mcap.active` files are listed.
pub fn files_of(path: &Path) -> Result<Vec<PathBuf>, LogError> {
    let failed = |source| LogError::Open { path: path.to_owned(), source };
    if !std::fs::metadata(path).map_err(failed)?.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    let mut files = segments_in(path).map_err(failed)?;
    if files.is_empty() {
        if let Some(bag) = sqlite_bag_in(path).map_err(failed)? {
            return Err(LogError::NoLog { kind: FileKind::of(&read_start(&bag)?), path: bag });
        }
        let folders = std::fs::read_dir(path).map_err(failed)?.flatten().map(|entry| entry.path());
        let holds_logs = |folder: &PathBuf| segments_in(folder).is_ok_and(|files| !files.is_empty());
        let mut within: Vec<PathBuf> = folders.filter(holds_logs).collect();
        within.sort();
        return Err(LogError::NoFiles { path: path.to_owned(), within });
    }
    // rosbag2 numbers files without leading zeros: ..._9.mcap comes before ..._10.mcap.
    files.sort_by_key(|file| {
        let name = file.file_name().and_then(|name| name.to_str()).unwrap_or_default().to_owned();
        let number = name.trim_end_matches(".active").trim_end_matches(".mcap");
        let digits = number.len() - number.trim_end_matches(|c: char| c.is_ascii_digit()).len();
        (number[number.len() - digits..].parse::<u64>().unwrap_or(0), name)
    });
    Ok(files)
}

/// Lists the MCAP files directly in a folder, in any order.
fn segments_in(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder)? {
        let file = entry?.path();
        let name = file.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        if name.ends_with(".mcap") || name.ends_with(".mcap.active") {
            files.push(file);
        }
    }
    Ok(files)
}

/// Returns a file of a bag that rosbag2 wrote as an SQLite database, the first by name.
fn sqlite_bag_in(folder: &Path) -> io::Result<Option<PathBuf>> {
    let files = std::fs::read_dir(folder)?.map(|entry| entry.map(|entry| entry.path()));
    let files = files.collect::<io::Result<Vec<_>>>()?;
    Ok(files.into_iter().filter(|file| file.extension().is_some_and(|ending| ending == "db3")).min())
}

/// Iterator over the messages of several MCAP files, one file after the other.
///
/// Messages of Foxglove's schemas come as the ROS 2 messages that say the same ([`foxglove`](crate::foxglove)), and types as
/// rosbag2 spells them. A message of Foxglove's that cannot be converted is left out and counts as damage.
pub struct LogSource {
    files: std::vec::IntoIter<PathBuf>,
    open: Option<OpenFile>,
    selection: Selection,
    with_outputs: bool,
    damage: Vec<(PathBuf, Damage)>,
}

/// A file that is being read.
struct OpenFile {
    path: PathBuf,
    reader: LogReader<BufReader<File>>,
    converter: MessageConverter,
    /// Whether the bytes of the last message are not those of the file.
    is_converted: bool,
    /// Messages that could not be converted, and were left out.
    unconverted: Damage,
}

impl LogSource {
    /// Reads what the robot recorded; messages that an earlier replay added are left out.
    pub fn new(files: Vec<PathBuf>, selection: Selection) -> Self {
        Self { files: files.into_iter(), open: None, selection, with_outputs: false, damage: Vec::new() }
    }

    /// Reads all messages, also those that an earlier replay added.
    pub fn with_outputs(files: Vec<PathBuf>, selection: Selection) -> Self {
        Self { with_outputs: true, ..Self::new(files, selection) }
    }

    /// Returns the damage found in the files that were read to their end; complete when the iterator has ended.
    pub fn damage(&self) -> &[(PathBuf, Damage)] {
        &self.damage
    }

    /// Returns the file of the last message, and the offset in bytes where its data begin; `None` if they are compressed or were
    /// converted.
    pub fn place(&self) -> Option<(&Path, u64)> {
        let open = self.open.as_ref().filter(|open| !open.is_converted)?;
        Some((&open.path, open.reader.place()?))
    }

    fn close(&mut self) {
        let Some(OpenFile { path, reader, unconverted, .. }) = self.open.take() else { return };
        let mut damage = reader.damage().clone();
        damage.bad_records += unconverted.bad_records;
        damage.bytes_skipped += unconverted.bytes_skipped;
        damage.first_error = damage.first_error.or(unconverted.first_error);
        if !damage.is_none() {
            self.damage.push((path, damage));
        }
    }
}

impl Iterator for LogSource {
    type Item = Result<LogMessage, LogError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if self.open.is_none() {
                let path = self.files.next()?;
                match open(&path, self.selection.clone()) {
                    Ok(reader) => {
                        let converter = MessageConverter::default();
                        let unconverted = Damage::default();
                        self.open = Some(OpenFile { path, reader, converter, is_converted: false, unconverted });
                    }
                    Err(error) => match unwritten_segment(&error) {
                        Some(damage) => self.damage.push((path, damage)),
                        None => return Some(Err(with_file_kind(error))),
                    },
                }
                continue;
            }
            let open = self.open.as_mut()?;
            match open.reader.next() {
                Some(Ok(message)) if !self.with_outputs && is_output(&message) => {}
                Some(Ok(message)) => {
                    let (channel, time_ns) = (Arc::clone(&message.channel), message.log_time_ns);
                    let bytes = message.data.len() as u64;
                    match open.converter.convert(message) {
                        Ok((message, is_converted)) => {
                            open.is_converted = is_converted;
                            return Some(Ok(message));
                        }
                        Err(error) => {
                            open.unconverted.bad_records += 1;
                            open.unconverted.bytes_skipped += bytes;
                            let what = || format!("{}, logged at {time_ns} ns: {error}", channel.topic);
                            open.unconverted.first_error.get_or_insert_with(what);
                        }
                    }
                }
                Some(Err(source)) => {
                    let error = LogError::Read { path: open.path.clone(), source };
                    self.close();
                    return Some(Err(error));
                }
                None => self.close(),
            }
        }
    }
}

/// Returns whether a status is a mark: a note that a person gave the recorder.
pub fn is_mark(status: &DiagnosticStatus) -> bool {
    status.name.strip_prefix(topics::DIAGNOSTICS_PREFIX) == Some("mark")
}

/// Returns whether an earlier replay added this message. Marks are input, though this program wrote them: nothing gives them again.
fn is_output(message: &LogMessage) -> bool {
    let topic = message.channel.topic.as_str();
    let ours = |report: DiagnosticArray| {
        report.status.iter().any(|status| status.name.starts_with(topics::DIAGNOSTICS_PREFIX) && !is_mark(status))
    };
    topics::OUTPUTS.contains(&topic)
        || (topic == topics::DIAGNOSTICS && DiagnosticArray::decode(&message.data).is_ok_and(ours))
}

fn open(path: &Path, selection: Selection) -> Result<LogReader<BufReader<File>>, LogError> {
    LogReader::open(buffered(path)?, selection).map_err(|source| LogError::Read { path: path.to_owned(), source })
}

fn buffered(path: &Path) -> Result<BufReader<File>, LogError> {
    let failed = |source| LogError::Open { path: path.to_owned(), source };
    Ok(BufReader::with_capacity(1 << 18, plain_file::open(path).map_err(failed)?))
}

/// Surveys what each file holds, by its index if it has one.
pub fn surveys(files: &[PathBuf]) -> Result<Vec<Survey>, LogError> {
    survey_each(files, survey)
}

/// Surveys what each file holds by reading every byte, which finds all damage.
pub fn examinations(files: &[PathBuf]) -> Result<Vec<Survey>, LogError> {
    survey_each(files, examine)
}

/// Surveys each file with `look`; a segment of which nothing was written counts as damaged.
fn survey_each(
    files: &[PathBuf],
    look: impl Fn(BufReader<File>) -> Result<Survey, ReadError>,
) -> Result<Vec<Survey>, LogError> {
    let looked = |path: &PathBuf| {
        let looked = look(buffered(path)?).map_err(|source| LogError::Read { path: path.clone(), source });
        looked.or_else(|error| match unwritten_segment(&error) {
            Some(damage) => Ok(Survey { damage, ..Survey::default() }),
            None => Err(with_file_kind(error)),
        })
    };
    files.iter().map(looked).collect()
}

/// Returns the damage of a segment whose recorder was stopped before its first bytes were on disk.
///
/// Such a file ends in `.active` and is a torn segment, not a file of another kind.
fn unwritten_segment(error: &LogError) -> Option<Damage> {
    let LogError::Read { path, source: ReadError::NotMcap { found } } = error else { return None };
    let open = path.extension().is_some_and(|ending| ending == "active");
    open.then(|| Damage { torn: true, first_error: Some(format!("found {found}")), ..Damage::default() })
}

/// Adds to the error about a file that is no MCAP log what kind of file it is.
fn with_file_kind(error: LogError) -> LogError {
    match error {
        LogError::Read { path, source: ReadError::NotMcap { found } } => match read_start(&path) {
            Ok(start) => LogError::NoLog { kind: FileKind::of(&start), path },
            Err(_) => LogError::Read { path, source: ReadError::NotMcap { found } },
        },
        error => error,
    }
}

/// Reads the first bytes of a file, by which its kind is recognized.
fn read_start(path: &Path) -> Result<Vec<u8>, LogError> {
    let mut start = Vec::new();
    let read = buffered(path)?.take(START_BYTES as u64).read_to_end(&mut start);
    read.map(|_| start).map_err(|source| LogError::Open { path: path.to_owned(), source })
}

/// Collects the topics that have at least one message, with their types as [`LogSource`] gives them.
///
/// A type of Foxglove's schemas that is not read has its encoding behind it, for
/// [`TopicError`](super::topic_resolution::TopicError).
pub fn topic_types(surveys: &[Survey]) -> TopicTypes {
    let mut types = TopicTypes::new();
    for topic in surveys.iter().flat_map(|survey| &survey.topics) {
        if topic.messages > 0 {
            let mut type_name = ros2_type_name(&topic.type_name, &topic.message_encoding).into_owned();
            if type_name.starts_with(FOXGLOVE_PACKAGE) {
                type_name = format!("{type_name} in {}", topic.message_encoding);
            }
            types.entry(topic.topic.clone()).or_default().insert(type_name);
        }
    }
    types
}

/// The checkpoint in a segment of a capture: the state of the filter at the segment's start.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum StoredCheckpoint {
    /// There is none, as in a log that is no capture.
    None,
    /// There is one, and it cannot be read.
    Damaged,
    /// The bytes of the checkpoint, not decoded.
    Bytes(Vec<u8>),
}

/// Reads the checkpoint of a segment; `survey` is that of the same file.
pub fn checkpoint(path: &Path, survey: &Survey) -> Result<StoredCheckpoint, LogError> {
    if !survey.attachments.iter().any(|name| name == topics::CHECKPOINT_ATTACHMENT) {
        return Ok(StoredCheckpoint::None);
    }
    let found = attachments(buffered(path)?).map_err(|source| LogError::Read { path: path.to_owned(), source })?;
    let found = found.list.into_iter().find(|attachment| attachment.name == topics::CHECKPOINT_ATTACHMENT);
    Ok(found.map_or(StoredCheckpoint::Damaged, |found| StoredCheckpoint::Bytes(found.data)))
}
