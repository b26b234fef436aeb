//! A camera whose cable comes loose: frames are missing for a while, and the last one before is torn.

use serde::Deserialize;

use super::{Role, Span};
use crate::SceneError;
use crate::check::within;
use crate::stream::{Purpose, Stream};

#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraFault {
    pub role: Option<Role>,
    /// Meanwhile there is no frame.
    pub unplugged: Span,
}

impl CameraFault {
    pub(super) fn check(&self, key: &str) -> Result<(), SceneError> {
        let Span { from_s, for_s } = self.unplugged;
        within(format_args!("{key}.unplugged.from_s"), from_s, 0.0..=7200.0, "0 to 7200 s after the start")?;
        within(format_args!("{key}.unplugged.for_s"), for_s, 0.001..=7200.0, "0.001 to 7200 s")
    }

    pub(crate) fn is_unplugged(&self, time: f64) -> bool {
        self.unplugged.holds(time)
    }

    /// How much of a frame arrives, if not all of it: it was under way when the cable came loose.
    pub(crate) fn arrives(&self, time: f64, next_time: f64, seed: u64, frame: u64) -> Option<f64> {
        let is_torn = time < self.unplugged.from_s && self.unplugged.holds(next_time);
        is_torn.then(|| Stream::new(seed, Purpose::CameraFault, frame).between(0.2, 0.9))
    }
}
