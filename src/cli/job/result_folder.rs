//! The folder of a session's result: its name, how it comes to it, and what it says of itself.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail, ensure};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use tempfile::TempDir;

use super::super::paths::cannot_write;
use super::session_name;
use super::step::{Findings, Step};
use crate::config::plain_file;
use crate::recording::{FolderLock, Loss, sync_folder, write_atomically};

/// File of a result that says what it is made of. It is written last.
const UNIT_FILE: &str = "unit.json";
/// Version of that file.
const UNIT_FORMAT: u64 = 1;
/// Largest file of that name, bytes: it has some hundred bytes for each file of the result.
const MAX_UNIT_BYTES: u64 = 256 << 20;
/// Program and version that results are named by.
const SOFTWARE: &str = concat!("realitysim ", env!("CARGO_PKG_VERSION"));

/// Content of [`UNIT_FILE`]: what a result is made of, what was found, and its files.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct UnitRecord {
    format: u64,
    session: String,
    step: String,
    software: String,
    config: Value,
    /// Hash of the recording.
    inputs: String,
    pub(super) summary: Value,
    /// What of the session could not be read, in words.
    pub(super) losses: Vec<String>,
    files: Vec<ResultFile>,
}

/// A file of a result.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct ResultFile {
    /// Path within the result.
    path: String,
    bytes: u64,
    blake3: String,
}

/// Where the result of a session is, or comes to be.
pub(super) struct ResultFolder {
    pub(super) path: PathBuf,
    session: String,
    config: Value,
    inputs: String,
}

impl ResultFolder {
    /// Names the result of a session: by the session, and by a hash of its recording, the program's version and the settings.
    pub(super) fn of(step: &Step, capture: &Path, results: &Path) -> anyhow::Result<Self> {
        let (session, config, inputs) = (session_name(capture), step.config(capture)?, step.inputs(capture)?);
        let named_by = json!([step.name(), SOFTWARE, config, inputs]).to_string();
        let hash = blake3::hash(named_by.as_bytes()).to_hex();
        Ok(Self { path: results.join(format!("{session}-{}", &hash[..16])), session, config, inputs })
    }

    /// Reads what the result says of itself; `None` if there is no result.
    pub(super) fn read(&self) -> anyhow::Result<Option<UnitRecord>> {
        if !self.path.exists() {
            return Ok(None);
        }
        let path = self.path.join(UNIT_FILE);
        let again = || format!("{}: no whole result: remove it, and run the job again", self.path.display());
        let bytes = plain_file::read(&path, MAX_UNIT_BYTES).with_context(again)?;
        let record: UnitRecord = serde_json::from_slice(&bytes).with_context(again)?;
        ensure!(
            record.format == UNIT_FORMAT,
            "{}: of format {}, and this program knows {UNIT_FORMAT}: use the program that wrote it, or another folder",
            path.display(),
            record.format
        );
        for ResultFile { path, bytes, .. } in &record.files {
            let there = fs::metadata(self.path.join(path)).map(|found| found.len());
            ensure!(there.is_ok_and(|there| there == *bytes), "{} ({path} is not as it was written)", again());
        }
        Ok(Some(record))
    }

    /// Makes the result: in a hidden folder, which gets its name once it is whole.
    pub(super) fn make(
        &self,
        step: &Step,
        capture: &Path,
        progress: &mut dyn FnMut(u64),
    ) -> anyhow::Result<UnitRecord> {
        let results = self.path.parent().unwrap_or(Path::new("."));
        let prefix = format!(".{}-", self.session);
        let working = tempfile::Builder::new().prefix(&prefix).permissions(own_mode()).tempdir_in(results);
        let working = working.map_err(|error| cannot_write(results, error))?;
        let lock = FolderLock::in_folder(working.path()).map_err(|error| cannot_write(working.path(), error))?;
        let findings = step.run(capture, working.path(), progress)?;
        ensure!(
            self.inputs == step.inputs(capture)?,
            "{}: the session changed while it was read: run the job again",
            capture.display()
        );
        let record = self.record(step, capture, working.path(), findings)?;
        self.keep(working)?;
        drop(lock);
        remove_abandoned(results, &prefix);
        Ok(record)
    }

    /// Lists the files of a whole result, forces them onto the disk, and writes what the result is made of.
    fn record(&self, step: &Step, capture: &Path, folder: &Path, findings: Findings) -> anyhow::Result<UnitRecord> {
        let record = UnitRecord {
            format: UNIT_FORMAT,
            session: self.session.clone(),
            step: step.name().to_owned(),
            software: SOFTWARE.to_owned(),
            config: self.config.clone(),
            inputs: self.inputs.clone(),
            summary: findings.summary,
            losses: findings.losses.iter().map(|loss| within(loss, capture)).collect(),
            files: files(folder)?,
        };
        write_atomically(&folder.join(UNIT_FILE), &serde_json::to_vec_pretty(&record)?)?;
        Ok(record)
    }

    /// Gives a whole result its name, unless another process was first: its result is the same.
    fn keep(&self, working: TempDir) -> anyhow::Result<()> {
        match fs::rename(working.path(), &self.path) {
            Ok(()) => {
                // The folder has another name now: there is nothing to remove.
                let _ = working.keep();
                Ok(self.path.parent().map_or(Ok(()), sync_folder)?)
            }
            Err(error) if matches!(error.kind(), ErrorKind::DirectoryNotEmpty | ErrorKind::AlreadyExists) => Ok(()),
            Err(error) => Err(cannot_write(&self.path, error)),
        }
    }
}

/// Permissions of a new folder, of which the process's mask takes away.
fn own_mode() -> fs::Permissions {
    std::os::unix::fs::PermissionsExt::from_mode(0o777)
}

/// A loss in words that do not depend on where the session lies.
fn within(loss: &Loss, capture: &Path) -> String {
    match loss.file.strip_prefix(capture) {
        Ok(file) if file.as_os_str().is_empty() => loss.what.clone(),
        Ok(file) => format!("{}: {}", file.display(), loss.what),
        Err(_) => loss.to_string(),
    }
}

/// All files in a folder, by path, each forced onto the disk.
fn files(folder: &Path) -> anyhow::Result<Vec<ResultFile>> {
    let (mut folders, mut found) = (vec![folder.to_owned()], Vec::new());
    while let Some(inside) = folders.pop() {
        for entry in fs::read_dir(&inside).map_err(|error| cannot_write(&inside, error))? {
            let path = entry?.path();
            if path.is_dir() {
                folders.push(path);
            } else {
                found.push(result_file(folder, &path).with_context(|| path.display().to_string())?);
            }
        }
        sync_folder(&inside)?;
    }
    found.sort_by(|a, b| a.path.cmp(&b.path));
    Ok(found)
}

fn result_file(folder: &Path, path: &Path) -> anyhow::Result<ResultFile> {
    let file = plain_file::open(path)?;
    let mut hash = blake3::Hasher::new();
    hash.update_reader(&file)?;
    file.sync_all()?;
    let Some(name) = path.strip_prefix(folder).ok().and_then(Path::to_str) else { bail!("not a plain name") };
    Ok(ResultFile { path: name.to_owned(), bytes: hash.count(), blake3: hash.finalize().to_hex().to_string() })
}

/// Removes what jobs that were killed have left of a session: hidden folders that no process holds.
fn remove_abandoned(results: &Path, prefix: &str) {
    for entry in fs::read_dir(results).into_iter().flatten().flatten() {
        let is_hidden = entry.file_name().to_string_lossy().starts_with(prefix);
        if is_hidden && FolderLock::try_in_folder(&entry.path()).is_ok_and(|lock| lock.is_some()) {
            // It is in nobody's way: if it cannot be removed now, the next job tries again.
            let _ = fs::remove_dir_all(entry.path());
        }
    }
}
