//! The recorder's thread: it alone waits for the disk, tries again what failed, and watches how much room is left.

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

pub(super) struct Writer {
    shared: Arc<RecordQueue>,
    ended: Receiver<Result<PathBuf, RecordingError>>,
}

/// A disk that refuses is asked again after this time, then after twice of it ...
const RETRY: Duration = Duration::from_millis(100);
/// ... up to this.
const MAX_RETRY: Duration = Duration::from_secs(3);
/// So long a disk may take to let a session end. Less than a service manager waits.
pub const MAX_FINISH: Duration = Duration::from_secs(10);
/// How often the free space is looked at.
const LOOK_EVERY: Duration = Duration::from_secs(1);

impl Writer {
    pub fn start(recorder: Recorder, shared: Arc<RecordQueue>, storage: Arc<dyn Storage>, limits: Limits) -> Self {
        let (send, ended) = bounded(1);
        let retention = Retention::new(Arc::clone(&storage), limits);
        let run = Run { recorder, shared: Arc::clone(&shared), storage, retention, looked: None, retry: RETRY };
        std::thread::spawn(move || {
            let _ = send.send(run.until_the_end());
        });
        Self { shared, ended }
    }

    /// Waits until all is written, but not for ever.
    pub fn finish(self, now: Duration) -> Result<PathBuf, RecordingError> {
        self.shared.close(now);
        match self.ended.recv_timeout(MAX_FINISH + LOOK_EVERY) {
            Ok(ended) => ended,
            Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => {
                let path = self.shared.folder().unwrap_or_default();
                Err(RecordingError::io(&path, std::io::ErrorKind::TimedOut.into()))
            }
        }
    }
}

struct Run {
    recorder: Recorder,
    shared: Arc<RecordQueue>,
    storage: Arc<dyn Storage>,
    retention: Retention,
    looked: Option<Duration>,
    retry: Duration,
}

impl Run {
    fn until_the_end(mut self) -> Result<PathBuf, RecordingError> {
        loop {
            self.shared.go_round();
            self.look_at_the_room();
            let done = match self.shared.next(self.recorder.idle().min(LOOK_EVERY)) {
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

    /// Until the disk takes everything that was taken, or nothing more will come.
    fn wait_for_the_disk(&mut self, error: &RecordingError) {
        self.note_fault(error);
        while !self.shared.is_closed() {
            self.shared.pause(self.retry);
            self.retry = (2 * self.retry).min(MAX_RETRY);
            self.look_at_the_room();
            match self.while_it_helps(Recorder::go_on) {
                Ok(()) => break,
                Err(error) => self.note_fault(&error),
            }
        }
        self.recover();
    }

    /// Again and again, as long as each try gets some more onto the disk: a file that may not grow, little room.
    fn while_it_helps<T>(
        &mut self,
        go_on: impl Fn(&mut Recorder) -> Result<T, RecordingError>,
    ) -> Result<T, RecordingError> {
        loop {
            self.shared.go_round();
            let before = self.recorder.confirmed();
            let done = go_on(&mut self.recorder);
            if done.is_ok() || self.recorder.confirmed() == before {
                return done;
            }
        }
    }

    fn note_fault(&self, error: &RecordingError) {
        let fault = Fault { cause: self.named(error), said: error.to_string() };
        let known = self.shared.status().fault;
        if known.as_ref() != Some(&fault) {
            self.shared.set_fault(Some(fault));
        }
    }

    fn recover(&mut self) {
        self.retry = RETRY;
        self.shared.set_fault(None);
    }

    /// A disk says that it is full when it has no room for another file's name, too.
    fn named(&self, error: &RecordingError) -> &'static str {
        let folder = self.recorder.folder().and_then(Path::parent).unwrap_or(Path::new("."));
        match error.cause() {
            "disk_full" if self.storage.space(folder).is_ok_and(|space| space.free_inodes == 0) => "no_inodes",
            cause => cause,
        }
    }

    fn look_at_the_room(&mut self) {
        let now = self.storage.now();
        if self.looked.is_some_and(|looked| now.saturating_sub(looked) < LOOK_EVERY) {
            return;
        }
        self.looked = Some(now);
        let seen = self.retention.look(self.recorder.folder());
        let before = self.shared.allowed();
        self.shared.allow(seen.allowed);
        self.shared.update(|status| seen.tell(status));
        if matches!(seen.allowed, Allowed::Nothing(_)) && !matches!(before, Allowed::Nothing(_)) {
            // Whole while it still can be. What fails now is tried again with the next entry.
            let _ = self.recorder.rest();
        }
    }

    fn finish(mut self) -> Result<PathBuf, RecordingError> {
        let began = self.storage.now();
        loop {
            match self.while_it_helps(Recorder::finish) {
                Ok(folder) => return Ok(folder),
                Err(error) if self.storage.now().saturating_sub(began) >= MAX_FINISH => {
                    self.note_fault(&error);
                    self.recorder.abandon(error.cause());
                    return Err(error);
                }
                Err(_) => std::thread::sleep(RETRY),
            }
        }
    }
}
