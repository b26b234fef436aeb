//! What a reference is of. Only tags of the same are compared.

use std::io;
use std::path::Path;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::ReferenceError;
use realitysim_config::plain_file;
use realitysim_geometry::Pose2;
use realitysim_log_input::log::files_of;
use realitysim_log_input::scene_source::MAX_SCENE_BYTES;
use realitysim_recording::{SessionInfo, read_info};

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Identity {
    /// `realitysim` and its version.
    pub software: String,
    /// For people: the log's or scene's name.
    pub source: String,
    /// BLAKE3 of the log's files, or of the scene with its field and lens.
    pub blake3: String,
    pub seed: u64,
    /// In place of what the log announces: x, y in m, yaw in rad.
    pub initial: Option<[f64; 3]>,
}

impl Identity {
    /// Of a replay and the session that it has made.
    pub fn of(source: &Path, session: &Path, initial: Option<Pose2>) -> Result<Self, ReferenceError> {
        let info = read_info(session).map_err(|error| ReferenceError::Session(error.to_string()))?;
        let blake3 = hash(source, &info)
            .map_err(|error| ReferenceError::Read { file: source.display().to_string(), message: error.to_string() })?;
        Ok(Self {
            software: info.software.clone(),
            source: info.source.clone().unwrap_or_default(),
            blake3,
            seed: info.settings.filter.seed,
            initial: initial.map(|pose| [pose.x, pose.y, pose.yaw]),
        })
    }

    /// What makes it a reference of something else, if anything does.
    pub fn differs(&self, replayed: &Self) -> Option<String> {
        if self.software != replayed.software {
            return Some(format!("it was made by {}, this is {}", self.software, replayed.software));
        }
        if self.blake3 != replayed.blake3 {
            let of = |identity: &Self| format!("{} ({:.16})", identity.source, identity.blake3);
            return Some(format!("it is of another log or scene, {}; this is {}", of(self), of(replayed)));
        }
        if self.seed != replayed.seed {
            return Some(format!("it was made with seed {}, this is seed {}", self.seed, replayed.seed));
        }
        let started = |identity: &Self| {
            identity.initial.map_or("where the log says".to_owned(), |[x, y, yaw]| {
                format!("at {x},{y},{:.3} (--initial)", yaw.to_degrees())
            })
        };
        (self.initial != replayed.initial)
            .then(|| format!("it started {}, this started {}", started(self), started(replayed)))
    }
}

/// What the names of field and lens stand for. Not in references that were made before these were kept.
pub(super) const CONTENTS: [&str; 2] = ["field_content", "lens_content"];

/// Of the session. How and under which name it is stored changes no tag.
pub fn settings_that_matter(session: &Path) -> Result<Value, ReferenceError> {
    let told = |message: String| ReferenceError::Session(message);
    let info = read_info(session).map_err(|error| told(error.to_string()))?;
    let json = |value: serde_json::Result<Value>| value.map_err(|error| told(error.to_string()));
    let mut settings = json(serde_json::to_value(info.settings))?;
    let contents = [json(serde_json::to_value(info.field))?, json(serde_json::to_value(info.lens))?];
    if let Some(settings) = settings.as_object_mut() {
        // A name stays the same when what it stands for changes.
        settings.extend(CONTENTS.map(str::to_owned).into_iter().zip(contents));
        settings.remove("recording");
        settings.remove("robot");
    }
    Ok(settings)
}

fn hash(source: &Path, info: &SessionInfo) -> io::Result<String> {
    let mut hasher = blake3::Hasher::new();
    if source.extension().is_some_and(|ending| ending == "toml") {
        // What it says, not how: comments change nothing. And what its names stand for.
        let scene: toml::Table =
            toml::from_str(&plain_file::read_text(source, MAX_SCENE_BYTES)?).map_err(io::Error::other)?;
        hasher.update(&serde_json::to_vec(&(scene, &info.field, &info.lens))?);
    } else {
        for file in files_of(source).map_err(io::Error::other)? {
            hasher.update_reader(plain_file::open(&file)?)?;
        }
    }
    Ok(hasher.finalize().to_hex().to_string())
}
