//! The frames of a capture, each with its tag.

use std::collections::{HashMap, VecDeque};
use std::fs;
use std::path::Path;

use anyhow::bail;

use super::super::host_info::cores;
use super::super::output;
use super::super::paths::{cannot_write, make_folder};
use super::super::settings::UsageError;
use crate::log_input::decode;
use crate::log_input::log::{self, LogSource};
use crate::recording::{Loss, losses, read_info};
use crate::ros2::mcap_read::{LogMessage, Selection};
use crate::ros2::messages::FrameTag;
use crate::ros2::topics;
use crate::tagging::in_parallel;

/// Uses a frame and its tag. Returns why the frame cannot be used, if it cannot.
pub(in super::super) type TakeFrame<'a> =
    &'a mut dyn FnMut(&FrameTag, &LogMessage) -> anyhow::Result<Result<(), String>>;

/// Goes through the tagged frames of a capture in their order, with a progress bar. Returns how many `take` took, and what was lost.
///
/// Frames that `take` cannot use are counted as lost. That none could be used is an error.
pub(in super::super) fn each_frame(
    capture: &Path,
    tags: &[FrameTag],
    take: TakeFrame<'_>,
) -> anyhow::Result<(usize, Vec<Loss>)> {
    let mut frames = TaggedFrames::of(capture, tags)?;
    let mut counted = Counted::default();
    while let Some((tag, message)) = frames.next().transpose()? {
        counted.add(tag, take(tag, &message)?);
        frames.show(&counted);
    }
    frames.end(counted)
}

/// Does the same as [`each_frame`] in two steps: `draw` makes something of a frame, on all cores, and `take` gets it in the order of the
/// frames.
pub(super) fn each_drawn_frame<T: Send>(
    capture: &Path,
    tags: &[FrameTag],
    draw: impl Fn(&FrameTag, &LogMessage) -> anyhow::Result<T> + Sync,
    mut take: impl FnMut(&FrameTag, T) -> anyhow::Result<()>,
) -> anyhow::Result<(usize, Vec<Loss>)> {
    let mut frames = TaggedFrames::of(capture, tags)?;
    let mut counted = Counted::default();
    let threads = cores();
    loop {
        let some = frames.by_ref().take(FRAMES_PER_THREAD * threads).collect::<anyhow::Result<Vec<_>>>()?;
        if some.is_empty() {
            return frames.end(counted);
        }
        let drawn = in_parallel(threads, some.len(), |index| draw(some[index].0, &some[index].1));
        for ((tag, _), drawn) in some.iter().zip(drawn) {
            let taken = match drawn {
                Ok(drawn) => Ok(take(tag, drawn)?),
                Err(error) => Err(error.to_string()),
            };
            counted.add(tag, taken);
            frames.show(&counted);
        }
    }
}

/// Frames that a thread draws before all of them are taken.
const FRAMES_PER_THREAD: usize = 4;

/// How many frames were used.
#[derive(Default)]
struct Counted {
    taken: usize,
    unreadable: usize,
    /// Why the first frame could not be used.
    first_error: Option<String>,
}

impl Counted {
    fn add(&mut self, tag: &FrameTag, taken: Result<(), String>) {
        match taken {
            Ok(()) => self.taken += 1,
            Err(why) => {
                self.unreadable += 1;
                self.first_error.get_or_insert_with(|| format!("frame {}: {why}", tag.sequence));
            }
        }
    }
}

/// The frames of a capture that have a tag, in their order.
struct TaggedFrames<'a> {
    capture: &'a Path,
    count: usize,
    image_topic: String,
    /// Tags whose frame has not come yet.
    waiting: HashMap<i64, VecDeque<&'a FrameTag>>,
    source: LogSource,
    progress: output::Progress,
}

impl<'a> TaggedFrames<'a> {
    fn of(capture: &'a Path, tags: &'a [FrameTag]) -> anyhow::Result<Self> {
        let image_topic = image_topic(capture)?;
        // The tags are read again with the images, so that damage to them is counted, too.
        let selection = Selection::topics([image_topic.as_str(), topics::FRAME_TAG]);
        let source = LogSource::with_outputs(log::files_of(capture)?, selection);
        let progress = output::Progress::new("exporting");
        Ok(Self { capture, count: tags.len(), image_topic, waiting: by_stamp(tags), source, progress })
    }

    /// The tag of an image; `None` for another message, and for an image without a tag.
    fn tag(&mut self, message: &LogMessage) -> Option<&'a FrameTag> {
        if message.channel.topic != self.image_topic {
            return None;
        }
        // If the stamp cannot be read, replay could not read it either, so that this frame has no tag.
        self.waiting.get_mut(&decode::stamp_ns(message).ok()?)?.pop_front()
    }

    fn show(&mut self, counted: &Counted) {
        self.progress.set((counted.taken + counted.unreadable) as u64, Some(self.count as u64));
    }

    /// Ends the progress bar. Returns the number of frames that were used, and what was lost.
    fn end(self, Counted { taken, unreadable, first_error }: Counted) -> anyhow::Result<(usize, Vec<Loss>)> {
        let Self { capture, count, image_topic, source, progress, .. } = self;
        progress.finish();
        let mut lost = losses(capture, source.damage());
        let mut lose = |what: String| Loss::new(capture, what).join(&mut lost);
        if let Some(error) = first_error {
            lose(format!("{unreadable} frames on {image_topic} do not decode ({error})"));
        }
        let without = count - taken - unreadable;
        if without > 0 {
            lose(format!("{without} of {count} tags have no image on {image_topic}"));
        }
        if taken == 0 {
            let all: Vec<String> = lost.iter().map(ToString::to_string).collect();
            bail!("nothing was written: {}", all.join("; "));
        }
        Ok((taken, lost))
    }
}

impl<'a> Iterator for TaggedFrames<'a> {
    type Item = anyhow::Result<(&'a FrameTag, LogMessage)>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            let message = match self.source.next()? {
                Ok(message) => message,
                Err(error) => return Some(Err(error.into())),
            };
            if let Some(tag) = self.tag(&message) {
                return Some(Ok((tag, message)));
            }
        }
    }
}

/// Tags by their stamp, because a frame or a tag may be lost; those of the same stamp in their order.
fn by_stamp(tags: &[FrameTag]) -> HashMap<i64, VecDeque<&FrameTag>> {
    let mut waiting: HashMap<i64, VecDeque<&FrameTag>> = HashMap::new();
    for tag in tags {
        waiting.entry(tag.header.stamp.to_nanoseconds()).or_default().push_back(tag);
    }
    waiting
}

/// Makes the folder of an export, which must be empty: files of another export would mix with those of this one.
pub(in super::super) fn own_folder(folder: &Path) -> anyhow::Result<()> {
    make_folder(folder)?;
    if fs::read_dir(folder).map_err(|error| cannot_write(folder, error))?.next().is_some() {
        let what = "is not empty, and an export needs a folder of its own: name another, or remove what is in it first";
        return Err(UsageError(format!("{}: {what}", folder.display())).into());
    }
    Ok(())
}

/// Fills a folder of its own by `fill`. What a failure leaves is removed, so that nobody takes it for a whole one.
pub(in super::super) fn fill_own_folder<T>(
    folder: &Path,
    fill: impl FnOnce() -> anyhow::Result<T>,
) -> anyhow::Result<T> {
    own_folder(folder)?;
    let filled = fill();
    if filled.is_err() {
        clear_folder(folder);
    }
    filled
}

fn clear_folder(folder: &Path) {
    for entry in fs::read_dir(folder).into_iter().flatten().filter_map(Result::ok) {
        let path = entry.path();
        let _ = if path.is_dir() { fs::remove_dir_all(&path) } else { fs::remove_file(&path) };
    }
}

/// Returns the topic that the session's settings name; without it, the only topic of images.
pub(super) fn image_topic(capture: &Path) -> anyhow::Result<String> {
    let folder = if capture.is_dir() { Some(capture) } else { capture.parent() };
    let configured = folder.and_then(|folder| read_info(folder).ok());
    let wanted = configured.map(|info| info.settings.topics.image).unwrap_or_default();
    let types = log::topic_types(&log::surveys(&log::files_of(capture)?)?);
    if types.contains_key(&wanted) {
        return Ok(wanted);
    }
    let images: Vec<&String> = types
        .iter()
        .filter(|(_, kinds)| kinds.iter().any(|kind| kind.ends_with("Image")))
        .map(|(topic, _)| topic)
        .collect();
    match images[..] {
        [topic] => Ok(topic.clone()),
        _ => bail!("{}: no single topic of images; there are: {images:?}", capture.display()),
    }
}
