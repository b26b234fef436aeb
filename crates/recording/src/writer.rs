//! The recorder's thread: it waits for the disk, repeats what failed, and watches the room on the disk.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use crossbeam_channel::{Receiver, RecvTimeoutError, bounded};

use super::error::RecordingError;
use super::record_queue::{Allowed, Next, RecordQueue};
use super::recorder::Recorder;
pub(super) use super::retention::Limits;
use super::retention::Retention;
use super::status::Fault;
use super::storage::Storage;

/// Handle of the recorder's thread.
pub(super) struct Writer {
    shared: Arc<RecordQueue>,
    ended: Receiver<Result<PathBuf, RecordingError>>,
}

/// Pause before a disk that refused is tried again; it doubles with each failure.
const MIN_RETRY: Duration = Duration::from_millis(100);
/// Longest pause before a disk that refused is tried again.
const MAX_RETRY: Duration = Duration::from_secs(3);
/// Longest time for a disk to let a session end, less than a service manager waits.
pub const MAX_FINISH: Duration = Duration::from_secs(10);
/// Time between two checks of the free room.
const SPACE_CHECK_INTERVAL: Duration = Duration::from_secs(1);

impl Writer {
    /// Starts the thread.
    pub fn start(recorder: Recorder, shared: Arc<RecordQueue>, storage: Arc<dyn Storage>, limits: Limits) -> Self {
        let (send, ended) = bounded(1);
        let retention = Retention::new(Arc::clone(&storage), limits);
        let run = WriterThread {
            recorder,
            shared: Arc::clone(&shared),
            storage,
            retention,
            last_space_check: None,
            retry: MIN_RETRY,
        };
        std::thread::spawn(move || {
            let _ = send.send(run.run_to_end());
        });
        Self { shared, ended }
    }

    /// Waits until everything is written, at most a little longer than [`MAX_FINISH`]. `now` is the time of the
    /// storage's clock.
    pub fn finish(self, now: Duration) -> Result<PathBuf, RecordingError> {
        self.shared.close(now);
        match self.ended.recv_timeout(MAX_FINISH + SPACE_CHECK_INTERVAL) {
            Ok(ended) => ended,
            Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => {
                let path = self.shared.folder().unwrap_or_default();
                Err(RecordingError::io(&path, std::io::ErrorKind::TimedOut.into()))
            }
        }
    }
}

/// State of the recorder's thread.
struct WriterThread {
    recorder: Recorder,
    shared: Arc<RecordQueue>,
    storage: Arc<dyn Storage>,
    retention: Retention,
    last_space_check: Option<Duration>,
    retry: Duration,
}

impl WriterThread {
    /// Writes entries as they come, and ends the session when the queue is closed.
    fn run_to_end(mut self) -> Result<PathBuf, RecordingError> {
        loop {
            self.shared.count_round();
            self.check_space();
            let done = match self.shared.next(self.recorder.time_to_sync().min(SPACE_CHECK_INTERVAL)) {
                Next::Write(waiting) => self.recorder.take(waiting),
                Next::Idle => Ok(()),
                Next::Closed => break,
            };
            if let Err(error) = done.and_then(|()| self.recorder.sync_if_due()) {
                self.wait_for_the_disk(&error);
            }
        }
        self.finish()
    }

    /// Tries again until the disk takes everything, or the queue is closed.
    fn wait_for_the_disk(&mut self, error: &RecordingError) {
        self.note_fault(error);
        while !self.shared.is_closed() {
            self.shared.pause(self.retry);
            self.retry = (2 * self.retry).min(MAX_RETRY);
            self.check_space();
            match self.retry_while_progressing(Recorder::write_pending) {
                Ok(()) => break,
                Err(error) => self.note_fault(&error),
            }
        }
        self.recover();
    }

    /// Repeats an attempt as long as each gets some more onto the disk, as where a file may not grow or there is
    /// little room.
    fn retry_while_progressing<T>(
        &mut self,
        attempt: impl Fn(&mut Recorder) -> Result<T, RecordingError>,
    ) -> Result<T, RecordingError> {
        loop {
            self.shared.count_round();
            let before = self.recorder.confirmed();
            let done = attempt(&mut self.recorder);
            if done.is_ok() || self.recorder.confirmed() == before {
                return done;
            }
        }
    }

    /// Shows a fault in the status; one that is shown already is not counted again.
    fn note_fault(&self, error: &RecordingError) {
        let fault = Fault { cause: self.cause_of(error).to_owned(), said: error.to_string() };
        let known = self.shared.status().fault;
        if known.as_ref() != Some(&fault) {
            self.shared.set_fault(Some(fault));
        }
    }

    /// Clears the fault.
    fn recover(&mut self) {
        self.retry = MIN_RETRY;
        self.shared.set_fault(None);
    }

    /// Cause of an error. A disk without inodes reports that it is full, although it has room.
    fn cause_of(&self, error: &RecordingError) -> &'static str {
        let folder = self.recorder.folder().and_then(Path::parent).unwrap_or(Path::new("."));
        match error.cause() {
            "disk_full" if self.storage.space(folder).is_ok_and(|space| space.free_inodes == 0) => "no_inodes",
            cause => cause,
        }
    }

    /// Checks the free room, if it is time, and makes the segment whole when nothing may be written any more.
    fn check_space(&mut self) {
        let now = self.storage.now();
        if self.last_space_check.is_some_and(|last| now.saturating_sub(last) < SPACE_CHECK_INTERVAL) {
            return;
        }
        self.last_space_check = Some(now);
        let seen = self.retention.check_space(self.recorder.folder());
        let before = self.shared.allowed();
        self.shared.allow(seen.allowed);
        self.shared.update(|status| seen.report_to(status));
        if matches!(seen.allowed, Allowed::Nothing(_)) && !matches!(before, Allowed::Nothing(_)) {
            // The segment is made whole while there is room. What fails now is tried again with the next entry.
            let _ = self.recorder.complete_segment();
        }
    }

    /// Ends the session; after [`MAX_FINISH`] gives up, and counts what is left as lost.
    fn finish(mut self) -> Result<PathBuf, RecordingError> {
        let began = self.storage.now();
        loop {
            match self.retry_while_progressing(Recorder::finish) {
                Ok(folder) => return Ok(folder),
                Err(error) if self.storage.now().saturating_sub(began) >= MAX_FINISH => {
                    self.note_fault(&error);
                    self.recorder.abandon(error.cause());
                    return Err(error);
                }
                Err(_) => std::thread::sleep(MIN_RETRY),
            }
        }
    }
}
