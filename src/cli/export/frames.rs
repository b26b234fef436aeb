//! The frames of a capture, each with its tag.

use std::collections::{HashMap, VecDeque};
use std::fs;
use std::path::Path;

use anyhow::bail;

use super::super::output;
use super::super::paths::{cannot_write, make_folder};
use super::super::settings::UsageError;
use crate::log_input::decode;
use crate::log_input::log::{self, LogSource};
use crate::recording::{Loss, losses, read_info};
use crate::ros2::mcap_read::{LogMessage, Selection};
use crate::ros2::messages::FrameTag;
use crate::ros2::topics;

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
    let image_topic = image_topic(capture)?;
    let mut waiting = by_stamp(tags);
    // The tags are read again with the images, so that damage to them is counted, too.
    let selection = Selection::topics([image_topic.as_str(), topics::FRAME_TAG]);
    let mut source = LogSource::with_outputs(log::files_of(capture)?, selection);
    let mut progress = output::Progress::new("exporting");
    let (mut taken, mut unreadable, mut first_error) = (0, 0, None);
    for message in source.by_ref() {
        let message = message?;
        if message.channel.topic != image_topic {
            continue;
        }
        let tag = match decode::stamp_ns(&message) {
            Ok(stamp_ns) => waiting.get_mut(&stamp_ns).and_then(VecDeque::pop_front),
            // Replay could not read the stamp either, so this frame has no tag.
            Err(_) => None,
        };
        let Some(tag) = tag else { continue };
        match take(tag, &message)? {
            Ok(()) => taken += 1,
            Err(why) => {
                unreadable += 1;
                first_error.get_or_insert_with(|| format!("frame {}: {why}", tag.sequence));
            }
        }
        progress.set((taken + unreadable) as u64, Some(tags.len() as u64));
    }
    progress.finish();
    let mut lost = losses(capture, source.damage());
    let mut lose = |what: String| Loss::new(capture, what).join(&mut lost);
    if let Some(error) = first_error {
        lose(format!("{unreadable} frames on {image_topic} do not decode ({error})"));
    }
    let without = tags.len() - taken - unreadable;
    if without > 0 {
        lose(format!("{without} of {} tags have no image on {image_topic}", tags.len()));
    }
    if taken == 0 {
        let all: Vec<String> = lost.iter().map(ToString::to_string).collect();
        bail!("nothing was written: {}", all.join("; "));
    }
    Ok((taken, lost))
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
