//! The name that a folder of captures has as a receiver, in acknowledgements.

use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

use super::error::{SyncError, io};
use crate::sessions::sessions_in;
use crate::{ACK_ENDING, ACK_FOLDER, RECEIVER_FILE, receiver_of, robot_id, write_atomically};

/// Hexadecimal digits behind the machine's name.
const NUMBER_DIGITS: usize = 12;

/// Reads or makes the folder's name as a receiver.
///
/// It is the machine's name with a number made from machine, volume and path, since a machine may have several such
/// folders, and several sticks may be used under one path. A folder that was deleted and made anew has its old name
/// again: its next sync takes back what it had acknowledged.
pub(super) fn receiver(state: &Path) -> Result<String, SyncError> {
    let path = state.join(RECEIVER_FILE);
    if let Some(name) = state.parent().and_then(receiver_of) {
        return Ok(name);
    }
    let host = rustix::system::uname().nodename().to_string_lossy().into_owned();
    let host: String = host.chars().filter(|c| c.is_ascii_alphanumeric() || *c == '-').take(64).collect();
    let host = if host.is_empty() { "machine" } else { &host };
    let captures = state.parent().unwrap_or(state).canonicalize().map_err(io(state))?;
    let volume = volume_of(&captures).unwrap_or_default();
    let place =
        [robot_id().as_bytes(), b"\0", volume.as_bytes(), b"\0", captures.as_os_str().as_encoded_bytes()].concat();
    let name = format!("{host}-{}", &blake3::hash(&place).to_hex()[..NUMBER_DIGITS]);
    silence_former_names(&captures, &name)?;
    write_atomically(&path, format!("{name}\n").as_bytes())?;
    Ok(name)
}

/// UUID of the file system, if it lies on a device that has one.
fn volume_of(folder: &Path) -> Option<String> {
    let device = fs::metadata(folder).ok()?.dev();
    let mut volumes = fs::read_dir("/dev/disk/by-uuid").ok()?.flatten();
    let found = volumes.find(|volume| fs::metadata(volume.path()).is_ok_and(|it| it.rdev() == device))?;
    Some(found.file_name().to_string_lossy().into_owned())
}

/// Empties the acknowledgements in all sessions that were synced into this folder, except those under its present
/// name.
///
/// One of them may be the folder's own, under a name that it had before it was moved, and it is unknown which one.
/// The other stores acknowledge again at their next sync.
fn silence_former_names(captures: &Path, name: &str) -> Result<(), SyncError> {
    let (sessions, _) = sessions_in(captures).map_err(io(captures))?;
    for session in sessions.iter().filter(|session| session.received.is_some()) {
        for receiver in session.acknowledged.keys().filter(|receiver| *receiver != name) {
            write_atomically(&session.folder.join(ACK_FOLDER).join(format!("{receiver}{ACK_ENDING}")), b"")?;
        }
    }
    Ok(())
}
