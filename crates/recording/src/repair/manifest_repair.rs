//! The manifest: lines that are missing, damaged, or contradict each other.

use std::collections::BTreeSet;

use super::super::catalogue::SetAside;
use super::super::error::RecordingError;
use super::super::folder::{DamagedLine, Loss, all_lines};
use super::super::manifest::{MANIFEST_FILE, ManifestLine};
use super::super::retention::evicted_segments;
use super::super::segment::{ACTIVE, segment_index, segment_name};
use super::super::storage::{read_small, write_atomically};
use super::super::verify::hash;
use super::Work;
use super::segment::describe;

/// Missing segments in a row that are named one by one.
const MAX_NAMED: usize = 16;

impl Work<'_> {
    pub(super) fn complete_manifest(&mut self) -> Result<(), RecordingError> {
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
                    if let Some(why) = self.stranger(&name)? {
                        self.repaired.set_aside.push(SetAside::new(&file, why));
                        continue;
                    }
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
}
