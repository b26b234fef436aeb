//! Segments of other sessions that somebody has put among these.

use super::super::error::RecordingError;
use super::super::segment::session_in;
use super::Work;
use realitysim_ros2::mcap_read::{Survey, examine, metadata_records};

impl Work<'_> {
    /// Why a file with a segment's name is none of this session; nothing where nobody can tell. One that bears no session's id is
    /// of another writer if it is whole, has nothing beside its messages, and the session's own bear theirs.
    pub(super) fn stranger(&self, name: &str) -> Result<Option<String>, RecordingError> {
        let Some(own) = &self.info.id else { return Ok(None) };
        Ok(match self.bearer(name)? {
            Some(id) if id == *own => None,
            Some(id) => Some(format!("of the session with id {id}, not of this one: left alone")),
            None if self.is_plain_log(name)? && self.others_bear(own, name)? => {
                Some("not written by this session's recorder: left alone".to_owned())
            }
            None => None,
        })
    }

    /// The id of the session that a segment was written in.
    fn bearer(&self, name: &str) -> Result<Option<String>, RecordingError> {
        let path = self.session.join(name);
        let file = self.storage.read(&path).map_err(|source| RecordingError::io(&path, source))?;
        // One that has not even a head says nothing.
        let records = metadata_records(file).unwrap_or_default();
        Ok(records.iter().find_map(session_in).map(str::to_owned))
    }

    fn is_plain_log(&self, name: &str) -> Result<bool, RecordingError> {
        let path = self.session.join(name);
        let file = self.storage.read(&path).map_err(|source| RecordingError::io(&path, source))?;
        let is_plain = |it: Survey| it.damage.is_none() && it.attachments.is_empty() && it.metadata.is_empty();
        Ok(examine(file).is_ok_and(is_plain))
    }

    fn others_bear(&self, own: &str, name: &str) -> Result<bool, RecordingError> {
        for other in self.files(|other| other != name)? {
            if self.bearer(&other)?.is_some_and(|id| id == own) {
                return Ok(true);
            }
        }
        Ok(false)
    }
}
