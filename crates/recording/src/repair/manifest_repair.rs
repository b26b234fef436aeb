//! Repair of the manifest: lines that are missing, damaged, or contradict each other.

use std::collections::BTreeSet;

use super::super::error::RecordingError;
use super::super::folder::{DamagedLine, Loss, all_lines};
use super::super::manifest::{MANIFEST_FILE, ManifestLine};
use super::super::retention::evicted_segments;
use super::super::segment::{ACTIVE, segment_index, segment_name};
use super::super::sessions::SetAside;
use super::super::storage::{read_small, write_atomically};
use super::super::verify::hash;
use super::SessionRepair;
use super::segment::describe;

/// Most missing segments in a row that are named one by one.
const MAX_NAMED: usize = 16;

impl SessionRepair<'_> {
    /// Makes the manifest list every segment of the folder once, in order.
    pub(super) fn complete_manifest(&mut self) -> Result<(), RecordingError> {
        let path = self.session.join(MANIFEST_FILE);
        let fails = |source| RecordingError::io(&path, source);
        let (mut lines, damaged) = all_lines(self.storage, self.session).map_err(fails)?;
        self.resolve_contradictions(&mut lines)?;
        for name in self.files(|name| !name.ends_with(ACTIVE))? {
            if lines.iter().any(|line| line.name == name) {
                continue;
            }
            let line = match self.lines.remove(&name) {
                Some(line) => line,
                None => {
                    let file = self.session.join(&name);
                    if let Some(why) = self.foreign_reason(&name)? {
                        self.repaired.set_aside.push(SetAside::new(&file, why));
                        continue;
                    }
                    let (line, topics, damage) =
                        describe(self.storage, &file, &name, &self.info.settings, self.journal.of(&name))?;
                    self.repaired.lost.extend(damage.map(|said| Loss::new(&file, said)));
                    self.topics.insert(name.clone(), topics);
                    line
                }
            };
            lines.push(line);
            self.repaired.listed.push(name);
        }
        self.report_lost_lines(&lines, &damaged);
        lines.sort_by_key(|line| segment_index(&line.name));
        let mut text = Vec::new();
        for line in &lines {
            serde_json::to_writer(&mut text, line)?;
            text.push(b'\n');
        }
        let old = read_small(self.storage, &path, u64::MAX).map_err(fails)?;
        if old.is_none() {
            self.report_missing_segments(&lines)?;
        }
        if old.as_ref() != Some(&text) {
            write_atomically(self.storage, &path, &text)?;
            self.repaired.manifest_rewritten = true;
        }
        Ok(())
    }

    /// Reports segments of damaged lines that are not here. Segments that are here have got new lines.
    fn report_lost_lines(&mut self, lines: &[ManifestLine], damaged: &[DamagedLine]) {
        let evicted = evicted_segments(self.storage, self.session);
        let of_damaged: Vec<&String> = damaged.iter().filter_map(|line| line.name.as_ref()).collect();
        // It is unknown which segment a line without a name stood for. Segments that were never finished had no line.
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
                lost.push(Loss::new(&file, format!("{MANIFEST_FILE}: {}; its segment is not here", line.describe())));
            }
        }
        self.repaired.lost.append(&mut lost);
    }

    /// Of lines that contradict each other, keeps the one whose hash is that of the file; all of them, if none is.
    fn resolve_contradictions(&mut self, lines: &mut Vec<ManifestLine>) -> Result<(), RecordingError> {
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

    /// Reports gaps in the numbers of segments, for a session without a manifest. With a manifest, a missing number
    /// is no loss: a segment that could not be begun has used it up.
    fn report_missing_segments(&mut self, lines: &[ManifestLine]) -> Result<(), RecordingError> {
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
}
