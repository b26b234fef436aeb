//! The pictures of an import with their stamps, from a folder or a video.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

use super::super::paths::cannot_read;
use super::super::settings::UsageError;
use super::video::{FrameReader, is_video};
use super::{ImportArguments, Reader, Span};
use crate::config::plain_file;
use crate::log_input::decode::{self, MAX_IMAGE_FILE_BYTES};
use crate::log_input::tables::pictures::{self, StampedPicture, at_rate};
use crate::log_input::tables::stamp::seconds;
use crate::recording::Loss;

/// Endings of the files that are taken.
const TAKEN: [&str; 3] = ["jpg", "jpeg", "png"];
/// Endings of pictures that are not read.
const OTHER_PICTURES: [&str; 7] = ["bmp", "tif", "tiff", "webp", "gif", "ppm", "pgm"];
/// Most pictures of a folder: more than nine hours at 30 Hz.
const MAX_PICTURES: usize = 1_000_000;
/// Most names that a message lists.
const MAX_NAMES_SHOWN: usize = 3;
/// Time of the first picture where nothing else states one, nanoseconds: a stamp of zero would mean that there is none.
const FIRST_NS: i64 = 1_000_000_000;

/// A picture with the bytes of its file.
pub(super) struct Picture {
    pub(super) name: String,
    pub(super) stamp_ns: i64,
    pub(super) data: Vec<u8>,
    /// Width and height, pixels.
    pub(super) size: [usize; 2],
}

/// Where pictures come from, in the order of time.
pub(super) enum Source {
    Folder { folder: PathBuf, pictures: Vec<StampedPicture>, next: usize, lost: Vec<Loss>, assumed: Vec<String> },
    Video { file: PathBuf, frames: FrameReader, stamps: FrameStamps, next: usize, assumed: Vec<String> },
}

/// When the frames of a video were taken.
pub(super) enum FrameStamps {
    Table { file: PathBuf, stamps_ns: Vec<i64> },
    Rate { first_ns: i64, rate_hz: f64 },
}

impl Source {
    pub(super) fn of_folder(arguments: &ImportArguments, reader: &mut Reader, spans: &[Span]) -> anyhow::Result<Self> {
        let folder = arguments.source.clone();
        let names = names_in(&folder)?;
        let (mut lost, mut assumed) = (Vec::new(), Vec::new());
        let pictures = if let Some(table) = &arguments.stamps {
            let rows = reader.read(Some(table), pictures::read)?.unwrap_or_default();
            matched(&folder, table, rows, &names, &mut lost)?
        } else if let Some(rate_hz) = arguments.rate {
            let (first_ns, what) = first_at_rate(spans);
            assumed.push(what);
            pictures::by_rate(&names, first_ns, rate_hz)
        } else {
            let measured = pictures::by_names(&names).map_err(|what| {
                let folder = folder.display();
                UsageError(format!(
                    "{folder}: {what}: say when the pictures were taken with --stamps CSV (image,stamp) or --rate HZ"
                ))
            })?;
            reader.tell_unit("names of the pictures", measured.stamps);
            measured.rows
        };
        Ok(Self::Folder { folder, pictures, next: 0, lost, assumed })
    }

    pub(super) fn of_video(arguments: &ImportArguments, reader: &mut Reader, spans: &[Span]) -> anyhow::Result<Self> {
        let file = arguments.source.clone();
        let start = plain_file::open(&file).map_err(|error| cannot_read(&file, error))?;
        if !is_video(start) {
            let what = "is neither a folder of pictures nor a video (MP4, MOV, AVI, Matroska)";
            return Err(UsageError(format!("{}: {what}", file.display())).into());
        }
        let mut assumed = Vec::new();
        let stamps = match (&arguments.stamps, arguments.rate) {
            (Some(table), _) => {
                let stamps_ns = reader.read(Some(table), pictures::read_frames)?.unwrap_or_default();
                FrameStamps::Table { file: table.clone(), stamps_ns }
            }
            (None, Some(rate_hz)) => {
                let (first_ns, what) = first_at_rate(spans);
                assumed.push(what);
                FrameStamps::Rate { first_ns, rate_hz }
            }
            (None, None) => {
                let what =
                    "say when its frames were taken with --stamps CSV (stamp, a row for each frame) or --rate HZ";
                return Err(UsageError(format!("{}: {what}", file.display())).into());
            }
        };
        let frames = FrameReader::start(&file)?;
        Ok(Self::Video { file, frames, stamps, next: 0, assumed })
    }

    /// Number of pictures, if it is known.
    pub(super) fn count(&self) -> Option<u64> {
        match self {
            Self::Folder { pictures, .. } => Some(pictures.len() as u64),
            Self::Video { stamps: FrameStamps::Table { stamps_ns, .. }, .. } => Some(stamps_ns.len() as u64),
            Self::Video { .. } => None,
        }
    }

    /// The stamps that are known before the pictures are read; of a video with a rate the first.
    pub(super) fn stamps_ns(&self) -> Box<dyn Iterator<Item = i64> + '_> {
        match self {
            Self::Folder { pictures, .. } => Box::new(pictures.iter().map(|picture| picture.stamp_ns)),
            Self::Video { stamps: FrameStamps::Table { stamps_ns, .. }, .. } => Box::new(stamps_ns.iter().copied()),
            Self::Video { stamps: FrameStamps::Rate { first_ns, .. }, .. } => Box::new([*first_ns].into_iter()),
        }
    }

    pub(super) fn span_ns(&self) -> Option<[i64; 2]> {
        Some([self.stamps_ns().min()?, self.stamps_ns().max()?])
    }

    pub(super) fn assumed(&self) -> Vec<String> {
        match self {
            Self::Folder { assumed, .. } | Self::Video { assumed, .. } => assumed.clone(),
        }
    }

    /// The next picture that can be read; what cannot is a loss.
    pub(super) fn next(&mut self, losses: &mut Vec<Loss>) -> anyhow::Result<Option<Picture>> {
        match self {
            Self::Folder { folder, pictures, next, lost, .. } => {
                losses.append(lost);
                while let Some(StampedPicture { name, stamp_ns }) = pictures.get(*next) {
                    *next += 1;
                    let path = folder.join(name);
                    match read_picture(&path) {
                        Ok((data, size)) => {
                            return Ok(Some(Picture { name: name.clone(), stamp_ns: *stamp_ns, data, size }));
                        }
                        Err(what) => losses.push(Loss::new(&path, format!("left out: {what}"))),
                    }
                }
                Ok(None)
            }
            Self::Video { file, frames, stamps, next, .. } => {
                let index = *next;
                *next += 1;
                let complain = &mut |what| losses.push(Loss::new(file, what));
                let Some(data) = frames.next_frame(complain)? else {
                    if let FrameStamps::Table { file: table, stamps_ns } = stamps
                        && index != stamps_ns.len()
                    {
                        let (table, rows, video) = (table.display(), stamps_ns.len(), file.display());
                        anyhow::bail!("{table} has {rows} rows, and {video} {index} frames: each frame needs a row");
                    }
                    return Ok(None);
                };
                let stamp_ns = match stamps {
                    FrameStamps::Rate { first_ns, rate_hz } => at_rate(index, *first_ns, *rate_hz),
                    FrameStamps::Table { file: table, stamps_ns } => *stamps_ns.get(index).ok_or_else(|| {
                        let (table, rows, video) = (table.display(), stamps_ns.len(), file.display());
                        anyhow::anyhow!("{table} has {rows} rows, and {video} more frames: each frame needs a row")
                    })?,
                };
                let size = decode::dimensions(&data)?;
                Ok(Some(Picture { name: format!("frame {index}"), stamp_ns, data, size }))
            }
        }
    }
}

/// The time of the first picture at a rate, and what to say about it.
fn first_at_rate(spans: &[Span]) -> (i64, String) {
    match spans.iter().min_by_key(|span| span.span_ns[0]) {
        Some(Span { file, span_ns: [first_ns, _] }) => {
            let what = format!("the first picture is taken to be of the first stamp of {}", file.display());
            (*first_ns, format!("{what} ({} s); --stamps says another", seconds(*first_ns)))
        }
        None => (FIRST_NS, "no table has stamps: the first picture is taken to be of 1 s after 1970".to_owned()),
    }
}

fn read_picture(path: &Path) -> Result<(Vec<u8>, [usize; 2]), String> {
    let data = plain_file::read(path, MAX_IMAGE_FILE_BYTES).map_err(|error| error.to_string())?;
    let size = decode::dimensions(&data).map_err(|error| error.to_string())?;
    Ok((data, size))
}

/// Names of the JPEG and PNG files of a folder, in natural order.
pub(in crate::cli) fn names_in(folder: &Path) -> anyhow::Result<Vec<String>> {
    let (mut names, mut others) = (Vec::new(), Vec::new());
    for entry in std::fs::read_dir(folder).map_err(|error| cannot_read(folder, error))? {
        let name = entry.map_err(|error| cannot_read(folder, error))?.file_name();
        let Some(name) = name.to_str() else {
            let what = "is no UTF-8 name: rename it";
            return Err(UsageError(format!("{}: {what}", folder.join(&name).display())).into());
        };
        let ending = Path::new(name).extension().and_then(|ending| ending.to_str()).unwrap_or_default().to_lowercase();
        match name.starts_with('.') {
            // Copies from macOS bring hidden files that have the endings of pictures.
            true => {}
            false if TAKEN.contains(&ending.as_str()) => names.push(name.to_owned()),
            false if OTHER_PICTURES.contains(&ending.as_str()) => others.push(name.to_owned()),
            false => {}
        }
        if names.len() > MAX_PICTURES {
            return Err(UsageError(format!("{}: more than {MAX_PICTURES} pictures", folder.display())).into());
        }
    }
    let shown = folder.display();
    match (names.is_empty(), others.is_empty()) {
        (true, true) => Err(UsageError(format!("{shown}: it holds no JPEG or PNG file (.jpg, .jpeg, .png)")).into()),
        (_, false) => {
            others.sort();
            let what = "is neither JPEG nor PNG: convert it, or move it elsewhere";
            Err(UsageError(format!("{shown}: {} {what}", shortened(&others))).into())
        }
        (false, true) => {
            names.sort_by(|a, b| pictures::natural_order(a, b));
            Ok(names)
        }
    }
}

/// Matches the rows of a table of stamps with the files that there are.
fn matched(
    folder: &Path,
    table: &Path,
    rows: Vec<StampedPicture>,
    names: &[String],
    lost: &mut Vec<Loss>,
) -> anyhow::Result<Vec<StampedPicture>> {
    // A table may name files by a path, with the folder.
    let known: HashMap<&str, &String> = names.iter().map(|name| (name.as_str(), name)).collect();
    let find = |name: &str| known.get(name.rsplit(['/', '\\']).next().unwrap_or(name)).copied();
    let (mut found, mut missing, mut seen) = (Vec::new(), Vec::new(), HashSet::new());
    for StampedPicture { name, stamp_ns } in rows {
        match find(&name) {
            Some(file) if seen.insert(file.clone()) => found.push(StampedPicture { name: file.clone(), stamp_ns }),
            Some(file) => anyhow::bail!("{}: two rows name the picture {file}", table.display()),
            None => missing.push(name),
        }
    }
    if found.is_empty() {
        let (table, folder, first) = (table.display(), folder.display(), names.first().map_or("", String::as_str));
        anyhow::bail!("{table}: no row names a picture of {folder}, where the first is {first}");
    }
    if !missing.is_empty() {
        Loss::new(table, format!("{} rows have no picture: {}", missing.len(), shortened(&missing))).join(lost);
    }
    let without: Vec<String> = names.iter().filter(|name| !seen.contains(*name)).cloned().collect();
    if !without.is_empty() {
        let what = format!("{} pictures have no stamp and are left out: {}", without.len(), shortened(&without));
        Loss::new(table, what).join(lost);
    }
    Ok(found)
}

fn shortened(names: &[String]) -> String {
    let more = names.len().saturating_sub(MAX_NAMES_SHOWN);
    let shown = names[..names.len() - more].join(", ");
    if more == 0 { shown } else { format!("{shown} and {more} more") }
}
