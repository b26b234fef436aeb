//! Captures for the page: what sessions there are, what their tags say, and single frames.
//!
//! A client names a session by the name of its folder, and that name is looked up among the sessions that are there: no path is
//! made of what a client sends.

mod frame;
mod piece;
mod scan;
mod tag_arrays;

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError};
use std::time::Duration;

use hyper::StatusCode;
use serde_json::{Value, json};

use super::HttpProblem;
pub(super) use piece::MAX_PIECE_S;
use realitysim_recording::sessions::{session_named, sessions_in};
use realitysim_recording::{ACTIVE, ManifestLine, Session};
use scan::Capture;

/// The folder of captures that the service shows, if one was named.
pub(super) struct Captures {
    folder: Option<PathBuf>,
    /// Captures that were read, the least recently used first.
    read: Mutex<Vec<Arc<Capture>>>,
    /// Held while a capture is read, a frame explained or a piece cut, which takes seconds: other clients come back, and views go on.
    long_work: Mutex<()>,
}

/// Time since the last write after which a segment without an end is one that nobody writes any more: a recorder writes several times a
/// second.
const MAX_WRITING_AGE: Duration = Duration::from_secs(30);
/// Largest number of captures whose tags are held in memory.
const MAX_CAPTURES: usize = 4;

impl Captures {
    /// Makes the captures of a folder; `None` shows none.
    pub(super) fn of(folder: Option<PathBuf>) -> Self {
        Self { folder, read: Mutex::default(), long_work: Mutex::default() }
    }

    /// Returns what sessions there are, the newest first.
    pub(super) fn list(&self) -> Result<Value, HttpProblem> {
        let Some(folder) = &self.folder else {
            return Ok(json!({ "shown": false, "sessions": [], "set_aside": [] }));
        };
        let (mut sessions, set_aside) = sessions_in(folder).map_err(|error| unreadable(&error.to_string()))?;
        sessions.sort_by(|a, b| b.head.started.cmp(&a.head.started).then(b.name.cmp(&a.name)));
        // Folders of this machine are named by their last part alone.
        let aside = set_aside.iter().map(|aside| json!({ "name": last_part(&aside.path), "why": aside.why }));
        Ok(json!({
            "shown": true,
            "sessions": sessions.iter().map(summary).collect::<Vec<Value>>(),
            "set_aside": aside.collect::<Vec<Value>>(),
        }))
    }

    /// Returns the tags of a session, column by column.
    pub(super) fn tags(&self, name: &str) -> Result<Vec<u8>, HttpProblem> {
        Ok(self.capture(name)?.columns().to_string().into_bytes())
    }

    /// Returns the tags of a session as arrays, `.npz`.
    pub(super) fn tag_arrays(&self, name: &str) -> Result<Vec<u8>, HttpProblem> {
        tag_arrays::tag_arrays(&*self.capture(name)?)
    }

    /// Returns a frame's pixels, R G B, with width and height.
    pub(super) fn pixels(&self, name: &str, frame: u32) -> Result<(Vec<u8>, [usize; 2]), HttpProblem> {
        frame::pixels(&*self.capture(name)?, frame)
    }

    /// Returns a frame's picture and its media type.
    pub(super) fn picture(&self, name: &str, frame: u32) -> Result<(Vec<u8>, &'static str), HttpProblem> {
        frame::picture(&*self.capture(name)?, frame)
    }

    /// Returns a frame's tag with the lines of the field where it puts them.
    pub(super) fn tag(&self, name: &str, frame: u32) -> Result<Value, HttpProblem> {
        frame::tag(&*self.capture(name)?, frame)
    }

    /// Returns the evidence for and against a frame's tag.
    pub(super) fn explanation(&self, name: &str, frame: u32) -> Result<Value, HttpProblem> {
        let capture = self.capture(name)?;
        let _alone = self.alone()?;
        frame::explanation(&capture, frame)
    }

    /// Returns a log of some seconds around a frame.
    pub(super) fn piece(&self, name: &str, frame: u32, seconds: u32) -> Result<Vec<u8>, HttpProblem> {
        let capture = self.capture(name)?;
        let _alone = self.alone()?;
        piece::piece(&capture, frame, seconds)
    }

    /// Reads a session, unless it has been read and is as it was then.
    fn capture(&self, name: &str) -> Result<Arc<Capture>, HttpProblem> {
        let none = |what: String| HttpProblem::new(StatusCode::NOT_FOUND, what);
        let Some(folder) = &self.folder else {
            return Err(none("no captures are shown: start the service with --captures DIR".to_owned()));
        };
        // Of one session: with hundreds of them, reading all manifests for a picture takes longer than the picture.
        let session = session_named(folder, name).map_err(|error| unreadable(&error.to_string()))?;
        let session = session.ok_or_else(|| none("there is no such capture: /v1/captures lists them".to_owned()))?;
        if let Some(known) = self.known(&session) {
            return Ok(known);
        }
        let _alone = self.alone()?;
        let capture = Arc::new(Capture::read(&session)?);
        let mut read = self.read.lock().unwrap_or_else(PoisonError::into_inner);
        read.retain(|known| known.name != capture.name);
        read.push(Arc::clone(&capture));
        if read.len() > MAX_CAPTURES {
            read.remove(0);
        }
        Ok(capture)
    }

    /// Takes the right to do long work; refuses it while another request has it.
    fn alone(&self) -> Result<MutexGuard<'_, ()>, HttpProblem> {
        match self.long_work.try_lock() {
            Ok(alone) => Ok(alone),
            // A request that panicked has left nothing behind.
            Err(TryLockError::Poisoned(alone)) => Ok(alone.into_inner()),
            Err(TryLockError::WouldBlock) => Err(busy()),
        }
    }

    /// Returns what was read of a session that has not changed since, and marks it as used.
    fn known(&self, session: &Session) -> Option<Arc<Capture>> {
        let mut read = self.read.lock().unwrap_or_else(PoisonError::into_inner);
        let at = read.iter().position(|known| known.is_of(session))?;
        let known = read.remove(at);
        read.push(Arc::clone(&known));
        Some(known)
    }
}

/// A session as the list shows it.
fn summary(session: &Session) -> Value {
    let sum = |of: fn(&ManifestLine) -> u64| session.lines.iter().map(of).fold(0_u64, u64::saturating_add);
    let times = ManifestLine::times_of(&session.lines);
    json!({
        "name": session.name,
        "robot": session.head.robot,
        "started": session.head.started,
        "seconds": times.map(|(first, last)| last.saturating_sub(first) as f64 * 1e-9),
        "frames": sum(|line| line.frames.captured),
        "tagged": sum(|line| line.frames.tagged),
        "valid": sum(|line| line.frames.valid),
        "bytes": session.segments.values().fold(0_u64, |sum, bytes| sum.saturating_add(*bytes)),
        "open": session.open,
        "recording": is_being_recorded(session),
        "missing": session.missing().count() as u64 + session.doubted,
        "pinned": session.pinned,
    })
}

/// Whether a segment of the session is being written, rather than left unfinished.
fn is_being_recorded(session: &Session) -> bool {
    session.open && last_write_age(&session.folder).is_some_and(|age| age < MAX_WRITING_AGE)
}

/// Returns the time since a segment without an end was last written.
fn last_write_age(folder: &Path) -> Option<Duration> {
    let open = std::fs::read_dir(folder)
        .ok()?
        .flatten()
        .filter(|entry| entry.file_name().to_str().is_some_and(|name| name.ends_with(ACTIVE)));
    let written = open.filter_map(|entry| entry.metadata().ok()?.modified().ok()).max()?;
    // A clock that was set back makes files of the future: they were written just now.
    Some(written.elapsed().unwrap_or_default())
}

fn last_part(path: &Path) -> String {
    path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

/// Refusal because other long work is under way.
fn busy() -> HttpProblem {
    let what = "another capture is being read, a frame explained, or a piece cut: come back in a second";
    HttpProblem::new(StatusCode::SERVICE_UNAVAILABLE, what)
}

/// Refusal because files cannot be read, without their place on this machine.
fn unreadable(what: &str) -> HttpProblem {
    HttpProblem::new(StatusCode::INTERNAL_SERVER_ERROR, format!("the captures cannot be read: {what}"))
}
