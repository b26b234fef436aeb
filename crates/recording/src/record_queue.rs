//! The queue between the agent, which must never wait for a disk, and the recorder's thread, which does nothing else.
//! It is bounded in bytes and keeps the account of every frame.
//!
//! Frames have a memory of their own. Everything else may use what they leave, and a reserve beside it that no frame
//! gets into.

use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use super::entry::{Entry, Gap, Kind};
use super::manifest::Counts;
use super::status::{Fault, RecorderStatus};
use realitysim_ros2::mcap_read::LogMessage;

/// Log time after which a gap that goes on is written again, ns.
const GAP_EVERY_NS: i64 = 1_000_000_000;
/// Most gaps that wait to be written. Beyond that, causes that alternate while a disk stalls share one gap.
const MAX_GAPS: usize = 256;
/// Cause of a gap that several causes share.
const SEVERAL: &str = "several";
/// Cause of a drop while the disk works but is too slow.
pub(super) const QUEUE_FULL: &str = "queue_full";

/// Memory between agent and disk, including what is written but not yet synced.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct QueueLimits {
    /// Memory for frames, bytes.
    pub frames_bytes: usize,
    /// Further memory, for everything but frames, bytes.
    pub reserve_bytes: usize,
}

/// The queue and its account, shared by both threads.
pub(super) struct RecordQueue {
    state: Mutex<State>,
    /// Signals that an entry has arrived, or that the queue was closed.
    filled: Condvar,
    room: QueueLimits,
    /// Number of rounds of the recorder's thread.
    rounds: AtomicU64,
}

/// An entry and when it arrived.
pub(super) struct QueuedEntry {
    pub entry: Entry,
    /// Time of arrival, by the storage's clock.
    pub taken: Duration,
}

/// Number of messages of a folder that the disk has confirmed, by kind.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct ConfirmedContent {
    frames: u64,
    tags: u64,
    valid: u64,
    /// Messages that are neither frames nor tags.
    others: u64,
    /// Log times of the first and the last message, ns.
    times_ns: Option<(i64, i64)>,
}

impl ConfirmedContent {
    /// Counts an entry that the disk has confirmed.
    pub fn add(&mut self, entry: &Entry) {
        let Entry::Message(message, kind) = entry else { return };
        match kind {
            Kind::Frame => self.frames += 1,
            Kind::Tag(at) => {
                self.tags += 1;
                self.valid += u64::from(at.is_some());
            }
            Kind::Latched | Kind::Other => self.others += 1,
        }
        self.times_ns = joined(self.times_ns, Some((message.log_time_ns, message.log_time_ns)));
    }

    /// Adds other content.
    pub fn join(&mut self, other: Self) {
        self.frames += other.frames;
        self.tags += other.tags;
        self.valid += other.valid;
        self.others += other.others;
        self.times_ns = joined(self.times_ns, other.times_ns);
    }

    /// Gap that says that all of this is lost; `None` if there is nothing.
    pub fn gap(&self, cause: &str) -> Option<Gap> {
        let (first_ns, last_ns) = self.times_ns?;
        let messages = self.tags + self.others;
        Some(Gap { cause: cause.to_owned(), frames: self.frames, messages, untagged: self.tags, first_ns, last_ns })
    }
}

/// Smallest interval that contains both.
fn joined(a: Option<(i64, i64)>, b: Option<(i64, i64)>) -> Option<(i64, i64)> {
    match (a, b) {
        (Some((a0, a1)), Some((b0, b1))) => Some((a0.min(b0), a1.max(b1))),
        (a, b) => a.or(b),
    }
}

/// What may be written, given the room on the disk. A restriction names its cause.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Allowed {
    /// Everything may be written.
    #[default]
    All,
    /// Everything but frames may be written.
    NoFrames(&'static str),
    /// Nothing may be written.
    Nothing(&'static str),
}

#[derive(Default)]
struct State {
    queue: VecDeque<QueuedEntry>,
    /// Memory of frames that are queued or not yet synced, bytes.
    frames_bytes: usize,
    /// Memory of other entries that are queued or not yet synced, bytes.
    others_bytes: usize,
    frames_queued: u64,
    /// Frames that are out of the queue and not yet written.
    frames_in_hand: u64,
    gaps_queued: usize,
    counts: Counts,
    /// The gap that goes on. It is not yet in the queue, since it may grow.
    gap: Option<Gap>,
    allowed: Allowed,
    closed: bool,
    /// Whether the recorder has begun another folder, whose first segment lacks the state of the filter.
    is_segment_requested: bool,
    status: RecorderStatus,
}

/// What the recorder's thread is to do next.
pub(super) enum Next {
    /// Write this entry.
    Write(QueuedEntry),
    /// Nothing: no entry came in the time given.
    Idle,
    /// End the session: no entry will come any more.
    Closed,
}

impl RecordQueue {
    pub fn new(room: QueueLimits) -> Self {
        let status = RecorderStatus { queue_limit_bytes: room.frames_bytes + room.reserve_bytes, ..Default::default() };
        Self {
            state: Mutex::new(State { status, ..State::default() }),
            filled: Condvar::new(),
            room,
            rounds: AtomicU64::new(0),
        }
    }

    /// Takes an entry if there is room; otherwise counts it as dropped and extends a gap.
    pub fn offer(&self, entry: Entry, taken: Duration) {
        let mut state = self.lock();
        state.note_thinned(&entry);
        let log_time_ns = entry.log_time_ns();
        if let Some(cause) = self.refusal(&state, &entry) {
            state.refuse(&entry, &cause, log_time_ns);
        } else {
            if let Some(log_time_ns) = log_time_ns
                && state
                    .gap
                    .as_ref()
                    .is_some_and(|gap| entry.is_frame() || log_time_ns.saturating_sub(gap.first_ns) >= GAP_EVERY_NS)
            {
                state.push_gap(taken);
            }
            state.counts.captured += u64::from(entry.is_frame());
            state.push(QueuedEntry { entry, taken });
        }
        drop(state);
        self.filled.notify_one();
    }

    /// Counts frames that never became messages.
    pub fn drop_frames(&self, cause: &str, frames: u64, log_time_ns: i64, now: Duration) {
        let mut state = self.lock();
        state.counts.captured += frames;
        state.drop_frames(cause, frames);
        state.open_gap(cause, [frames, 0, 0], log_time_ns, now);
    }

    /// Cause why an entry is refused; `None` if it is taken.
    fn refusal(&self, state: &State, entry: &Entry) -> Option<String> {
        let held = state.frames_bytes + state.others_bytes + entry.bytes();
        let cause = || state.status.fault.as_ref().map_or_else(|| QUEUE_FULL.to_owned(), |fault| fault.cause.clone());
        match (entry, state.allowed) {
            // A state file is soon replaced by a newer one, so it may be left out. The beginning of a segment must
            // not be lost.
            (Entry::Begin(_), Allowed::All | Allowed::NoFrames(_)) => None,
            (Entry::State(..), Allowed::All) => (held > self.room.frames_bytes).then(cause),
            (Entry::State(..), Allowed::NoFrames(why)) => Some(why.to_owned()),
            (_, Allowed::Nothing(why)) => Some(why.to_owned()),
            (Entry::Message(_, Kind::Frame), Allowed::NoFrames(why)) => Some(why.to_owned()),
            (Entry::Message(_, Kind::Frame), _) => (state.frames_bytes + entry.bytes() > self.room.frames_bytes
                || held > self.room.frames_bytes + self.room.reserve_bytes)
                .then(cause),
            _ => {
                let in_reserve = state.others_bytes + entry.bytes() <= self.room.reserve_bytes;
                (!in_reserve && held > self.room.frames_bytes + self.room.reserve_bytes).then(cause)
            }
        }
    }

    /// Waits for the next entry, at most so long.
    pub fn next(&self, within: Duration) -> Next {
        let mut state = self.lock();
        if state.queue.is_empty() && !state.closed {
            let waited = self.filled.wait_timeout(state, within);
            state = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
        match state.queue.pop_front() {
            Some(waiting) => {
                let frame = u64::from(waiting.entry.is_frame());
                state.frames_queued -= frame;
                state.frames_in_hand += frame;
                state.gaps_queued -= usize::from(matches!(waiting.entry, Entry::Gap(_)));
                Next::Write(waiting)
            }
            None if state.closed => Next::Closed,
            None => Next::Idle,
        }
    }

    /// When the oldest queued entry arrived.
    pub fn next_taken(&self) -> Option<Duration> {
        self.lock().queue.front().map(|waiting| waiting.taken)
    }

    /// Waits for so long, or until the queue is closed.
    pub fn pause(&self, time: Duration) {
        let state = self.lock();
        if !state.closed {
            let _ = self.filled.wait_timeout_while(state, time, |state| !state.closed);
        }
    }

    /// Closes the queue: nothing more is offered. A gap at the end is still written.
    pub fn close(&self, now: Duration) {
        let mut state = self.lock();
        state.push_gap(now);
        state.closed = true;
        drop(state);
        self.filled.notify_all();
    }

    /// Counts a round of the recorder's thread.
    pub fn count_round(&self) {
        self.rounds.fetch_add(1, Ordering::Relaxed);
    }

    /// Number of rounds of the recorder's thread. It stands still while that thread does, also while it waits for the
    /// disk.
    pub fn rounds(&self) -> u64 {
        self.rounds.load(Ordering::Relaxed)
    }

    /// Whether the queue is closed.
    pub fn is_closed(&self) -> bool {
        self.lock().closed
    }

    /// Counts an entry that is written for the first time.
    pub fn count_written(&self, entry: &Entry) {
        let mut state = self.lock();
        match entry {
            Entry::Message(_, Kind::Frame) => {
                state.frames_in_hand = state.frames_in_hand.saturating_sub(1);
                state.counts.written += 1;
            }
            Entry::Message(_, Kind::Tag(at)) => {
                state.counts.tagged += 1;
                state.counts.valid += u64::from(at.is_some());
            }
            Entry::Untagged(cause) => *state.counts.untagged.entry(cause.clone()).or_default() += 1,
            _ => {}
        }
    }

    /// Counts an entry that was taken and is lost: it was never written, or nobody knows whether it arrived.
    pub fn count_lost(&self, entry: &Entry, was_written: bool, cause: &str) {
        let mut state = self.lock();
        match entry {
            Entry::Message(_, Kind::Frame) => {
                if was_written {
                    state.counts.written = state.counts.written.saturating_sub(1);
                } else {
                    state.frames_in_hand = state.frames_in_hand.saturating_sub(1);
                }
                state.status.frames_refused += 1;
                state.drop_frames(cause, 1);
            }
            Entry::Message(_, kind) => {
                if let (Kind::Tag(at), true) = (kind, was_written) {
                    state.counts.tagged = state.counts.tagged.saturating_sub(1);
                    state.counts.valid = state.counts.valid.saturating_sub(u64::from(at.is_some()));
                }
                state.lose_message(*kind, cause);
            }
            _ => {}
        }
    }

    /// Counts content that the disk had confirmed and that somebody has removed.
    pub fn count_removed(&self, content: &ConfirmedContent, cause: &str) {
        let mut state = self.lock();
        let State { counts, status, .. } = &mut *state;
        counts.written = counts.written.saturating_sub(content.frames);
        counts.tagged = counts.tagged.saturating_sub(content.tags);
        counts.valid = counts.valid.saturating_sub(content.valid);
        status.frames_synced = status.frames_synced.saturating_sub(content.frames);
        status.frames_refused += content.frames;
        let sums = [
            (content.frames, &mut counts.dropped),
            (content.tags, &mut counts.untagged),
            (content.tags + content.others, &mut counts.lost),
        ];
        for (lost, sum) in sums.into_iter().filter(|(lost, _)| *lost > 0) {
            *sum.entry(cause.to_owned()).or_default() += lost;
        }
    }

    /// Asks for a segment with the state of the filter, because another folder begins.
    pub fn request_segment(&self) {
        self.lock().is_segment_requested = true;
    }

    /// Whether such a segment is asked for.
    pub fn is_segment_requested(&self) -> bool {
        self.lock().is_segment_requested
    }

    /// Notes that a segment begins.
    pub fn note_segment_begun(&self) {
        self.lock().is_segment_requested = false;
    }

    /// Frees the memory of an entry that is written and synced.
    pub fn release(&self, entry: &Entry) {
        let mut state = self.lock();
        let held = if entry.is_frame() { &mut state.frames_bytes } else { &mut state.others_bytes };
        *held = held.saturating_sub(entry.bytes());
    }

    /// Accounts for an entry that the caller writes itself, without the queue.
    pub fn hold_unqueued(&self, entry: &Entry) {
        let mut state = self.lock();
        state.note_thinned(entry);
        state.hold(entry);
        let frame = u64::from(entry.is_frame());
        state.counts.captured += frame;
        state.frames_in_hand += frame;
    }

    /// Takes the gap that goes on, if there is one, to write it without the queue.
    pub fn take_gap(&self) -> Option<Gap> {
        self.lock().gap.take()
    }

    /// Sets what may be written.
    pub fn allow(&self, allowed: Allowed) {
        self.lock().allowed = allowed;
    }

    /// What may be written.
    pub fn allowed(&self) -> Allowed {
        self.lock().allowed
    }

    /// Frames and lost messages so far.
    pub fn counts(&self) -> Counts {
        self.lock().counts.clone()
    }

    /// Folder of the session, once it has been made.
    pub fn folder(&self) -> Option<PathBuf> {
        self.lock().status.session.clone()
    }

    /// Changes the status.
    pub fn update(&self, change: impl FnOnce(&mut RecorderStatus)) {
        change(&mut self.lock().status);
    }

    /// Sets or clears the fault; one that is set is counted by its cause.
    pub fn set_fault(&self, fault: Option<Fault>) {
        let mut state = self.lock();
        if let Some(fault) = &fault {
            *state.status.faults.entry(fault.cause.to_owned()).or_default() += 1;
        }
        state.status.fault = fault;
    }

    /// Status, with the memory and the frames of this moment.
    pub fn status(&self) -> RecorderStatus {
        self.lock().status()
    }

    /// Counts and status of the same moment.
    pub fn account(&self) -> (Counts, RecorderStatus) {
        let state = self.lock();
        (state.counts.clone(), state.status())
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // A panic of the other thread leaves the counts right, since they change in single steps.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    /// Status of this moment. It checks `captured = written + thinned + dropped + still in memory`, each of which is
    /// counted in a place of its own.
    fn status(&self) -> RecorderStatus {
        let frames_waiting = self.frames_queued + self.frames_in_hand;
        let dropped: u64 = self.counts.dropped.values().sum();
        RecorderStatus {
            frames_waiting,
            queue_bytes: self.frames_bytes + self.others_bytes,
            conserved: self.counts.captured == self.counts.written + self.counts.thinned + dropped + frames_waiting,
            ..self.status.clone()
        }
    }

    /// Appends an entry to the queue.
    fn push(&mut self, waiting: QueuedEntry) {
        self.hold(&waiting.entry);
        self.frames_queued += u64::from(waiting.entry.is_frame());
        self.queue.push_back(waiting);
    }

    /// Counts a frame that was thinned out. It counts at once, since nothing more can become of it.
    fn note_thinned(&mut self, entry: &Entry) {
        let thinned = u64::from(matches!(entry, Entry::Thinned));
        self.counts.captured += thinned;
        self.counts.thinned += thinned;
    }

    /// Accounts for the memory of an entry.
    fn hold(&mut self, entry: &Entry) {
        let held = if entry.is_frame() { &mut self.frames_bytes } else { &mut self.others_bytes };
        *held += entry.bytes();
    }

    /// Counts an entry that is not taken, and extends the gap.
    fn refuse(&mut self, entry: &Entry, cause: &str, log_time_ns: Option<i64>) {
        match entry {
            Entry::Message(LogMessage { log_time_ns, .. }, Kind::Frame) => {
                self.counts.captured += 1;
                self.status.frames_refused += 1;
                self.drop_frames(cause, 1);
                self.open_gap(cause, [1, 0, 0], *log_time_ns, Duration::ZERO);
            }
            Entry::Message(_, kind) => {
                self.lose_message(*kind, cause);
                let untagged = u64::from(matches!(kind, Kind::Tag(_)));
                self.open_gap(cause, [0, 1, untagged], log_time_ns.unwrap_or_default(), Duration::ZERO);
            }
            Entry::Untagged(cause) => *self.counts.untagged.entry(cause.clone()).or_default() += 1,
            Entry::Begin(_) | Entry::Gap(_) | Entry::State(..) | Entry::Thinned => {}
        }
    }

    fn drop_frames(&mut self, cause: &str, frames: u64) {
        *self.counts.dropped.entry(cause.to_owned()).or_default() += frames;
    }

    fn lose_message(&mut self, kind: Kind, cause: &str) {
        *self.counts.lost.entry(cause.to_owned()).or_default() += 1;
        if matches!(kind, Kind::Tag(_)) {
            *self.counts.untagged.entry(cause.to_owned()).or_default() += 1;
        }
    }

    /// Extends the gap, or begins one for another cause. `lost` are numbers of frames, of other messages, and of tags
    /// among these.
    fn open_gap(&mut self, cause: &str, lost: [u64; 3], log_time_ns: i64, now: Duration) {
        match &mut self.gap {
            Some(gap) if gap.cause != cause && self.gaps_queued >= MAX_GAPS => SEVERAL.clone_into(&mut gap.cause),
            Some(gap) if gap.cause != cause => self.push_gap(now),
            _ => {}
        }
        let gap = self.gap.get_or_insert_with(|| Gap {
            cause: cause.to_owned(),
            frames: 0,
            messages: 0,
            untagged: 0,
            first_ns: log_time_ns,
            last_ns: log_time_ns,
        });
        let [frames, messages, untagged] = lost;
        gap.frames += frames;
        gap.messages += messages;
        gap.untagged += untagged;
        gap.last_ns = gap.last_ns.max(log_time_ns);
    }

    /// Appends the gap that goes on to the queue, if there is one.
    fn push_gap(&mut self, taken: Duration) {
        if let Some(gap) = self.gap.take() {
            self.gaps_queued += 1;
            self.push(QueuedEntry { entry: Entry::Gap(gap), taken });
        }
    }
}
