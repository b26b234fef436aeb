//! Segments of other sessions that somebody has put into the folder.

use super::super::error::RecordingError;
use super::super::segment::session_in;
use super::SessionRepair;
use realitysim_ros2::mcap_read::{Survey, examine, metadata_records};

impl SessionRepair<'_> {
    /// Says why a file with a segment's name does not belong to this session; `None` where that cannot be told.
    ///
    /// A file that names another session is foreign. A file that names none is foreign if it is whole, holds nothing
    /// but messages, and the other segments name this session.
    pub(super) fn foreign_reason(&self, name: &str) -> Result<Option<String>, RecordingError> {
        let Some(own) = &self.info.id else { return Ok(None) };
        Ok(match self.session_id_in(name)? {
            Some(id) if id == *own => None,
            Some(id) => Some(format!("of the session with id {id}, not of this one: left alone")),
            None if self.is_plain_log(name)? && self.others_carry_id(own, name)? => {
                Some("not written by this session's recorder: left alone".to_owned())
            }
            None => None,
        })
    }

    /// Identity of the session that a segment was written in.
    fn session_id_in(&self, name: &str) -> Result<Option<String>, RecordingError> {
        let path = self.session.join(name);
        let file = self.storage.read(&path).map_err(|source| RecordingError::io(&path, source))?;
        // A file without even a head names no session.
        let records = metadata_records(file).unwrap_or_default();
        Ok(records.iter().find_map(session_in).map(str::to_owned))
    }

    /// Whether a file is whole and holds nothing but messages.
    fn is_plain_log(&self, name: &str) -> Result<bool, RecordingError> {
        let path = self.session.join(name);
        let file = self.storage.read(&path).map_err(|source| RecordingError::io(&path, source))?;
        let is_plain = |it: Survey| it.damage.is_none() && it.attachments.is_empty() && it.metadata.is_empty();
        Ok(examine(file).is_ok_and(is_plain))
    }

    /// Whether another segment names this session.
    fn others_carry_id(&self, own: &str, name: &str) -> Result<bool, RecordingError> {
        for other in self.files(|other| other != name)? {
            if self.session_id_in(&other)?.is_some_and(|id| id == own) {
                return Ok(true);
            }
        }
        Ok(false)
    }
}
