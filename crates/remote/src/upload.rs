//! Copies captures to an object store.

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use realitysim_recording::sessions::sessions_in;
use realitysim_recording::sync::{Selection, is_as_recorded};
use realitysim_recording::{
    Acknowledgement, COVERAGE_FILE, Head, Loss, MANIFEST_FILE, METADATA_FILE, ManifestLine, SESSION_FILE, Session,
    acknowledge,
};
use serde::Serialize;

use super::address::Address;
use super::error::{RemoteError, io};
use super::object_stores::{ObjectStores, content};

/// What people want to know as it happens.
#[derive(Clone, Copy, Debug)]
pub enum UploadEvent<'a> {
    /// A session is begun with.
    Session(&'a str),
    /// Bytes of the segment under way that are sent, and all of them.
    Sent(u64, u64),
}

/// Result of an upload.
#[derive(Debug, Default, Serialize)]
pub struct UploadReport {
    /// Where the captures are uploaded to.
    pub to: String,
    /// Name of the store in acknowledgements.
    pub receiver: String,
    /// Number of sessions that were looked at.
    pub sessions: u64,
    /// Segments that were uploaded and read back.
    pub uploaded: u64,
    /// Bytes of these segments.
    pub uploaded_bytes: u64,
    /// Segments that were there already, and are acknowledged.
    pub already: u64,
    /// Segments that the store had acknowledged and does not have any more: the acknowledgement is taken back.
    pub withdrawn: u64,
    /// Segments that are damaged here, and were not uploaded.
    pub losses: Vec<Loss>,
    /// Whether the upload was stopped before its end.
    pub stopped: bool,
}

/// Largest small file of a capture, bytes.
const MAX_SMALL_BYTES: u64 = 64 << 20;

/// Uploads the finished segments of the captures in a folder, and acknowledges in each capture what the store has.
///
/// A segment is compared with its manifest here, uploaded, read back and compared again. Then the store gets the manifest with its
/// line, and only then the capture an acknowledgement, so that nothing is deleted here that is not there. What a stop or an error
/// interrupts goes on with the next call.
///
/// # Errors
///
/// [`RemoteError`] if the store or the folder fails. What was acknowledged until then stays so.
pub fn upload(
    stores: &ObjectStores,
    captures: &Path,
    to: &Address,
    selection: &Selection,
    stop: &AtomicBool,
    tell: &mut dyn FnMut(UploadEvent),
) -> Result<UploadReport, RemoteError> {
    let receiver = receiver_name(to);
    let mut report = UploadReport { to: to.to_string(), receiver, ..UploadReport::default() };
    let (sessions, _) = sessions_in(captures).map_err(io(captures))?;
    for session in sessions.iter().filter(|session| selection.takes_session(&session.name)) {
        if stop.load(Ordering::Relaxed) {
            break;
        }
        tell(UploadEvent::Session(&session.name));
        report.sessions += 1;
        upload_session(&mut Upload { stores, stop, tell, report: &mut report }, session, to, selection)?;
    }
    report.stopped = stop.load(Ordering::Relaxed);
    Ok(report)
}

/// The name that a folder of an object store has in acknowledgements: its bucket, and a number made from its address.
fn receiver_name(to: &Address) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() || c == '-' { c } else { '-' };
    let place: String = to.as_str().split("://").nth(1).unwrap_or_default().chars().map(plain).take(48).collect();
    format!("store-{}-{}", place.trim_matches('-'), &blake3::hash(to.as_str().as_bytes()).to_hex()[..12])
}

/// An upload under way.
struct Upload<'a> {
    stores: &'a ObjectStores,
    stop: &'a AtomicBool,
    tell: &'a mut dyn FnMut(UploadEvent),
    report: &'a mut UploadReport,
}

fn upload_session(
    upload: &mut Upload,
    session: &Session,
    captures: &Address,
    selection: &Selection,
) -> Result<(), RemoteError> {
    let to = folder_of(upload.stores, session, captures)?;
    let there = manifest_at(upload.stores, &to)?;
    let acknowledged = session.acknowledged.get(&upload.report.receiver).map_or(&[][..], Vec::as_slice);
    let mut verified: Vec<&ManifestLine> = Vec::new();
    let mut failed = None;
    for line in &session.lines {
        let is_wanted = selection.takes(line) && session.segments.contains_key(&line.name);
        let was_there = acknowledged.iter().any(|ack| ack.is_of(line));
        if !is_wanted && !was_there {
            continue;
        }
        if upload.stop.load(Ordering::Relaxed) && !was_there {
            continue;
        }
        match upload.segment(session, line, &to, was_there, is_wanted) {
            Ok(true) => verified.push(line),
            Ok(false) => {}
            Err(error) => {
                failed = Some(error);
                break;
            }
        }
    }
    let is_known = |line: &&ManifestLine| there.contains(&line.name);
    if !verified.iter().all(is_known) {
        put_manifest(upload.stores, session, &to, &there, &verified)?;
    }
    // A failure tells nothing of the segments behind it.
    let lost = |ack: &&Acknowledgement| failed.is_none() && verified.iter().all(|line| !ack.is_of(line));
    let withdrawn = acknowledged.iter().filter(lost).count();
    if verified.iter().any(|line| acknowledged.iter().all(|ack| !ack.is_of(line))) || withdrawn > 0 {
        let mut acks: Vec<Acknowledgement> = acknowledged.iter().filter(|ack| !lost(ack)).cloned().collect();
        let new = verified.iter().map(|line| Acknowledgement::of(line)).filter(|new| !acks.contains(new));
        acks.extend(new.collect::<Vec<_>>());
        acknowledge(session, &upload.report.receiver, &acks)?;
    }
    upload.report.withdrawn += withdrawn as u64;
    if let Some(error) = failed {
        return Err(error);
    }
    if session.has_ended && session.lines.iter().all(|line| verified.contains(&line)) {
        put_ending(upload.stores, session, &to)?;
    }
    Ok(())
}

impl Upload<'_> {
    /// Makes a segment be there as it was recorded, and tells whether it is.
    fn segment(
        &mut self,
        session: &Session,
        line: &ManifestLine,
        folder: &Address,
        was_there: bool,
        is_wanted: bool,
    ) -> Result<bool, RemoteError> {
        let to = folder.join(&line.name);
        let is_there = match self.stores.info(&to) {
            Ok(object) => object.bytes == line.bytes,
            Err(error) if error.is_absent() => false,
            Err(error) => return Err(error),
        };
        if is_there && (was_there || self.is_read_back(&to, line)?) {
            self.report.already += 1;
            return Ok(true);
        }
        if !is_wanted {
            return Ok(false);
        }
        let here = session.folder.join(&line.name);
        if !is_as_recorded(&here, line).map_err(io(&here))? {
            self.report.losses.push(Loss::new(&here, "is not as it was recorded: not uploaded".to_owned()));
            return Ok(false);
        }
        self.stores.upload(&here, &to, &mut |sent| (self.tell)(UploadEvent::Sent(sent, line.bytes)))?;
        if !self.is_read_back(&to, line)? {
            return Err(content(&to, "the store gives back other bytes than it was sent".to_owned()));
        }
        self.report.uploaded += 1;
        self.report.uploaded_bytes += line.bytes;
        Ok(true)
    }

    /// Reads a segment back and compares its hash.
    fn is_read_back(&self, address: &Address, line: &ManifestLine) -> Result<bool, RemoteError> {
        let mut hash = blake3::Hasher::new();
        self.stores.read_pieces(address, line.bytes, &mut |piece| {
            hash.update(piece);
            Ok(())
        })?;
        Ok(hash.finalize().to_hex().as_str() == line.blake3.to_ascii_lowercase())
    }
}

/// The folder of a session in the store: its name, and its identity behind it if another session has the name. Its `session.json` is
/// written if it is not there.
fn folder_of(stores: &ObjectStores, session: &Session, captures: &Address) -> Result<Address, RemoteError> {
    for name in [session.name.clone(), format!("{}-{}", session.name, session.id.as_str())] {
        let folder = captures.join(&name);
        let head = folder.join(SESSION_FILE);
        match stores.read(&head, MAX_SMALL_BYTES) {
            Ok(bytes) if Head::parse(&bytes).is_ok_and(|there| there.id(&bytes) == session.id) => return Ok(folder),
            Ok(_) => {}
            Err(error) if error.is_absent() => {
                stores.write(&head, session.head_bytes.clone())?;
                return Ok(folder);
            }
            Err(error) => return Err(error),
        }
    }
    Err(content(captures, format!("holds two other sessions of the name {}", session.name)))
}

/// The segments that the manifest in the store names.
fn manifest_at(stores: &ObjectStores, folder: &Address) -> Result<BTreeSet<String>, RemoteError> {
    match stores.read(&folder.join(MANIFEST_FILE), MAX_SMALL_BYTES) {
        Ok(bytes) => {
            let text = String::from_utf8_lossy(&bytes).into_owned();
            Ok(text
                .lines()
                .filter_map(|line| serde_json::from_str::<ManifestLine>(line).ok())
                .map(|line| line.name)
                .collect())
        }
        Err(error) if error.is_absent() => Ok(BTreeSet::new()),
        Err(error) => Err(error),
    }
}

/// Writes the manifest of what the store has: the lines that it had, and those of new segments, in the order of the recording.
fn put_manifest(
    stores: &ObjectStores,
    session: &Session,
    to: &Address,
    there: &BTreeSet<String>,
    verified: &[&ManifestLine],
) -> Result<(), RemoteError> {
    let mut text = Vec::new();
    for line in session.lines.iter().filter(|line| there.contains(&line.name) || verified.contains(line)) {
        serde_json::to_writer(&mut text, line).map_err(realitysim_recording::RecordingError::from)?;
        text.push(b'\n');
    }
    stores.write(&to.join(MANIFEST_FILE), text)
}

/// Writes what describes a session whose segments are all there.
fn put_ending(stores: &ObjectStores, session: &Session, to: &Address) -> Result<(), RemoteError> {
    for name in [METADATA_FILE, COVERAGE_FILE] {
        let path = session.folder.join(name);
        let Ok(bytes) = realitysim_config::plain_file::read(&path, MAX_SMALL_BYTES) else { continue };
        let is_there = stores.info(&to.join(name)).is_ok_and(|object| object.bytes == bytes.len() as u64);
        if !is_there {
            stores.write(&to.join(name), bytes)?;
        }
    }
    Ok(())
}
