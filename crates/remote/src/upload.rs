//! Copies captures to an object store.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use realitysim_recording::sessions::sessions_in;
use realitysim_recording::sync::{Selection, is_as_recorded};
use realitysim_recording::{
    Acknowledgement, COVERAGE_FILE, Head, Loss, MANIFEST_FILE, METADATA_FILE, ManifestLine, SESSION_FILE, SYNC_FOLDER,
    Session, acknowledge,
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
    if to.is_of_this_machine() {
        let what = "it names a folder of this machine, into which `sync SOURCE -o FOLDER` copies".to_owned();
        return Err(RemoteError::Address { address: to.to_string(), what });
    }
    let receiver = receiver_name(to);
    let tags_path = captures.join(SYNC_FOLDER).join(format!("{receiver}.tags.json"));
    let mut tags = read_tags(&tags_path);
    let mut report = UploadReport { to: to.to_string(), receiver, ..UploadReport::default() };
    let (sessions, _) = sessions_in(captures).map_err(io(captures))?;
    for session in sessions.iter().filter(|session| selection.takes_session(&session.name)) {
        if stop.load(Ordering::Relaxed) {
            break;
        }
        tell(UploadEvent::Session(&session.name));
        report.sessions += 1;
        let mut upload = Upload { stores, stop, tell, report: &mut report, tags: &mut tags };
        let done = upload_session(&mut upload, session, to, selection);
        write_tags(&tags_path, &tags)?;
        done?;
    }
    report.stopped = stop.load(Ordering::Relaxed);
    Ok(report)
}

/// Tags of the objects that were read back, by the session's identity and the segment's name.
type Tags = BTreeMap<String, String>;

/// Reads the tags that an earlier upload has left. What is missing there is read back anew.
fn read_tags(path: &Path) -> Tags {
    let bytes = realitysim_config::plain_file::read(path, MAX_SMALL_BYTES).unwrap_or_default();
    serde_json::from_slice(&bytes).unwrap_or_default()
}

fn write_tags(path: &Path, tags: &Tags) -> Result<(), RemoteError> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(io(folder))?;
    }
    let text = serde_json::to_vec(tags).map_err(realitysim_recording::RecordingError::from)?;
    Ok(realitysim_recording::write_atomically(path, &text)?)
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
    tags: &'a mut Tags,
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
    let is_known = |line: &&ManifestLine| there.contains(line);
    if !verified.iter().all(is_known) {
        put_manifest(upload.stores, &to, &there, &verified)?;
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
        let key = format!("{}/{}", session.id.as_str(), line.name);
        if let Some(tag) = self.tag_of_size(&to, line)? {
            // The same tag stands for the same content, which was read back before.
            let is_known = was_there && self.tags.get(&key) == Some(&tag);
            if is_known || self.is_read_back(&to, line)? {
                self.tags.insert(key, tag);
                self.report.already += 1;
                return Ok(true);
            }
        }
        self.tags.remove(&key);
        if !is_wanted {
            return Ok(false);
        }
        let here = session.folder.join(&line.name);
        if !is_as_recorded(&here, line).map_err(io(&here))? {
            self.report.losses.push(Loss::new(&here, "is not as it was recorded: not uploaded".to_owned()));
            return Ok(false);
        }
        self.stores.upload(&here, &to, &mut |sent| (self.tell)(UploadEvent::Sent(sent, line.bytes)))?;
        let other = || content(&to, "the store gives back other bytes than it was sent".to_owned());
        let tag = self.tag_of_size(&to, line)?.ok_or_else(other)?;
        if !self.is_read_back(&to, line)? {
            return Err(other());
        }
        self.tags.insert(key, tag);
        self.report.uploaded += 1;
        self.report.uploaded_bytes += line.bytes;
        Ok(true)
    }

    /// The tag of a segment in the store; `None` if it is not there, or has another size.
    fn tag_of_size(&self, address: &Address, line: &ManifestLine) -> Result<Option<String>, RemoteError> {
        match self.stores.info(address) {
            Ok(object) => Ok((object.bytes == line.bytes).then_some(object.tag)),
            Err(error) if error.is_absent() => Ok(None),
            Err(error) => Err(error),
        }
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
/// written if it is not there, in one step, so that of two uploads at once one gets the name.
fn folder_of(stores: &ObjectStores, session: &Session, captures: &Address) -> Result<Address, RemoteError> {
    for name in [session.name.clone(), format!("{}-{}", session.name, session.id.as_str())] {
        let folder = captures.join(&name);
        let head = folder.join(SESSION_FILE);
        let there = match stores.read(&head, MAX_SMALL_BYTES) {
            Err(error) if error.is_absent() => {
                if stores.create(&head, session.head_bytes.clone())? {
                    return Ok(folder);
                }
                stores.read(&head, MAX_SMALL_BYTES)?
            }
            there => there?,
        };
        if Head::parse(&there).is_ok_and(|head| head.id(&there) == session.id) {
            return Ok(folder);
        }
    }
    Err(content(captures, format!("holds two other sessions of the name {}", session.name)))
}

/// The lines of the manifest in the store.
fn manifest_at(stores: &ObjectStores, folder: &Address) -> Result<Vec<ManifestLine>, RemoteError> {
    match stores.read(&folder.join(MANIFEST_FILE), MAX_SMALL_BYTES) {
        Ok(bytes) => {
            Ok(String::from_utf8_lossy(&bytes).lines().filter_map(|line| serde_json::from_str(line).ok()).collect())
        }
        Err(error) if error.is_absent() => Ok(Vec::new()),
        Err(error) => Err(error),
    }
}

/// Writes the manifest of what the store has: the lines that it had, and those of verified segments, by the segments' names, which are
/// those of their order.
fn put_manifest(
    stores: &ObjectStores,
    to: &Address,
    there: &[ManifestLine],
    verified: &[&ManifestLine],
) -> Result<(), RemoteError> {
    let all = there.iter().chain(verified.iter().copied()).map(|line| (line.name.as_str(), line));
    let mut text = Vec::new();
    for line in all.collect::<BTreeMap<_, _>>().values() {
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
