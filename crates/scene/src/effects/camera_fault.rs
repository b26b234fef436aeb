//! A loose camera cable: frames are missing for a while, and the last one before the gap is incomplete.

use serde::Deserialize;

use super::{EffectKind, Role, Span};
use crate::Scene;
use crate::SceneError;
use crate::check::check_range;
use crate::stream::{Purpose, Stream};
use realitysim_geometry::Field;

/// A camera that is unplugged for a while.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraFault {
    /// Why the scene has this effect, for people.
    pub role: Option<Role>,
    /// Span of time without frames.
    pub unplugged: Span,
}

impl EffectKind for CameraFault {
    fn role(&self) -> Option<Role> {
        self.role
    }

    fn check(&self, key: &str, _: &Field) -> Result<(), SceneError> {
        let Span { from_s, for_s } = self.unplugged;
        check_range(format_args!("{key}.unplugged.from_s"), from_s, 0.0..=7200.0, "0 to 7200 s after the start")?;
        check_range(format_args!("{key}.unplugged.for_s"), for_s, 0.001..=7200.0, "0.001 to 7200 s")
    }

    fn add_to(&self, scene: &mut Scene, _: &str) -> Result<(), SceneError> {
        scene.camera_fault = Some(self.clone());
        Ok(())
    }

    fn begins(&self) -> Vec<(&'static str, f64)> {
        vec![("unplugged.from_s", self.unplugged.from_s)]
    }
}

impl CameraFault {
    /// Whether the camera is unplugged at `time`, seconds.
    pub(crate) fn is_unplugged(&self, time: f64) -> bool {
        self.unplugged.contains(time)
    }

    /// Share of a frame that arrives (0.2 to 0.9), if the cable came loose between it and the next frame.
    pub(crate) fn arriving_share(&self, time: f64, next_time: f64, seed: u64, frame: u64) -> Option<f64> {
        let is_torn = time < self.unplugged.from_s && self.unplugged.contains(next_time);
        is_torn.then(|| Stream::new(seed, Purpose::CameraFault, frame).between(0.2, 0.9))
    }
}
