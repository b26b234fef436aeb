//! A map over the image of a camera, as an SVG picture: a value in each cell.

use std::fmt::Write;

use realitysim_localization::smoothing::projection::{CellBias, ImageGrid};

/// What stands in a cell of a map.
#[derive(Clone, Debug, PartialEq)]
pub struct Cell {
    /// The value, for people.
    pub words: String,
    /// How bad it is: from 0 (good) to 1.
    pub bad: f64,
}

/// Bias of residuals that is shown as bad, pixels.
const BAD_BIAS_PX: f64 = 0.3;
/// Side of a cell, pixels of the picture.
const SIDE: f64 = 44.0;
const HEAD: f64 = 34.0;

impl Cell {
    /// The cell of a bias of residuals.
    pub fn of_bias(bias: &CellBias) -> Self {
        let px = bias.off_px.length();
        Self { words: format!("{px:.2}"), bad: px / BAD_BIAS_PX }
    }
}

/// Draws a map. `cells` lie row by row; those without a value are grey.
pub fn cell_map(grid: &ImageGrid, title: &str, cells: Vec<Option<Cell>>) -> String {
    let columns = grid.columns;
    let (width, height) = (SIDE * columns as f64, HEAD + SIDE * grid.rows as f64);
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" height=\"{height}\" \
         font-family=\"'DejaVu Sans', Verdana, sans-serif\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n\
         <text x=\"8\" y=\"22\" font-size=\"15\">{title}</text>\n"
    );
    for (number, cell) in cells.into_iter().enumerate() {
        let (x, y) = (SIDE * (number % columns) as f64, HEAD + SIDE * (number / columns) as f64);
        let (words, colour) = cell.map_or((String::new(), "#d9d9d9".to_owned()), |cell| (cell.words, colour(cell.bad)));
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
