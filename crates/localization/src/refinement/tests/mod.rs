//! Tests of the least squares on measurements made up from a known pose: without an image, so that the truth is exact.

use glam::{DQuat, DVec2, DVec3};
use nalgebra::{Matrix2, Matrix6, SymmetricEigen, Vector2, Vector6};

use super::line_measurement::LineMeasurement;
use super::miscalibration::{Miscalibration, UNMEASURED_RAD_PER_S, UNSEEN_M_PER_S, row};
use super::solve::{self, Noise, Solution};
use super::{Errors, Prior, SCALES, error_between, moved_pose, pose_block, pose_part};
use crate::random::{Purpose, Stream};
use realitysim_geometry::{Euler, Isometry, Lens, LensModel, LensParameters, Twist};

mod exact;
mod honesty;
mod laws;
mod poor_views;

const PIXELS_PER_RAD: f64 = 205.0;

/// A camera half a metre above the carpet, looking 20 degrees down.
fn camera(x: f64, y: f64, yaw: f64) -> Isometry {
    Isometry::from_euler(Euler { yaw, pitch: 0.35, roll: 0.02 }, DVec3::new(x, y, 0.49)) * Isometry::link_from_optical()
}

fn prior(map_from_optical: Isometry) -> Prior {
    let sigmas = Vector6::new(0.1, 0.1, 0.012, 0.012, 0.012, 0.06);
    Prior::of_pose(map_from_optical, &Matrix6::from_diagonal(&sigmas.component_mul(&sigmas)))
}

/// The same prior with a lens that is calibrated to half a percent and about a pixel.
fn prior_with_lens(map_from_optical: Isometry) -> Prior {
    let mut prior = prior(map_from_optical);
    for (index, sigma) in [(6, 0.005), (7, 0.002), (8, 0.002), (9, 0.015)] {
        prior.covariance[(index, index)] = sigma * sigma;
    }
    prior.twist = MOVING;
    prior
}

/// Velocity of the camera. The tests project rays as if they were points a metre away.
const MOVING: Twist = Twist { linear: DVec3::new(0.1, 0.0, 0.3), angular: DVec3::new(0.3, -0.2, 0.4) };

fn lens() -> Lens {
    let (fx, fy) = (PIXELS_PER_RAD, PIXELS_PER_RAD);
    let model = LensModel::KannalaBrandt { k: [0.0; 4] };
    let fov_deg = Some(340.0);
    Lens::new(LensParameters { width: 640, height: 480, fx, fy, cx: 319.5, cy: 239.5, model, fov_deg }).expect("a lens")
}

/// The ray that someone who believes the calibration sees through a lens that is off by `off`.
fn misread(lens: &Lens, off: &Miscalibration, ray: DVec3) -> Option<DVec3> {
    let late_s = off.readout_s * row(lens, lens.project(ray)?);
    lens.unproject(off.drawn(lens, lens.project(ray + MOVING.passing(ray) * late_s)?))
}

/// Points of a straight line, 10 cm apart.
fn line(from: DVec3, to: DVec3) -> Vec<(DVec3, DVec3)> {
    let count = (from.distance(to) / 0.1).round() as usize;
    let tangent = (to - from).normalize();
    (0..=count).map(|i| (from.lerp(to, i as f64 / count as f64), tangent)).collect()
}

/// A corner and a line across, as at a penalty area.
fn corner() -> Vec<Vec<(DVec3, DVec3)>> {
    vec![
        line(DVec3::new(1.5, -1.0, 0.0), DVec3::new(1.5, 1.2, 0.0)),
        line(DVec3::new(0.4, 1.2, 0.0), DVec3::new(1.5, 1.2, 0.0)),
        line(DVec3::new(0.2, -0.8, 0.0), DVec3::new(1.3, -0.8, 0.0)),
    ]
}

/// Measurements of the lines as a camera sees them: each ray is off its line by `noise(index)` pixels across and arbitrary along it.
fn measurements(
    truth: &Isometry,
    lines: &[Vec<(DVec3, DVec3)>],
    mut noise: impl FnMut(usize) -> f64,
) -> Vec<LineMeasurement> {
    let mut measurements = Vec::new();
    for (line, places) in lines.iter().enumerate() {
        for (index, (point, tangent)) in places.iter().enumerate() {
            let along = 0.03 * ((index % 3) as f64 - 1.0);
            let to = (*point + *tangent * along - truth.translation).normalize();
            let across = (*point - truth.translation).cross(*tangent).normalize();
            let ray = (to + across * (noise(measurements.len()) / PIXELS_PER_RAD)).normalize();
            measurements.push(LineMeasurement {
                ray: truth.rotation.conjugate() * ray,
                row: 0.0,
                distance: 1.0,
                ray_by_lens: ray_by_lens(truth.rotation.conjugate() * ray),
                point: *point,
                tangent: *tangent,
                sigmas: 1.0,
                visibility: 1.0,
                pixels_per_rad: PIXELS_PER_RAD,
                line,
                follows: index > 0,
            });
        }
    }
    measurements
}

/// Derivatives by central differences.
fn ray_by_lens(ray: DVec3) -> [DVec3; 4] {
    let lens = lens();
    let small = |by: f64| {
        [
            Miscalibration { stretch: by, ..Miscalibration::NONE },
            Miscalibration { shift: DVec2::new(by, 0.0), ..Miscalibration::NONE },
            Miscalibration { shift: DVec2::new(0.0, by), ..Miscalibration::NONE },
            Miscalibration { readout_s: by, ..Miscalibration::NONE },
        ]
    };
    let (more, less) = (small(1e-6), small(-1e-6));
    // A lens believed to be longer puts what is seen nearer to the axis.
    let bend = |i: usize| Some((misread(&lens, &less[i], ray)? - misread(&lens, &more[i], ray)?) / 2e-6);
    core::array::from_fn(|i| bend(i).unwrap_or_default())
}

fn normal(seed: u64, index: usize) -> f64 {
    Stream::new(seed, Purpose::Start, 0, 0, index as u32).normal()
}

fn pixel_noise(seed: u64) -> impl FnMut(usize) -> f64 {
    move |index| 0.25 * normal(seed, index)
}

/// Solves as a frame is refined: a wide loss, then a narrow one with the noise that the frame shows.
fn solved(prior: &Prior, measurements: &[LineMeasurement]) -> (Solution, Matrix6<f64>, f64) {
    let [_, wide, narrow] = SCALES;
    let first = solve::solve(prior, measurements, &Vector6::zeros(), wide, Noise::USUAL).expect("a solution");
    let noise = Noise { correlated: Noise::USUAL.correlated, ..first.residuals.noise() };
    let second = solve::solve(prior, measurements, &first.moved, narrow, noise).expect("a solution");
    let noise = second.residuals.noise();
    let joint = solve::joint(prior, measurements, &second.moved, narrow, [noise; 2]).expect("a covariance");
    (second, pose_block(&joint.covariance), joint.condition)
}

fn assert_sound(prior: &Prior, solution: &Solution, covariance: &Matrix6<f64>, condition: f64) {
    assert!(solution.moved.iter().all(|value| value.is_finite()) && solution.cost.is_finite());
    assert!(covariance == &covariance.transpose() && covariance.cholesky().is_some(), "{covariance}");
    assert!((1.0 - 1e-12..1e12).contains(&condition), "{condition}");
    // The result is never less certain than the prior: the difference has no negative eigenvalue.
    let spread = prior.pose_covariance().cholesky().expect("a prior").l();
    let inverse = spread.try_inverse().expect("regular");
    let relative = SymmetricEigen::new(inverse * covariance * inverse.transpose()).eigenvalues;
    assert!(relative.max() <= 1.0 + 1e-9 && relative.min() > 0.0, "{relative}");
}
