//! Comparison of steps and poses with a computation in 256 bits.

use super::*;
use realitysim_test_support::exact::{Exact, exact, rounded};
use realitysim_test_support::measured::largest_error;

/// The same problem in 256 bits, written differently: rotations by Rodrigues' formula, derivatives by central differences,
/// dense normal equations.
struct Oracle<'a, const N: usize> {
    prior: &'a Prior,
    /// Lower triangular factor of the prior's covariance.
    spread: [[Exact; N]; N],
    measurements: &'a [LineMeasurement],
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
    fn new(prior: &'a Prior, measurements: &'a [LineMeasurement], scale: f64, noise: Noise) -> Self {
        let mut spread: [[Exact; N]; N] = core::array::from_fn(|_| core::array::from_fn(|_| exact(0.0)));
        for i in 0..N {
            for j in 0..=i {
                let rest = (0..j).fold(exact(prior.covariance[(i, j)]), |sum, k| sum - &spread[i][k] * &spread[j][k]);
                spread[i][j] = if i == j { rest.sqrt() } else { rest / &spread[j][j] };
            }
        }
        Self { prior, spread, measurements, scale, noise }
    }

    /// Deviations in standard deviations of one measurement, before the loss; `y` is in those of the prior.
    fn deviations(&self, y: &[Exact; N]) -> Vec<Exact> {
        let moved: [Exact; N] =
            core::array::from_fn(|i| (0..=i).fold(exact(0.0), |sum, j| sum + &self.spread[i][j] * &y[j]));
        let turn: Vector = [moved[3].clone(), moved[4].clone(), moved[5].clone()];
        let start = vector(self.prior.map_from_optical.translation);
        let q = self.prior.map_from_optical.rotation;
        let length = [q.x, q.y, q.z, q.w].map(exact).iter().fold(exact(0.0), |sum, x| sum + x * x).sqrt();
        let axis = [q.x, q.y, q.z].map(|x| exact(x) / &length);
        let w = exact(q.w) / &length;
        self.measurements
            .iter()
            .map(|measurement| {
                // q v q*: v + 2 w (a x v) + 2 a x (a x v).
                let mut ray = vector(measurement.ray);
                for (bend, by) in measurement.ray_by_lens.iter().zip(moved.iter().skip(6)) {
                    let bend = vector(*bend);
                    ray = core::array::from_fn(|i| &ray[i] + &bend[i] * by);
                }
                let once = cross(&axis, &ray);
                let twice = cross(&axis, &once);
                let two = exact(2.0);
                let ray: Vector = core::array::from_fn(|i| &ray[i] + &two * &w * &once[i] + &two * &twice[i]);
                let ray = turned(&ray, &turn);
                let point = vector(measurement.point);
                let off: Vector = core::array::from_fn(|i| &point[i] - &start[i] - &moved[i]);
                let across = cross(&off, &vector(measurement.tangent));
                let residual = dot(&ray, &across) / dot(&across, &across).sqrt();
                residual * exact(measurement.pixels_per_rad) / (exact(self.noise.sigma_px) * exact(measurement.sigmas))
            })
            .collect()
    }

    /// The Gauss-Newton step in y, with the weights of the loss held fixed.
    fn step(&self, y: &[Exact; N]) -> [Exact; N] {
        // Small enough that the error of central differences, h^2, is below 1e-35.
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
        // Gaussian elimination without pivots: the matrix is positive definite.
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
        let measurements = measurements(&truth, &corner(), pixel_noise(seed));
        let noise = Noise::USUAL;
        let found = solve::step(&start, &measurements, &Vector6::zeros(), SCALES[0], noise).expect("a step");
        let truth = Oracle::<6>::new(&start, &measurements, SCALES[0], noise).step(&zero());
        let size = truth.iter().map(|y| rounded(y).abs()).fold(0.0, f64::max);
        let errors = found.iter().zip(&truth).map(|(found, truth)| rounded(&(exact(*found) - truth)).abs() / size);
        largest = errors.fold(largest, f64::max);
    }
    largest_error(largest, 2e-14, "of the step");
}

/// The last step is that of the lens and of the pose that follows it: what all ten unknowns do beyond what six do.
#[test]
fn a_step_of_the_lens_agrees_with_256_bits() {
    let mut largest = 0.0f64;
    for seed in 0..3 {
        let start = prior_with_lens(camera(0.1 * seed as f64, 0.05, 0.2));
        let off = Vector6::from_fn(|i, _| normal(seed + 100, i))
            .component_mul(&Vector6::new(0.1, 0.1, 0.01, 0.01, 0.01, 0.05));
        let measurements = measurements(&moved_pose(&start.map_from_optical, &off), &corner(), pixel_noise(seed));
        let noise = Noise::USUAL;
        let found = solve::joint(&start, &measurements, &Vector6::zeros(), SCALES[0], [noise; 2]).expect("a step");
        let together = Oracle::<10>::new(&start, &measurements, SCALES[0], noise).step(&zero());
        let pose_alone = Oracle::<6>::new(&start, &measurements, SCALES[0], noise).step(&zero());
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

/// The end of the iteration agrees with the end of the oracle's.
#[test]
fn the_refined_pose_is_where_256_bits_put_it() {
    let mut largest = 0.0f64;
    for seed in 0..3 {
        let start = prior(camera(0.1, 0.05, 0.2));
        let off = Vector6::from_fn(|i, _| normal(seed + 200, i))
            .component_mul(&Vector6::new(0.1, 0.1, 0.01, 0.01, 0.01, 0.05));
        let truth = moved_pose(&start.map_from_optical, &off);
        let measurements = measurements(&truth, &corner(), pixel_noise(seed + 10));
        let found =
            solve::solve(&start, &measurements, &Vector6::zeros(), SCALES[0], Noise::USUAL).expect("a solution");
        let oracle = Oracle::<6>::new(&start, &measurements, SCALES[0], Noise::USUAL);
        let mut y = zero();
        for _ in 0..12 {
            let step = oracle.step(&y);
            y = core::array::from_fn(|i| &y[i] + &step[i]);
        }
        let spread = start.pose_covariance().cholesky().expect("a prior").l();
        let minimum = spread * Vector6::from_fn(|i, _| rounded(&y[i]));
        let (_, covariance, _) = solved(&start, &measurements);
        let miss = found.moved - minimum;
        largest = (0..6).map(|i| miss[i].abs() / covariance[(i, i)].sqrt()).fold(largest, f64::max);
    }
    largest_error(largest, 2e-2, "standard deviations of the refined pose");
}
