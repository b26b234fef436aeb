//! Repair of segments that were never finished, and of files that stand under their names.

use std::collections::BTreeMap;
use std::path::Path;

use super::super::error::RecordingError;
use super::super::folder::Loss;
use super::super::segment::{ACTIVE, CUT_BYTES, CUT_RECORD, CUT_SEGMENT, is_segment_name};
use super::super::sessions::SetAside;
use super::super::storage::Listed;
use super::SessionRepair;
use super::quarantine::set_aside;
use super::repair_journal::Cut;
use super::segment::{FinishOutcome, finish};
use realitysim_ros2::mcap_read::{FileTail, metadata_records};

impl SessionRepair<'_> {
    /// Finishes, sets aside or removes every unfinished segment.
    pub(super) fn finish_segments(&mut self) -> Result<(), RecordingError> {
        let names = self.files(|name| name.ends_with(ACTIVE))?;
        let fails = |source| RecordingError::io(self.session, source);
        let cuts = if names.is_empty() { BTreeMap::new() } else { self.cuts()? };
        for active in names {
            let name = active.trim_end_matches(ACTIVE).to_owned();
            let path = self.session.join(&active);
            // It is an old copy, or what a killed repair has copied from: a finished segment is never replaced.
            if self.storage.list(self.session).map_err(fails)?.iter().any(|there| there.name == name) {
                self.set_aside(&path, &format!("{name} is finished, and stays as it is"))?;
                continue;
            }
            if let Some(why) = self.foreign_reason(&active)? {
                self.set_aside(&path, &why)?;
                continue;
            }
            let limit = cuts.get(&name).copied();
            match finish(self.storage, &path, &name, limit, &self.info.settings, &mut self.journal)? {
                FinishOutcome::Empty(file_tail) => self.discard_empty(&path, &name, file_tail)?,
                FinishOutcome::Whole { line, topics, damage, damaged } => {
                    if let Some(bytes) = line.cut_bytes {
                        let said = Cut { bytes, damage }.describe();
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

    /// Handles a segment without a message. If it is only the beginning of a log, it is removed; anything else is set
    /// aside, since it may be worth looking at.
    fn discard_empty(&mut self, path: &Path, name: &str, file_tail: FileTail) -> Result<(), RecordingError> {
        let segment = self.session.join(name);
        match file_tail {
            FileTail::Nothing => {}
            FileTail::Torn { bytes } => {
                let damage = Some("it held nothing that was whole".to_owned());
                let cut = self.journal.note(name, Cut { bytes, damage })?;
                self.repaired.lost.push(Loss::new(&segment, cut.describe()));
            }
            FileTail::Other => {
                let bytes = self.storage.list(self.session).map_err(|source| RecordingError::io(path, source))?;
                let bytes = bytes.iter().find(|there| path.ends_with(&there.name)).and_then(Listed::bytes).unwrap_or(0);
                let damage = Some("no message in it can be read: it is set aside".to_owned());
                let cut = self.journal.note(name, Cut { bytes, damage })?;
                self.repaired.lost.push(Loss::new(&segment, cut.describe()));
                return self.set_aside(path, "no message in it can be read");
            }
        }
        let removed = self.storage.remove(path).and_then(|()| self.storage.sync_folder(self.session));
        removed.map_err(|source| RecordingError::io(path, source))?;
        self.repaired.removed.push(format!("{name}{ACTIVE}"));
        Ok(())
    }

    /// Sets an unfinished segment aside, for a reason.
    fn set_aside(&mut self, active: &Path, why: &str) -> Result<(), RecordingError> {
        let aside = set_aside(self.storage, active)?;
        self.repaired.set_aside.push(SetAside::new(aside, why));
        Ok(())
    }

    /// Reports what a killed repair has noted of segments that are no longer here.
    pub(super) fn report_journalled_losses(&mut self) -> Result<(), RecordingError> {
        let there = self.files(|_| true)?;
        for (name, cut) in self.journal.all().filter(|(name, _)| is_segment_name(name)) {
            let file = self.session.join(name);
            let is_told = self.repaired.lost.iter().any(|loss| loss.file == file);
            if !is_told && !there.iter().any(|file| file == name) {
                self.repaired.lost.push(Loss::new(&file, cut.describe()));
            }
        }
        Ok(())
    }

    /// Reads from all segments where those end that were given up, in bytes by name.
    pub(super) fn cuts(&self) -> Result<BTreeMap<String, u64>, RecordingError> {
        let mut cuts = BTreeMap::new();
        for name in self.files(|_| true)? {
            let path = self.session.join(&name);
            let file = self.storage.read(&path).map_err(|source| RecordingError::io(&path, source))?;
            // A file without even a head says nothing.
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
}
