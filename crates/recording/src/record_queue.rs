//! Between the agent, which must never wait for a disk, and the recorder's thread, which does nothing else: a queue that
//! is bounded in bytes, and the account of every frame.
//!
//! Frames have the queue; everything else may use what they leave, and a reserve beside it that no frame gets into.

use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use super::entry::{Entry, Gap, Kind};
use super::manifest::Counts;
use super::status::{Fault, RecorderStatus};
use realitysim_ros2::mcap_read::LogMessage;

/// A gap that goes on is written again after this time.
const GAP_EVERY_NS: i64 = 1_000_000_000;
/// Gaps that wait to be written: causes that alternate while a disk stands still share one beyond that.
const MAX_GAPS: usize = 256;
/// Their cause then.
const SEVERAL: &str = "several";
/// The queue is full.
pub(super) const QUEUE_FULL: &str = "queue_full";

/// Memory between agent and disk, what is written but not yet synced included.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct QueueLimits {
    pub frames_bytes: usize,
    pub reserve_bytes: usize,
}

pub(super) struct RecordQueue {
    state: Mutex<State>,
    filled: Condvar,
    room: QueueLimits,
    rounds: AtomicU64,
}

/// An entry, and when it came.
pub(super) struct QueuedEntry {
    pub entry: Entry,
    pub taken: Duration,
}

/// What the disk had confirmed of a folder, by what it is.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Had {
    frames: u64,
    tags: u64,
    valid: u64,
    /// Neither frames nor tags.
    others: u64,
    /// Log times of the first and the last.
    times_ns: Option<(i64, i64)>,
}

impl Had {
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

    pub fn join(&mut self, other: Self) {
        self.frames += other.frames;
        self.tags += other.tags;
        self.valid += other.valid;
        self.others += other.others;
        self.times_ns = joined(self.times_ns, other.times_ns);
    }

    /// That all of it is lost; `None` of nothing.
    pub fn gap(&self, cause: &str) -> Option<Gap> {
        let (first_ns, last_ns) = self.times_ns?;
        let messages = self.tags + self.others;
        Some(Gap { cause: cause.to_owned(), frames: self.frames, messages, untagged: self.tags, first_ns, last_ns })
    }
}

fn joined(a: Option<(i64, i64)>, b: Option<(i64, i64)>) -> Option<(i64, i64)> {
    match (a, b) {
        (Some((a0, a1)), Some((b0, b1))) => Some((a0.min(b0), a1.max(b1))),
        (a, b) => a.or(b),
    }
}

/// What the disk allows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Allowed {
    #[default]
    All,
    NoFrames(&'static str),
    Nothing(&'static str),
}

#[derive(Default)]
struct State {
    queue: VecDeque<QueuedEntry>,
    /// Held by what is queued, and by what is not yet synced.
    frames_bytes: usize,
    others_bytes: usize,
    frames_queued: u64,
    /// Out of the queue and not yet written.
    frames_in_hand: u64,
    gaps_queued: usize,
    counts: Counts,
    /// Not yet in the queue: it may grow.
    gap: Option<Gap>,
    allowed: Allowed,
    closed: bool,
    /// The recorder has begun another folder, whose first segment has no state of the filter.
    wants_beginning: bool,
    status: RecorderStatus,
}

/// What the recorder's thread is to do.
pub(super) enum Next {
    Write(QueuedEntry),
    /// Nothing came in the time given.
    Idle,
    /// Nothing will come any more.
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

    /// Takes it if there is room, or counts it and leaves a gap.
    pub fn offer(&self, entry: Entry, taken: Duration) {
        let mut state = self.lock();
        state.note_thinned(&entry);
        let log_time_ns = entry.log_time_ns();
        if let Some(cause) = self.refusal(&state, &entry) {
            state.refuse(&entry, cause, log_time_ns);
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

    /// Frames that never became messages.
    pub fn drop_frames(&self, cause: &str, frames: u64, log_time_ns: i64, now: Duration) {
        let mut state = self.lock();
        state.counts.captured += frames;
        state.drop_frames(cause, frames);
        state.open_gap(cause, [frames, 0, 0], log_time_ns, now);
    }

    fn refusal(&self, state: &State, entry: &Entry) -> Option<&'static str> {
        let held = state.frames_bytes + state.others_bytes + entry.bytes();
        let cause = || state.status.fault.as_ref().map_or(QUEUE_FULL, |fault| fault.cause);
        match (entry, state.allowed) {
            // A state is worth nothing once there is a newer one, and a segment's beginning is not to be lost.
            (Entry::Begin(_), Allowed::All | Allowed::NoFrames(_)) => None,
            (Entry::State(..), Allowed::All) => (held > self.room.frames_bytes).then(cause),
            (Entry::State(..), Allowed::NoFrames(why)) => Some(why),
            (_, Allowed::Nothing(why)) => Some(why),
            (Entry::Message(_, Kind::Frame), Allowed::NoFrames(why)) => Some(why),
            (Entry::Message(_, Kind::Frame), _) => (state.frames_bytes + entry.bytes() > self.room.frames_bytes
                || held > self.room.frames_bytes + self.room.reserve_bytes)
                .then(cause),
            _ => {
                let in_reserve = state.others_bytes + entry.bytes() <= self.room.reserve_bytes;
                (!in_reserve && held > self.room.frames_bytes + self.room.reserve_bytes).then(cause)
            }
        }
    }

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

    /// When that came which waits longest.
    pub fn next_taken(&self) -> Option<Duration> {
        self.lock().queue.front().map(|waiting| waiting.taken)
    }

    /// Waits, unless nothing will come any more.
    pub fn pause(&self, time: Duration) {
        let state = self.lock();
        if !state.closed {
            let _ = self.filled.wait_timeout_while(state, time, |state| !state.closed);
        }
    }

    /// Nothing more is offered; a gap at the end is written too.
    pub fn close(&self, now: Duration) {
        let mut state = self.lock();
        state.push_gap(now);
        state.closed = true;
        drop(state);
        self.filled.notify_all();
    }

    /// The recorder's thread has got round once more.
    pub fn go_round(&self) {
        self.rounds.fetch_add(1, Ordering::Relaxed);
    }

    /// It stands still if that thread does, be it at the disk.
    pub fn rounds(&self) -> u64 {
        self.rounds.load(Ordering::Relaxed)
    }

    pub fn is_closed(&self) -> bool {
        self.lock().closed
    }

    /// Written for the first time.
    pub fn written(&self, entry: &Entry) {
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

    /// Taken, but not to be had any more: never written, or written where nobody knows whether it arrived.
    pub fn lost(&self, entry: &Entry, was_written: bool, cause: &str) {
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

    /// Written and confirmed, and then removed by somebody.
    pub fn removed(&self, had: &Had, cause: &str) {
        let mut state = self.lock();
        let State { counts, status, .. } = &mut *state;
        counts.written = counts.written.saturating_sub(had.frames);
        counts.tagged = counts.tagged.saturating_sub(had.tags);
        counts.valid = counts.valid.saturating_sub(had.valid);
        status.frames_synced = status.frames_synced.saturating_sub(had.frames);
        status.frames_refused += had.frames;
        let sums = [
            (had.frames, &mut counts.dropped),
            (had.tags, &mut counts.untagged),
            (had.tags + had.others, &mut counts.lost),
        ];
        for (lost, sum) in sums.into_iter().filter(|(lost, _)| *lost > 0) {
            *sum.entry(cause.to_owned()).or_default() += lost;
        }
    }

    /// Another folder begins.
    pub fn begin_anew(&self) {
        self.lock().wants_beginning = true;
    }

    /// Whether a segment is to begin for that reason; asked for once.
    pub fn wants_beginning(&self) -> bool {
        self.lock().wants_beginning
    }

    /// A segment begins.
    pub fn begins(&self) {
        self.lock().wants_beginning = false;
    }

    /// Written and synced: the memory is free again.
    pub fn release(&self, entry: &Entry) {
        let mut state = self.lock();
        let held = if entry.is_frame() { &mut state.frames_bytes } else { &mut state.others_bytes };
        *held = held.saturating_sub(entry.bytes());
    }

    /// For a recorder that is called by the agent itself.
    pub fn take_at_once(&self, entry: &Entry) {
        let mut state = self.lock();
        state.note_thinned(entry);
        state.hold(entry);
        let frame = u64::from(entry.is_frame());
        state.counts.captured += frame;
        state.frames_in_hand += frame;
    }

    /// The gap that waits, if any: for a recorder that is called by the agent itself.
    pub fn take_gap(&self) -> Option<Gap> {
        self.lock().gap.take()
    }

    pub fn allow(&self, allowed: Allowed) {
        self.lock().allowed = allowed;
    }

    pub fn allowed(&self) -> Allowed {
        self.lock().allowed
    }

    pub fn counts(&self) -> Counts {
        self.lock().counts.clone()
    }

    pub fn folder(&self) -> Option<PathBuf> {
        self.lock().status.session.clone()
    }

    pub fn update(&self, change: impl FnOnce(&mut RecorderStatus)) {
        change(&mut self.lock().status);
    }

    pub fn set_fault(&self, fault: Option<Fault>) {
        let mut state = self.lock();
        if let Some(fault) = &fault {
            *state.status.faults.entry(fault.cause.to_owned()).or_default() += 1;
        }
        state.status.fault = fault;
    }

    pub fn status(&self) -> RecorderStatus {
        self.lock().status()
    }

    /// Of one moment.
    pub fn account(&self) -> (Counts, RecorderStatus) {
        let state = self.lock();
        (state.counts.clone(), state.status())
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // Counts are changed in single steps: they are right even if a thread panicked while it held them.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    /// `captured = written + thinned + dropped + still in memory`, each counted in a place of its own.
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

    fn push(&mut self, waiting: QueuedEntry) {
        self.hold(&waiting.entry);
        self.frames_queued += u64::from(waiting.entry.is_frame());
        self.queue.push_back(waiting);
    }

    /// Nothing can become of it any more: it counts at once, whether a segment hears of it or not.
    fn note_thinned(&mut self, entry: &Entry) {
        let thinned = u64::from(matches!(entry, Entry::Thinned));
        self.counts.captured += thinned;
        self.counts.thinned += thinned;
    }

    fn hold(&mut self, entry: &Entry) {
        let held = if entry.is_frame() { &mut self.frames_bytes } else { &mut self.others_bytes };
        *held += entry.bytes();
    }

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

    /// For so many frames, other messages, and tags among these.
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

    fn push_gap(&mut self, taken: Duration) {
        if let Some(gap) = self.gap.take() {
            self.gaps_queued += 1;
            self.push(QueuedEntry { entry: Entry::Gap(gap), taken });
        }
    }
}
