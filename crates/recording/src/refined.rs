//! Refined tags of a capture: a folder beside what was recorded, with better poses and the lens that they belong to.

use std::io;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::error::RecordingError;
use super::manifest::REFINED_FOLDER;
use realitysim_config::plain_file;
use realitysim_geometry::LensParameters;

/// The file of a [`RefinedInfo`] in the folder of refined tags.
pub const REFINED_INFO: &str = "refined.json";
/// The log of refined tags in that folder.
pub const REFINED_TAGS: &str = "0000.mcap";

/// What stands beside refined tags: the lens that they belong to, and how it was found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RefinedInfo {
    pub lens: LensParameters,
    pub constants: Vec<RefinedConstant>,
    pub frames: usize,
    /// Root mean square of the lines' distances from where they are expected, pixels, before and after.
    pub rms_px: [f64; 2],
    /// The same of lines that took no part.
    #[serde(default)]
    pub held_out_px: [f64; 2],
}

/// Lines that took no part must fit better by this share for refined tags to be preferred: what is less may be chance.
const PREFERRED_IMPROVEMENT: f64 = 0.01;

impl RefinedInfo {
    /// Whether the refined tags are to be used in place of those that were recorded.
    pub fn is_better(&self) -> bool {
        let [before, after] = self.held_out_px;
        after < (1.0 - PREFERRED_IMPROVEMENT) * before
    }
}

/// A constant of lens, mount or camera that refining has estimated.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RefinedConstant {
    pub name: String,
    pub unit: String,
    /// To be added to what was believed.
    pub value: f64,
    /// Standard deviations before the walk and after it.
    pub believed: f64,
    pub known: f64,
    /// The walk says more about it than was believed before.
    pub observable: bool,
}

/// A lens and a dozen constants take some KiB.
const MAX_INFO_BYTES: u64 = 4 << 20;

/// The lens that a capture's refined tags belong to, if it has any.
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
