//! Repair of a segment that was never finished.
//!
//! What can be trusted of it goes through the writer again, which gives the whole file: the same bytes, as far as
//! they are there, and then index and footer. So only the end of the file is touched. The file is copied instead if
//! the bytes differ, since then another writer made it, or if more can be read behind damage.

use std::collections::BTreeMap;
use std::io::{self, BufReader, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::super::error::RecordingError;
use super::super::hashing::HashingWriter;
use super::super::manifest::{ManifestLine, TopicEntry};
use super::super::storage::{Appending, Readable, Storage};
use super::quarantine::{rename_durably, set_aside};
use super::repair_journal::{Cut, RepairJournal};
use super::segment_counts::SegmentCounts;
use realitysim_config::Settings;
use realitysim_ros2::mcap_read::{
    Damage, FileTail, LogReader, Part, Piece, ReadError, Selection, examine, file_tail, metadata_records, sound_pieces,
};
use realitysim_ros2::mcap_write::{LogWriter, WriteError};

/// Number of messages of each topic.
pub(super) type Topics = BTreeMap<TopicEntry, u64>;

/// Result of finishing a segment.
pub(super) enum FinishOutcome {
    /// The segment holds no message.
    Empty(FileTail),
    /// The segment is whole under its final name.
    Whole {
        line: Box<ManifestLine>,
        topics: Topics,
        damage: Option<String>,
        /// The file that it was copied from, set aside.
        damaged: Option<PathBuf>,
    },
}

/// Largest end that is written behind a segment, bytes: index and footer take some hundred bytes a chunk.
const MAX_END_BYTES: usize = 32 << 20;
/// End of the name of a copy until it is whole.
pub(crate) const COPY: &str = ".repair";

/// Finishes the unfinished segment `active` as `name`, which must not exist. `limit` is its confirmed length, bytes,
/// if the recorder gave it up.
pub(super) fn finish(
    storage: &dyn Storage,
    active: &Path,
    name: &str,
    limit: Option<u64>,
    settings: &Settings,
    journal: &mut RepairJournal,
) -> Result<FinishOutcome, RecordingError> {
    let length = length(storage, active)?.min(limit.unwrap_or(u64::MAX));
    let open = || open_until(storage, active, length);
    let mut account = SegmentCounts::new(settings);
    let sink = ComparingSink {
        there: BufReader::new(open()?),
        same: 0,
        differs: false,
        end: Vec::new(),
        hash: Default::default(),
    };
    let (sink, sound) = through_writer(open()?, sink, &mut account).map_err(|error| error.at(active))?;
    let others = count_readable(open()?).map_err(|error| error.at(active))?;
    if account.messages() == 0 && others == 0 {
        return Ok(FinishOutcome::Empty(
            file_tail(open()?, sound.end).map_err(|error| CopyError::from(error).at(active))?,
        ));
    }
    let fails = |source| RecordingError::io(active, source);
    let path = active.with_file_name(name);
    let is_prefix = sink.same >= sound.end && sink.end.len() < MAX_END_BYTES;
    if !is_prefix || others > account.messages() {
        return copy(storage, active, &path, open()?, settings, sound.damage, journal);
    }
    let ComparingSink { same, end, hash, .. } = sink;
    let cut = length.saturating_sub(same);
    let cut = journal.note(name, Cut { bytes: cut, damage: sound.damage.filter(|_| cut > 0) })?;
    let file = storage.append(active).map_err(fails)?;
    file.set_len(same).map_err(fails)?;
    Appending(Arc::clone(&file)).write_all(&end).and_then(|()| file.sync()).map_err(fails)?;
    rename_durably(storage, active, &path)?;
    let (line, topics) = account.line(name, hash.count(), hash.finalize().to_hex().to_string(), cut.bytes);
    Ok(FinishOutcome::Whole { line: Box::new(line), topics, damage: cut.damage, damaged: None })
}

/// Makes the manifest line of a finished segment that has none, and says what of the segment is damaged.
pub(super) fn describe(
    storage: &dyn Storage,
    path: &Path,
    name: &str,
    settings: &Settings,
    noted: Option<&Cut>,
) -> Result<(ManifestLine, Topics, Option<String>), RecordingError> {
    let fails = |source| RecordingError::io(path, source);
    let mut hash = blake3::Hasher::new();
    io::copy(&mut storage.read(path).map_err(fails)?, &mut hash).map_err(fails)?;
    let mut account = SegmentCounts::new(settings);
    let mut read = || -> Result<Damage, CopyError> {
        for message in LogReader::open(storage.read(path).map_err(ReadError::from)?, Selection::All)? {
            account.note(&message?);
        }
        // This examines attachments as well.
        Ok(examine(storage.read(path).map_err(ReadError::from)?)?.damage)
    };
    let damage = read().map_err(|error| error.at(path))?;
    let cut = damage.bytes_skipped.max(noted.map_or(0, |cut| cut.bytes));
    let (line, topics) = account.line(name, hash.count(), hash.finalize().to_hex().to_string(), cut);
    let said = match noted {
        Some(cut) => Some(cut.describe()),
        None => (damage != Damage::default()).then(|| damage.to_string()),
    };
    Ok((line, topics, said))
}

/// Copies everything that can be read into a new file and sets the old one aside.
fn copy(
    storage: &dyn Storage,
    active: &Path,
    path: &Path,
    reader: impl Read + Seek,
    settings: &Settings,
    damage: Option<String>,
    journal: &mut RepairJournal,
) -> Result<FinishOutcome, RecordingError> {
    let beside = path.with_extension(format!("mcap{COPY}"));
    let fails = |source| RecordingError::io(&beside, source);
    let file = storage.create_over(&beside).map_err(fails)?;
    let mut account = SegmentCounts::new(settings);
    let hashing = HashingWriter::new(Appending(Arc::clone(&file)));
    let written = || -> Result<HashingWriter<Appending>, CopyError> {
        let mut writer = LogWriter::new(hashing)?;
        for attachment in realitysim_ros2::mcap_read::attachments(storage.read(active).map_err(ReadError::from)?)?.list
        {
            writer.attach(&attachment.name, &attachment.media_type, attachment.log_time_ns, &attachment.data)?;
        }
        for record in metadata_records(storage.read(active).map_err(ReadError::from)?)? {
            writer.metadata(&record.name, &record.values)?;
        }
        for message in LogReader::open(reader, Selection::All)? {
            let message = message?;
            let id = writer.add_raw_channel(&message.channel.as_ref().into())?;
            writer.write(id, message.sequence, message.log_time_ns, message.publish_time_ns, &message.data)?;
            account.note(&message);
        }
        Ok(writer.finish()?)
    };
    let (bytes, hash) = written().map_err(|error| error.at(&beside))?.end().map_err(fails)?;
    file.sync().map_err(fails)?;
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let cut = length(storage, active)?.saturating_sub(bytes).max(1);
    let cut = journal.note(&name, Cut { bytes: cut, damage })?;
    // In this order: if power fails in between, the next run does the same again.
    rename_durably(storage, &beside, path)?;
    let damaged = Some(set_aside(storage, active)?);
    let (line, topics) = account.line(&name, bytes, hash, cut.bytes);
    Ok(FinishOutcome::Whole { line: Box::new(line), topics, damage: cut.damage, damaged })
}

/// Passes the sound beginning of a segment through the writer.
fn through_writer(
    reader: impl Read + Seek,
    sink: ComparingSink,
    account: &mut SegmentCounts,
) -> Result<(ComparingSink, realitysim_ros2::mcap_read::Sound), CopyError> {
    let mut writer = LogWriter::new(sink)?;
    let sound = sound_pieces(reader, &mut |piece| -> Result<(), CopyError> {
        match piece {
            Piece::Attachment(attachment) => {
                writer.attach(&attachment.name, &attachment.media_type, attachment.log_time_ns, &attachment.data)?;
            }
            Piece::Metadata(metadata) => writer.metadata(&metadata.name, &metadata.values)?,
            Piece::Chunk(parts) => {
                for part in parts {
                    match part {
                        Part::Channel(channel) => drop(writer.add_raw_channel(&channel.as_ref().into())?),
                        Part::Message(message) => {
                            let id = writer.add_raw_channel(&message.channel.as_ref().into())?;
                            let [log_ns, publish_ns] = [message.log_time_ns, message.publish_time_ns];
                            writer.write(id, message.sequence, log_ns, publish_ns, &message.data)?;
                            account.note(&message);
                        }
                    }
                }
                writer.flush_chunk()?;
            }
        }
        Ok(())
    })?;
    Ok((writer.finish()?, sound))
}

/// Number of messages that a reader gets out of the segment if it passes over what is damaged.
fn count_readable(reader: impl Read + Seek) -> Result<u64, CopyError> {
    let reader = match LogReader::open(reader, Selection::All) {
        Err(ReadError::NotMcap { .. }) => return Ok(0),
        reader => reader?,
    };
    let mut messages = 0;
    for message in reader {
        message?;
        messages += 1;
    }
    Ok(messages)
}

/// Sink that compares what the writer gives with the bytes of the file.
struct ComparingSink {
    there: BufReader<TruncatedFile>,
    /// Number of equal bytes.
    same: u64,
    differs: bool,
    /// Bytes of the writer from the first difference on.
    end: Vec<u8>,
    hash: blake3::Hasher,
}

impl Write for ComparingSink {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.hash.update(bytes);
        let mut equal = 0;
        if !self.differs {
            let mut there = vec![0; bytes.len()];
            let read = read_up_to(&mut self.there, &mut there)?;
            equal = there[..read].iter().zip(bytes).take_while(|(one, other)| one == other).count();
            self.same += equal as u64;
            self.differs = equal < bytes.len();
        }
        if self.end.len() < MAX_END_BYTES {
            self.end.extend(&bytes[equal..]);
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Fills a buffer as far as the file goes.
fn read_up_to(reader: &mut impl Read, buffer: &mut [u8]) -> io::Result<usize> {
    let mut done = 0;
    while done < buffer.len() {
        match reader.read(&mut buffer[done..])? {
            0 => break,
            read => done += read,
        }
    }
    Ok(done)
}

/// A file that is read as if it ended at `length`.
struct TruncatedFile {
    file: Box<dyn Readable>,
    position: u64,
    length: u64,
}

/// Size of a file, bytes.
fn length(storage: &dyn Storage, path: &Path) -> Result<u64, RecordingError> {
    let length = storage.read(path).and_then(|mut file| file.seek(SeekFrom::End(0)));
    length.map_err(|source| RecordingError::io(path, source))
}

/// Opens a file as if it ended at `length`.
fn open_until(storage: &dyn Storage, path: &Path, length: u64) -> Result<TruncatedFile, RecordingError> {
    let file = storage.read(path).map_err(|source| RecordingError::io(path, source))?;
    Ok(TruncatedFile { file, position: 0, length })
}

impl Read for TruncatedFile {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let left = usize::try_from(self.length.saturating_sub(self.position)).unwrap_or(usize::MAX);
        let wanted = buffer.len().min(left);
        let read = self.file.read(&mut buffer[..wanted])?;
        self.position += read as u64;
        Ok(read)
    }
}

impl Seek for TruncatedFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let to = match to {
            SeekFrom::End(from) => SeekFrom::Start(self.length.saturating_add_signed(from)),
            SeekFrom::Current(by) => SeekFrom::Start(self.position.saturating_add_signed(by)),
            to @ SeekFrom::Start(_) => to,
        };
        self.position = self.file.seek(to)?;
        Ok(self.position)
    }
}

/// Error of reading or of writing.
enum CopyError {
    Read(ReadError),
    Write(WriteError),
}

impl CopyError {
    /// Adds the path.
    fn at(self, path: &Path) -> RecordingError {
        match self {
            Self::Read(source) => RecordingError::Read { path: path.to_owned(), source },
            Self::Write(source) => RecordingError::log(path, source),
        }
    }
}

impl From<ReadError> for CopyError {
    fn from(error: ReadError) -> Self {
        Self::Read(error)
    }
}

impl From<WriteError> for CopyError {
    fn from(error: WriteError) -> Self {
        Self::Write(error)
    }
}
