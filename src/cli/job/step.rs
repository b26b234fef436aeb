//! The steps of a job: what one does with a session, and what its result depends on.

use std::path::Path;

use clap::ValueEnum;
use serde::Serialize;
use serde_json::{Value, json};

use super::super::input_files::{files_named_in, small_text};
use super::super::labels::{Format, label_capture};
use super::super::paths::temporary;
use crate::config::{Settings, plain_file};
use crate::database::{self, Added, Contents, TagLimits};
use crate::localization::smoothing::Model;
use crate::log_input::log::files_of;
use crate::recording::storage::Disk;
use crate::recording::{Loss, read_info, read_tags, recorded_hash, source_hash, verify};
use crate::ros2::messages::FrameTag;
use crate::tagging::offline_refinement::refine;
use crate::tagging::{ReplayOptions, ReplayReport, replay, write_tag_log};
use crate::views::Hall;

/// What is done with each session.
pub(super) enum Step {
    /// All tags are made anew, with other settings or with those of the session.
    Tag(Option<Box<TagSettings>>),
    Refine,
    Labels(Format),
    Depth,
    Check,
}

/// What a step has found in a session, beside the files that it has written.
pub(super) struct Findings {
    /// Numbers that do not depend on the machine.
    pub(super) summary: Value,
    pub(super) losses: Vec<Loss>,
}

/// Callback that gets the number of frames done so far.
pub(super) type Progress<'a> = &'a mut dyn FnMut(u64);

impl Step {
    /// Name on the command line, and of the folder of results.
    pub(super) fn name(&self) -> &'static str {
        match self {
            Self::Tag(_) => "tag",
            Self::Refine => "refine",
            Self::Labels(_) => "labels",
            Self::Depth => "depth",
            Self::Check => "check",
        }
    }

    /// What is done, for a bar of progress.
    pub(super) fn doing(&self) -> &'static str {
        match self {
            Self::Tag(_) => "tagging",
            Self::Refine => "refining",
            Self::Labels(_) => "labelling",
            Self::Depth => "finding the depth",
            Self::Check => "checking",
        }
    }

    /// The settings that the result for a session depends on.
    pub(super) fn config(&self, capture: &Path) -> anyhow::Result<Value> {
        Ok(match self {
            Self::Tag(settings) => tag_config(&tag_settings(settings.as_deref(), capture)?)?,
            Self::Labels(format) => {
                json!({"format": format.to_possible_value().map(|value| value.get_name().to_owned())})
            }
            Self::Depth => json!({"max_sigma_m": TagLimits::default().sigma_m}),
            Self::Refine | Self::Check => json!({}),
        })
    }

    /// Hash of what the step reads of a session.
    pub(super) fn inputs(&self, capture: &Path) -> anyhow::Result<String> {
        Ok(match self {
            Self::Tag(_) | Self::Refine => recorded_hash(capture)?,
            Self::Labels(_) | Self::Depth => source_hash(capture)?,
            // Damage is what a check looks for, and damage may leave names and sizes as they are.
            Self::Check => hash_of_bytes(capture)?,
        })
    }

    /// Does the step with a session. The result is written into `folder`.
    pub(super) fn run(&self, capture: &Path, folder: &Path, progress: Progress) -> anyhow::Result<Findings> {
        match self {
            Self::Tag(settings) => tag(tag_settings(settings.as_deref(), capture)?, capture, folder, progress),
            Self::Refine => refine_session(capture, folder, progress),
            Self::Labels(format) => label(capture, folder, *format, progress),
            Self::Depth => find_depth(capture, folder, progress),
            Self::Check => check(capture),
        }
    }
}

/// Settings of a config file, for sessions on any field.
pub(super) struct TagSettings {
    settings: Settings,
    /// Whether the file names a field; else each session keeps its own.
    names_field: bool,
}

impl TagSettings {
    pub(super) fn load(path: &Path) -> anyhow::Result<Self> {
        let settings = Settings::load(&path.display().to_string())?;
        let names_field = small_text(path).is_some_and(|text| Settings::names_field(&text));
        Ok(Self { settings, names_field })
    }
}

/// The settings to tag a session with.
fn tag_settings(given: Option<&TagSettings>, capture: &Path) -> anyhow::Result<Settings> {
    let recorded = read_info(capture)?.settings;
    Ok(match given {
        None => recorded,
        Some(TagSettings { settings, names_field: true }) => settings.clone(),
        Some(TagSettings { settings, names_field: false }) => {
            Settings { field: recorded.field, field_size_m: recorded.field_size_m, ..settings.clone() }
        }
    })
}

/// The settings, and hashes of the files that they name.
fn tag_config(settings: &Settings) -> anyhow::Result<Value> {
    let mut hashes = Vec::new();
    for file in files_named_in(settings) {
        let mut hash = blake3::Hasher::new();
        hash.update_reader(plain_file::open(&file).map_err(|error| super::super::paths::cannot_read(&file, error))?)?;
        hashes.push(hash.finalize().to_hex().to_string());
    }
    Ok(json!({"settings": settings, "files": hashes}))
}

/// Hash of a recording with all bytes of its segments.
fn hash_of_bytes(capture: &Path) -> anyhow::Result<String> {
    let mut hash = blake3::Hasher::new();
    hash.update(source_hash(capture)?.as_bytes());
    for segment in files_of(capture)? {
        hash.update_reader(plain_file::open(&segment)?)?;
    }
    Ok(hash.finalize().to_hex().to_string())
}

/// Log of the tags that a session gets.
const TAGS_FILE: &str = "tags.mcap";

fn tag(settings: Settings, capture: &Path, folder: &Path, progress: Progress) -> anyhow::Result<Findings> {
    let captures = temporary()?;
    let options = ReplayOptions {
        source: capture.to_owned(),
        captures: captures.path().to_owned(),
        settings,
        initial: None,
        // Sessions are done side by side.
        threads: 1,
        realtime: false,
        warm_start: false,
    };
    let report = replay(&options, &mut |done, _| progress(done))?;
    let mut tags = read_tags(&report.session)?.found;
    // A time that was measured is different each time.
    tags.iter_mut().for_each(|tag| tag.elapsed_ms = 0.0);
    write_tag_log(&folder.join(TAGS_FILE), &tags)?;
    let ReplayReport { frames, tagged, valid, invalid, .. } = &report;
    let summary = json!({"frames": frames, "tags": tagged, "valid": valid, "invalid": invalid});
    Ok(Findings { summary, losses: losses_of(&report, capture) })
}

/// What a replay could not read or use of a session.
fn losses_of(report: &ReplayReport, capture: &Path) -> Vec<Loss> {
    let mut losses = report.unread();
    let counted = [
        (report.untagged.values().sum(), "frames do not say when they were exposed and have no tag"),
        (report.bad_messages, "messages are not what their type says"),
        (report.late_measurements, "measurements came more than a second after later ones and were not used"),
    ];
    let counted = counted.into_iter().filter(|(count, _)| *count > 0).map(|(count, what)| format!("{count} {what}"));
    for what in counted.chain(report.first_bad_image.clone()) {
        Loss::new(capture, what).join(&mut losses);
    }
    losses
}

fn refine_session(capture: &Path, folder: &Path, progress: Progress) -> anyhow::Result<Findings> {
    let refining = refine(capture, &Model::default(), &mut |done, _| progress(done))?;
    refining.write(folder)?;
    let info = refining.info();
    #[derive(Serialize)]
    struct Summary {
        frames: usize,
        tags: usize,
        /// Whether `db add` takes the refined tags.
        preferred: bool,
        held_out_px: [f64; 2],
    }
    let (frames, tags) = (info.frames, refining.tags.len());
    let summary = Summary { frames, tags, preferred: info.is_better(), held_out_px: info.held_out_px };
    Ok(Findings { summary: serde_json::to_value(summary)?, losses: refining.losses })
}

fn label(capture: &Path, folder: &Path, format: Format, progress: Progress) -> anyhow::Result<Findings> {
    let report = label_capture(capture, folder, format, progress)?;
    let summary = json!({
        "images": report.images,
        "imprecise": report.imprecise,
        "visible_landmarks": report.visible_landmarks,
        "sigma_px": report.sigma_px,
        "ignored_share": report.ignored_share,
    });
    // Its files are named by the folder that becomes the result, which has another name while it is filled.
    let losses = report.lost.into_iter().map(|loss| match loss.file == folder {
        true => Loss { file: capture.to_owned(), ..loss },
        false => loss,
    });
    Ok(Findings { summary, losses: losses.collect() })
}

/// Folder of the database that a session gets.
const DATABASE_FOLDER: &str = "images";

/// Makes a database of a session alone: with the walls of its hall, by which views have depth, and with what moves in its images.
fn find_depth(capture: &Path, folder: &Path, progress: Progress) -> anyhow::Result<Findings> {
    let database = folder.join(DATABASE_FOLDER);
    let added = database::add(&database, &[capture.to_owned()], None, TagLimits::default(), progress)?;
    let halls: Vec<Hall> = Contents::read(&database)?.sources.into_iter().map(|source| source.hall).collect();
    let Added { images, left_out, ambiguous, imprecise, .. } = added;
    let summary =
        json!({"images": images, "left_out": left_out, "ambiguous": ambiguous, "imprecise": imprecise, "halls": halls});
    Ok(Findings { summary, losses: added.losses })
}

fn check(capture: &Path) -> anyhow::Result<Findings> {
    let verified = verify(&Disk, capture)?;
    let tags = read_tags(capture)?;
    let mut losses = verified.wrong;
    for loss in tags.losses {
        if losses.iter().all(|known| known.file != loss.file) {
            losses.push(loss);
        }
    }
    let count = |is: fn(&FrameTag) -> bool| tags.found.iter().filter(|tag| is(tag)).count();
    let mut invalid = std::collections::BTreeMap::<&str, u64>::new();
    tags.found.iter().filter(|tag| !tag.valid).for_each(|tag| *invalid.entry(&tag.reason).or_default() += 1);
    let summary = json!({
        "segments": verified.sound,
        "bytes": verified.bytes,
        "evicted": verified.evicted,
        "tags": tags.found.len(),
        "valid": count(|tag| tag.valid),
        "ambiguous": count(|tag| tag.ambiguous),
        "invalid": invalid,
    });
    Ok(Findings { summary, losses })
}
