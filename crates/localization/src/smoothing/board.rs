//! Fits a lens, and the poses of a calibration board, to the board's corners in many pictures.
//!
//! The unknowns of a picture are the six of the board's pose, those of all pictures the lens's part of [`Constants`]. The
//! normal equations are those of a walk ([`Chain`]) whose frames have no links. A pose is begun from the homography between the
//! board and the rays of its corners, which exists for a fisheye as well.

use glam::{DMat3, DQuat, DVec2, DVec3};
use nalgebra::{SMatrix, SVector};
use thiserror::Error;

use super::chain::{Border, Chain, FRAME_UNKNOWNS, FrameVector, Solution};
use super::model::HELD;
use super::{CONSTANTS, Constants, ConstantsCovariance, PlaceResidual};
use realitysim_geometry::{Isometry, Lens, LensError, LensModel, LensParameters};

/// The corners of a board in one picture.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BoardView {
    /// Corners on the board, metres, and their pixels.
    pub corners: Vec<(DVec2, DVec2)>,
}

/// The lens and the poses that fit the corners best.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardFit {
    /// Pose of the board in the camera's optical frame, by picture.
    pub optical_from_board: Vec<Isometry>,
    /// Corrections of the lens.
    pub constants: Constants,
    /// The corrected lens.
    pub lens: LensParameters,
    /// Standard deviations of the constants; 0 of those that do not belong to the lens.
    pub known: [f64; CONSTANTS],
    /// Covariance of the constants.
    pub covariance: ConstantsCovariance,
    /// Root mean square distance of the corners that fit from where they are drawn, pixels.
    pub rms_px: f64,
    /// Residuals of the corners that fit, along u and along v, by picture.
    pub residuals: Vec<Vec<PlaceResidual>>,
    /// Number of corners, and of those that do not fit.
    pub corners: [usize; 2],
}

/// Why corners give no lens.
#[derive(Debug, Error, PartialEq)]
pub enum BoardFitError {
    /// The lens is not valid.
    #[error("the lens: {0}")]
    Lens(#[from] LensError),
    /// A picture's corners give no pose.
    #[error("picture {0}: its corners lie on a line, or the lens does not see them")]
    NoPose(usize),
    /// The corners do not determine everything that is sought.
    #[error("the corners do not determine the lens")]
    NotDetermined,
}

/// Fewest corners of a picture with which its board's pose is determined well.
pub const MIN_CORNERS: usize = 8;
/// Standard deviations of the lens before the fit: so large that they only hold what no corner tells.
const LOOSE: [(usize, f64); 7] = [(0, 0.5), (1, 200.0), (2, 200.0), (3, 0.5), (8, 0.5), (9, 0.5), (10, 0.5)];
/// Steps of derivatives by the lens.
const STEPS: [(usize, f64); 7] = [(0, 1e-5), (1, 1e-3), (2, 1e-3), (3, 1e-5), (8, 1e-5), (9, 1e-5), (10, 1e-5)];
/// Step of derivatives by a ray, as a share of its length.
const RAY_STEP: f64 = 1e-6;
/// Most steps of the fit.
const ITERATIONS: usize = 60;
/// The fit ends when a step lowers the cost by a smaller share.
const MIN_GAIN: f64 = 1e-9;
/// Scale of the robust loss (Geman-McClure), in medians of what corners lie off, and its least value, pixels.
const ROBUST: (f64, f64) = (6.0, 0.5);
/// A corner does not fit if it lies off by more scales.
const OUTLIER: f64 = 1.0;

/// Finds the lens and the poses that fit best. Each view needs [`MIN_CORNERS`] corners.
///
/// # Errors
///
/// A [`BoardFitError`] if a lens is not valid, a picture gives no pose, or the corners do not determine the lens.
pub fn fit_board(views: &[BoardView], believed: &LensParameters) -> Result<BoardFit, BoardFitError> {
    let lens = Lens::new(believed.clone())?;
    let poses =
        views.iter().enumerate().map(|(number, view)| first_pose(view, &lens).ok_or(BoardFitError::NoPose(number)));
    let mut state = State { poses: poses.collect::<Result<_, _>>()?, constants: Constants::default() };
    let mut damping = 1e-3;
    for _ in 0..ITERATIONS {
        let scale_px = robust_scale(&offs(views, &state, believed)?);
        let linear = linearise(views, &state, believed, scale_px, 1.0)?;
        let mut gain = 0.0;
        while damping < 1e6 {
            let next = linear.damped(damping).solve().map(|solution| state.stepped(&solution));
            let cost = next.as_ref().and_then(|next| cost(views, next, believed, scale_px));
            if let Some((next, cost)) = next.zip(cost).filter(|(_, cost)| *cost <= linear.cost) {
                gain = (linear.cost - cost) / linear.cost.max(1e-12);
                state = next;
                damping = (damping * 0.1).max(1e-9);
                break;
            }
            damping *= 10.0;
        }
        if gain < MIN_GAIN {
            break;
        }
    }
    assess(views, state, believed)
}

struct State {
    poses: Vec<Isometry>,
    constants: Constants,
}

impl State {
    fn stepped(&self, solution: &Solution) -> Self {
        let poses = self.poses.iter().zip(&solution.steps).map(|(pose, step)| {
            let turn = DQuat::from_scaled_axis(DVec3::new(step[3], step[4], step[5]));
            let rotation = (turn * pose.rotation).normalize();
            Isometry::new(rotation, pose.translation + DVec3::new(step[0], step[1], step[2]))
        });
        Self { poses: poses.collect(), constants: self.constants.plus(&solution.border.into()) }
    }
}

/// Distances of all corners from where they are drawn, pixels; infinite where the lens draws nothing.
fn offs(views: &[BoardView], state: &State, believed: &LensParameters) -> Result<Vec<f64>, LensError> {
    let lens = Lens::new(state.constants.lens(believed))?;
    let corners = views.iter().zip(&state.poses).flat_map(|(view, pose)| view.corners.iter().map(move |at| (pose, at)));
    let off = |(pose, (point, pixel)): (&Isometry, &(DVec2, DVec2))| {
        let drawn = lens.project(pose.transform_point(point.extend(0.0)));
        drawn.map_or(f64::INFINITY, |drawn| drawn.distance(*pixel))
    };
    Ok(corners.map(off).collect())
}

fn robust_scale(offs: &[f64]) -> f64 {
    let mut sorted = offs.to_vec();
    sorted.sort_by(f64::total_cmp);
    let median = sorted.get(sorted.len() / 2).copied().filter(|off| off.is_finite()).unwrap_or(100.0);
    (ROBUST.0 * median).max(ROBUST.1)
}

/// The loss of a corner that lies off by so many scales.
fn loss(off: f64) -> f64 {
    if off.is_finite() { 0.5 * off * off / (1.0 + off * off) } else { 0.5 }
}

/// The cost of a state; `None` if its lens is not valid.
fn cost(views: &[BoardView], state: &State, believed: &LensParameters, scale_px: f64) -> Option<f64> {
    let offs = offs(views, state, believed).ok()?;
    Some(offs.iter().map(|off| loss(off / scale_px)).sum::<f64>() + prior_cost(&state.constants, 1.0))
}

fn prior_cost(constants: &Constants, sigma_px: f64) -> f64 {
    let values = constants.values();
    LOOSE
        .iter()
        .map(|(at, sigma)| 0.5 * (values[*at] * sigma_px / sigma) * (values[*at] * sigma_px / sigma) * 1e-6)
        .sum()
}

struct Linear {
    chain: Chain,
    cost: f64,
    frames: usize,
}

impl Linear {
    /// The equations with a penalty on long steps (Levenberg).
    fn damped(&self, damping: f64) -> Chain {
        let mut chain = self.chain.clone();
        let weight = libm::sqrt(damping);
        for frame in 0..self.frames {
            // Centimetres and hundredths of a radian.
            (0..6).for_each(|at| chain.add(frame, 0.0, &unit(at, weight / 0.01), &Border::zeros()));
        }
        LOOSE.iter().for_each(|(at, sigma)| chain.add_common(0.0, &common(*at, weight / (0.1 * sigma))));
        chain
    }
}

fn unit(at: usize, value: f64) -> FrameVector {
    let mut vector = FrameVector::zeros();
    vector[at] = value;
    vector
}

fn common(at: usize, value: f64) -> Border {
    let mut vector = Border::zeros();
    vector[at] = value;
    vector
}

/// The normal equations about a state. Residuals are divided by `scale_px` for the robust loss, and by `sigma` times that in all.
fn linearise(
    views: &[BoardView],
    state: &State,
    believed: &LensParameters,
    scale_px: f64,
    sigma: f64,
) -> Result<Linear, LensError> {
    let lens = Lens::new(state.constants.lens(believed))?;
    let is_radial = matches!(believed.model, LensModel::KannalaBrandt { .. });
    let steps = STEPS.iter().filter(|(at, _)| is_radial || *at < 3);
    let moved: Vec<(usize, f64, Lens)> = steps
        .map(|(at, step)| {
            let mut by = [0.0; CONSTANTS];
            by[*at] = *step;
            Ok((*at, *step, Lens::new(state.constants.plus(&by).lens(believed))?))
        })
        .collect::<Result<_, LensError>>()?;
    let mut chain = Chain::new(views.len());
    let mut cost = prior_cost(&state.constants, 1.0);
    for (frame, (view, pose)) in views.iter().zip(&state.poses).enumerate() {
        for (point, pixel) in &view.corners {
            let turned = pose.rotation * point.extend(0.0);
            let Some(corner) = Corner::new(&lens, turned, pose.translation) else {
                cost += loss(f64::INFINITY);
                continue;
            };
            let off = (corner.drawn - *pixel) / scale_px;
            let weight = 1.0 / (1.0 + off.length_squared());
            cost += loss(off.length());
            let by_lens: Vec<(usize, DVec2)> = moved
                .iter()
                .filter_map(|(at, step, lens)| Some((*at, (lens.project(corner.ray)? - corner.drawn) / *step)))
                .collect();
            for axis in [DVec2::X, DVec2::Y] {
                let scale = weight / (scale_px * sigma);
                let own = corner.derivatives(axis) * scale;
                let mut shared = Border::zeros();
                by_lens.iter().for_each(|(at, by)| shared[*at] = by.dot(axis) * scale);
                chain.add(frame, off.dot(axis) * weight / sigma, &own, &shared);
            }
        }
        (6..FRAME_UNKNOWNS).for_each(|at| chain.add(frame, 0.0, &unit(at, 1.0), &Border::zeros()));
    }
    for (at, value) in state.constants.values().into_iter().enumerate() {
        match LOOSE.iter().find(|(loose, _)| *loose == at && (is_radial || at < 3)) {
            Some((_, loose)) => chain.add_common(1e-3 * value / loose, &common(at, 1e-3 / loose)),
            None => chain.add_common(0.0, &common(at, 1.0 / HELD)),
        }
    }
    Ok(Linear { chain, cost, frames: views.len() })
}

/// A corner as a lens draws it, with its derivatives by the pose.
struct Corner {
    drawn: DVec2,
    ray: DVec3,
    turned: DVec3,
    /// Movement of the pixel for each metre along the camera's axes.
    by_place: [DVec2; 3],
}

impl Corner {
    fn new(lens: &Lens, turned: DVec3, translation: DVec3) -> Option<Self> {
        let ray = turned + translation;
        let drawn = lens.project(ray)?;
        let step = RAY_STEP * ray.length();
        let by = |axis: DVec3| Some((lens.project(ray + axis * step)? - drawn) / step);
        Some(Self { drawn, ray, turned, by_place: [by(DVec3::X)?, by(DVec3::Y)?, by(DVec3::Z)?] })
    }

    /// Derivatives of the pixel along an axis of the image by translation and rotation.
    fn derivatives(&self, axis: DVec2) -> FrameVector {
        let by_place = DVec3::from_array(self.by_place.map(|by| by.dot(axis)));
        let by_turn = self.turned.cross(by_place);
        let mut own = FrameVector::zeros();
        own.fixed_rows_mut::<3>(0).copy_from_slice(&by_place.to_array());
        own.fixed_rows_mut::<3>(3).copy_from_slice(&by_turn.to_array());
        own
    }
}

/// Residuals, uncertainties and covariance of the last state.
fn assess(views: &[BoardView], state: State, believed: &LensParameters) -> Result<BoardFit, BoardFitError> {
    let lens = Lens::new(state.constants.lens(believed))?;
    let scale_px = robust_scale(&offs(views, &state, believed)?);
    let (mut residuals, mut squares, mut fitting, mut all) = (Vec::new(), 0.0, 0usize, 0usize);
    for (view, pose) in views.iter().zip(&state.poses) {
        let mut of_view = Vec::new();
        for (point, pixel) in &view.corners {
            all += 1;
            let Some(drawn) = lens.project(pose.transform_point(point.extend(0.0))) else { continue };
            let off = *pixel - drawn;
            if off.length() > OUTLIER * scale_px {
                continue;
            }
            fitting += 1;
            squares += off.length_squared();
            let along = |across: DVec2| PlaceResidual {
                pixel: *pixel,
                across,
                off_px: off.dot(across),
                sigmas: 1.0,
                ground: None,
            };
            of_view.extend([along(DVec2::X), along(DVec2::Y)]);
        }
        residuals.push(of_view);
    }
    let rms_px = libm::sqrt(squares / fitting.max(1) as f64);
    // The standard deviation of one coordinate.
    let sigma_px = rms_px / core::f64::consts::SQRT_2;
    let linear = linearise(views, &state, believed, scale_px, (sigma_px / scale_px).max(1e-9))?;
    let solution = linear.chain.solve().ok_or(BoardFitError::NotDetermined)?;
    let sigmas = solution.border_sigmas();
    let is_radial = matches!(believed.model, LensModel::KannalaBrandt { .. });
    let is_sought = |at: usize| LOOSE.iter().any(|(loose, _)| *loose == at && (is_radial || at < 3));
    Ok(BoardFit {
        optical_from_board: state.poses,
        constants: state.constants,
        lens: lens.parameters().clone(),
        known: core::array::from_fn(|at| if is_sought(at) { sigmas[at] } else { 0.0 }),
        covariance: solution.border_covariance,
        rms_px,
        residuals,
        corners: [all, all - fitting],
    })
}

/// The pose of a board from the homography that maps its corners onto their rays.
///
/// A ray r and a corner p satisfy r x (H p) = 0, which is linear in H (direct linear transform).
fn first_pose(view: &BoardView, lens: &Lens) -> Option<Isometry> {
    let rays: Vec<(DVec2, DVec3)> =
        view.corners.iter().filter_map(|(point, pixel)| Some((*point, lens.unproject(*pixel)?))).collect();
    if rays.len() < MIN_CORNERS {
        return None;
    }
    let middle = rays.iter().map(|(point, _)| *point).sum::<DVec2>() / rays.len() as f64;
    let size_m = rays.iter().map(|(point, _)| point.distance(middle)).fold(0.0, f64::max).max(1e-6);
    let mut normal = SMatrix::<f64, 9, 9>::zeros();
    for (point, ray) in &rays {
        let p = ((*point - middle) / size_m).extend(1.0);
        for (a, b, ra, rb) in [(1, 2, ray.y, ray.z), (2, 0, ray.z, ray.x), (0, 1, ray.x, ray.y)] {
            let mut row = SVector::<f64, 9>::zeros();
            (0..3).for_each(|i| {
                row[3 * b + i] = ra * p[i];
                row[3 * a + i] = -rb * p[i];
            });
            normal += row * row.transpose();
        }
    }
    let eigen = normal.symmetric_eigen();
    let least = eigen.eigenvalues.imin();
    let h = eigen.eigenvectors.column(least);
    let row = |i: usize| DVec3::new(h[3 * i], h[3 * i + 1], h[3 * i + 2]);
    let map = DMat3::from_cols(row(0), row(1), row(2)).transpose();
    pose_of(map, &rays, middle, size_m)
}

/// Splits a homography into a rotation and a translation, with the board in front of its rays.
fn pose_of(map: DMat3, rays: &[(DVec2, DVec3)], middle: DVec2, size_m: f64) -> Option<Isometry> {
    let scale = libm::sqrt(map.x_axis.length() * map.y_axis.length());
    let ahead: f64 = rays.iter().map(|(point, ray)| (map * ((*point - middle) / size_m).extend(1.0)).dot(*ray)).sum();
    let map = map * (ahead.signum() / scale);
    let (x, y) = (map.x_axis.normalize_or_zero(), map.y_axis.normalize_or_zero());
    // The perpendicular axes that are as near to one as to the other.
    let (sum, difference) = ((x + y).normalize_or_zero(), (x - y).normalize_or_zero());
    let half = core::f64::consts::FRAC_1_SQRT_2;
    let (x, y) = ((sum + difference) * half, (sum - difference) * half);
    let rotation = DQuat::from_mat3(&DMat3::from_cols(x, y, x.cross(y))).normalize();
    let pose = Isometry::new(rotation, map.z_axis * size_m - rotation * middle.extend(0.0));
    pose.is_finite().then_some(pose)
}

#[cfg(test)]
mod tests;
