//! Entries to files: the one place that writes a session, whichever thread it runs in and whatever the disk does.
//!
//! What is written is kept until the disk has confirmed it. If anything fails, the segment is given up where it was
//! confirmed last, and the next try writes what is kept into a new one: no failed fsync is ever tried again on its file.

use std::any::Any;
use std::collections::{BTreeMap, VecDeque};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use super::acknowledgement::ACK_FOLDER;
use super::entry::{Beginning, Entry, Gap, Kind};
use super::error::{REMOVED, RecordingError};
use super::gap::GapMessages;
use super::identity::SessionId;
use super::manifest::{
    Counts, MANIFEST_FILE, METADATA_FILE, ManifestLine, SESSION_FILE, SessionInfo, TopicEntry, metadata_yaml,
};
use super::record_queue::{Had, QueuedEntry, RecordQueue};
use super::segment::{Cut, Finished, Segment, Unfinished};
use super::storage::{Appending, Storage, StoredFile, write_atomically};
use super::sync_schedule::Pace;
use realitysim_ros2::mcap_read::LogMessage;
use realitysim_ros2::messages::{CameraInfo, Message};

/// What a session is, before anything is written.
#[derive(Clone)]
pub(super) struct Plan {
    pub captures: PathBuf,
    /// Of the folder, unless it is taken.
    pub name: String,
    pub info: SessionInfo,
    pub sync_interval: Duration,
    /// Others may fetch it, and say what they have.
    pub is_synced_from: bool,
}

pub(super) struct Recorder {
    storage: Arc<dyn Storage>,
    shared: Arc<RecordQueue>,
    plan: Plan,
    folder: Option<PathBuf>,
    /// Session file and manifest are there.
    is_ready: bool,
    /// The file system that it was made on.
    volume: Option<u64>,
    /// What the disk has confirmed of the segments in `lines`, and of the open one.
    had_before: Had,
    had: Had,
    /// Since when the session's folder is not there.
    away_since: Option<Duration>,
    /// Tells `repair` to leave the folder alone.
    lock: Option<Box<dyn Any + Send>>,
    segment: Option<Segment>,
    next_index: u32,
    /// Taken and not yet confirmed by the disk, oldest first; so many of them are written to the segment.
    kept: VecDeque<Kept>,
    written: usize,
    /// Of the written ones.
    written_bytes: usize,
    /// The disk is asked after so many of them. Little after a failure: a disk that takes a little keeps that little.
    batch_bytes: usize,
    /// Entries that the disk has confirmed so far.
    confirmed: u64,
    /// Ends of earlier segments that no confirmed segment tells yet.
    cuts: Vec<Cut>,
    manifest: Option<Arc<dyn StoredFile>>,
    lines: Vec<ManifestLine>,
    /// Messages of the segments in `lines`.
    topics: BTreeMap<TopicEntry, u64>,
    /// Calibration and constants, written again at the start of each segment.
    latched: Vec<LogMessage>,
    gaps: GapMessages,
    pace: Pace,
}

/// Where a folder is that was made here.
enum Whereabouts {
    Here,
    /// With the folder of all captures; it may come back.
    Away,
    Removed,
}

struct Kept {
    waiting: QueuedEntry,
    /// Counted when it was first written; it may be written again.
    is_counted: bool,
}

/// More latched messages than this are not repeated in each segment.
const MAX_LATCHED: usize = 256;
/// Names tried before giving up: `name`, `name-2`, ...
const MAX_SUFFIX: u32 = 10_000;
/// With more than this not confirmed, the disk is asked before its time.
const MAX_UNSYNCED_BYTES: usize = 32 << 20;
/// After a failure it is asked with more than this, and then with twice as much each time that all goes well.
const LEAST_UNSYNCED_BYTES: usize = 4 << 10;
/// So long a folder of captures may be away before another is made in its place, on the same file system.
const PATIENCE: Duration = Duration::from_secs(5);

impl Recorder {
    pub fn new(storage: Arc<dyn Storage>, shared: Arc<RecordQueue>, plan: Plan) -> Self {
        let gaps = GapMessages::new(&plan.info.robot);
        let pace = Pace::new(plan.sync_interval);
        Self {
            storage,
            shared,
            plan,
            folder: None,
            is_ready: false,
            volume: None,
            had_before: Had::default(),
            had: Had::default(),
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
            pace,
        }
    }

    /// Whatever comes back, the entry is kept: [`go_on`](Self::go_on) tries again.
    pub fn take(&mut self, waiting: QueuedEntry) -> Result<(), RecordingError> {
        if let Entry::State(path, data) = &waiting.entry {
            let written = write_atomically(self.storage.as_ref(), path, data);
            self.shared.release(&waiting.entry);
            return written;
        }
        self.kept.push_back(Kept { waiting, is_counted: false });
        self.go_on()
    }

    /// Writes what is not written yet, into a new segment if the last one was given up.
    pub fn go_on(&mut self) -> Result<(), RecordingError> {
        let done = self.write_all();
        self.give_up_after(done)
    }

    pub fn sync_if_due(&mut self) -> Result<(), RecordingError> {
        if !self.pace.is_due(self.oldest(), self.shared.next_taken(), self.storage.now()) {
            return Ok(());
        }
        let done = self.sync();
        self.give_up_after(done)
    }

    /// So long until the next sync is due.
    pub fn idle(&self) -> Duration {
        self.pace.wait(self.oldest(), self.storage.now())
    }

    /// Everything confirmed, the segment whole. The next entry begins another.
    pub fn rest(&mut self) -> Result<(), RecordingError> {
        self.go_on()?;
        if self.segment.is_none() {
            return Ok(());
        }
        let done = self.sync().and_then(|()| self.finish_segment());
        self.give_up_after(done)
    }

    /// The session is whole. May be tried again if it fails.
    pub fn finish(&mut self) -> Result<PathBuf, RecordingError> {
        self.rest()?;
        let done = self.describe();
        let folder = self.give_up_after(done)?;
        self.lock = None;
        Ok(folder)
    }

    fn describe(&mut self) -> Result<PathBuf, RecordingError> {
        let folder = self.open_session()?;
        let yaml = metadata_yaml(&self.lines, &self.topics);
        write_atomically(self.storage.as_ref(), &folder.join(METADATA_FILE), yaml.as_bytes())?;
        Ok(folder)
    }

    /// The disk never took what is left: it is counted as lost.
    pub fn abandon(mut self, cause: &str) {
        for Kept { waiting, is_counted } in self.kept.drain(..) {
            self.shared.lost(&waiting.entry, is_counted, cause);
            self.shared.release(&waiting.entry);
        }
        drop(self.segment.take().map(Segment::give_up));
    }

    pub fn folder(&self) -> Option<&Path> {
        self.folder.as_deref()
    }

    /// Entries that the disk has confirmed: a try that fails with more of them was worth it.
    pub fn confirmed(&self) -> u64 {
        self.confirmed
    }

    /// When the oldest entry came that the disk has not confirmed.
    fn oldest(&self) -> Option<Duration> {
        self.kept.front().map(|kept| kept.waiting.taken)
    }

    /// Entries that the disk has not confirmed.
    #[cfg(test)]
    pub fn kept(&self) -> usize {
        self.kept.len()
    }

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

    /// The folder, made when it is needed first; each step can be repeated.
    fn open_session(&mut self) -> Result<PathBuf, RecordingError> {
        let storage = self.storage.as_ref();
        let captures = &self.plan.captures;
        let failed = |source| RecordingError::io(captures, source);
        let folder = match &self.folder {
            Some(folder) => folder.clone(),
            None => {
                let unmade = |source| RecordingError::Folder { path: captures.clone(), source };
                storage.create_folders(captures).map_err(unmade)?;
                self.volume = storage.volume(captures).ok();
                let folder = new_folder(storage, captures, &self.plan.name)?;
                self.folder = Some(folder.clone());
                folder
            }
        };
        if !self.is_ready {
            if self.plan.is_synced_from {
                create_shared_folder(storage, &folder.join(ACK_FOLDER))?;
            }
            write_atomically(storage, &folder.join(SESSION_FILE), &serde_json::to_vec_pretty(&self.plan.info)?)?;
            storage.sync_folder(captures).map_err(failed)?;
            // The folder of all captures may be as new.
            captures.parent().map_or(Ok(()), |parent| storage.sync_folder(parent)).map_err(failed)?;
            // A repair that is at it will be done in a moment.
            let busy = || RecordingError::io(&folder, io::ErrorKind::ResourceBusy.into());
            self.lock = Some(storage.lock(&folder.join(SESSION_FILE)).map_err(failed)?.ok_or_else(busy)?);
            self.is_ready = true;
            self.shared.update(|status| status.session = Some(folder.clone()));
        }
        if self.manifest.is_none() {
            let path = folder.join(MANIFEST_FILE);
            let mut text = Vec::new();
            for line in &self.lines {
                serde_json::to_writer(&mut text, line)?;
                text.push(b'\n');
            }
            write_atomically(storage, &path, &text)?;
            self.manifest = Some(storage.append(&path).map_err(|source| RecordingError::io(&path, source))?);
        }
        Ok(folder)
    }

    fn begin_segment(&mut self, folder: &Path, beginning: Option<&Beginning>) -> Result<(), RecordingError> {
        let created = Segment::create(&self.storage, folder, self.next_index);
        // A file that is in the way, as of a try that failed halfway, has used the number up as well.
        if created.is_ok() || created.as_ref().is_err_and(RecordingError::already_exists) {
            self.next_index += 1;
        }
        let segment = self.segment.insert(created?);
        if let Some(id) = &self.plan.info.id {
            segment.belongs_to(id)?;
        }
        if let Some(Beginning { log_time_ns, name, state }) = beginning {
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

    /// The next entry that is not written yet.
    fn write(&mut self) -> Result<(), RecordingError> {
        let (Some(segment), Some(kept)) = (&mut self.segment, self.kept.get_mut(self.written)) else { return Ok(()) };
        let entry = &kept.waiting.entry;
        match entry {
            Entry::Message(message, kind) => {
                match segment.write(message) {
                    Err(error) if error.is_of_the_message() => {
                        self.shared.lost(entry, kept.is_counted, error.cause());
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
                    Kind::Latched => keep(&mut self.latched, message),
                    Kind::Other => {}
                }
            }
            Entry::Gap(gap) => {
                let message = self.gaps.message(gap);
                segment.write(&message)?;
                note_gap(&mut segment.counts, gap);
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
            self.shared.written(&kept.waiting.entry);
        }
        Ok(())
    }

    /// What is written becomes what is confirmed.
    fn sync(&mut self) -> Result<(), RecordingError> {
        let Some(segment) = &mut self.segment else { return Ok(()) };
        segment.sync()?;
        let ended = self.storage.now();
        self.cuts.clear();
        self.pace.confirmed(self.oldest().unwrap_or(ended), ended);
        let mut frames = 0;
        for Kept { waiting, .. } in self.kept.drain(..self.written) {
            frames += u64::from(waiting.entry.is_frame());
            self.had.add(&waiting.entry);
            self.shared.release(&waiting.entry);
        }
        self.confirmed += self.written as u64;
        (self.written, self.written_bytes) = (0, 0);
        let pace = &self.pace;
        self.shared.update(|status| {
            status.frames_synced += frames;
            status.worst_stall_ms = pace.worst_stall_ms();
            status.worst_unsynced_ms = pace.worst_unsynced_ms();
            status.loss_bound_ms = pace.loss_bound_ms();
        });
        Ok(())
    }

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

    /// The line stands in memory in any case: a manifest that failed is written anew.
    fn note_finished(&mut self, Finished { line, topics }: Finished) -> Result<(), RecordingError> {
        for (topic, messages) in topics {
            *self.topics.entry(topic).or_default() += messages;
        }
        let mut text = serde_json::to_vec(&line)?;
        text.push(b'\n');
        self.lines.push(line);
        self.had_before.join(std::mem::take(&mut self.had));
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

    fn give_up_after<T>(&mut self, done: Result<T, RecordingError>) -> Result<T, RecordingError> {
        let error = match done {
            Ok(done) => {
                self.away_since = None;
                return Ok(done);
            }
            Err(error) => error,
        };
        self.pace.failed();
        (self.written, self.written_bytes) = (0, 0);
        self.batch_bytes = LEAST_UNSYNCED_BYTES;
        let mut is_segment_removed = false;
        if let Some(segment) = self.segment.take() {
            is_segment_removed = segment.is_removed();
            let cut = segment.give_up();
            self.note_cut(cut);
        }
        let Some(folder) = self.folder.clone() else { return Err(error) };
        match self.whereabouts(&folder) {
            Whereabouts::Removed => {
                self.begin_anew();
                Err(RecordingError::Removed(folder))
            }
            Whereabouts::Away => Err(RecordingError::io(&folder, io::ErrorKind::NotFound.into())),
            Whereabouts::Here => {
                if is_segment_removed {
                    let had = std::mem::take(&mut self.had);
                    self.tell_removed(had);
                }
                Err(error)
            }
        }
    }

    /// Of the session's folder. If it is gone while that of all captures is there, on the same file system, somebody has removed or
    /// moved it. Where the captures are gone as well they may come back, as a disk that was away: they are waited for.
    fn whereabouts(&mut self, folder: &Path) -> Whereabouts {
        let (storage, captures) = (self.storage.as_ref(), &self.plan.captures);
        let is_missing =
            |error: io::Error| matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory);
        let is_gone = match self.is_ready {
            true => storage.read(&folder.join(SESSION_FILE)).is_err_and(is_missing),
            // It has nothing in it yet.
            false => storage.volume(folder).is_err_and(is_missing),
        };
        if !is_gone {
            self.away_since = None;
            return Whereabouts::Here;
        }
        let now = storage.now();
        let away_since = *self.away_since.get_or_insert(now);
        let near = captures.ancestors().skip(1).find_map(|folder| storage.volume(non_empty(folder)).ok());
        let is_removed = match storage.volume(captures) {
            Ok(volume) => Some(volume) == self.volume,
            Err(_) => near == self.volume && now.saturating_sub(away_since) >= PATIENCE,
        };
        if is_removed { Whereabouts::Removed } else { Whereabouts::Away }
    }

    /// Another folder, with another identity: if the old one was only moved, there are two sessions. What was in it counts as lost,
    /// and a gap in the new one tells so.
    fn begin_anew(&mut self) {
        let mut had = std::mem::take(&mut self.had_before);
        had.join(std::mem::take(&mut self.had));
        self.tell_removed(had);
        (self.folder, self.lock, self.manifest, self.away_since) = (None, None, None, None);
        (self.is_ready, self.next_index) = (false, 0);
        self.lines.clear();
        self.topics.clear();
        self.cuts.clear();
        if let Some(id) = &mut self.plan.info.id {
            SessionId::new().as_str().clone_into(id);
        }
        if let Some(next_ns) = self.kept.iter().find_map(|kept| kept.waiting.entry.log_time_ns()) {
            let started = jiff::Timestamp::from_nanosecond(i128::from(next_ns)).unwrap_or_default();
            self.plan.info.started = started.to_string();
            self.plan.name = folder_name(started, &self.plan.info.robot);
        }
        self.shared.begin_anew();
    }

    /// Behind what is kept and written no more, so that the gap stands before what comes after.
    fn tell_removed(&mut self, had: Had) {
        let Some(gap) = had.gap(REMOVED) else { return };
        self.shared.removed(&had, REMOVED);
        let entry = Entry::Gap(gap);
        self.shared.take_at_once(&entry);
        let taken = self.storage.now();
        self.kept.push_front(Kept { waiting: QueuedEntry { entry, taken }, is_counted: true });
    }

    fn note_cut(&mut self, cut: Cut) {
        self.shared.update(|status| status.segments_given_up += 1);
        self.cuts.push(cut);
    }
}

/// Of a session's folder.
pub fn folder_name(started: jiff::Timestamp, robot: &str) -> String {
    format!("{}-{robot}", started.strftime("%Y-%m-%dT%H-%M-%SZ"))
}

/// The parent of a plain name is the empty path.
fn non_empty(path: &Path) -> &Path {
    if path.as_os_str().is_empty() { Path::new(".") } else { path }
}

fn new_folder(storage: &dyn Storage, captures: &Path, name: &str) -> Result<PathBuf, RecordingError> {
    for suffix in 1..=MAX_SUFFIX {
        let folder = captures.join(if suffix == 1 { name.to_owned() } else { format!("{name}-{suffix}") });
        match storage.create_folder(&folder) {
            Ok(()) => return Ok(folder),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            Err(source) => return Err(RecordingError::Folder { path: folder, source }),
        }
    }
    let source = io::Error::from(io::ErrorKind::AlreadyExists);
    Err(RecordingError::Io { path: captures.join(name), source })
}

/// One that is there already is as good.
fn create_shared_folder(storage: &dyn Storage, path: &Path) -> Result<(), RecordingError> {
    match storage.create_shared_folder(path) {
        Err(source) if source.kind() != io::ErrorKind::AlreadyExists => {
            Err(RecordingError::Folder { path: path.to_owned(), source })
        }
        _ => Ok(()),
    }
}

/// Many drivers send calibration with every frame, and constants again and again: once is enough.
fn keep(latched: &mut Vec<LogMessage>, message: &LogMessage) {
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

pub(super) fn note_gap(counts: &mut Counts, gap: &Gap) {
    counts.captured += gap.frames;
    let sums =
        [(gap.frames, &mut counts.dropped), (gap.messages, &mut counts.lost), (gap.untagged, &mut counts.untagged)];
    for (lost, sum) in sums {
        if lost > 0 {
            *sum.entry(gap.cause.clone()).or_default() += lost;
        }
    }
}

fn gap_of(message: &LogMessage, kind: Kind, cause: &str) -> Gap {
    let frames = u64::from(kind == Kind::Frame);
    let at_ns = message.log_time_ns;
    let untagged = u64::from(matches!(kind, Kind::Tag(_)));
    Gap { cause: cause.to_owned(), frames, messages: 1 - frames, untagged, first_ns: at_ns, last_ns: at_ns }
}
