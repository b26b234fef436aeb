//! One file of a capture while it is being written.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use super::manifest::{Counts, ManifestLine, PoseBox};
use super::session::RecordingError;
use crate::ros2::mcap_read::{Channel, LogMessage};
use crate::ros2::mcap_write::{ChannelId, Durability, LogWriter, RawChannel};
use crate::ros2::messages::Message;

/// What the open file ends with until it is complete.
pub(super) const ACTIVE: &str = ".active";

pub(super) struct Segment {
    folder: PathBuf,
    name: String,
    writer: LogWriter<Hashing>,
    /// The same file, to force it to disk while the writer owns the other handle.
    file: File,
    /// Of the source, and our own by topic.
    passed: Vec<(Arc<Channel>, ChannelId)>,
    own: BTreeMap<&'static str, ChannelId>,
    pub(super) counts: Counts,
    poses: Option<PoseBox>,
    first_ns: Option<i64>,
    last_ns: i64,
    messages: u64,
    synced: Instant,
    /// Encoding buffer, kept so that nothing is allocated per message.
    buffer: Vec<u8>,
}

/// Hashes what goes to the file, so that the manifest's checksum is of what was meant to be written.
struct Hashing {
    file: BufWriter<File>,
    hash: blake3::Hasher,
}

impl Write for Hashing {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let taken = self.file.write(bytes)?;
        self.hash.update(&bytes[..taken]);
        Ok(taken)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Segment {
    /// Creates `<index>.mcap.active`, which must not exist.
    pub(super) fn create(folder: &Path, index: u32) -> Result<Self, RecordingError> {
        let name = format!("{index:04}.mcap");
        let path = folder.join(format!("{name}{ACTIVE}"));
        let failed = |source| RecordingError::Io { path: path.clone(), source };
        let file = OpenOptions::new().write(true).create_new(true).open(&path).map_err(failed)?;
        sync_folder(folder)?;
        let handle = file.try_clone().map_err(failed)?;
        let hashing = Hashing { file: BufWriter::with_capacity(1 << 20, file), hash: blake3::Hasher::new() };
        let writer = LogWriter::new(hashing)?;
        Ok(Self {
            folder: folder.to_owned(),
            name,
            writer,
            file: handle,
            passed: Vec::new(),
            own: BTreeMap::new(),
            counts: Counts::default(),
            poses: None,
            first_ns: None,
            last_ns: i64::MIN,
            messages: 0,
            synced: Instant::now(),
            buffer: Vec::new(),
        })
    }

    pub(super) fn attach(&mut self, name: &str, log_time_ns: i64, data: &[u8]) -> Result<(), RecordingError> {
        Ok(self.writer.attach(name, "application/octet-stream", log_time_ns, data)?)
    }

    /// A recorded message, its bytes untouched.
    pub(super) fn pass(&mut self, message: &LogMessage) -> Result<(), RecordingError> {
        let channel = self.channel_of(&message.channel)?;
        let LogMessage { sequence, log_time_ns, publish_time_ns, data, .. } = message;
        self.writer.write(channel, *sequence, *log_time_ns, *publish_time_ns, data)?;
        self.count(*log_time_ns);
        Ok(())
    }

    /// A message of our own.
    pub(super) fn write<M: Message>(
        &mut self,
        topic: &'static str,
        log_time_ns: i64,
        message: &M,
    ) -> Result<(), RecordingError> {
        let channel = match self.own.get(topic) {
            Some(channel) => *channel,
            None => {
                let channel = self.writer.add_channel::<M>(topic, Durability::Volatile)?;
                self.own.insert(topic, channel);
                channel
            }
        };
        message.encode_into(&mut self.buffer);
        self.writer.write(channel, 0, log_time_ns, log_time_ns, &self.buffer)?;
        self.count(log_time_ns);
        Ok(())
    }

    pub(super) fn valid_pose(&mut self, x: f64, y: f64) {
        self.poses = Some(PoseBox::around(self.poses, x, y));
    }

    pub(super) fn bytes(&self) -> u64 {
        self.writer.bytes_written()
    }

    pub(super) fn first_ns(&self) -> Option<i64> {
        self.first_ns
    }

    /// Closes the chunk and forces everything to disk, if that is due.
    pub(super) fn sync_if_due(&mut self, interval: std::time::Duration) -> Result<(), RecordingError> {
        if self.synced.elapsed() < interval {
            return Ok(());
        }
        self.writer.flush_chunk()?;
        let failed = |source| RecordingError::Io { path: self.folder.join(&self.name), source };
        self.file.sync_data().map_err(failed)?;
        self.synced = Instant::now();
        Ok(())
    }

    /// Footer, onto disk, then the final name: whoever sees that name sees a whole file.
    pub(super) fn finish(self) -> Result<ManifestLine, RecordingError> {
        let active = self.folder.join(format!("{}{ACTIVE}", self.name));
        let path = self.folder.join(&self.name);
        let failed = |source| RecordingError::Io { path: active.clone(), source };
        let Hashing { file, hash } = self.writer.finish()?;
        let file = file.into_inner().map_err(|error| failed(error.into_error()))?;
        file.sync_all().map_err(failed)?;
        let bytes = file.metadata().map_err(failed)?.len();
        std::fs::rename(&active, &path).map_err(failed)?;
        sync_folder(&self.folder)?;
        Ok(ManifestLine {
            name: self.name,
            bytes,
            blake3: hash.finalize().to_hex().to_string(),
            first_ns: self.first_ns.unwrap_or(0),
            last_ns: self.last_ns.max(self.first_ns.unwrap_or(0)),
            messages: self.messages,
            frames: self.counts,
            poses: self.poses,
        })
    }

    /// One channel for all of the source's that are the same but for their number.
    fn channel_of(&mut self, channel: &Arc<Channel>) -> Result<ChannelId, RecordingError> {
        if let Some((_, id)) = self.passed.iter().find(|(known, _)| Arc::ptr_eq(known, channel)) {
            return Ok(*id);
        }
        // The next file of the source has entries of its own, and so has each of several senders.
        let known = self.passed.iter().find(|(known, _)| is_same(known, channel)).map(|(_, id)| *id);
        let id = match known {
            Some(id) => id,
            None => self.writer.add_raw_channel(&RawChannel::from(channel.as_ref()))?,
        };
        self.passed.push((Arc::clone(channel), id));
        Ok(id)
    }

    fn count(&mut self, log_time_ns: i64) {
        self.first_ns = Some(self.first_ns.map_or(log_time_ns, |first| first.min(log_time_ns)));
        self.last_ns = self.last_ns.max(log_time_ns);
        self.messages += 1;
    }
}

/// Whether the file may take both for one.
fn is_same(one: &Channel, other: &Channel) -> bool {
    *one == Channel { id: one.id, ..other.clone() }
}

/// Makes a created or renamed name survive a power cut.
pub fn sync_folder(folder: &Path) -> Result<(), RecordingError> {
    let failed = |source| RecordingError::Io { path: folder.to_owned(), source };
    File::open(folder).and_then(|folder| folder.sync_all()).map_err(failed)
}
