//! The folder of a catalogue: how sessions come into it, and how it stands to its captures.

use std::collections::HashMap;
use std::fs;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::capture::{CapturedSession, rows_of_capture};
use super::error::{CatalogueError, io};
use super::file::{FileHead, parquet_of_rows, read_head};
use super::partition::files;
use realitysim_recording::storage::Disk;
use realitysim_recording::{FolderLock, Loss, captures_within, sessions_of, source_hash, write_atomically};

/// What a change of a catalogue has done.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Report {
    /// Number of sessions that were written.
    pub sessions: u64,
    /// Number of their rows.
    pub rows: u64,
    /// Number of these with a valid tag.
    pub valid: u64,
    /// Size of their files, bytes.
    pub bytes: u64,
    /// Files that were removed: of sessions that are not there any more, or that moved within the catalogue.
    pub removed: Vec<PathBuf>,
    /// Captures or parts of them that could not be read. The rows that the catalogue had of such a capture stay.
    pub losses: Vec<Loss>,
    /// What may not be as it seems: clocks that differ, a session that lies twice, files of other programs.
    pub warnings: Vec<String>,
}

/// Callback that gets the number of images read so far of a capture.
pub type Progress<'a> = &'a mut dyn FnMut(u64);

/// Adds captures to a catalogue, which is made if there is none. The rows that it has of these sessions are replaced.
///
/// # Errors
///
/// Fails if a path is no capture, if another process changes the catalogue, or if one of its files is of a newer version.
pub fn add(catalogue: &Path, captures: &[PathBuf], progress: Progress) -> Result<Report, CatalogueError> {
    let _lock = lock(catalogue)?;
    add_those(catalogue, captures, |_, _| true, progress)
}

/// The catalogue that is kept up to date with a folder of captures: `catalogue` beside the folder; `None` if there is none.
pub fn catalogue_beside(captures: &Path) -> Option<PathBuf> {
    let catalogue = captures.canonicalize().ok()?.parent()?.join(FOLDER_BESIDE);
    is_catalogue(&catalogue).then_some(catalogue)
}

/// Name of the folder of [`catalogue_beside`].
const FOLDER_BESIDE: &str = "catalogue";

/// Adds those captures to a catalogue that it lacks, or that changed since. Waits for another process that changes it.
///
/// # Errors
///
/// Fails if a path is no capture, or if a file of the catalogue is of a newer version.
pub fn update(catalogue: &Path, captures: &[PathBuf], progress: Progress) -> Result<Report, CatalogueError> {
    let _lock = FolderLock::in_folder(catalogue).map_err(io(catalogue))?;
    let is_new = |known: &Known, capture: &Path| !known.has_current(capture);
    add_those(catalogue, captures, is_new, progress)
}

fn add_those(
    catalogue: &Path,
    captures: &[PathBuf],
    is_asked_for: impl Fn(&Known, &Path) -> bool,
    progress: Progress,
) -> Result<Report, CatalogueError> {
    let mut known = Known::read(catalogue)?;
    let mut report = Report { warnings: known.foreign.clone(), ..Report::default() };
    for capture in captures {
        if !is_asked_for(&known, capture) {
            continue;
        }
        let session = rows_of_capture(capture, progress).map_err(|error| match error {
            CatalogueError::Source { path, what } => {
                CatalogueError::Source { what: what + &captures_within(&path), path }
            }
            error => error,
        })?;
        write(catalogue, session, &mut known, &mut report)?;
    }
    Ok(report)
}

/// Makes a catalogue of all captures in a folder: the same captures give the same files, whatever was there before.
///
/// A capture that cannot be read is a loss, and the rows that the catalogue has of it stay. Files of sessions that are not in the
/// folder, and files that are not whole, are removed.
///
/// # Errors
///
/// Fails if the folder holds no capture, if another process changes the catalogue, or if one of its files is of a newer version.
pub fn rebuild(catalogue: &Path, captures: &Path, progress: Progress) -> Result<Report, CatalogueError> {
    let mut folders = sessions_of(&Disk, captures);
    if folders.is_empty() {
        let what =
            "holds no capture: name the folder that `realitysim record`, `replay` or `sync` writes captures into";
        return Err(CatalogueError::Source { path: captures.to_owned(), what: what.to_owned() });
    }
    folders.sort();
    let _lock = lock(catalogue)?;
    let mut known = Known::read(catalogue)?;
    let mut report = Report { warnings: known.foreign.clone(), ..Report::default() };
    let mut written: HashMap<String, (PathBuf, PathBuf)> = HashMap::new();
    let mut unread = Vec::new();
    for folder in folders {
        let session = match rows_of_capture(&folder, progress) {
            Ok(session) => session,
            Err(error) => {
                report.losses.push(Loss::new(&folder, reason(&error, &folder)));
                unread.push(folder.canonicalize().unwrap_or(folder).display().to_string());
                continue;
            }
        };
        if let Some((first, _)) = written.get(&session.head.session_id) {
            let warning = format!("{}: the same session as {}: left out", folder.display(), first.display());
            report.warnings.push(warning);
            continue;
        }
        let id = session.head.session_id.clone();
        let file = write(catalogue, session, &mut known, &mut report)?;
        written.insert(id, (folder, file));
    }
    let is_written = |file: &PathBuf| written.values().any(|(_, written)| written == file);
    let gone = known.heads.into_iter().filter(|(_, head)| !unread.contains(&head.capture)).map(|(file, _)| file);
    for file in gone.chain(known.damaged).filter(|file| !is_written(file)) {
        remove(file, &mut report)?;
    }
    Ok(report)
}

/// An error about a folder without the folder's name before it.
fn reason(error: &CatalogueError, folder: &Path) -> String {
    let text = error.to_string();
    text.strip_prefix(&format!("{}: ", folder.display())).map_or(text.clone(), str::to_owned)
}

/// A file of a catalogue, as [`show`] found it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Entry {
    /// The file, relative to the catalogue.
    pub file: PathBuf,
    /// Where its rows are from; `None` if the file cannot be read.
    #[serde(flatten)]
    pub head: Option<FileHead>,
    /// Number of its rows.
    pub rows: u64,
    /// Size of the file, bytes.
    pub bytes: u64,
    /// How the file stands to its capture.
    pub state: EntryState,
    /// What is wrong with the file, in words; empty if nothing is.
    pub what: String,
}

/// How a file of a catalogue stands to its capture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum EntryState {
    /// The capture is as it was catalogued.
    Current,
    /// The capture changed since.
    Changed,
    /// The capture is not there any more.
    Gone,
    /// The file is not whole, of another program, or of a newer version.
    Unreadable,
}

/// Lists the files of a catalogue, and compares each with its capture.
///
/// # Errors
///
/// Fails if the folder has no file of a catalogue.
pub fn show(catalogue: &Path) -> Result<Vec<Entry>, CatalogueError> {
    Ok(catalogue_files(catalogue)?.into_iter().map(|file| entry(catalogue, &file)).collect())
}

/// The files of a catalogue, by path.
///
/// # Errors
///
/// Fails if the folder has none.
pub fn catalogue_files(catalogue: &Path) -> Result<Vec<PathBuf>, CatalogueError> {
    let files = files(catalogue)?;
    if files.is_empty() { Err(CatalogueError::None { path: catalogue.to_owned() }) } else { Ok(files) }
}

/// The captures that a catalogue has rows of, by path; some may not be there any more. None if the folder is no catalogue.
///
/// # Errors
///
/// Fails if a file of the catalogue cannot be read.
pub fn captures_in(catalogue: &Path) -> Result<Vec<PathBuf>, CatalogueError> {
    let heads = files(catalogue)?.into_iter().map(|file| read_head(&file));
    let captures = heads.map(|read| read.map(|(head, _)| PathBuf::from(head.capture)));
    let mut captures = captures.collect::<Result<Vec<_>, _>>()?;
    captures.sort();
    captures.dedup();
    Ok(captures)
}

/// Whether a folder holds files of a catalogue.
pub fn is_catalogue(folder: &Path) -> bool {
    files(folder).is_ok_and(|files| !files.is_empty())
}

fn entry(catalogue: &Path, path: &Path) -> Entry {
    let bytes = fs::metadata(path).map_or(0, |found| found.len());
    let file = path.strip_prefix(catalogue).unwrap_or(path).to_owned();
    let (head, rows) = match read_head(path) {
        Ok(read) => read,
        Err(error) => {
            let (state, what) = (EntryState::Unreadable, error.to_string());
            return Entry { file, head: None, rows: 0, bytes, state, what };
        }
    };
    let (state, what) = match source_hash(Path::new(&head.capture)) {
        Ok(hash) if hash == head.source_hash => (EntryState::Current, String::new()),
        _ if !Path::new(&head.capture).is_dir() => (EntryState::Gone, format!("{}: not there any more", head.capture)),
        Ok(_) => {
            let what =
                format!("{}: changed since it was catalogued: `realitysim catalogue add` reads it again", head.capture);
            (EntryState::Changed, what)
        }
        Err(error) => (EntryState::Changed, error.to_string()),
    };
    Entry { file, head: Some(head), rows, bytes, state, what }
}

/// The files that a catalogue has before a change.
struct Known {
    /// Whole files, and where their rows are from.
    heads: Vec<(PathBuf, FileHead)>,
    /// Files that are not whole.
    damaged: Vec<PathBuf>,
    /// Warnings of files of other programs, which stay.
    foreign: Vec<String>,
}

impl Known {
    /// Whether the catalogue has a capture as it is now.
    fn has_current(&self, capture: &Path) -> bool {
        let Ok(capture) = capture.canonicalize() else { return false };
        let Ok(hash) = source_hash(&capture) else { return false };
        let capture = capture.display().to_string();
        self.heads.iter().any(|(_, head)| head.capture == capture && head.source_hash == hash)
    }

    /// Reads the ends of all files. A file of a newer version is an error, because nothing may be lost of it.
    fn read(catalogue: &Path) -> Result<Self, CatalogueError> {
        let mut known = Self { heads: Vec::new(), damaged: Vec::new(), foreign: Vec::new() };
        for file in files(catalogue)? {
            match read_head(&file) {
                Ok((head, _)) => known.heads.push((file, head)),
                Err(CatalogueError::Damaged { .. }) => known.damaged.push(file),
                Err(error @ CatalogueError::Foreign { .. }) => known.foreign.push(error.to_string()),
                Err(error) => return Err(error),
            }
        }
        Ok(known)
    }
}

/// Locks a catalogue for a change, because of two concurrent changes one could remove what the other writes. Makes its folder.
fn lock(catalogue: &Path) -> Result<FolderLock, CatalogueError> {
    fs::create_dir_all(catalogue).map_err(io(catalogue))?;
    let lock = FolderLock::try_in_folder(catalogue).map_err(io(catalogue))?;
    lock.ok_or_else(|| CatalogueError::Busy { path: catalogue.to_owned() })
}

/// Writes the file of a session and removes others that hold rows of it. Returns the file.
fn write(
    catalogue: &Path,
    session: CapturedSession,
    known: &mut Known,
    report: &mut Report,
) -> Result<PathBuf, CatalogueError> {
    let CapturedSession { head, file, rows, losses, warnings } = session;
    let path = catalogue.join(file);
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder).map_err(io(folder))?;
    }
    report.sessions += 1;
    report.rows += rows.len() as u64;
    report.valid += head.valid;
    report.losses.extend(losses);
    report.warnings.extend(warnings);
    let bytes = parquet_of_rows(&head, &rows)?;
    report.bytes += bytes.len() as u64;
    write_atomically(&path, &bytes)?;
    let is_old = |(file, old): &(PathBuf, FileHead)| old.session_id == head.session_id && *file != path;
    for (file, _) in known.heads.extract_if(.., |known| is_old(known)) {
        remove(file, report)?;
    }
    Ok(path)
}

fn remove(file: PathBuf, report: &mut Report) -> Result<(), CatalogueError> {
    fs::remove_file(&file).map_err(io(&file))?;
    report.removed.push(file);
    Ok(())
}
