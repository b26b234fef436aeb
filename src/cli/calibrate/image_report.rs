//! What a calibration found of a lens, in words and as JSON: the part that walk and board share.

use glam::DVec2;
use serde::Serialize;

use crate::geometry::{LensModel, LensParameters};
use crate::tagging::calibrated_lens::CalibratedLens;
use crate::tagging::walk_calibration::CalibratedConstant;

/// What a calibration found of the lens, whatever it was found from.
#[derive(Serialize)]
pub(super) struct ImageReport {
    pub(super) rms_px: f64,
    lens: LensParameters,
    /// Uncertainty of projection that 95 % of the cells stay below, pixels.
    uncertainty_p95_px: f64,
    cross_validation: CrossValidation,
    /// Cells whose residuals are no noise.
    model_errors: Vec<ModelError>,
    /// Parts of the image in which next to nothing was seen, with the share of their cells.
    needs_views: Vec<Sparse>,
    consequences: Vec<Consequence>,
}

/// A constant of a calibration.
#[derive(Serialize)]
pub(super) struct Constant {
    name: &'static str,
    unit: &'static str,
    /// Correction of what was believed.
    value: f64,
    sigma: f64,
    determined: bool,
}

#[derive(Serialize)]
struct CrossValidation {
    /// Difference of the lenses by two halves of the walk that 95 % of the cells stay below, pixels.
    p95_px: f64,
    /// The same of the sum of the uncertainties of both halves.
    allowed_p95_px: f64,
    agrees: bool,
}

#[derive(Serialize)]
struct ModelError {
    at_px: [f64; 2],
    place: &'static str,
    off_px: [f64; 2],
    sigmas: f64,
}

#[derive(Serialize)]
struct Sparse {
    place: &'static str,
    share: f64,
}

/// What the uncertainty at the rim means on the ground.
#[derive(Serialize)]
struct Consequence {
    distance_m: f64,
    /// Error along the line of sight, and across it, centimetres.
    along_cm: f64,
    across_cm: f64,
}

/// Residuals of a cell are a model error if they lie off by this many standard deviations ...
const ERROR_SIGMAS: f64 = 5.0;
/// ... and by this many pixels: less is what paint and light do.
const ERROR_PX: f64 = 0.15;
/// A cell needs views if fewer frames of a walk show lines in it: each shows one direction of a few places ...
pub(super) const MIN_FRAMES: usize = 10;
/// ... or fewer pictures show corners of a board, each of which is a point.
pub(super) const MIN_PICTURES: usize = 3;
/// A part of the image needs views if this share of its cells does.
const SPARSE_SHARE: f64 = 0.5;
/// Both halves agree if they differ by at most this many times the sum of their uncertainties.
const AGREEMENT: f64 = 1.5;
const DISTANCES_M: [f64; 4] = [1.0, 2.0, 3.0, 5.0];
const PLACES: [&str; 9] =
    ["upper left", "top", "upper right", "left", "middle", "right", "lower left", "bottom", "lower right"];

impl Constant {
    pub(super) fn all(constants: &[CalibratedConstant]) -> Vec<Self> {
        let constant = |constant: &CalibratedConstant| Self {
            name: constant.name,
            unit: constant.unit,
            value: constant.value,
            sigma: constant.sigma,
            determined: constant.determined,
        };
        constants.iter().map(constant).collect()
    }

    /// A line for people; `source` is what determines it or not.
    pub(super) fn text(&self, source: &str) -> String {
        let Self { name, unit, value, sigma, determined } = self;
        match determined {
            true => format!("  {name:<26} {value:+.5} +- {sigma:.5} {unit}\n"),
            false => format!("  {name:<26} not determined by {source} (+- {sigma:.5} {unit})\n"),
        }
    }
}

impl ImageReport {
    /// The report of a lens that is used at a height above the ground, metres. A cell needs views below `min_frames`.
    pub(super) fn of(image: &CalibratedLens, height_m: f64, min_frames: usize) -> Self {
        let uncertainty_p95_px = p95(&image.uncertainty_px);
        let (p95_px, allowed_p95_px) = (p95(&image.difference_px), p95(&image.allowed_px));
        Self {
            rms_px: image.rms_px,
            lens: image.lens.clone(),
            uncertainty_p95_px,
            cross_validation: CrossValidation { p95_px, allowed_p95_px, agrees: p95_px <= AGREEMENT * allowed_p95_px },
            model_errors: model_errors(image, min_frames),
            needs_views: needs_views(image, min_frames),
            consequences: consequences(&image.lens, height_m, uncertainty_p95_px),
        }
    }

    pub(super) fn lens_text(&self) -> String {
        let LensParameters { fx, fy, cx, cy, model, .. } = &self.lens;
        let mut text = format!("lens: fx {fx:.3}, fy {fy:.3}, cx {cx:.3}, cy {cy:.3} px");
        if let LensModel::KannalaBrandt { k: [k1, k2, k3, k4] } = model {
            text.push_str(&format!(", k {k1:.5}, {k2:.5}, {k3:.5}, {k4:.5}"));
        }
        text + "\n"
    }

    /// What it means for the image, for people. `halves` names the data, `marks` what was seen in it.
    pub(super) fn text(&self, halves: &str, marks: &str) -> String {
        let CrossValidation { p95_px, allowed_p95_px, agrees } = self.cross_validation;
        let mut text = format!(
            "projection: +- {:.2} px over 95 % of the image\ntwo halves of {halves} differ by {p95_px:.2} px, and {allowed_p95_px:.2} px \
             are what their uncertainties allow: {}\n",
            self.uncertainty_p95_px,
            if agrees { "they agree" } else { "they do not agree: model error" }
        );
        for ModelError { at_px: [u, v], place, off_px: [x, y], .. } in &self.model_errors {
            text.push_str(&format!(
                "model error: {place}, at ({u:.0}, {v:.0}) {marks} lie off by ({x:+.2}, {y:+.2}) px\n"
            ));
        }
        if self.model_errors.is_empty() {
            text.push_str("residuals are noise all over the image\n");
        }
        for Sparse { place, share } in &self.needs_views {
            text.push_str(&format!("needs more views: {place} ({:.0} % of it without {marks})\n", 100.0 * share));
        }
        for Consequence { distance_m, along_cm, across_cm } in &self.consequences {
            text.push_str(&format!(
                "{:.2} px at the rim: {along_cm:.1} cm along and {across_cm:.1} cm across at {distance_m} m\n",
                self.uncertainty_p95_px
            ));
        }
        text
    }
}

/// The value that 95 % of the cells stay below; 0 without cells.
fn p95(cells: &[Option<f64>]) -> f64 {
    let mut values: Vec<f64> = cells.iter().flatten().copied().collect();
    values.sort_by(f64::total_cmp);
    let last = values.len().saturating_sub(1);
    values.get((0.95 * last as f64).round() as usize).copied().unwrap_or(0.0)
}

/// Words for where in the image a pixel lies.
fn place(image: &CalibratedLens, pixel: DVec2) -> usize {
    let third = |at: f64, size: u32| ((3.0 * at / f64::from(size)).max(0.0) as usize).min(2);
    3 * third(pixel.y, image.lens.height) + third(pixel.x, image.lens.width)
}

fn model_errors(image: &CalibratedLens, min_frames: usize) -> Vec<ModelError> {
    let cells = image.grid.middles().zip(&image.bias);
    let biased = cells
        .filter(|(_, bias)| bias.frames >= min_frames && bias.sigmas > ERROR_SIGMAS && bias.off_px.length() > ERROR_PX);
    biased
        .map(|(pixel, bias)| ModelError {
            at_px: pixel.to_array(),
            place: PLACES[place(image, pixel)],
            off_px: bias.off_px.to_array(),
            sigmas: bias.sigmas,
        })
        .collect()
}

fn needs_views(image: &CalibratedLens, min_frames: usize) -> Vec<Sparse> {
    let mut counts = [(0usize, 0usize); 9];
    for ((pixel, bias), seen) in image.grid.middles().zip(&image.bias).zip(&image.uncertainty_px) {
        let (sparse, all) = &mut counts[place(image, pixel)];
        *all += usize::from(seen.is_some());
        *sparse += usize::from(seen.is_some() && bias.frames < min_frames);
    }
    let share = |(sparse, all): (usize, usize)| sparse as f64 / all.max(1) as f64;
    let shares = PLACES.iter().zip(counts.map(share));
    shares.filter(|(_, share)| *share > SPARSE_SHARE).map(|(place, share)| Sparse { place, share }).collect()
}

fn consequences(lens: &LensParameters, height_m: f64, off_px: f64) -> Vec<Consequence> {
    let off_rad = off_px / lens.fx;
    let on_ground = |distance_m: f64| {
        let sight_m = distance_m.hypot(height_m);
        let along_m = off_rad * sight_m * sight_m / height_m.max(0.01);
        Consequence { distance_m, along_cm: 100.0 * along_m, across_cm: 100.0 * off_rad * sight_m }
    };
    DISTANCES_M.into_iter().map(on_ground).collect()
}
