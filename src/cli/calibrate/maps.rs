//! Maps over the image, as SVG pictures: a value in each cell.

use std::fmt::Write;

use crate::tagging::calibrated_lens::CalibratedLens;

/// Side of a cell, pixels of the picture.
const SIDE: f64 = 44.0;
const HEAD: f64 = 34.0;

/// A picture and the name of its file.
pub(super) struct Map {
    pub(super) file: &'static str,
    pub(super) svg: String,
}

/// All maps of a lens. `marks` names what was seen in its image; a cell needs views below `min_frames`.
pub(super) fn maps(found: &CalibratedLens, marks: &str, min_frames: usize) -> Vec<Map> {
    let number = |worst_px: f64| move |value: &Option<f64>| value.map(|px| (format!("{px:.2}"), px / worst_px));
    let uncertainty = found.uncertainty_px.iter().map(number(0.5)).collect();
    let difference = found.difference_px.iter().map(number(0.5)).collect();
    let seen = || found.bias.iter().zip(&found.uncertainty_px).map(|(bias, seen)| seen.map(|_| bias));
    let bias = seen().map(|bias| {
        let bias = bias.filter(|bias| bias.frames > 0)?;
        Some((format!("{:.2}", bias.off_px.length()), bias.off_px.length() / 0.3))
    });
    let views = seen().map(|bias| {
        let frames = bias?.frames;
        Some((frames.to_string(), 1.0 - frames as f64 / (5 * min_frames) as f64))
    });
    let map = |file, title: &str, cells| Map { file, svg: svg(found, title, cells) };
    vec![
        map("uncertainty.svg", "Uncertainty of projection, px", uncertainty),
        map("cross-validation.svg", "Difference of the lenses by two halves of the data, px", difference),
        map("residuals.svg", "Bias of the residuals, px (noise is near 0)", bias.collect()),
        map("views.svg", &format!("Frames with {marks}: red places need more views"), views.collect()),
    ]
}

fn svg(found: &CalibratedLens, title: &str, cells: Vec<Option<(String, f64)>>) -> String {
    let columns = found.grid.columns;
    let (width, height) = (SIDE * columns as f64, HEAD + SIDE * found.grid.rows as f64);
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" height=\"{height}\" \
         font-family=\"'DejaVu Sans', Verdana, sans-serif\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n\
         <text x=\"8\" y=\"22\" font-size=\"15\">{title}</text>\n"
    );
    for (number, cell) in cells.into_iter().enumerate() {
        let (x, y) = (SIDE * (number % columns) as f64, HEAD + SIDE * (number / columns) as f64);
        let (words, colour) = cell.map_or((String::new(), "#d9d9d9".to_owned()), |(words, bad)| (words, colour(bad)));
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "<rect x=\"{x}\" y=\"{y}\" width=\"{SIDE}\" height=\"{SIDE}\" fill=\"{colour}\" stroke=\"white\"/>\
             <text x=\"{}\" y=\"{}\" font-size=\"12\" text-anchor=\"middle\">{words}</text>",
            x + SIDE / 2.0,
            y + SIDE / 2.0 + 4.0
        );
    }
    text + "</svg>\n"
}

/// From green (0) through yellow to red (1).
fn colour(bad: f64) -> String {
    let bad = bad.clamp(0.0, 1.0);
    let [red, green] = [2.0 * bad, 2.0 * (1.0 - bad)].map(|share| 130.0 + 110.0 * share.min(1.0));
    format!("rgb({red:.0},{green:.0},130)")
}
