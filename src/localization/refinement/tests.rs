//! Least squares on sights made up from a known pose: no image, so that the truth is exact.

use glam::{DQuat, DVec2, DVec3};
use nalgebra::{Matrix2, Matrix6, SymmetricEigen, Vector2, Vector6};
use proptest::prelude::*;

use super::miscalibration::{Miscalibration, UNSEEN_M_PER_S, row};
use super::offsets::Sight;
use super::solve::{self, Noise, Solution};
use super::{Errors, Prior, SCALES, error_between, moved_pose};
use crate::exact::{Exact, exact, rounded};
use crate::geometry::{Euler, Isometry, Lens, LensModel, LensParameters, Twist};
use crate::localization::random::{Purpose, Stream};
use crate::measured::largest_error;

const PIXELS_PER_RAD: f64 = 205.0;

/// Half a metre above the carpet, looking 20 degrees down.
fn camera(x: f64, y: f64, yaw: f64) -> Isometry {
    Isometry::from_euler(Euler { yaw, pitch: 0.35, roll: 0.02 }, DVec3::new(x, y, 0.49)) * Isometry::link_from_optical()
}

fn prior(map_from_optical: Isometry) -> Prior {
    let sigmas = Vector6::new(0.1, 0.1, 0.012, 0.012, 0.012, 0.06);
    Prior::of_pose(map_from_optical, &Matrix6::from_diagonal(&sigmas.component_mul(&sigmas)))
}

/// The same with a lens that is calibrated to half a percent and a pixel or so.
fn prior_with_lens(map_from_optical: Isometry) -> Prior {
    let mut prior = prior(map_from_optical);
    for (index, sigma) in [(6, 0.005), (7, 0.002), (8, 0.002), (9, 0.015)] {
        prior.covariance[(index, index)] = sigma * sigma;
    }
    prior.twist = MOVING;
    prior
}

/// Places are rays of these tests: what is a metre away.
const MOVING: Twist = Twist { linear: DVec3::new(0.1, 0.0, 0.3), angular: DVec3::new(0.3, -0.2, 0.4) };

fn lens() -> Lens {
    let (fx, fy) = (PIXELS_PER_RAD, PIXELS_PER_RAD);
    let model = LensModel::KannalaBrandt { k: [0.0; 4] };
    let fov_deg = Some(340.0);
    Lens::new(LensParameters { width: 640, height: 480, fx, fy, cx: 319.5, cy: 239.5, model, fov_deg }).expect("a lens")
}

/// What is seen through a lens that is off, by one who does not know.
fn misread(lens: &Lens, off: &Miscalibration, ray: DVec3) -> Option<DVec3> {
    let late_s = off.readout_s * row(lens, lens.project(ray)?);
    lens.unproject(off.drawn(lens, lens.project(ray + MOVING.passing(ray) * late_s)?))
}

/// The places of a straight line, every 10 cm.
fn line(from: DVec3, to: DVec3) -> Vec<(DVec3, DVec3)> {
    let count = (from.distance(to) / 0.1).round() as usize;
    let tangent = (to - from).normalize();
    (0..=count).map(|i| (from.lerp(to, i as f64 / count as f64), tangent)).collect()
}

/// A corner and a line across, as before a penalty area.
fn corner() -> Vec<Vec<(DVec3, DVec3)>> {
    vec![
        line(DVec3::new(1.5, -1.0, 0.0), DVec3::new(1.5, 1.2, 0.0)),
        line(DVec3::new(0.4, 1.2, 0.0), DVec3::new(1.5, 1.2, 0.0)),
        line(DVec3::new(0.2, -0.8, 0.0), DVec3::new(1.3, -0.8, 0.0)),
    ]
}

/// What a camera sees of them: each ray off its line by `noise(index)` pixels across, and anywhere along it.
fn sights(truth: &Isometry, lines: &[Vec<(DVec3, DVec3)>], mut noise: impl FnMut(usize) -> f64) -> Vec<Sight> {
    let mut sights = Vec::new();
    for (line, places) in lines.iter().enumerate() {
        for (index, (point, tangent)) in places.iter().enumerate() {
            let along = 0.03 * ((index % 3) as f64 - 1.0);
            let to = (*point + *tangent * along - truth.translation).normalize();
            let across = (*point - truth.translation).cross(*tangent).normalize();
            let ray = (to + across * (noise(sights.len()) / PIXELS_PER_RAD)).normalize();
            sights.push(Sight {
                ray: truth.rotation.conjugate() * ray,
                row: 0.0,
                distance: 1.0,
                bends: bends(truth.rotation.conjugate() * ray),
                point: *point,
                tangent: *tangent,
                sigmas: 1.0,
                pixels_per_rad: PIXELS_PER_RAD,
                line,
                follows: index > 0,
            });
        }
    }
    sights
}

/// By central differences.
fn bends(ray: DVec3) -> [DVec3; 4] {
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
    // Who takes the lens for longer takes what is seen for nearer to the axis.
    let bend = |i: usize| Some((misread(&lens, &less[i], ray)? - misread(&lens, &more[i], ray)?) / 2e-6);
    core::array::from_fn(|i| bend(i).unwrap_or_default())
}

fn normal(seed: u64, index: usize) -> f64 {
    Stream::new(seed, Purpose::Start, 0, 0, index as u32).normal()
}

fn pixel_noise(seed: u64) -> impl FnMut(usize) -> f64 {
    move |index| 0.25 * normal(seed, index)
}

/// As a frame is refined: wide loss, then narrow, with the noise that the frame shows.
fn solved(prior: &Prior, sights: &[Sight]) -> (Solution, Matrix6<f64>, f64) {
    let [_, wide, narrow] = SCALES;
    let first = solve::solve(prior, sights, &Vector6::zeros(), wide, Noise::USUAL).expect("a solution");
    let noise = Noise { correlated: Noise::USUAL.correlated, ..first.residuals.noise() };
    let second = solve::solve(prior, sights, &first.moved, narrow, noise).expect("a solution");
    let noise = second.residuals.noise();
    let joint = solve::joint(prior, sights, &second.moved, narrow, [noise; 2]).expect("a covariance");
    (second, super::pose_block(&joint.covariance), joint.condition)
}

fn assert_sound(prior: &Prior, solution: &Solution, covariance: &Matrix6<f64>, condition: f64) {
    assert!(solution.moved.iter().all(|value| value.is_finite()) && solution.cost.is_finite());
    assert!(covariance == &covariance.transpose() && covariance.cholesky().is_some(), "{covariance}");
    assert!((1.0 - 1e-12..1e12).contains(&condition), "{condition}");
    // Never more uncertain than before looking: the difference has no negative eigenvalue.
    let spread = prior.pose_covariance().cholesky().expect("a prior").l();
    let inverse = spread.try_inverse().expect("regular");
    let relative = SymmetricEigen::new(inverse * covariance * inverse.transpose()).eigenvalues;
    assert!(relative.max() <= 1.0 + 1e-9 && relative.min() > 0.0, "{relative}");
}

// ---------------------------------------------------------------- against an oracle

/// The same problem once more in 256 bits, written down differently: rotations by Rodrigues' formula, derivatives
/// by central differences, dense normal equations.
struct Oracle<'a, const N: usize> {
    prior: &'a Prior,
    /// Lower triangular factor of the prior's covariance.
    spread: [[Exact; N]; N],
    sights: &'a [Sight],
    scale: f64,
    noise: Noise,
}

type Vector = [Exact; 3];

fn vector(v: DVec3) -> Vector {
    v.to_array().map(exact)
}

fn cross(a: &Vector, b: &Vector) -> Vector {
    let part = |i: usize, j: usize| &a[i] * &b[j] - &a[j] * &b[i];
    [part(1, 2), part(2, 0), part(0, 1)]
}

fn dot(a: &Vector, b: &Vector) -> Exact {
    &a[0] * &b[0] + &a[1] * &b[1] + &a[2] * &b[2]
}

/// Rodrigues: v cos + (k x v) sin + k (k . v) (1 - cos).
fn turned(v: &Vector, turn: &Vector) -> Vector {
    let angle = dot(turn, turn).sqrt();
    if rounded(&angle) == 0.0 {
        return v.clone();
    }
    let axis = turn.clone().map(|part| part / &angle);
    let (sin, cos) = (angle.sin(), angle.cos());
    let (side, along) = (cross(&axis, v), dot(&axis, v) * (exact(1.0) - &cos));
    core::array::from_fn(|i| &v[i] * &cos + &side[i] * &sin + &axis[i] * &along)
}

impl<'a, const N: usize> Oracle<'a, N> {
    fn new(prior: &'a Prior, sights: &'a [Sight], scale: f64, noise: Noise) -> Self {
        let mut spread: [[Exact; N]; N] = core::array::from_fn(|_| core::array::from_fn(|_| exact(0.0)));
        for i in 0..N {
            for j in 0..=i {
                let rest = (0..j).fold(exact(prior.covariance[(i, j)]), |sum, k| sum - &spread[i][k] * &spread[j][k]);
                spread[i][j] = if i == j { rest.sqrt() } else { rest / &spread[j][j] };
            }
        }
        Self { prior, spread, sights, scale, noise }
    }

    /// Deviations in standard deviations of one measurement, before any loss; `y` in those of the prior.
    fn deviations(&self, y: &[Exact; N]) -> Vec<Exact> {
        let moved: [Exact; N] =
            core::array::from_fn(|i| (0..=i).fold(exact(0.0), |sum, j| sum + &self.spread[i][j] * &y[j]));
        let turn: Vector = [moved[3].clone(), moved[4].clone(), moved[5].clone()];
        let start = vector(self.prior.map_from_optical.translation);
        let q = self.prior.map_from_optical.rotation;
        let length = [q.x, q.y, q.z, q.w].map(exact).iter().fold(exact(0.0), |sum, x| sum + x * x).sqrt();
        let axis = [q.x, q.y, q.z].map(|x| exact(x) / &length);
        let w = exact(q.w) / &length;
        self.sights
            .iter()
            .map(|sight| {
                // q v q*: v + 2 w (a x v) + 2 a x (a x v).
                let mut ray = vector(sight.ray);
                for (bend, by) in sight.bends.iter().zip(moved.iter().skip(6)) {
                    let bend = vector(*bend);
                    ray = core::array::from_fn(|i| &ray[i] + &bend[i] * by);
                }
                let once = cross(&axis, &ray);
                let twice = cross(&axis, &once);
                let two = exact(2.0);
                let ray: Vector = core::array::from_fn(|i| &ray[i] + &two * &w * &once[i] + &two * &twice[i]);
                let ray = turned(&ray, &turn);
                let point = vector(sight.point);
                let off: Vector = core::array::from_fn(|i| &point[i] - &start[i] - &moved[i]);
                let across = cross(&off, &vector(sight.tangent));
                let residual = dot(&ray, &across) / dot(&across, &across).sqrt();
                residual * exact(sight.pixels_per_rad) / (exact(self.noise.sigma_px) * exact(sight.sigmas))
            })
            .collect()
    }

    /// The Gauss-Newton step with the loss's weights held, as y.
    fn step(&self, y: &[Exact; N]) -> [Exact; N] {
        // Exact enough that the error of central differences, h^2, is below 1e-35.
        let h = exact(2f64.powi(-60));
        let here = self.deviations(y);
        let columns: Vec<Vec<Exact>> = (0..N)
            .map(|j| {
                let at = |sign: f64| {
                    let mut moved = y.clone();
                    moved[j] = &moved[j] + &h * exact(sign);
                    self.deviations(&moved)
                };
                at(1.0).into_iter().zip(at(-1.0)).map(|(a, b)| (a - b) / (exact(2.0) * &h)).collect()
            })
            .collect();
        let vote = exact(self.noise.correlated);
        let weights: Vec<Exact> = here
            .iter()
            .map(|deviation| {
                let u = deviation / exact(self.scale);
                let robust = exact(1.0) / (exact(1.0) + &u * &u);
                &robust * &robust / &vote
            })
            .collect();
        let sum = |a: &[Exact], b: &[Exact]| {
            weights.iter().zip(a.iter().zip(b)).fold(exact(0.0), |sum, (w, (a, b))| sum + w * a * b)
        };
        let mut rows: Vec<Vec<Exact>> = (0..N)
            .map(|i| {
                let mut row: Vec<Exact> =
                    (0..N).map(|j| sum(&columns[i], &columns[j]) + exact(if i == j { 1.0 } else { 0.0 })).collect();
                row.push(-sum(&columns[i], &here) - &y[i]);
                row
            })
            .collect();
        // Gauss without pivots: the matrix is positive definite.
        for i in 0..N {
            let (above, below) = rows.split_at_mut(i + 1);
            for row in below {
                let factor = &row[i] / &above[i][i];
                for (value, above) in row.iter_mut().zip(&above[i]) {
                    *value = &*value - &factor * above;
                }
            }
        }
        let mut step: [Exact; N] = core::array::from_fn(|_| exact(0.0));
        for i in (0..N).rev() {
            let rest = (i + 1..N).fold(rows[i][N].clone(), |rest, j| rest - &rows[i][j] * &step[j]);
            step[i] = rest / &rows[i][i];
        }
        step
    }
}

fn zero<const N: usize>() -> [Exact; N] {
    core::array::from_fn(|_| exact(0.0))
}

#[test]
fn a_refinement_step_agrees_with_256_bits() {
    let mut largest = 0.0f64;
    for seed in 0..4 {
        let start = prior(camera(0.1 * seed as f64, 0.05, 0.2));
        let off = Vector6::from_fn(|i, _| normal(seed + 100, i))
            .component_mul(&Vector6::new(0.1, 0.1, 0.01, 0.01, 0.01, 0.05));
        let truth = moved_pose(&start.map_from_optical, &off);
        let sights = sights(&truth, &corner(), pixel_noise(seed));
        let noise = Noise::USUAL;
        let found = solve::step(&start, &sights, &Vector6::zeros(), SCALES[0], noise).expect("a step");
        let truth = Oracle::<6>::new(&start, &sights, SCALES[0], noise).step(&zero());
        let size = truth.iter().map(|y| rounded(y).abs()).fold(0.0, f64::max);
        let errors = found.iter().zip(&truth).map(|(found, truth)| rounded(&(exact(*found) - truth)).abs() / size);
        largest = errors.fold(largest, f64::max);
    }
    largest_error(largest, 2e-14, "of the step");
}

/// The last step, of the lens and of the pose that follows it: what all ten unknowns would do beyond what six do.
#[test]
fn a_step_of_the_lens_agrees_with_256_bits() {
    let mut largest = 0.0f64;
    for seed in 0..3 {
        let start = prior_with_lens(camera(0.1 * seed as f64, 0.05, 0.2));
        let off = Vector6::from_fn(|i, _| normal(seed + 100, i))
            .component_mul(&Vector6::new(0.1, 0.1, 0.01, 0.01, 0.01, 0.05));
        let sights = sights(&moved_pose(&start.map_from_optical, &off), &corner(), pixel_noise(seed));
        let noise = Noise::USUAL;
        let found = solve::joint(&start, &sights, &Vector6::zeros(), SCALES[0], [noise; 2]).expect("a step");
        let together = Oracle::<10>::new(&start, &sights, SCALES[0], noise).step(&zero());
        let pose_alone = Oracle::<6>::new(&start, &sights, SCALES[0], noise).step(&zero());
        let following = |i: usize| pose_alone.get(i).map_or(together[i].clone(), |alone| &together[i] - alone);
        let truth: [Exact; 10] = core::array::from_fn(following);
        let size = truth.iter().map(|y| rounded(y).abs()).fold(0.0, f64::max);
        let spread = start.covariance.cholesky().expect("a prior").l();
        let found = spread.solve_lower_triangular(&found.moved).expect("regular");
        let errors = found.iter().zip(&truth).map(|(found, truth)| rounded(&(exact(*found) - truth)).abs() / size);
        largest = errors.fold(largest, f64::max);
    }
    largest_error(largest, 2e-13, "of the step of the lens");
}

/// Where iterating ends, against the place where the oracle's steps end.
#[test]
fn the_refined_pose_is_where_256_bits_put_it() {
    let mut largest = 0.0f64;
    for seed in 0..3 {
        let start = prior(camera(0.1, 0.05, 0.2));
        let off = Vector6::from_fn(|i, _| normal(seed + 200, i))
            .component_mul(&Vector6::new(0.1, 0.1, 0.01, 0.01, 0.01, 0.05));
        let truth = moved_pose(&start.map_from_optical, &off);
        let sights = sights(&truth, &corner(), pixel_noise(seed + 10));
        let found = solve::solve(&start, &sights, &Vector6::zeros(), SCALES[0], Noise::USUAL).expect("a solution");
        let oracle = Oracle::<6>::new(&start, &sights, SCALES[0], Noise::USUAL);
        let mut y = zero();
        for _ in 0..12 {
            let step = oracle.step(&y);
            y = core::array::from_fn(|i| &y[i] + &step[i]);
        }
        let spread = start.pose_covariance().cholesky().expect("a prior").l();
        let minimum = spread * Vector6::from_fn(|i, _| rounded(&y[i]));
        let (_, covariance, _) = solved(&start, &sights);
        let miss = found.moved - minimum;
        largest = (0..6).map(|i| miss[i].abs() / covariance[(i, i)].sqrt()).fold(largest, f64::max);
    }
    largest_error(largest, 2e-2, "standard deviations of the refined pose");
}

// ---------------------------------------------------------------- poor views

#[test]
fn one_line_in_view_leaves_the_pose_free_along_it_alone() {
    let start = prior(camera(0.0, 0.0, 0.0));
    let truth = moved_pose(&start.map_from_optical, &Vector6::new(0.06, 0.05, 0.004, 0.005, -0.004, 0.03));
    let across = line(DVec3::new(1.2, -1.0, 0.0), DVec3::new(1.2, 1.0, 0.0));
    let sights = sights(&truth, &[across], pixel_noise(3));
    let (solution, covariance, condition) = solved(&start, &sights);
    assert_sound(&start, &solution, &covariance, condition);
    let sigma = |i: usize| covariance[(i, i)].sqrt();
    assert!(sigma(1) > 0.095, "along the line nothing is learnt: {}", sigma(1));
    assert!(sigma(0) < 0.045, "across it much: {}", sigma(0));
    assert!(solution.moved[1].abs() < 0.03, "no jump along it: {}", solution.moved[1]);
    let plane: Matrix2<f64> = covariance.fixed_view::<2, 2>(0, 0).into();
    let values = SymmetricEigen::new(plane).eigenvalues;
    assert!((values.max() / values.min()).sqrt() > 2.0, "{values}");
}

#[test]
fn collinear_points_few_points_and_none_leave_what_was_known() {
    let start = prior(camera(0.0, 0.0, 0.0));
    let truth = moved_pose(&start.map_from_optical, &Vector6::new(0.03, -0.04, 0.004, 0.005, -0.004, 0.02));
    let all = sights(&truth, &corner(), pixel_noise(4));
    for count in [0, 1, 2, 3, 5] {
        let few: Vec<Sight> = all.iter().step_by(9).take(count).copied().collect();
        let (solution, covariance, condition) = solved(&start, &few);
        assert_sound(&start, &solution, &covariance, condition);
        if count == 0 {
            assert_eq!((solution.moved, condition), (Vector6::zeros(), 1.0));
            assert!((covariance - start.pose_covariance()).amax() < 1e-15);
        }
    }
    // One ray again and again: as one point.
    let same = vec![all[5]; 400];
    let (solution, covariance, condition) = solved(&start, &same);
    assert_sound(&start, &solution, &covariance, condition);
    let free = SymmetricEigen::new(covariance).eigenvalues;
    assert!(free.max() > 0.009, "{free}");
}

#[test]
fn points_that_all_lie_far_off_are_rejected_and_move_nothing() {
    let start = prior(camera(0.0, 0.0, 0.0));
    // Every ray 60 px off, to this side and that: 240 standard deviations.
    let wrong = sights(&start.map_from_optical, &corner(), |index| if index % 2 == 0 { 60.0 } else { -60.0 });
    let (solution, covariance, condition) = solved(&start, &wrong);
    assert_sound(&start, &solution, &covariance, condition);
    assert_eq!(solution.residuals.fitting, 0);
    assert!(solution.moved.amax() < 0.02, "{}", solution.moved);
    assert!((0..6).all(|i| covariance[(i, i)] > 0.9 * start.covariance[(i, i)]), "{covariance}");
}

#[test]
fn a_field_a_million_metres_away_is_refined_as_well_as_one_here() {
    let far = DVec3::new(1e6, -1e6, 0.0);
    let shift = |pose: Isometry| Isometry::new(pose.rotation, pose.translation + far);
    let start = camera(0.0, 0.0, 0.0);
    let truth = moved_pose(&start, &Vector6::new(0.06, -0.05, 0.004, 0.005, -0.004, 0.03));
    let here = sights(&truth, &corner(), pixel_noise(5));
    let there: Vec<Sight> = here.iter().map(|sight| Sight { point: sight.point + far, ..*sight }).collect();
    let (near, near_covariance, _) = solved(&prior(start), &here);
    let (distant, covariance, condition) = solved(&prior(shift(start)), &there);
    assert_sound(&prior(shift(start)), &distant, &covariance, condition);
    assert!((covariance - near_covariance).amax() < 1e-8);
    // A millionth of a millimetre is what f64 has left there.
    largest_error((distant.moved - near.moved).amax(), 1e-10, "m or rad at 1e6 m");
}

#[test]
fn weights_that_span_twelve_orders_of_magnitude_leave_the_best_in_charge() {
    let start = prior(camera(0.0, 0.0, 0.0));
    let truth = moved_pose(&start.map_from_optical, &Vector6::new(0.03, -0.04, 0.004, 0.005, -0.004, 0.02));
    let mut all = sights(&truth, &corner(), |_| 0.0);
    for (index, sight) in all.iter_mut().enumerate() {
        // Squared, weights from 1 down to 1e-12.
        sight.sigmas = 10f64.powf(6.0 * index as f64 / 44.0);
    }
    for order in [1, -1] {
        if order < 0 {
            all.reverse();
        }
        let (solution, covariance, condition) = solved(&start, &all);
        assert_sound(&start, &solution, &covariance, condition);
        let error = error_between(&moved_pose(&start.map_from_optical, &solution.moved), &truth);
        let information = covariance.try_inverse().expect("regular");
        assert!(error.dot(&(information * error)) < 12.0, "{error}");
    }
}

/// Two starts, one in a wrong basin: what the lines cost tells them apart.
#[test]
fn several_starts_leave_a_wrong_basin() {
    let truth = camera(0.0, 0.0, 0.0);
    // Two parallel lines 40 cm apart, as goal line and goal area; the prior is one line off.
    let wide = Vector6::new(0.25, 0.1, 0.012, 0.012, 0.012, 0.06);
    let beside = moved_pose(&truth, &Vector6::new(0.4, 0.0, 0.0, 0.0, 0.0, 0.0));
    let start = Prior::of_pose(beside, &Matrix6::from_diagonal(&wide.component_mul(&wide)));
    let across = |x: f64| line(DVec3::new(x, -1.0, 0.0), DVec3::new(x, 1.0, 0.0));
    let along = line(DVec3::new(0.3, -0.7, 0.0), DVec3::new(1.2, -0.7, 0.0));
    let mut seen = sights(&truth, &[across(1.2), across(1.6), along], pixel_noise(6));
    // Associated as the prior expects: what is seen of the line at 1.2 is taken for the one at 1.6.
    for sight in seen.iter_mut().filter(|sight| sight.tangent.y > 0.5 && sight.point.x < 1.4) {
        sight.point.x += 0.4;
    }
    let outliers = seen.iter().filter(|sight| sight.tangent.y > 0.5).count() / 2;
    let from =
        |start_at: &Vector6<f64>| solve::solve(&start, &seen, start_at, SCALES[1], Noise::USUAL).expect("a solution");
    let (stuck, free) = (from(&Vector6::zeros()), from(&error_between(&start.map_from_optical, &truth)));
    assert!(stuck.residuals.fitting + free.residuals.fitting >= seen.len() - 2 && outliers > 15);
    assert!((stuck.moved[0] - free.moved[0]).abs() > 0.2, "two basins: {} {}", stuck.moved[0], free.moved[0]);
}

// ---------------------------------------------------------------- what a covariance promises

/// The 95 % ellipse holds 90 to 99 % of the truth where errors along a line are correlated, as those of images are. Where
/// they are independent it is too wide, by the allowance for what lines share ([`solve::SHARED`]); without that it is right.
#[test]
fn the_ellipse_holds_the_truth_as_often_as_it_says() {
    const DRAWS: u64 = 1500;
    let start = prior(camera(0.0, 0.0, 0.1));
    let factor = start.pose_covariance().cholesky().expect("a prior").l();
    for correlation in [0.0f64, 0.6] {
        let (mut stated, mut bare, mut nees) = ([0; 2], [0; 2], 0.0);
        for seed in 0..DRAWS {
            let off = factor * Vector6::from_fn(|i, _| normal(seed + 10_000, i));
            let truth = moved_pose(&start.map_from_optical, &off);
            // An autoregressive process along the lines.
            let mut last = 0.25 * normal(seed + 20_000, 0);
            let noise = |index: usize| {
                last = correlation * last + (1.0 - correlation * correlation).sqrt() * 0.25 * normal(seed, index);
                last
            };
            let (solution, covariance, condition) = solved(&start, &sights(&truth, &corner(), noise));
            assert_sound(&start, &solution, &covariance, condition);
            let error = error_between(&moved_pose(&start.map_from_optical, &solution.moved), &truth);
            let plane: Matrix2<f64> = covariance.fixed_view::<2, 2>(0, 0).into();
            let xy = Vector2::new(error[0], error[1]);
            // Squared deviations, each against its 95 % quantile.
            let squares = [
                xy.dot(&(plane.try_inverse().expect("regular") * xy)) / 5.991,
                error[5] * error[5] / covariance[(5, 5)] / 3.841,
            ];
            for (i, square) in squares.into_iter().enumerate() {
                stated[i] += usize::from(square < 1.0);
                bare[i] += usize::from(square * solve::SHARED < 1.0);
            }
            nees += error.dot(&(covariance.try_inverse().expect("regular") * error)) / 6.0 / DRAWS as f64;
        }
        let share = |counts: [usize; 2]| counts.map(|count| count as f64 / DRAWS as f64);
        let (stated, bare) = (share(stated), share(bare));
        println!("correlation {correlation}: position and heading {stated:?}, bare {bare:?}, NEES {nees:.2}");
        assert!(stated.iter().all(|share| *share >= 0.90), "correlation {correlation}: {stated:?}");
        let honest = if correlation > 0.0 { stated } else { bare };
        assert!(honest.iter().all(|share| (0.90..=0.99).contains(share)), "correlation {correlation}: {honest:?}");
    }
}

/// Lenses as wrong as their calibration says, and poses as wrong as the prior: both are found as well as the covariance says, and the
/// pose is off by less than if the lens were taken for right.
#[test]
fn what_a_lens_has_wrong_is_found_with_the_pose_and_its_covariance_is_honest() {
    const DRAWS: u64 = 800;
    let start = prior_with_lens(camera(0.0, 0.0, 0.1));
    let ignorant = prior(start.map_from_optical);
    let factor = start.covariance.cholesky().expect("a prior").l();
    let (mut held, mut held_if_ignorant, mut nees, mut off_m, mut off_if_ignorant_m) = (0, 0, 0.0, 0.0, 0.0);
    let lens = lens();
    for seed in 0..DRAWS {
        let off: Errors = factor * Errors::from_fn(|i, _| normal(seed + 30_000, i));
        let truth = moved_pose(&start.map_from_optical, &super::pose_part(&off));
        let wrong = Miscalibration { stretch: off[6], shift: DVec2::new(off[7], off[8]), readout_s: off[9] };
        let mut seen = sights(&truth, &corner(), pixel_noise(seed));
        for sight in &mut seen {
            sight.ray = misread(&lens, &wrong, sight.ray).expect("in view");
            sight.bends = bends(sight.ray);
        }
        let noise = Noise { sigma_px: 0.25, correlated: 1.0 };
        let [.., scale] = SCALES;
        let [knowing, not] = [&start, &ignorant].map(|prior| {
            let solution = solve::solve(prior, &seen, &Vector6::zeros(), SCALES[0], noise).expect("a solution");
            solve::joint(prior, &seen, &solution.moved, scale, [noise; 2]).expect("a covariance")
        });
        let within = |joint: &solve::Joint| {
            let error = joint.moved - off;
            let plane: Matrix2<f64> = joint.covariance.fixed_view::<2, 2>(0, 0).into();
            let xy = Vector2::new(error[0], error[1]);
            (xy.dot(&(plane.try_inverse().expect("regular") * xy)) < 5.991, xy.norm())
        };
        let ((is_held, m), (is_held_if_ignorant, if_ignorant_m)) = (within(&knowing), within(&not));
        held += u64::from(is_held);
        held_if_ignorant += u64::from(is_held_if_ignorant);
        (off_m, off_if_ignorant_m) = (off_m + m / DRAWS as f64, off_if_ignorant_m + if_ignorant_m / DRAWS as f64);
        let error = knowing.moved - off;
        nees += error.dot(&(knowing.covariance.try_inverse().expect("regular") * error)) / 10.0 / DRAWS as f64;
    }
    let [held, ignorant] = [held, held_if_ignorant].map(|count| count as f64 / DRAWS as f64);
    println!(
        "held {held:.3}, NEES {nees:.2}, {off_m:.5} m; lens taken for right: {ignorant:.3}, {off_if_ignorant_m:.5} m"
    );
    assert!((0.90..=0.99).contains(&held) && (0.7..1.4).contains(&nees), "{held} {nees}");
    assert!(ignorant < 0.7 && off_m < off_if_ignorant_m, "{ignorant} {off_m} {off_if_ignorant_m}");
}

/// Its torso sways as nothing tells while row after row is read: the pose in the middle row's time is found as well as the covariance
/// says, and better than by one who takes what is seen for one moment's.
#[test]
fn where_a_camera_was_that_swayed_unseen_while_rows_were_read_is_known_as_well_as_it_says() {
    const DRAWS: u64 = 800;
    const READOUT_S: f64 = 0.025;
    const SIGMA_PX: f64 = 0.08;
    let lens = lens();
    let of_a_moment = prior(camera(0.0, 0.0, 0.1));
    let mut swaying = of_a_moment.clone();
    swaying.lens.readout_s = READOUT_S;
    let factor = of_a_moment.pose_covariance().cholesky().expect("a prior").l();
    let noise = Noise { sigma_px: SIGMA_PX, correlated: 1.0 };
    let (mut held, mut nees, mut off_m) = ([0u64; 2], [0.0; 2], [0.0; 2]);
    for seed in 0..DRAWS {
        let off: Vector6<f64> = factor * Vector6::from_fn(|i, _| normal(seed + 50_000, i));
        let truth = moved_pose(&of_a_moment.map_from_optical, &off);
        let sways = DVec3::from_array(core::array::from_fn(|i| UNSEEN_M_PER_S * normal(seed + 60_000, i)));
        let mut seen = sights(&truth, &corner(), |index| SIGMA_PX * normal(seed, index));
        for sight in &mut seen {
            sight.row = row(&lens, lens.project(sight.ray).expect("in view"));
            sight.distance = sight.point.distance(truth.translation);
            sight.ray = (sight.ray * sight.distance - sways * READOUT_S * sight.row).normalize();
        }
        for (i, prior) in [&swaying, &of_a_moment].into_iter().enumerate() {
            let solution = solve::solve(prior, &seen, &Vector6::zeros(), SCALES[0], noise).expect("a solution");
            let joint = solve::joint(prior, &seen, &solution.moved, SCALES[2], [noise; 2]).expect("a covariance");
            let (error, covariance) = (super::pose_part(&joint.moved) - off, super::pose_block(&joint.covariance));
            let plane: Matrix2<f64> = covariance.fixed_view::<2, 2>(0, 0).into();
            let xy = Vector2::new(error[0], error[1]);
            held[i] += u64::from(xy.dot(&(plane.try_inverse().expect("regular") * xy)) < 5.991);
            nees[i] += error.dot(&(covariance.try_inverse().expect("regular") * error)) / 6.0 / DRAWS as f64;
            off_m[i] += xy.norm() / DRAWS as f64;
        }
    }
    let held = held.map(|count| count as f64 / DRAWS as f64);
    println!("held {held:.3?}, NEES {nees:.2?}, {off_m:.5?} m");
    assert!((0.90..=0.99).contains(&held[0]) && (0.7..1.4).contains(&nees[0]), "{held:?} {nees:?}");
    assert!(held[1] < 0.9 && off_m[0] < off_m[1], "{held:?} {off_m:?}");
}

fn tilted(turn: f64) -> DQuat {
    DQuat::from_rotation_z(turn)
}

proptest! {
    /// Whatever the lines say, at a fixed pose and fixed noise another one never makes the pose less certain.
    #[test]
    fn more_lines_never_widen_the_covariance(seed in 0u64..1000, few in 1usize..40) {
        let start = prior_with_lens(camera(0.0, 0.0, 0.0));
        let all = sights(&start.map_from_optical, &corner(), pixel_noise(seed));
        let covariance = |sights: &[Sight]| {
            solve::joint(&start, sights, &Vector6::zeros(), SCALES[1], [Noise::USUAL; 2]).expect("a covariance").covariance
        };
        let (less, more) = (covariance(&all[..few]), covariance(&all));
        let factor = less.cholesky().expect("positive definite").l().try_inverse().expect("regular");
        let ratio = SymmetricEigen::new(factor * more * factor.transpose()).eigenvalues;
        prop_assert!(ratio.max() <= 1.0 + 1e-9, "{}", ratio);
    }

    /// Field and robot elsewhere together: the same errors of the pose, in turned axes.
    #[test]
    fn rotating_and_shifting_field_and_robot_together_changes_nothing(
        x in -20.0..20.0f64, y in -20.0..20.0f64, turn in -3.1..3.1f64, seed in 0u64..1000,
    ) {
        let moved_by = Isometry::new(tilted(turn), DVec3::new(x, y, 0.0));
        let start = prior(camera(0.1, 0.0, 0.2));
        let truth = moved_pose(&start.map_from_optical, &Vector6::new(0.04, -0.03, 0.004, 0.005, -0.004, 0.02));
        let here = sights(&truth, &corner(), pixel_noise(seed));
        let there: Vec<Sight> = here
            .iter()
            .map(|sight| Sight {
                point: moved_by.transform_point(sight.point),
                tangent: moved_by.transform_vector(sight.tangent),
                ..*sight
            })
            .collect();
        let mut axes = Matrix6::zeros();
        for (row, column, value) in [(0, 0, turn.cos()), (0, 1, -turn.sin()), (1, 0, turn.sin()), (1, 1, turn.cos())] {
            axes[(row, column)] = value;
            axes[(row + 3, column + 3)] = value;
        }
        axes[(2, 2)] = 1.0;
        axes[(5, 5)] = 1.0;
        let covariance = axes * start.pose_covariance() * axes.transpose();
        let covariance = (covariance + covariance.transpose()) * 0.5;
        let elsewhere = Prior::of_pose(moved_by * start.map_from_optical, &covariance);
        let ((a, a_covariance, _), (b, b_covariance, _)) = (solved(&start, &here), solved(&elsewhere, &there));
        prop_assert!((axes * a.moved - b.moved).amax() < 1e-9, "{} {}", axes * a.moved, b.moved);
        prop_assert!((axes * a_covariance * axes.transpose() - b_covariance).amax() < 1e-9);
    }

    /// Any prior, any lines: a covariance that is one, and no number that is none.
    #[test]
    fn the_covariance_is_positive_definite_always(
        seed in any::<u64>(), count in 0usize..45, sizes in proptest::array::uniform6(-5.0..1.0f64),
        off_px in 0.0..200.0f64, height in 0.01..30.0f64,
    ) {
        let mut start = prior(camera(0.0, 0.0, 0.0));
        start.map_from_optical.translation.z = height;
        let mixed = Matrix6::from_fn(|i, j| 10f64.powf(sizes[i]) * (normal(seed, 6 * i + j) + f64::from(u8::from(i == j))));
        let covariance = mixed * mixed.transpose();
        start = Prior::of_pose(start.map_from_optical, &(covariance + Matrix6::identity() * (1e-9 * covariance.trace())));
        let seen = sights(&start.map_from_optical, &corner(), |index| off_px * normal(seed ^ 1, index));
        let found = solve::solve(&start, &seen[..count], &Vector6::zeros(), SCALES[0], Noise::USUAL);
        let solution = found.expect("a covariance has a factor");
        let joint =
            solve::joint(&start, &seen[..count], &solution.moved, SCALES[1], [solution.residuals.noise(); 2]).expect("one");
        assert_sound(&start, &solution, &super::pose_block(&joint.covariance), joint.condition);
    }
}
