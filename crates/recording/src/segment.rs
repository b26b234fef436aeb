//! One segment of a session while it is being written.

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use super::error::RecordingError;
use super::hashing::HashingWriter;
use super::manifest::{Counts, ManifestLine, PoseBox, TopicEntry};
use super::storage::{Storage, StoredFile};
use realitysim_ros2::mcap_read::{Channel, LogMessage, MetadataRecord};
use realitysim_ros2::mcap_write::{ChannelId, LogWriter, RawChannel};

/// End of the name of a segment that is not finished.
pub const ACTIVE: &str = ".active";
/// Name of the metadata record that says where an earlier segment ends, if that is before the end of its file. What
/// stood behind that point is repeated in this segment, because the disk had not confirmed it.
pub(super) const CUT_RECORD: &str = "realitysim.cut";
/// Name of the metadata record at the beginning that says which session the segment belongs to, wherever it may be
/// copied to.
const SESSION_RECORD: &str = "realitysim.session";
/// Key of the session's identity.
const SESSION_ID: &str = "id";
/// Key of a hash of the identity: MCAP has no checksum for metadata records.
const SESSION_HASH: &str = "blake3";

/// Identity of the session that a metadata record names; `None` if it is another record, or damaged.
pub(super) fn session_in(record: &MetadataRecord) -> Option<&str> {
    let id = record.values.get(SESSION_ID).filter(|_| record.name == SESSION_RECORD)?;
    (record.values.get(SESSION_HASH) == Some(&hash_of(id))).then_some(id)
}

/// First 16 hexadecimal digits of the BLAKE3 hash of an identity.
fn hash_of(id: &str) -> String {
    blake3::hash(id.as_bytes()).to_hex()[..16].to_owned()
}
/// Key of the name of the segment that was given up.
pub(super) const CUT_SEGMENT: &str = "segment";
/// Key of the number of bytes that count of it.
pub(super) const CUT_BYTES: &str = "bytes";

/// Name of a finished segment, as `0000.mcap`.
pub(super) fn segment_name(index: u32) -> String {
    format!("{index:04}.mcap")
}

/// Number of a segment's file, finished or not; `None` if the name is not a segment's.
pub(super) fn segment_index(name: &str) -> Option<u32> {
    let digits = name.strip_suffix(ACTIVE).unwrap_or(name).strip_suffix(".mcap")?;
    let plain = (4..=9).contains(&digits.len()) && digits.bytes().all(|byte| byte.is_ascii_digit());
    if plain { digits.parse().ok() } else { None }
}

/// Whether a name is that of a finished segment, as `0000.mcap`.
pub fn is_segment_name(name: &str) -> bool {
    !name.ends_with(ACTIVE) && segment_index(name).is_some()
}

/// End of a segment that was given up: what lies behind these bytes may or may not be on the disk.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Cut {
    /// Name of the segment.
    pub name: String,
    /// Bytes of the file that count.
    pub bytes: u64,
}

impl Cut {
    fn record(&self) -> BTreeMap<String, String> {
        let (segment, bytes) = (self.name.clone(), self.bytes.to_string());
        BTreeMap::from([(CUT_SEGMENT.to_owned(), segment), (CUT_BYTES.to_owned(), bytes)])
    }
}

/// Why a segment could not be finished, and what became of it.
pub(super) enum Unfinished {
    /// The segment was given up.
    GivenUp(Cut, RecordingError),
    /// The segment has its final name, but a power cut may undo that.
    Renamed(Box<Finished>, RecordingError),
}

/// Description of a segment that is whole.
pub(super) struct Finished {
    pub line: ManifestLine,
    pub topics: BTreeMap<TopicEntry, u64>,
}

/// A segment that is being written.
pub(super) struct Segment {
    storage: Arc<dyn Storage>,
    folder: PathBuf,
    name: String,
    writer: LogWriter<HashingWriter<Gate>>,
    /// A second handle of the file, to sync it while the writer owns the first.
    file: Arc<dyn StoredFile>,
    /// Whether the writer may still write to the file.
    open: Arc<AtomicBool>,
    /// Whether the file system can tell if the file still has its name.
    tells_its_place: bool,
    /// Channels of the source, and their numbers in the file.
    channels: Vec<(Arc<Channel>, ChannelId)>,
    /// Number of messages of each channel, by its number in the file.
    written: BTreeMap<ChannelId, (Arc<Channel>, u64)>,
    pub(super) counts: Counts,
    poses: Option<PoseBox>,
    first_ns: Option<i64>,
    last_ns: i64,
    messages: u64,
    /// Bytes that the disk has confirmed.
    synced_bytes: u64,
}

impl Segment {
    /// Creates `<index>.mcap.active`, which must not exist.
    pub(super) fn create(storage: &Arc<dyn Storage>, folder: &Path, index: u32) -> Result<Self, RecordingError> {
        let name = segment_name(index);
        let path = folder.join(format!("{name}{ACTIVE}"));
        let file = storage.create(&path).map_err(|source| RecordingError::io(&path, source))?;
        let open = Arc::new(AtomicBool::new(true));
        let gate = Gate { file: Arc::clone(&file), open: Arc::clone(&open) };
        let hashing = HashingWriter::new(gate);
        let created = storage
            .sync_folder(folder)
            .map_err(|source| RecordingError::io(folder, source))
            .and_then(|()| LogWriter::new(hashing).map_err(|source| RecordingError::log(&path, source)));
        let writer = created.inspect_err(|_| {
            // The file is empty, and the next attempt takes another number.
            let _ = storage.remove(&path);
        })?;
        let tells_its_place = file.is_at(&path).unwrap_or(false);
        Ok(Self {
            tells_its_place,
            storage: Arc::clone(storage),
            folder: folder.to_owned(),
            name,
            writer,
            file,
            open,
            channels: Vec::new(),
            written: BTreeMap::new(),
            counts: Counts::default(),
            poses: None,
            first_ns: None,
            last_ns: i64::MIN,
            messages: 0,
            synced_bytes: 0,
        })
    }

    /// Writes an attachment, such as the state of the filter.
    pub(super) fn attach(&mut self, name: &str, log_time_ns: i64, data: &[u8]) -> Result<(), RecordingError> {
        let written = self.writer.attach(name, "application/octet-stream", log_time_ns, data);
        written.map_err(|source| RecordingError::log(&self.active(), source))
    }

    /// Writes which session the segment belongs to.
    pub(super) fn belongs_to(&mut self, session: &str) -> Result<(), RecordingError> {
        let values =
            BTreeMap::from([(SESSION_ID.to_owned(), session.to_owned()), (SESSION_HASH.to_owned(), hash_of(session))]);
        let written = self.writer.metadata(SESSION_RECORD, &values);
        written.map_err(|source| RecordingError::log(&self.active(), source))
    }

    /// Writes where an earlier segment ends that was given up.
    pub(super) fn continues(&mut self, cut: &Cut) -> Result<(), RecordingError> {
        let written = self.writer.metadata(CUT_RECORD, &cut.record());
        written.map_err(|source| RecordingError::log(&self.active(), source))
    }

    /// Writes a message with its bytes unchanged.
    pub(super) fn write(&mut self, message: &LogMessage) -> Result<(), RecordingError> {
        let LogMessage { channel, sequence, log_time_ns, publish_time_ns, data } = message;
        let written = self.channel_of(channel).and_then(|id| {
            self.writer.write(id, *sequence, *log_time_ns, *publish_time_ns, data)?;
            Ok(id)
        });
        let id = written.map_err(|source| RecordingError::log(&self.active(), source))?;
        self.written.entry(id).or_insert_with(|| (Arc::clone(channel), 0)).1 += 1;
        self.first_ns = Some(self.first_ns.map_or(*log_time_ns, |first| first.min(*log_time_ns)));
        self.last_ns = self.last_ns.max(*log_time_ns);
        self.messages += 1;
        Ok(())
    }

    /// Extends the box around valid tags by a position, metres in `map`.
    pub(super) fn valid_pose(&mut self, [x, y]: [f64; 2]) {
        self.poses = Some(PoseBox::around(self.poses, x, y));
    }

    /// Closes the chunk and forces everything to disk. This fails if the file was removed, since what has no name is
    /// lost.
    pub(super) fn sync(&mut self) -> Result<(), RecordingError> {
        self.writer.flush_chunk().map_err(|source| RecordingError::log(&self.active(), source))?;
        self.file.sync().map_err(|source| RecordingError::io(&self.active(), source))?;
        if self.is_removed() {
            return Err(RecordingError::Removed(self.active()));
        }
        self.synced_bytes = self.writer.bytes_written();
        Ok(())
    }

    /// Writes footer and index, forces them to disk, and gives the file its final name.
    ///
    /// It is called after [`sync`](Self::sync). A file with a final name is whole.
    pub(super) fn finish(self) -> Result<Finished, Unfinished> {
        let (active, path) = (self.active(), self.folder.join(&self.name));
        let Self { storage, folder, name, writer, written, file, open, synced_bytes, .. } = self;
        let cut = Cut { name: name.clone(), bytes: synced_bytes };
        let finished = writer
            .finish()
            .map_err(|source| RecordingError::log(&active, source))
            .and_then(|hashing| hashing.end().map_err(|source| RecordingError::io(&active, source)))
            .and_then(|ended| file.sync().map(|()| ended).map_err(|source| RecordingError::io(&active, source)));
        let (bytes, blake3) = match finished {
            Ok(ended) => ended,
            Err(error) => {
                open.store(false, Ordering::Relaxed);
                let _ = file.set_len(synced_bytes);
                return Err(Unfinished::GivenUp(cut, error));
            }
        };
        if let Err(source) = storage.rename(&active, &path) {
            return Err(Unfinished::GivenUp(Cut { bytes, ..cut }, RecordingError::io(&active, source)));
        }
        let first_ns = self.first_ns.unwrap_or(0);
        let line = ManifestLine {
            name,
            bytes,
            blake3,
            first_ns,
            last_ns: self.last_ns.max(first_ns),
            messages: self.messages,
            frames: self.counts,
            poses: self.poses,
            cut_bytes: None,
        };
        let mut topics = BTreeMap::new();
        for (channel, messages) in written.values() {
            *topics.entry(TopicEntry::of(channel)).or_default() += messages;
        }
        let finished = Finished { line, topics };
        match storage.sync_folder(&folder) {
            Ok(()) => Ok(finished),
            Err(source) => Err(Unfinished::Renamed(Box::new(finished), RecordingError::io(&folder, source))),
        }
    }

    /// Whether somebody has removed or moved the file. If the file system does not answer, it counts as there.
    pub(super) fn is_removed(&self) -> bool {
        self.tells_its_place && !self.file.is_at(&self.active()).unwrap_or(true)
    }

    /// Ends the segment at what is confirmed: nothing more is written, and what was not synced is cut off if the disk
    /// allows that.
    pub(super) fn give_up(self) -> Cut {
        self.open.store(false, Ordering::Relaxed);
        let _ = self.file.set_len(self.synced_bytes);
        // If the file was removed, a file of that name is somebody else's.
        if self.synced_bytes == 0 && !self.is_removed() {
            let _ = self.storage.remove(&self.active());
        }
        Cut { name: self.name.clone(), bytes: self.synced_bytes }
    }

    /// Path of the unfinished file.
    fn active(&self) -> PathBuf {
        self.folder.join(format!("{}{ACTIVE}", self.name))
    }

    /// Number in the file of a channel of the source. Channels that differ only in their number share one.
    fn channel_of(&mut self, channel: &Arc<Channel>) -> Result<ChannelId, realitysim_ros2::mcap_write::WriteError> {
        if let Some((_, id)) = self.channels.iter().find(|(known, _)| Arc::ptr_eq(known, channel)) {
            return Ok(*id);
        }
        // Each file of the source, and each of several senders, has channels of its own.
        let known = self.channels.iter().find(|(known, _)| is_same(known, channel)).map(|(_, id)| *id);
        let id = match known {
            Some(id) => id,
            None => self.writer.add_raw_channel(&RawChannel::from(channel.as_ref()))?,
        };
        self.channels.push((Arc::clone(channel), id));
        Ok(id)
    }
}

/// Whether two channels differ at most in their number.
fn is_same(one: &Channel, other: &Channel) -> bool {
    *one == Channel { id: one.id, ..other.clone() }
}

/// The file, closed to writes once the segment is given up: data that the writers above still buffer must not reach
/// it.
struct Gate {
    file: Arc<dyn StoredFile>,
    open: Arc<AtomicBool>,
}

impl Write for Gate {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.open.load(Ordering::Relaxed) {
            self.file.write(bytes)
        } else {
            Err(io::Error::other("the segment was given up"))
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
