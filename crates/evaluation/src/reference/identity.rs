//! The identity of a replay. Only tags of the same identity are compared.

use std::io;
use std::path::Path;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::ReferenceError;
use realitysim_config::plain_file;
use realitysim_geometry::Pose2;
use realitysim_log_input::InputSource;
use realitysim_log_input::log::files_of;
use realitysim_log_input::scene_source::MAX_SCENE_BYTES;
use realitysim_recording::{SessionInfo, read_info};

/// Program version, input, seed and start of a replay.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Identity {
    /// `realitysim` and its version.
    pub software: String,
    /// Name of the log or scene, for people.
    pub source: String,
    /// BLAKE3 hash of the files of the log, or of the scene with its field and lens.
    pub blake3: String,
    /// Seed of the filter.
    pub seed: u64,
    /// Initial pose in place of the one that the log announces: x and y in metres, yaw in radians.
    pub initial: Option<[f64; 3]>,
}

impl Identity {
    /// Identifies a replay of `source` by the session that it made.
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

    /// Describes the first difference to another replay; `None` if there is none.
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

/// Keys of the settings that hold the contents of field and lens. Old references lack them.
pub(super) const CONTENTS: [&str; 2] = ["field_content", "lens_content"];

/// Returns the settings of a session that can change tags.
///
/// How and under which name the session is stored is left out.
pub fn settings_that_matter(session: &Path) -> Result<Value, ReferenceError> {
    let failed = |message: String| ReferenceError::Session(message);
    let info = read_info(session).map_err(|error| failed(error.to_string()))?;
    let json = |value: serde_json::Result<Value>| value.map_err(|error| failed(error.to_string()));
    let mut settings = json(serde_json::to_value(info.settings))?;
    let contents = [json(serde_json::to_value(info.field))?, json(serde_json::to_value(info.lens))?];
    if let Some(settings) = settings.as_object_mut() {
        // The name of a field or lens stays the same when its content changes.
        settings.extend(CONTENTS.map(str::to_owned).into_iter().zip(contents));
        settings.remove("recording");
        settings.remove("robot");
    }
    Ok(settings)
}

/// Hashes the files of a log, or the content of a scene with its field and lens.
fn hash(source: &Path, info: &SessionInfo) -> io::Result<String> {
    let mut hasher = blake3::Hasher::new();
    if InputSource::is_scene(source) {
        // The parsed content is hashed: comments and layout change nothing. Field and lens are hashed by content, too.
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
