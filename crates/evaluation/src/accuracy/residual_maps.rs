//! Where lines lie systematically off after the fit of a walk: over the image, and over the field.
//!
//! An error of the lens shows in the image wherever the robot stands; a line that is laid beside its place shows on the field from
//! wherever it is seen. What the fit has put into the poses shows in neither.

use glam::DVec2;
use serde::Serialize;

use crate::drawing::{Cell, FieldSvg, cell_map};
use crate::statistics::rms;
use realitysim_geometry::{Field, LensError, LensParameters};
use realitysim_localization::smoothing::projection::{CellBias, ImageGrid};
use realitysim_localization::smoothing::{Frame, GroundResidual, Model, PlaceResidual, Smoothed, place_residuals};

/// Both maps of a walk.
#[derive(Clone, Debug, Serialize)]
pub struct ResidualMaps {
    /// Root mean square of the residuals, pixels.
    pub rms_px: f64,
    /// Root mean square over the cells of the image of the displacement that their lines share, pixels.
    pub image_px: f64,
    /// Root mean square over pieces of line of their displacement across the line, centimetres.
    pub field_cm: f64,
    /// Pieces of line that were seen.
    pub lines: Vec<LinePiece>,
    /// The map over the image, SVG.
    #[serde(skip)]
    pub image_svg: String,
    /// The map over the field, SVG.
    #[serde(skip)]
    pub field_svg: String,
}

/// A piece of a line of the field, and how far it lies from where the field file has it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LinePiece {
    /// Its middle, in `map`, metres.
    pub at_m: DVec2,
    /// Unit vector across the line.
    pub across: DVec2,
    /// Length, metres.
    pub length_m: f64,
    /// Distance along `across`, centimetres.
    pub off_cm: f64,
    /// Standard deviation of that distance over the frames, centimetres.
    pub sigma_cm: f64,
    /// Number of frames that saw it.
    pub frames: usize,
}

/// Length of a piece of line, metres.
const PIECE_M: f64 = 0.5;
/// Fewest frames of a cell or piece.
const MIN_FRAMES: usize = 5;
/// Line places whose pixel covers more ground are left out, metres.
const MAX_M_PER_PX: f64 = 0.03;
/// Displacement that is drawn in full red, centimetres.
const BAD_CM: f64 = 2.0;
/// Length of the drawn displacement for each centimetre, pixels.
const PX_PER_CM: f64 = 12.0;

/// Makes the maps of a walk. `lens` is that of the capture, which `smoothed` corrects.
///
/// # Errors
///
/// A [`LensError`] if the corrected lens is not valid.
pub fn residual_maps(
    frames: &[Frame],
    smoothed: &Smoothed,
    lens: &LensParameters,
    field: &Field,
) -> Result<ResidualMaps, LensError> {
    let residuals = place_residuals(frames, smoothed, lens, &Model::default())?;
    let [_, rms_px] = smoothed.rms_px;
    let grid = ImageGrid::new(lens);
    let bias = grid.bias(&residuals, rms_px);
    let seen = || bias.iter().filter(|cell| cell.frames >= MIN_FRAMES);
    let lines = pieces(&residuals, field);
    Ok(ResidualMaps {
        rms_px,
        image_px: rms(seen().map(|cell| cell.off_px.length())),
        field_cm: rms(lines.iter().map(|piece| piece.off_cm)),
        image_svg: image_svg(&grid, &bias),
        field_svg: field_svg(field, &lines),
        lines,
    })
}

/// Sums of one piece: those of the present frame, and over the frames.
#[derive(Clone, Copy, Default)]
struct Sums {
    weight: f64,
    off: f64,
    frames: usize,
    mean: f64,
    squares: f64,
}

impl Sums {
    fn add(&mut self, ground: &GroundResidual, off_m: f64) {
        let weight = 1.0 / (ground.m_per_px * ground.m_per_px).max(1e-12);
        self.weight += weight;
        self.off += weight * off_m;
    }

    /// Counts the places of one frame as one, since neighbouring places of a line err together (Welford's update).
    fn end_frame(&mut self) {
        if self.weight > 0.0 {
            let value = self.off / self.weight;
            self.frames += 1;
            let change = value - self.mean;
            self.mean += change / self.frames as f64;
            self.squares += change * (value - self.mean);
        }
        (self.weight, self.off) = (0.0, 0.0);
    }
}

fn pieces(residuals: &[Vec<PlaceResidual>], field: &Field) -> Vec<LinePiece> {
    let middles: Vec<_> = field.strokes().iter().flat_map(|stroke| stroke.points(PIECE_M)).collect();
    let mut sums = vec![Sums::default(); middles.len()];
    for frame in residuals {
        for ground in
            frame.iter().filter_map(|residual| residual.ground).filter(|ground| ground.m_per_px < MAX_M_PER_PX)
        {
            // On a circle the nearest middle has about the same normal; where lines cross, the other line's has not.
            let same = |index: &usize| middles[*index].normal.dot(ground.across).abs() > 0.9;
            let far = |index: &usize| middles[*index].position.distance_squared(ground.point);
            let nearest = (0..middles.len()).filter(same).min_by(|a, b| far(a).total_cmp(&far(b)));
            if let Some(index) = nearest.filter(|index| far(index) < PIECE_M * PIECE_M) {
                sums[index].add(&ground, ground.off_m * middles[index].normal.dot(ground.across).signum());
            }
        }
        sums.iter_mut().for_each(Sums::end_frame);
    }
    let seen = middles.iter().zip(&sums).filter(|(_, sums)| sums.frames >= MIN_FRAMES);
    seen.map(|(middle, sums)| LinePiece {
        at_m: middle.position,
        across: middle.normal,
        length_m: middle.length,
        off_cm: 100.0 * sums.mean,
        sigma_cm: 100.0 * libm::sqrt(sums.squares / sums.frames as f64),
        frames: sums.frames,
    })
    .collect()
}

fn image_svg(grid: &ImageGrid, bias: &[CellBias]) -> String {
    let cell = |bias: &CellBias| (bias.frames >= MIN_FRAMES).then(|| Cell::of_bias(bias));
    cell_map(grid, "Lines lie off by, px (noise is near 0; grey was not seen)", bias.iter().map(cell).collect())
}

/// Each piece is drawn where it was found, its displacement enlarged.
fn field_svg(field: &Field, lines: &[LinePiece]) -> String {
    let mut picture = FieldSvg::new(field, "Lines of the field as they were found; displacements are enlarged");
    for piece in lines {
        let along = piece.across.perp() * (piece.length_m / 2.0);
        let bad = (piece.off_cm.abs() / BAD_CM).min(1.0);
        let [red, green] = [bad, 1.0 - bad].map(|share| 40.0 + 180.0 * share);
        let colour = format!("rgb({red:.0},{:.0},60)", 0.7 * green);
        picture.line(&[piece.at_m - along, piece.at_m + along], &colour, 3.0);
        picture.arrow(piece.at_m, piece.across * (piece.off_cm * PX_PER_CM), &colour);
    }
    picture.finish()
}
