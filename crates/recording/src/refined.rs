//! Refined tags of a capture: a folder beside the recording, with better poses and the lens that they belong to.

use std::io;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::error::RecordingError;
use super::manifest::REFINED_FOLDER;
use realitysim_config::plain_file;
use realitysim_geometry::LensParameters;

/// File with a [`RefinedInfo`] in the folder of refined tags.
pub const REFINED_INFO: &str = "refined.json";
/// Log with the refined tags in that folder.
pub const REFINED_TAGS: &str = "0000.mcap";

/// The lens that refined tags belong to, and how it was found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RefinedInfo {
    /// Parameters of the lens after refinement.
    pub lens: LensParameters,
    /// Constants that were estimated.
    pub constants: Vec<RefinedConstant>,
    /// Number of frames that took part.
    pub frames: usize,
    /// Root mean square of the lines' distances from where they are expected, before and after, pixels.
    pub rms_px: [f64; 2],
    /// The same of lines that took no part in the estimation, before and after, pixels.
    #[serde(default)]
    pub held_out_px: [f64; 2],
}

/// Share by which lines that took no part must fit better for refined tags to be preferred: less may be chance.
const PREFERRED_IMPROVEMENT: f64 = 0.01;

impl RefinedInfo {
    /// Whether the refined tags are to be used in place of the recorded ones.
    pub fn is_better(&self) -> bool {
        let [before, after] = self.held_out_px;
        after < (1.0 - PREFERRED_IMPROVEMENT) * before
    }
}

/// A constant of lens, mount or camera that refinement has estimated.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RefinedConstant {
    /// Name of the constant.
    pub name: String,
    /// Unit of `value`, `believed` and `known`.
    pub unit: String,
    /// Estimated correction, to be added to the value that was recorded with.
    pub value: f64,
    /// Standard deviation before the walk.
    pub believed: f64,
    /// Standard deviation after the walk.
    pub known: f64,
    /// Whether the walk says more about the constant than was believed before.
    pub observable: bool,
}

/// Largest `refined.json`, bytes: a lens and a dozen constants take some KiB.
const MAX_INFO_BYTES: u64 = 4 << 20;

/// Reads what belongs to a capture's refined tags; `None` if it has none.
pub fn refined_info(capture: &Path) -> Result<Option<RefinedInfo>, RecordingError> {
    let folder = capture.join(REFINED_FOLDER);
    if !folder.join(REFINED_TAGS).is_file() {
        return Ok(None);
    }
    let path = folder.join(REFINED_INFO);
    let failed = |source| RecordingError::io(&path, source);
    let text = plain_file::read(&path, MAX_INFO_BYTES).map_err(failed)?;
    serde_json::from_slice(&text).map(Some).map_err(|error| failed(io::Error::from(error)))
}
