//! Pictures for a calibration: of a folder, a video or a log, one after the other.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};

use crate::cli::import::video::{FrameReader, is_video};
use crate::cli::paths::cannot_read;
use crate::config::{Topics, plain_file};
use crate::log_input::log::{LogSource, files_of, surveys, topic_types};
use crate::log_input::{decode, topic_resolution};
use crate::recording::{Loss, losses};
use crate::ros2::mcap_read::Selection;
use crate::vision::Picture;

/// Where pictures come from.
pub(super) struct BoardImages {
    source: Source,
    count: Option<u64>,
    taken: u64,
}

enum Source {
    Folder(std::vec::IntoIter<PathBuf>),
    Video(Box<FrameReader>, PathBuf),
    Log(Box<LogSource>, PathBuf),
}

/// Most pictures of a folder.
const MAX_FILES: usize = 100_000;

impl BoardImages {
    /// Opens a folder of pictures, a video or a log. `topic` is the image topic of the settings.
    pub(super) fn open(path: &Path, topic: &str) -> anyhow::Result<Self> {
        let files = if path.is_dir() { pictures_of(path)? } else { Vec::new() };
        if !files.is_empty() {
            let count = Some(files.len() as u64);
            return Ok(Self { source: Source::Folder(files.into_iter()), count, taken: 0 });
        }
        if path.is_file() && is_video(plain_file::open(path).map_err(|error| cannot_read(path, error))?) {
            let reader = Box::new(FrameReader::start(path)?);
            return Ok(Self { source: Source::Video(reader, path.to_owned()), count: None, taken: 0 });
        }
        Self::open_log(path, topic)
    }

    fn open_log(path: &Path, topic: &str) -> anyhow::Result<Self> {
        let files = files_of(path).with_context(|| "neither pictures (PNG, JPEG), nor a video, nor a log")?;
        let surveys = surveys(&files)?;
        let images = topic_resolution::images(&topic_types(&surveys));
        let chosen = match (images.iter().find(|image| *image == topic), &images[..]) {
            (Some(image), _) => image.clone(),
            (None, [only]) if topic == Topics::default().image => only.clone(),
            _ => bail!(
                "{}: it has {} image topics ({}): name the camera's, as in --set topics.image=/camera/image",
                path.display(),
                images.len(),
                images.join(", ")
            ),
        };
        let topics = surveys.iter().flat_map(|survey| &survey.topics).filter(|topic| topic.topic == chosen);
        let count = Some(topics.map(|topic| topic.messages).sum());
        let source = LogSource::new(files, Selection::topics([chosen]));
        Ok(Self { source: Source::Log(Box::new(source), path.to_owned()), count, taken: 0 })
    }

    /// Number of all pictures if it is known.
    pub(super) fn count(&self) -> Option<u64> {
        self.count
    }

    /// What of a log could not be read so far.
    pub(super) fn losses(&self) -> Vec<Loss> {
        match &self.source {
            Source::Log(messages, path) => losses(path, messages.damage()),
            Source::Folder(_) | Source::Video(..) => Vec::new(),
        }
    }

    /// The next picture with its name; `None` after the last.
    pub(super) fn next(&mut self) -> anyhow::Result<Option<(String, Picture)>> {
        self.taken += 1;
        let number = self.taken;
        let named = |path: &Path| format!("{}, picture {number}", path.display());
        match &mut self.source {
            Source::Folder(files) => {
                let Some(file) = files.next() else { return Ok(None) };
                let bytes = plain_file::read(&file, decode::MAX_IMAGE_FILE_BYTES);
                let bytes = bytes.map_err(|error| cannot_read(&file, error))?;
                let name = file.display().to_string();
                let picture = decode::compressed(&bytes).with_context(|| name.clone())?;
                Ok(Some((name, picture)))
            }
            Source::Video(reader, path) => {
                let frame = reader.next_frame(&mut |complaint| eprintln!("realitysim: warning: {complaint}"))?;
                let Some(frame) = frame else { return Ok(None) };
                let picture = decode::compressed(&frame).with_context(|| named(path))?;
                Ok(Some((named(path), picture)))
            }
            Source::Log(messages, path) => {
                let Some(message) = messages.next().transpose()? else { return Ok(None) };
                let picture = decode::picture(&message).with_context(|| named(path))?;
                Ok(Some((named(path), picture)))
            }
        }
    }
}

/// The PNG and JPEG files of a folder, by name.
fn pictures_of(folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let is_picture = |path: &PathBuf| {
        let ending = path.extension().map(|ending| ending.to_string_lossy().to_lowercase());
        ending.is_some_and(|ending| ["png", "jpg", "jpeg"].contains(&ending.as_str()))
    };
    let entries = std::fs::read_dir(folder).map_err(|error| cannot_read(folder, error))?;
    let mut files: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).filter(is_picture).collect();
    if files.len() > MAX_FILES {
        bail!("{}: it has more than {MAX_FILES} pictures", folder.display());
    }
    files.sort();
    Ok(files)
}
