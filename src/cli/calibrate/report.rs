//! What a walk found, in words and as JSON.

use serde::Serialize;

use super::image_report::{Constant, ImageReport, MIN_FRAMES};
use crate::tagging::walk_calibration::WalkCalibration;

/// The report of a calibration by a walk.
#[derive(Serialize)]
pub(super) struct Report {
    /// Frames that took part.
    frames: usize,
    /// Times that the walk was tagged and fitted.
    rounds: usize,
    height_m: f64,
    field_size_m: Option<[f64; 2]>,
    constants: Vec<Constant>,
    /// Names of what the walk does not determine.
    not_determined: Vec<&'static str>,
    #[serde(flatten)]
    image: ImageReport,
}

impl Report {
    pub(super) fn of(found: &WalkCalibration) -> Self {
        let not_determined = found.constants.iter().filter(|constant| !constant.determined);
        Self {
            frames: found.frames[0],
            rounds: found.rounds,
            height_m: found.height_m,
            field_size_m: found.field_size_m,
            constants: Constant::all(&found.constants),
            not_determined: not_determined.map(|constant| constant.name).collect(),
            image: ImageReport::of(&found.image, found.height_m, MIN_FRAMES),
        }
    }

    /// The report for people; it ends with a new line.
    pub(super) fn text(&self) -> String {
        let mut text = format!(
            "{} frames, tagged and fitted {} times; lines lie {:.2} px (rms) from where they are drawn\n{}",
            self.frames,
            self.rounds,
            self.image.rms_px,
            self.image.lens_text()
        );
        text.push_str("corrections of what the walk was tagged with last:\n");
        self.constants.iter().for_each(|constant| text.push_str(&constant.text("this walk")));
        text.push_str("  (tilt is of mount and IMU together)\n");
        text.push_str(&format!("height of the camera: {:.4} m\n", self.height_m));
        if let Some([length_m, width_m]) = self.field_size_m {
            text.push_str(&format!("field: {length_m:.3} x {width_m:.3} m\n"));
        }
        text + &self.image.text("the walk", "lines")
    }
}
