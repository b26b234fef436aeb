//! Repair: makes a whole capture of what a crash, a power cut or a failing disk has left of a session.
//!
//! Each step leaves a state from which the next run can go on; a second run changes nothing.

mod foreign_segments;
mod manifest_repair;
mod quarantine;
mod repair_journal;
mod report;
mod segment;
mod segment_counts;
mod unfinished;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Deserialize;

pub(super) use self::quarantine::is_damaged_name;
pub(super) use self::repair_journal::JOURNAL_FILE;
use self::repair_journal::RepairJournal;
pub use self::report::Repaired;
pub(super) use self::segment::COPY;
use super::error::RecordingError;
use super::folder::{Loss, manifest_lines};
use super::manifest::{
    FORMAT_VERSION, MANIFEST_FILE, METADATA_FILE, ManifestLine, SESSION_FILE, SessionInfo, TopicEntry, metadata_yaml,
};
use super::retention::evicted_segments;
use super::segment::{ACTIVE, is_segment_name, segment_index};
use super::storage::{Kind, Listed, Storage, read_small, write_atomically};
use realitysim_ros2::mcap_read::survey;

/// Largest `session.json`, bytes.
const MAX_SESSION_FILE_BYTES: u64 = 4 << 20;
/// Largest `metadata.yaml`, bytes: a segment takes some hundred bytes of it.
const MAX_METADATA_FILE_BYTES: u64 = 64 << 20;

/// Lists the folders of sessions in a folder of captures, oldest first, whether they can be read or not. If the
/// folder itself is a session, it is the only one. Other folders are left out.
pub fn sessions_of(storage: &dyn Storage, captures: &Path) -> Vec<PathBuf> {
    let is_session = |folder: &Path| storage.read(&folder.join(SESSION_FILE)).is_ok();
    if is_session(captures) {
        return vec![captures.to_owned()];
    }
    let entries = storage.list(captures).unwrap_or_default().into_iter();
    // Hidden folders belong to this program or are being deleted.
    let folders = entries.filter(|entry| entry.kind == Kind::Folder && !entry.name.starts_with('.'));
    folders.map(|entry| captures.join(entry.name)).filter(|folder| is_session(folder)).collect()
}

/// Finishes segments that were never finished and lists segments that the manifest does not list.
///
/// Files of other programs stay as they are. A session that is being recorded is not touched.
pub fn repair(storage: &dyn Storage, session: &Path) -> Result<Repaired, RecordingError> {
    let mut repaired = Repaired { session: session.to_owned(), ..Repaired::default() };
    let info = read_session(storage, session)?;
    let path = session.join(SESSION_FILE);
    let Some(_lock) = storage.lock(&path).map_err(|source| RecordingError::Io { path, source })? else {
        return Ok(Repaired { in_use: true, ..repaired });
    };
    let journal = RepairJournal::read(storage, session);
    let (lines, topics) = (BTreeMap::new(), BTreeMap::new());
    let mut work = SessionRepair { storage, session, info, repaired: &mut repaired, lines, topics, journal };
    work.finish_segments()?;
    work.report_journalled_losses()?;
    work.complete_manifest()?;
    work.complete_metadata()?;
    work.report_mismatches()?;
    work.journal.forget()?;
    Ok(repaired)
}

/// Reads `session.json` and checks its format version only, since the rest may be of a later program.
pub(super) fn read_head(storage: &dyn Storage, session: &Path) -> Result<Vec<u8>, RecordingError> {
    #[derive(Deserialize)]
    struct Version {
        format: u32,
    }
    let path = session.join(SESSION_FILE);
    let read =
        read_small(storage, &path, MAX_SESSION_FILE_BYTES).map_err(|source| RecordingError::io(&path, source))?;
    let bytes = read.ok_or_else(|| RecordingError::io(&path, std::io::ErrorKind::NotFound.into()))?;
    let Version { format } =
        serde_json::from_slice(&bytes).map_err(|source| RecordingError::Info { path: path.clone(), source })?;
    match format {
        FORMAT_VERSION => Ok(bytes),
        format => Err(RecordingError::Newer { path, format, known: FORMAT_VERSION }),
    }
}

/// Reads and parses `session.json`.
fn read_session(storage: &dyn Storage, session: &Path) -> Result<SessionInfo, RecordingError> {
    let bytes = read_head(storage, session)?;
    serde_json::from_slice(&bytes).map_err(|source| RecordingError::Info { path: session.join(SESSION_FILE), source })
}

/// State of the repair of one session.
struct SessionRepair<'a> {
    storage: &'a dyn Storage,
    session: &'a Path,
    info: SessionInfo,
    repaired: &'a mut Repaired,
    /// Manifest lines of segments that this repair has read.
    lines: BTreeMap<String, ManifestLine>,
    /// Messages of these segments, by topic.
    topics: BTreeMap<String, BTreeMap<TopicEntry, u64>>,
    journal: RepairJournal<'a>,
}

impl SessionRepair<'_> {
    /// Reports segments whose name or size is not what the manifest says; [`verify`](super::verify::verify) reads
    /// their content as well.
    fn report_mismatches(&mut self) -> Result<(), RecordingError> {
        let path = self.session.join(MANIFEST_FILE);
        let lines = manifest_lines(self.storage, self.session).map_err(|source| RecordingError::io(&path, source))?;
        let listed = self.storage.list(self.session).map_err(|source| RecordingError::io(self.session, source))?;
        let evicted = evicted_segments(self.storage, self.session);
        for line in &lines {
            let file = self.session.join(&line.name);
            if self.repaired.wrong.iter().any(|known| known.file == file) {
                continue;
            }
            let (file, said) = match listed.iter().find(|there| there.name == line.name).map(|there| there.kind) {
                _ if !is_segment_name(&line.name) => {
                    (path.clone(), format!("lists {:?}, which is no name of a segment", line.name))
                }
                Some(Kind::File(bytes)) if bytes == line.bytes => continue,
                Some(Kind::File(bytes)) => {
                    (file, format!("has {bytes} bytes, but {MANIFEST_FILE} says {}: it was cut or changed", line.bytes))
                }
                Some(_) => (file, "is no plain file".to_owned()),
                None if evicted.contains_key(&line.name) => continue,
                None => (file, format!("missing: {MANIFEST_FILE} lists it with {} messages", line.messages)),
            };
            self.repaired.wrong.push(Loss::new(&file, said));
        }
        Ok(())
    }

    /// Writes `metadata.yaml` if it is missing, if something was repaired, or if it lists segments that were removed.
    fn complete_metadata(&mut self) -> Result<(), RecordingError> {
        let path = self.session.join(METADATA_FILE);
        let fails = |source| RecordingError::io(&path, source);
        let there = read_small(self.storage, &path, MAX_METADATA_FILE_BYTES).map_err(fails)?;
        let files = self.files(|name| !name.ends_with(ACTIVE))?;
        // Readers that go by the file fail at segments that were removed.
        let lists_what_is_gone = |text: &[u8]| {
            let text = String::from_utf8_lossy(text);
            let gone = evicted_segments(self.storage, self.session).into_keys().filter(|name| !files.contains(name));
            gone.into_iter().any(|name| text.contains(&format!("path: \"{name}\"")))
        };
        if there.is_some_and(|text| !lists_what_is_gone(&text)) && self.repaired.changed_nothing() {
            return Ok(());
        }
        let mut lines = manifest_lines(self.storage, self.session).map_err(fails)?;
        lines.retain(|line| files.contains(&line.name));
        let mut topics = BTreeMap::new();
        for line in &lines {
            let file = self.session.join(&line.name);
            let of_file = match self.topics.remove(&line.name) {
                Some(topics) => topics,
                None => topics_of(self.storage, &file)?,
            };
            for (topic, messages) in of_file {
                *topics.entry(topic).or_default() += messages;
            }
        }
        write_atomically(self.storage, &path, metadata_yaml(&lines, &topics).as_bytes())?;
        self.repaired.metadata_rewritten = true;
        Ok(())
    }

    /// Names of plain files of this folder that are segments, finished or not.
    fn files(&self, wanted: impl Fn(&str) -> bool) -> Result<Vec<String>, RecordingError> {
        let listed = self.storage.list(self.session).map_err(|source| RecordingError::io(self.session, source))?;
        let is_ours = |file: &Listed| file.bytes().is_some() && segment_index(&file.name).is_some();
        Ok(listed.into_iter().filter(is_ours).map(|file| file.name).filter(|name| wanted(name)).collect())
    }
}

/// Messages of a segment by topic, from its index.
fn topics_of(storage: &dyn Storage, path: &Path) -> Result<BTreeMap<TopicEntry, u64>, RecordingError> {
    let file = storage.read(path).map_err(|source| RecordingError::io(path, source))?;
    let survey = survey(file).map_err(|source| RecordingError::Read { path: path.to_owned(), source })?;
    let mut topics = BTreeMap::new();
    for topic in survey.topics.into_iter().filter(|topic| topic.messages > 0) {
        let entry = TopicEntry { name: topic.topic, type_name: topic.type_name, qos_profiles: topic.qos_profiles };
        *topics.entry(entry).or_default() += topic.messages;
    }
    Ok(topics)
}
