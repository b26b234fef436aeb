//! Maps over the image, as SVG pictures: a value in each cell.

use crate::evaluation::drawing::{Cell, cell_map};
use crate::tagging::calibrated_lens::CalibratedLens;

/// A picture and the name of its file.
pub(super) struct Map {
    pub(super) file: &'static str,
    pub(super) svg: String,
}

/// All maps of a lens. `marks` names what was seen in its image; a cell needs views below `min_frames`.
pub(super) fn maps(found: &CalibratedLens, marks: &str, min_frames: usize) -> Vec<Map> {
    let number = |worst_px: f64| {
        move |value: &Option<f64>| value.map(|px| Cell { words: format!("{px:.2}"), bad: px / worst_px })
    };
    let uncertainty = found.uncertainty_px.iter().map(number(0.5)).collect();
    let difference = found.difference_px.iter().map(number(0.5)).collect();
    let seen = || found.bias.iter().zip(&found.uncertainty_px).map(|(bias, seen)| seen.map(|_| bias));
    let bias = seen().map(|bias| {
        let bias = bias.filter(|bias| bias.frames > 0)?;
        Some(Cell::of_bias(bias))
    });
    let views = seen().map(|bias| {
        let frames = bias?.frames;
        Some(Cell { words: frames.to_string(), bad: 1.0 - frames as f64 / (5 * min_frames) as f64 })
    });
    let map = |file, title: &str, cells| Map { file, svg: cell_map(&found.grid, title, cells) };
    vec![
        map("uncertainty.svg", "Uncertainty of projection, px", uncertainty),
        map("cross-validation.svg", "Difference of the lenses by two halves of the data, px", difference),
        map("residuals.svg", "Bias of the residuals, px (noise is near 0)", bias.collect()),
        map("views.svg", &format!("Frames with {marks}: red places need more views"), views.collect()),
    ]
}
