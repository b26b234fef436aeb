//! What a crash, a power cut or a failing disk has left of a session becomes a whole capture.
//!
//! Every step leaves something that the next run can go on from; a second run changes nothing.

mod account;
mod aside;
mod notes;
mod segment;

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

pub(super) use self::aside::is_damaged_name;
use self::aside::set_aside;
pub(super) use self::notes::NOTES_FILE;
use self::notes::{Cut, Notes};
pub(super) use self::segment::COPY;
use self::segment::{Ended, describe, finish};
use super::catalogue::SetAside;
use super::error::RecordingError;
use super::folder::{DamagedLine, Loss, all_lines, manifest_lines};
use super::manifest::{
    FORMAT_VERSION, MANIFEST_FILE, METADATA_FILE, ManifestLine, SESSION_FILE, SessionInfo, TopicEntry, metadata_yaml,
};
use super::retention::evicted_segments;
use super::segment::{ACTIVE, CUT_BYTES, CUT_RECORD, CUT_SEGMENT, is_segment_name, segment_index, segment_name};
use super::storage::{Kind, Listed, Storage, read_small, write_atomically};
use super::verify::hash;
use crate::ros2::mcap_read::{Remains, metadata_records, survey};

/// What was done to one session.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Repaired {
    pub session: PathBuf,
    /// It is being recorded: nothing was touched.
    pub in_use: bool,
    /// Segments that got their end.
    pub finished: Vec<String>,
    /// Files without a message that were removed.
    pub removed: Vec<String>,
    /// Segments that the manifest did not list.
    pub listed: Vec<String>,
    /// The manifest was written anew.
    pub manifest_rewritten: bool,
    pub metadata_rewritten: bool,
    /// What stays in the folder under another name, for people to look at, and why.
    pub set_aside: Vec<SetAside>,
    /// What could not be kept.
    pub lost: Vec<Loss>,
    /// What is not as the manifest says, and cannot be mended: left as it is.
    pub wrong: Vec<Loss>,
}

impl Repaired {
    pub fn changed_nothing(&self) -> bool {
        let wrong = self.wrong.clone();
        *self == Self { session: self.session.clone(), in_use: self.in_use, wrong, ..Self::default() }
    }
}

/// In words, over several lines.
impl fmt::Display for Repaired {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { session, in_use, finished, removed, listed, set_aside, lost, wrong, .. } = self;
        let state = match (in_use, self.changed_nothing()) {
            (true, _) => "is being recorded",
            (false, _) if !wrong.is_empty() => "not whole",
            (false, true) => "whole",
            (false, false) => "repaired",
        };
        write!(f, "{}: {state}", session.display())?;
        let parts = [("finished", finished), ("without a message, removed", removed), ("now in the manifest", listed)];
        for (what, names) in parts.into_iter().filter(|(_, names)| !names.is_empty()) {
            write!(f, "\n  {what}: {}", names.join(", "))?;
        }
        set_aside.iter().try_for_each(|aside| write!(f, "\n  set aside: {aside}"))?;
        lost.iter().try_for_each(|loss| write!(f, "\n  lost: {loss}"))?;
        wrong.iter().try_for_each(|wrong| write!(f, "\n  {wrong}"))
    }
}

/// A larger session file is none.
const MAX_SESSION_FILE_BYTES: u64 = 4 << 20;
/// A segment takes some hundred bytes of it.
const MAX_METADATA_FILE_BYTES: u64 = 64 << 20;

/// Missing segments in a row that are named one by one.
const MAX_NAMED: usize = 16;

/// Folders of sessions, oldest first, whether they can be read or not; the folder itself if it is one. What is no session is
/// left alone.
pub fn sessions_of(storage: &dyn Storage, captures: &Path) -> Vec<PathBuf> {
    let is_session = |folder: &Path| storage.read(&folder.join(SESSION_FILE)).is_ok();
    if is_session(captures) {
        return vec![captures.to_owned()];
    }
    let entries = storage.list(captures).unwrap_or_default().into_iter();
    // What is hidden is ours beside sessions, or on its way out.
    let folders = entries.filter(|entry| entry.kind == Kind::Folder && !entry.name.starts_with('.'));
    folders.map(|entry| captures.join(entry.name)).filter(|folder| is_session(folder)).collect()
}

/// Finishes what was never finished, lists what is not listed. Files that are not of this program stay as they are.
pub fn repair(storage: &dyn Storage, session: &Path) -> Result<Repaired, RecordingError> {
    let mut repaired = Repaired { session: session.to_owned(), ..Repaired::default() };
    let info = read_session(storage, session)?;
    let path = session.join(SESSION_FILE);
    let Some(_lock) = storage.lock(&path).map_err(|source| RecordingError::Io { path, source })? else {
        return Ok(Repaired { in_use: true, ..repaired });
    };
    let notes = Notes::read(storage, session);
    let (lines, topics) = (BTreeMap::new(), BTreeMap::new());
    let mut work = Work { storage, session, info, repaired: &mut repaired, lines, topics, notes };
    work.finish_segments()?;
    work.tell_what_was_noted()?;
    work.complete_manifest()?;
    work.complete_metadata()?;
    work.name_what_is_wrong()?;
    work.notes.forget()?;
    Ok(repaired)
}

/// `session.json`, of a format that is known; what else it says may be a later version's.
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

fn read_session(storage: &dyn Storage, session: &Path) -> Result<SessionInfo, RecordingError> {
    let bytes = read_head(storage, session)?;
    serde_json::from_slice(&bytes).map_err(|source| RecordingError::Info { path: session.join(SESSION_FILE), source })
}

struct Work<'a> {
    storage: &'a dyn Storage,
    session: &'a Path,
    info: SessionInfo,
    repaired: &'a mut Repaired,
    /// Of segments that were looked through.
    lines: BTreeMap<String, ManifestLine>,
    topics: BTreeMap<String, BTreeMap<TopicEntry, u64>>,
    notes: Notes<'a>,
}

impl Work<'_> {
    fn finish_segments(&mut self) -> Result<(), RecordingError> {
        let names = self.files(|name| name.ends_with(ACTIVE))?;
        let fails = |source| RecordingError::io(self.session, source);
        let cuts = if names.is_empty() { BTreeMap::new() } else { self.cuts()? };
        for active in names {
            let name = active.trim_end_matches(ACTIVE).to_owned();
            let path = self.session.join(&active);
            // Somebody's old copy of it, or what a repair that was killed has copied from: what is finished is never replaced.
            if self.storage.list(self.session).map_err(fails)?.iter().any(|there| there.name == name) {
                self.set_aside(&path, &format!("{name} is finished, and stays as it is"))?;
                continue;
            }
            let limit = cuts.get(&name).copied();
            match finish(self.storage, &path, &name, limit, &self.info.settings, &mut self.notes)? {
                Ended::Without(remains) => self.leave_out(&path, &name, remains)?,
                Ended::Whole { line, topics, damage, damaged } => {
                    if let Some(bytes) = line.cut_bytes {
                        let said = Cut { bytes, damage }.said();
                        self.repaired.lost.push(Loss::new(&self.session.join(&name), said));
                    }
                    let why = || format!("not all of it could be copied into {name}");
                    self.repaired.set_aside.extend(damaged.map(|path| SetAside::new(path, why())));
                    self.lines.insert(name.clone(), *line);
                    self.topics.insert(name.clone(), topics);
                    self.repaired.finished.push(name);
                }
            }
        }
        Ok(())
    }

    /// One without a message. What is the beginning of a log goes; everything else may be worth looking at.
    fn leave_out(&mut self, path: &Path, name: &str, remains: Remains) -> Result<(), RecordingError> {
        let segment = self.session.join(name);
        match remains {
            Remains::Nothing => {}
            Remains::Torn { bytes } => {
                let damage = Some("it held nothing that was whole".to_owned());
                let cut = self.notes.note(name, Cut { bytes, damage })?;
                self.repaired.lost.push(Loss::new(&segment, cut.said()));
            }
            Remains::Other => {
                let bytes = self.storage.list(self.session).map_err(|source| RecordingError::io(path, source))?;
                let bytes = bytes.iter().find(|there| path.ends_with(&there.name)).and_then(Listed::bytes).unwrap_or(0);
                let damage = Some("no message in it can be read: it is set aside".to_owned());
                let cut = self.notes.note(name, Cut { bytes, damage })?;
                self.repaired.lost.push(Loss::new(&segment, cut.said()));
                return self.set_aside(path, "no message in it can be read");
            }
        }
        let removed = self.storage.remove(path).and_then(|()| self.storage.sync_folder(self.session));
        removed.map_err(|source| RecordingError::io(path, source))?;
        self.repaired.removed.push(format!("{name}{ACTIVE}"));
        Ok(())
    }

    fn set_aside(&mut self, active: &Path, why: &str) -> Result<(), RecordingError> {
        let aside = set_aside(self.storage, active)?;
        self.repaired.set_aside.push(SetAside::new(aside, why));
        Ok(())
    }

    /// What a repair that was killed has noted of segments that are not here at all any more.
    fn tell_what_was_noted(&mut self) -> Result<(), RecordingError> {
        let there = self.files(|_| true)?;
        for (name, cut) in self.notes.all().filter(|(name, _)| is_segment_name(name)) {
            let file = self.session.join(name);
            let is_told = self.repaired.lost.iter().any(|loss| loss.file == file);
            if !is_told && !there.iter().any(|file| file == name) {
                self.repaired.lost.push(Loss::new(&file, cut.said()));
            }
        }
        Ok(())
    }

    /// Where segments end that were given up, as those behind them say.
    fn cuts(&self) -> Result<BTreeMap<String, u64>, RecordingError> {
        let mut cuts = BTreeMap::new();
        for name in self.files(|_| true)? {
            let path = self.session.join(&name);
            let file = self.storage.read(&path).map_err(|source| RecordingError::io(&path, source))?;
            // One that has not even a head says nothing.
            let Ok(found) = metadata_records(file) else { continue };
            for record in found.into_iter().filter(|record| record.name == CUT_RECORD) {
                let value = |key: &str| record.values.get(key).cloned();
                if let (Some(segment), Some(Ok(bytes))) =
                    (value(CUT_SEGMENT), value(CUT_BYTES).map(|text| text.parse()))
                {
                    cuts.insert(segment, bytes);
                }
            }
        }
        Ok(cuts)
    }

    fn complete_manifest(&mut self) -> Result<(), RecordingError> {
        let path = self.session.join(MANIFEST_FILE);
        let fails = |source| RecordingError::io(&path, source);
        let (mut lines, damaged) = all_lines(self.storage, self.session).map_err(fails)?;
        self.keep_the_true_lines(&mut lines)?;
        for name in self.files(|name| !name.ends_with(ACTIVE))? {
            if lines.iter().any(|line| line.name == name) {
                continue;
            }
            let line = match self.lines.remove(&name) {
                Some(line) => line,
                None => {
                    let file = self.session.join(&name);
                    let (line, topics, damage) =
                        describe(self.storage, &file, &name, &self.info.settings, self.notes.of(&name))?;
                    self.repaired.lost.extend(damage.map(|said| Loss::new(&file, said)));
                    self.topics.insert(name.clone(), topics);
                    line
                }
            };
            lines.push(line);
            self.repaired.listed.push(name);
        }
        self.tell_lost_lines(&lines, &damaged);
        lines.sort_by_key(|line| segment_index(&line.name));
        let mut text = Vec::new();
        for line in &lines {
            serde_json::to_writer(&mut text, line)?;
            text.push(b'\n');
        }
        let old = read_small(self.storage, &path, u64::MAX).map_err(fails)?;
        if old.is_none() {
            self.name_missing_numbers(&lines)?;
        }
        if old.as_ref() != Some(&text) {
            write_atomically(self.storage, &path, &text)?;
            self.repaired.manifest_rewritten = true;
        }
        Ok(())
    }

    /// What damaged lines were of and is not here. Their segments that are here have new lines now.
    fn tell_lost_lines(&mut self, lines: &[ManifestLine], damaged: &[DamagedLine]) {
        let evicted = evicted_segments(self.storage, self.session);
        let of_damaged: Vec<&String> = damaged.iter().filter_map(|line| line.name.as_ref()).collect();
        // Nobody can say which line was of which; one that was never finished had none.
        let is_explained = |name: &&String| !of_damaged.contains(name) && !self.repaired.finished.contains(name);
        let mut explained = self.repaired.listed.iter().filter(is_explained).count();
        let mut lost = Vec::new();
        for line in damaged {
            let is_lost = match &line.name {
                Some(name) => !evicted.contains_key(name) && !lines.iter().any(|line| line.name == *name),
                None => explained == 0,
            };
            explained = explained.saturating_sub(usize::from(line.name.is_none()));
            if is_lost {
                let file = self.session.join(line.name.as_deref().unwrap_or(MANIFEST_FILE));
                lost.push(Loss::new(&file, format!("{MANIFEST_FILE}: {}; its segment is not here", line.said())));
            }
        }
        self.repaired.lost.append(&mut lost);
    }

    /// Of lines that contradict each other, the one that the file bears out; all of them, if it bears out none.
    fn keep_the_true_lines(&mut self, lines: &mut Vec<ManifestLine>) -> Result<(), RecordingError> {
        let mut unlike: Vec<ManifestLine> = Vec::new();
        for line in lines.drain(..) {
            if !unlike.contains(&line) {
                unlike.push(line);
            }
        }
        let mut names = BTreeSet::new();
        let doubted: BTreeSet<String> =
            unlike.iter().filter(|line| !names.insert(&line.name)).map(|line| line.name.clone()).collect();
        let files = self.files(|name| !name.ends_with(ACTIVE))?;
        for name in doubted {
            let file = self.session.join(&name);
            let found = match files.contains(&name) {
                true => Some(hash(self.storage, &file).map_err(|source| RecordingError::io(&file, source))?),
                false => None,
            };
            let truth = unlike.iter().position(|line| line.name == name && found.as_ref() == Some(&line.blake3));
            match truth.map(|index| unlike[index].clone()) {
                Some(truth) => unlike.retain(|line| line.name != name || *line == truth),
                None => {
                    let said = format!("stands several times in {MANIFEST_FILE}, and no line is of what is here");
                    self.repaired.wrong.push(Loss::new(&file, said));
                }
            }
        }
        *lines = unlike;
        Ok(())
    }

    /// Where there was no manifest. With one, a number may be missing: a segment that could not be begun has used it up.
    fn name_missing_numbers(&mut self, lines: &[ManifestLine]) -> Result<(), RecordingError> {
        let (given_up, evicted) = (self.cuts()?, evicted_segments(self.storage, self.session));
        let mut next = 0;
        for index in lines.iter().filter_map(|line| segment_index(&line.name)) {
            for name in (next..index)
                .take(MAX_NAMED)
                .map(segment_name)
                .filter(|name| !given_up.contains_key(name) && !evicted.contains_key(name))
            {
                let said = format!("is missing, and so was {MANIFEST_FILE}: nobody can say what it held");
                self.repaired.wrong.push(Loss::new(&self.session.join(name), said));
            }
            next = index.saturating_add(1);
        }
        Ok(())
    }

    /// By name and size; `verify` reads all.
    fn name_what_is_wrong(&mut self) -> Result<(), RecordingError> {
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

    fn complete_metadata(&mut self) -> Result<(), RecordingError> {
        let path = self.session.join(METADATA_FILE);
        let fails = |source| RecordingError::io(&path, source);
        let there = read_small(self.storage, &path, MAX_METADATA_FILE_BYTES).map_err(fails)?;
        let files = self.files(|name| !name.ends_with(ACTIVE))?;
        // Readers that go by it stumble over segments that were removed.
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

    /// Segments, finished or not, that are plain files of this folder.
    fn files(&self, wanted: impl Fn(&str) -> bool) -> Result<Vec<String>, RecordingError> {
        let listed = self.storage.list(self.session).map_err(|source| RecordingError::io(self.session, source))?;
        let is_ours = |file: &Listed| file.bytes().is_some() && segment_index(&file.name).is_some();
        Ok(listed.into_iter().filter(is_ours).map(|file| file.name).filter(|name| wanted(name)).collect())
    }
}

/// By the index.
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
