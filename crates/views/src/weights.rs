//! The weight of each source at the corners of the view's cells.

use super::Candidate;
use super::camera::AREA;
use super::ground_warp::Warp;
use super::raster::SURE;
use super::target_rays::Target;
use super::world::Surface;

/// Sources whose score is within this share of the best one's are blended: the width of a seam.
const FEATHER: f32 = 0.04;
/// Distance between source and view, in metres, at which a source's score is halved. A nearer source shows things nearly
/// where they belong even if tag, lens and carpet are not exact.
const BASELINE_M: f64 = 0.15;
/// Distance in pixels from the source's border (of the picture, the lens's circle or the body) from which on the border
/// does not lower the score.
const BORDER_PX: f32 = 24.0;
/// Distance, in metres, at which the score for what is far is halved once more: the source shows another parallax.
const FAR_BASELINE_M: f64 = 0.3;

/// The weights of all sources at the corners of the cells.
pub(super) struct Weights {
    /// Source by source. The weights of a corner add up to 1, or to 0 where no source shows it.
    weights: Vec<Vec<f32>>,
}

impl Weights {
    /// Computes the weights from the scores of the sources.
    pub(super) fn new(target: &Target, warps: &[Warp]) -> Self {
        let mut weights: Vec<Vec<f32>> = warps.iter().map(|warp| scores(target, warp)).collect();
        for node in 0..target.node_count() {
            let best = weights.iter().map(|scores| scores[node]).fold(0.0, f32::max);
            let least = best * (1.0 - FEATHER);
            let left = |score: f32| (score - least).max(0.0);
            let sum: f32 = weights.iter().map(|scores| left(scores[node])).sum();
            for scores in &mut weights {
                scores[node] = if sum > 0.0 { left(scores[node]) / sum } else { 0.0 };
            }
        }
        Self { weights }
    }

    /// The weight of a source at a corner.
    pub(super) fn weight(&self, source: usize, node: usize) -> f32 {
        self.weights[source][node]
    }

    /// The number of pixels that each source contributes, by its weights.
    pub(super) fn pixels(&self) -> impl Iterator<Item = f64> {
        self.weights.iter().map(|weights| weights.iter().map(|weight| f64::from(*weight)).sum::<f64>() * AREA as f64)
    }
}

/// The score of a source at the corners of the cells: its resolution (source pixels per view pixel), its distance from the
/// border, and how near it was taken. 0 where it shows nothing.
fn scores(target: &Target, warp: &Warp) -> Vec<f32> {
    let (columns, rows) = target.camera().cells();
    let source = warp.source();
    let (width, height) = (source.camera.width() as f32 - 1.0, source.camera.height() as f32 - 1.0);
    let near = (1.0 / (1.0 + warp.baseline_m() / BASELINE_M)) as f32;
    let far = (1.0 / (1.0 + warp.baseline_m() / FAR_BASELINE_M)) as f32;
    let score = |node: usize| {
        let [u, v] = warp.node(node);
        let border = u.min(v).min(width - u).min(height - v);
        if border.is_nan() || border < 0.0 || !shows(source, u, v) {
            return 0.0;
        }
        let border = border.min(source.image.inset_px((u + 0.5) as usize, (v + 0.5) as usize));
        let (column, row) = (node % (columns + 1), node / (columns + 1));
        let step = |before: usize, after: usize| {
            let ([a, b], [c, d]) = (warp.node(before), warp.node(after));
            [c - a, d - b]
        };
        let [left, right] = [column.saturating_sub(1), (column + 1).min(columns)].map(|c| row * (columns + 1) + c);
        let [above, below] = [row.saturating_sub(1), (row + 1).min(rows)].map(|r| r * (columns + 1) + column);
        let ([ux, vx], [uy, vy]) = (step(left, right), step(above, below));
        let area = (ux * vy - uy * vx).abs() / (4 * AREA) as f32;
        let resolution = if area.is_nan() { 0.5 } else { area.clamp(0.05, 4.0) };
        let edge = (border / BORDER_PX).clamp(0.05, 1.0);
        let near = if target.surface_at(node) == Some(Surface::Far) { near * far } else { near };
        resolution * edge * near
    };
    (0..target.node_count()).map(score).collect()
}

/// Whether the source's pixel there is sure.
fn shows(source: &Candidate, u: f32, v: f32) -> bool {
    let image = source.image.full();
    image.pixels[(v + 0.5) as usize * image.width + (u + 0.5) as usize][3] == SURE
}
