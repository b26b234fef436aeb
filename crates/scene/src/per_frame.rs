//! Effects whose values may differ from frame to frame (`per = "frame"`).

use std::borrow::Cow;

use super::Scene;
use super::effects::{BrightWindow, HeadMotion, ImuError, LightModel, NoiseModel, OdometryError, SerialNoise, Shutter};
use super::file::SceneFile;
use super::ranges::Per;

/// The effects whose values may differ from frame to frame, with their values in one frame. Absent effects are `None`.
#[derive(Clone, Debug, Default)]
pub(super) struct Changing {
    pub(super) head: Option<HeadMotion>,
    pub(super) light: Option<LightModel>,
    pub(super) window: Option<BrightWindow>,
    pub(super) shutter: Option<Shutter>,
    pub(super) noise: Option<NoiseModel>,
    pub(super) odometry_error: Option<OdometryError>,
    pub(super) imu_error: Option<ImuError>,
    pub(super) serial_noise: Option<SerialNoise>,
}

impl Scene {
    /// The effects with the values that are drawn for this frame. If no value is drawn per frame, nothing is copied.
    pub(super) fn at_frame(&self, frame: u64) -> Cow<'_, Changing> {
        let Some(template) = self.file.template.as_ref().filter(|template| template.has_ranges_per(Per::Frame)) else {
            return Cow::Borrowed(&self.changing);
        };
        // Both ends of each range were read when the scene was built, so every value between them can be read, too.
        let effects = SceneFile::effects_with(template, |range| template.value(range, frame)).unwrap_or_default();
        let mut now = self.changing.clone();
        // A scene that was reduced to its first effects still has the text of all.
        effects.iter().take(self.file.effects.len()).for_each(|effect| effect.set_in(&mut now, self.file.scene.seed));
        Cow::Owned(now)
    }
}
