//! The recorder: turns entries into files. It is the only place that writes a session, whichever thread it runs in
//! and whatever the disk does.
//!
//! An entry is kept in memory until the disk has confirmed it. If anything fails, the segment is given up at the
//! point that was confirmed last, and the next attempt writes the kept entries into a new segment: a failed fsync is
//! never repeated on the same file, because its success would prove nothing.

mod session_folder;

use session_folder::FolderState;
pub use session_folder::folder_name;

use std::any::Any;
use std::collections::{BTreeMap, VecDeque};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use crate::entry::{Entry, Gap, Kind, SegmentStart};
use crate::error::{REMOVED, RecordingError};
use crate::gap::GapMessages;
use crate::manifest::{Counts, MANIFEST_FILE, METADATA_FILE, ManifestLine, SessionInfo, TopicEntry, metadata_yaml};
use crate::record_queue::{ConfirmedContent, QueuedEntry, RecordQueue};
use crate::segment::{Cut, Finished, Segment, Unfinished};
use crate::storage::{Appending, Storage, StoredFile, write_atomically};
use crate::sync_schedule::SyncSchedule;
use realitysim_ros2::mcap_read::LogMessage;
use realitysim_ros2::messages::{CameraInfo, Message};

/// What is to be recorded, and where.
#[derive(Clone)]
pub(crate) struct Plan {
    /// Folder of all captures.
    pub captures: PathBuf,
    /// Name of the session's folder, unless it is taken.
    pub name: String,
    /// Content of `session.json`.
    pub info: SessionInfo,
    /// Longest time that an entry waits until the disk is asked to confirm it.
    pub sync_interval: Duration,
    /// Whether other machines may fetch the session and acknowledge it.
    pub is_synced_from: bool,
}

/// Writes the entries of a session to its files. If somebody removes the folder, it begins another session.
pub(crate) struct Recorder {
    storage: Arc<dyn Storage>,
    shared: Arc<RecordQueue>,
    plan: Plan,
    /// Folder of the session, once it has been made.
    folder: Option<PathBuf>,
    /// Whether session file and manifest are there.
    is_ready: bool,
    /// Number of the file system that the folder of captures was on when the session began.
    volume: Option<u64>,
    /// Content that the disk has confirmed of the finished segments, those in `lines`.
    finished_content: ConfirmedContent,
    /// Content that the disk has confirmed of the open segment.
    open_content: ConfirmedContent,
    /// Since when the session's folder cannot be found.
    away_since: Option<Duration>,
    /// Lock of the session, which tells `repair` to leave the folder alone.
    lock: Option<Box<dyn Any + Send>>,
    segment: Option<Segment>,
    next_index: u32,
    /// Entries that were taken and are not yet confirmed by the disk, oldest first.
    kept: VecDeque<UnconfirmedEntry>,
    /// Number of these entries that are written to the open segment.
    written: usize,
    /// Memory of the entries that are written, bytes.
    written_bytes: usize,
    /// Size of a batch, bytes: when so much is written, the disk is asked to confirm it. It is small after a failure,
    /// so that a disk with little room keeps at least that little.
    batch_bytes: usize,
    /// Number of entries that the disk has confirmed.
    confirmed: u64,
    /// Ends of segments that were given up and that no confirmed segment mentions yet.
    cuts: Vec<Cut>,
    manifest: Option<Arc<dyn StoredFile>>,
    /// Manifest lines of the finished segments.
    lines: Vec<ManifestLine>,
    /// Messages of the finished segments, by topic.
    topics: BTreeMap<TopicEntry, u64>,
    /// Calibration and constant transforms, written again at the start of each segment.
    latched: Vec<LogMessage>,
    gaps: GapMessages,
    schedule: SyncSchedule,
}

/// An entry that the disk has not confirmed.
struct UnconfirmedEntry {
    waiting: QueuedEntry,
    /// Whether the entry has been counted: it may be written more than once.
    is_counted: bool,
}

/// Most latched messages that are repeated in each segment.
const MAX_LATCHED: usize = 256;
/// Largest batch, bytes: with more not confirmed, the disk is asked before its time.
const MAX_UNSYNCED_BYTES: usize = 32 << 20;
/// Smallest batch, bytes: the size after a failure. It doubles with each batch that the disk confirms.
const MIN_UNSYNCED_BYTES: usize = 4 << 10;

impl Recorder {
    /// Prepares a recorder; nothing is written before the first entry.
    pub fn new(storage: Arc<dyn Storage>, shared: Arc<RecordQueue>, plan: Plan) -> Self {
        let gaps = GapMessages::new(&plan.info.robot);
        let schedule = SyncSchedule::new(plan.sync_interval);
        Self {
            storage,
            shared,
            plan,
            folder: None,
            is_ready: false,
            volume: None,
            finished_content: ConfirmedContent::default(),
            open_content: ConfirmedContent::default(),
            away_since: None,
            lock: None,
            segment: None,
            next_index: 0,
            kept: VecDeque::new(),
            written: 0,
            written_bytes: 0,
            batch_bytes: MAX_UNSYNCED_BYTES,
            confirmed: 0,
            cuts: Vec::new(),
            manifest: None,
            lines: Vec::new(),
            topics: BTreeMap::new(),
            latched: Vec::new(),
            gaps,
            schedule,
        }
    }

    /// Takes an entry and writes it. The entry is kept even if this fails: [`write_pending`](Self::write_pending)
    /// tries again.
    ///
    /// A small file ([`Entry::State`]) is written at once and not kept.
    pub fn take(&mut self, waiting: QueuedEntry) -> Result<(), RecordingError> {
        if let Entry::State(path, data) = &waiting.entry {
            let written = write_atomically(self.storage.as_ref(), path, data);
            self.shared.release(&waiting.entry);
            return written;
        }
        self.kept.push_back(UnconfirmedEntry { waiting, is_counted: false });
        self.write_pending()
    }

    /// Writes what is not written yet, into a new segment if the last one was given up.
    pub fn write_pending(&mut self) -> Result<(), RecordingError> {
        let done = self.write_all();
        self.give_up_on_error(done)
    }

    /// Asks the disk to confirm what is written, if that is due.
    pub fn sync_if_due(&mut self) -> Result<(), RecordingError> {
        if !self.schedule.is_due(self.oldest_taken(), self.shared.next_taken(), self.storage.now()) {
            return Ok(());
        }
        let done = self.sync();
        self.give_up_on_error(done)
    }

    /// Time until the next sync is due.
    pub fn time_to_sync(&self) -> Duration {
        self.schedule.time_to_sync(self.oldest_taken(), self.storage.now())
    }

    /// Writes and confirms everything and finishes the open segment. The next entry begins another.
    pub fn complete_segment(&mut self) -> Result<(), RecordingError> {
        self.write_pending()?;
        if self.segment.is_none() {
            return Ok(());
        }
        let done = self.sync().and_then(|()| self.finish_segment());
        self.give_up_on_error(done)
    }

    /// Finishes the session and returns its folder. If this fails, it may be tried again.
    pub fn finish(&mut self) -> Result<PathBuf, RecordingError> {
        self.complete_segment()?;
        let done = self.write_metadata();
        let folder = self.give_up_on_error(done)?;
        self.lock = None;
        Ok(folder)
    }

    /// Writes `metadata.yaml`.
    fn write_metadata(&mut self) -> Result<PathBuf, RecordingError> {
        let folder = self.open_session()?;
        let yaml = metadata_yaml(&self.lines, &self.topics);
        write_atomically(self.storage.as_ref(), &folder.join(METADATA_FILE), yaml.as_bytes())?;
        Ok(folder)
    }

    /// Gives up: counts everything that the disk never confirmed as lost, for this cause.
    pub fn abandon(mut self, cause: &str) {
        for UnconfirmedEntry { waiting, is_counted } in self.kept.drain(..) {
            self.shared.count_lost(&waiting.entry, is_counted, cause);
            self.shared.release(&waiting.entry);
        }
        drop(self.segment.take().map(Segment::give_up));
    }

    /// Folder of the session, once it has been made.
    pub fn folder(&self) -> Option<&Path> {
        self.folder.as_deref()
    }

    /// Number of entries that the disk has confirmed. An attempt that fails but raises this number was worth it.
    pub fn confirmed(&self) -> u64 {
        self.confirmed
    }

    /// When the oldest entry arrived that the disk has not confirmed.
    fn oldest_taken(&self) -> Option<Duration> {
        self.kept.front().map(|kept| kept.waiting.taken)
    }

    /// Number of entries that the disk has not confirmed.
    #[cfg(test)]
    pub fn kept(&self) -> usize {
        self.kept.len()
    }

    /// Writes all kept entries, segment by segment, and syncs after each batch.
    fn write_all(&mut self) -> Result<(), RecordingError> {
        let folder = self.open_session()?;
        while let Some(kept) = self.kept.get(self.written) {
            if let Entry::Begin(beginning) = &kept.waiting.entry {
                let beginning = beginning.clone();
                if self.segment.is_some() {
                    self.sync()?;
                    self.finish_segment()?;
                }
                self.begin_segment(&folder, Some(&beginning))?;
            } else {
                if self.segment.is_none() {
                    self.begin_segment(&folder, None)?;
                }
                self.write()?;
            }
            self.written_bytes += self.kept.get(self.written).map_or(0, |kept| kept.waiting.entry.bytes());
            self.written += 1;
            if self.written_bytes >= self.batch_bytes {
                self.sync()?;
                self.batch_bytes = (2 * self.batch_bytes).min(MAX_UNSYNCED_BYTES);
            }
        }
        Ok(())
    }

    /// Begins a segment: identity of the session, state of the filter, ends of segments that were given up, latched
    /// messages.
    fn begin_segment(&mut self, folder: &Path, beginning: Option<&SegmentStart>) -> Result<(), RecordingError> {
        let created = Segment::create(&self.storage, folder, self.next_index);
        // A file that is in the way, left by an attempt that failed halfway, uses up the number as well.
        if created.is_ok() || created.as_ref().is_err_and(RecordingError::already_exists) {
            self.next_index += 1;
        }
        let segment = self.segment.insert(created?);
        if let Some(id) = &self.plan.info.id {
            segment.belongs_to(id)?;
        }
        if let Some(SegmentStart { log_time_ns, name, state }) = beginning {
            segment.attach(name, *log_time_ns, state)?;
        }
        for cut in &self.cuts {
            segment.continues(cut)?;
        }
        let begins_ns = beginning.map(|beginning| beginning.log_time_ns);
        let next_ns = || self.kept.iter().skip(self.written).find_map(|kept| kept.waiting.entry.log_time_ns());
        let log_time_ns = begins_ns.or_else(next_ns);
        for message in &self.latched {
            if self.kept.iter().any(|kept| kept.waiting.entry.repeats(message)) {
                continue;
            }
            let log_time_ns = log_time_ns.unwrap_or(message.log_time_ns);
            let again = LogMessage { log_time_ns, ..message.clone() };
            segment.write(&again)?;
        }
        Ok(())
    }

    /// Writes the next entry that is not written yet. A message that cannot be written at all becomes a gap.
    fn write(&mut self) -> Result<(), RecordingError> {
        let (Some(segment), Some(kept)) = (&mut self.segment, self.kept.get_mut(self.written)) else { return Ok(()) };
        let entry = &kept.waiting.entry;
        match entry {
            Entry::Message(message, kind) => {
                match segment.write(message) {
                    Err(error) if error.is_of_the_message() => {
                        self.shared.count_lost(entry, kept.is_counted, error.cause());
                        kept.waiting.entry = Entry::Gap(gap_of(message, *kind, error.cause()));
                        return self.write();
                    }
                    written => written?,
                }
                let counts = &mut segment.counts;
                match kind {
                    Kind::Frame => {
                        counts.captured += 1;
                        counts.written += 1;
                    }
                    Kind::Tag(at) => {
                        counts.tagged += 1;
                        counts.valid += u64::from(at.is_some());
                        at.iter().for_each(|at| segment.valid_pose(*at));
                    }
                    Kind::Latched => remember_latched(&mut self.latched, message),
                    Kind::Other => {}
                }
            }
            Entry::Gap(gap) => {
                let message = self.gaps.message(gap);
                segment.write(&message)?;
                count_gap(&mut segment.counts, gap);
            }
            Entry::Untagged(cause) => *segment.counts.untagged.entry(cause.clone()).or_default() += 1,
            Entry::Thinned => {
                segment.counts.captured += 1;
                segment.counts.thinned += 1;
            }
            Entry::Begin(_) | Entry::State(..) => {}
        }
        if !kept.is_counted {
            kept.is_counted = true;
            self.shared.count_written(&kept.waiting.entry);
        }
        Ok(())
    }

    /// Asks the disk to confirm the segment and forgets the entries that it holds.
    fn sync(&mut self) -> Result<(), RecordingError> {
        let Some(segment) = &mut self.segment else { return Ok(()) };
        segment.sync()?;
        let ended = self.storage.now();
        self.cuts.clear();
        self.schedule.confirmed(self.oldest_taken().unwrap_or(ended), ended);
        let mut frames = 0;
        for UnconfirmedEntry { waiting, .. } in self.kept.drain(..self.written) {
            frames += u64::from(waiting.entry.is_frame());
            self.open_content.add(&waiting.entry);
            self.shared.release(&waiting.entry);
        }
        self.confirmed += self.written as u64;
        (self.written, self.written_bytes) = (0, 0);
        let schedule = &self.schedule;
        self.shared.update(|status| {
            status.frames_synced += frames;
            status.worst_stall_ms = schedule.worst_stall_ms();
            status.worst_unsynced_ms = schedule.worst_unsynced_ms();
            status.loss_bound_ms = schedule.loss_bound_ms();
        });
        Ok(())
    }

    /// Finishes the open segment and notes it in the manifest.
    fn finish_segment(&mut self) -> Result<(), RecordingError> {
        let Some(segment) = self.segment.take() else { return Ok(()) };
        match segment.finish() {
            Ok(finished) => self.note_finished(finished),
            Err(Unfinished::Renamed(finished, error)) => self.note_finished(*finished).and(Err(error)),
            Err(Unfinished::GivenUp(cut, error)) => {
                self.note_cut(cut);
                Err(error)
            }
        }
    }

    /// Appends a segment to the manifest. The line stays in memory in any case: a manifest that could not be written
    /// is written anew.
    fn note_finished(&mut self, Finished { line, topics }: Finished) -> Result<(), RecordingError> {
        for (topic, messages) in topics {
            *self.topics.entry(topic).or_default() += messages;
        }
        let mut text = serde_json::to_vec(&line)?;
        text.push(b'\n');
        self.lines.push(line);
        self.finished_content.join(std::mem::take(&mut self.open_content));
        let Some(manifest) = self.manifest.take() else { return Ok(()) };
        let appended = io::Write::write_all(&mut Appending(Arc::clone(&manifest)), &text);
        match appended.and_then(|()| manifest.sync()) {
            Ok(()) => {
                self.manifest = Some(manifest);
                Ok(())
            }
            Err(source) => {
                let path = self.folder.as_deref().unwrap_or(Path::new("")).join(MANIFEST_FILE);
                Err(RecordingError::io(&path, source))
            }
        }
    }

    /// Passes a success on; after an error gives up the open segment and finds out whether somebody has removed the
    /// folder.
    fn give_up_on_error<T>(&mut self, done: Result<T, RecordingError>) -> Result<T, RecordingError> {
        let error = match done {
            Ok(done) => {
                self.away_since = None;
                return Ok(done);
            }
            Err(error) => error,
        };
        self.schedule.failed();
        (self.written, self.written_bytes) = (0, 0);
        self.batch_bytes = MIN_UNSYNCED_BYTES;
        let mut is_segment_removed = false;
        if let Some(segment) = self.segment.take() {
            is_segment_removed = segment.is_removed();
            let cut = segment.give_up();
            self.note_cut(cut);
        }
        let Some(folder) = self.folder.clone() else { return Err(error) };
        match self.find_folder(&folder) {
            FolderState::Removed => {
                self.begin_new_session();
                Err(RecordingError::Removed(folder))
            }
            FolderState::Unreachable => Err(RecordingError::io(&folder, io::ErrorKind::NotFound.into())),
            FolderState::Present => {
                if is_segment_removed {
                    let content = std::mem::take(&mut self.open_content);
                    self.report_removed(content);
                }
                Err(error)
            }
        }
    }

    /// Counts removed content as lost and puts a gap in front of all entries that are not written yet.
    fn report_removed(&mut self, content: ConfirmedContent) {
        let Some(gap) = content.gap(REMOVED) else { return };
        self.shared.count_removed(&content, REMOVED);
        let entry = Entry::Gap(gap);
        self.shared.hold_unqueued(&entry);
        let taken = self.storage.now();
        self.kept.push_front(UnconfirmedEntry { waiting: QueuedEntry { entry, taken }, is_counted: true });
    }

    /// Remembers where a segment that was given up ends.
    fn note_cut(&mut self, cut: Cut) {
        self.shared.update(|status| status.segments_given_up += 1);
        self.cuts.push(cut);
    }
}

/// Remembers a latched message. Many drivers send calibration with every frame, and constants again and again: one of
/// each is enough.
fn remember_latched(latched: &mut Vec<LogMessage>, message: &LogMessage) {
    let newest_only = message.channel.type_name == CameraInfo::TYPE;
    let is_known = |known: &LogMessage| {
        known.channel.topic == message.channel.topic && (newest_only || known.data == message.data)
    };
    match latched.iter().position(is_known) {
        Some(place) => latched[place] = message.clone(),
        None if latched.len() < MAX_LATCHED => latched.push(message.clone()),
        None => {}
    }
}

/// Adds what a gap says was dropped to the counts.
pub(crate) fn count_gap(counts: &mut Counts, gap: &Gap) {
    counts.captured += gap.frames;
    let sums =
        [(gap.frames, &mut counts.dropped), (gap.messages, &mut counts.lost), (gap.untagged, &mut counts.untagged)];
    for (lost, sum) in sums {
        if lost > 0 {
            *sum.entry(gap.cause.clone()).or_default() += lost;
        }
    }
}

/// Gap in place of a single message.
fn gap_of(message: &LogMessage, kind: Kind, cause: &str) -> Gap {
    let frames = u64::from(kind == Kind::Frame);
    let at_ns = message.log_time_ns;
    let untagged = u64::from(matches!(kind, Kind::Tag(_)));
    Gap { cause: cause.to_owned(), frames, messages: 1 - frames, untagged, first_ns: at_ns, last_ns: at_ns }
}
