//! Formulas against the same in 256 bits.

use glam::{DVec2, DVec3};
use realitysim::geometry::{Lens, LensModel};
use realitysim::localization::random::{Purpose, Stream};
use realitysim::localization::weights::normalise;

use super::lens::lenses;
use realitysim_test_support::exact::{Exact, exact, rounded};
use realitysim_test_support::measured::largest_error;

fn relative_error(found: f64, truth: &Exact) -> f64 {
    rounded(&((exact(found) - truth) / truth)).abs()
}

fn absolute_error(found: f64, truth: &Exact) -> f64 {
    rounded(&(exact(found) - truth)).abs()
}

/// Log weights of many shapes: nearly equal, spread over what f64 can hold, shifted far from 0.
fn sets() -> Vec<Vec<f64>> {
    let mut sets = Vec::new();
    for (index, count) in [1usize, 2, 7, 64, 65, 300, 1000].into_iter().enumerate() {
        for (shape, (spread, offset)) in [(1e-9, 0.0), (1.0, -1e6), (30.0, 3.0), (700.0, 1e6)].into_iter().enumerate() {
            let log = |i: usize| {
                let uniform = Stream::new(9, Purpose::Start, index as u64, shape as u32, i as u32).uniform();
                offset - spread * uniform
            };
            sets.push((0..count).map(log).collect());
        }
    }
    sets
}

#[test]
fn weights_evidence_and_effective_sample_size_agree_with_256_bits() {
    let (mut of_shares, mut of_size, mut of_evidence) = (0.0f64, 0.0f64, 0.0f64);
    for logs in sets() {
        let found = normalise(&logs);
        let raw: Vec<Exact> = logs.iter().map(|log| exact(*log).exp()).collect();
        let sum = raw.iter().fold(exact(0.0), |sum, weight| sum + weight);
        let squares = raw.iter().fold(exact(0.0), |sum, weight| sum + weight * weight);
        for (share, weight) in found.shares.iter().zip(&raw) {
            of_shares = of_shares.max(relative_error(*share, &(weight / &sum)));
        }
        of_size = of_size.max(relative_error(found.effective_sample_size, &(&sum * &sum / squares)));
        let evidence = (sum / exact(logs.len() as f64)).ln();
        of_evidence = of_evidence.max(absolute_error(found.evidence, &evidence) / rounded(&evidence).abs().max(1.0));
    }
    largest_error(of_shares, 5e-16, "of a weight");
    largest_error(of_size, 8e-16, "of the sample size");
    largest_error(of_evidence, 4e-16, "of the evidence");
}

fn hypot(a: &Exact, b: &Exact) -> Exact {
    (a * a + b * b).sqrt()
}

/// OpenCV's distortion with thin prism terms, of a point in the plane at distance 1.
fn opencv(d: [f64; 12], a: Exact, b: Exact) -> (Exact, Exact) {
    let [k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4] = d.map(exact);
    let s = &a * &a + &b * &b;
    let [one, two] = [1.0, 2.0].map(exact);
    let above = &one + &s * (k1 + &s * (k2 + &s * k3));
    let radial = above / (&one + &s * (k4 + &s * (k5 + &s * k6)));
    let u = &a * &radial + &two * &p1 * &a * &b + &p2 * (&s + &two * &a * &a) + &s * (s1 + &s * s2);
    let v = &b * &radial + &p1 * (&s + &two * &b * &b) + &two * &p2 * &a * &b + &s * (s3 + &s * s4);
    (u, v)
}

/// Where the model's own formula draws a ray.
fn drawn(lens: &Lens, ray: DVec3) -> [Exact; 2] {
    let [x, y, z] = ray.to_array().map(exact);
    let off_axis = hypot(&x, &y);
    let p = lens.parameters();
    let (u, v) = match p.model {
        LensModel::KannalaBrandt { k } => {
            let angle = off_axis.atan2(&z);
            let s = &angle * &angle;
            let series = k.iter().rev().fold(exact(0.0), |sum, k| (sum + exact(*k)) * &s);
            let scale = angle * (exact(1.0) + series) / off_axis;
            (x * &scale, y * scale)
        }
        LensModel::Equisolid => {
            let half = off_axis.atan2(&z) / exact(2.0);
            let scale = exact(2.0) * half.sin() / off_axis;
            (x * &scale, y * scale)
        }
        LensModel::PlumbBob { d } => {
            let [k1, k2, p1, p2, k3] = d.map(exact);
            let (a, b) = (x / &z, y / &z);
            let s = &a * &a + &b * &b;
            let radial = exact(1.0) + &s * (k1 + &s * (k2 + &s * k3));
            let two = exact(2.0);
            let u = &a * &radial + &two * &p1 * &a * &b + &p2 * (&s + &two * &a * &a);
            let v = &b * &radial + &p1 * (&s + &two * &b * &b) + &two * &p2 * &a * &b;
            (u, v)
        }
        LensModel::RationalPolynomial { d: [k1, k2, p1, p2, k3, k4, k5, k6] } => {
            opencv([k1, k2, p1, p2, k3, k4, k5, k6, 0.0, 0.0, 0.0, 0.0], x / &z, y / &z)
        }
        LensModel::ThinPrism { d } => opencv(d, x / &z, y / &z),
        LensModel::DoubleSphere { xi, alpha } => {
            let length = (&off_axis * &off_axis + &z * &z).sqrt();
            let depth = exact(xi) * &length + &z;
            let below = exact(alpha) * hypot(&off_axis, &depth) + (exact(1.0) - exact(alpha)) * &depth;
            (x / &below, y / below)
        }
        LensModel::Eucm { alpha, beta } => {
            let distance = (exact(beta) * &off_axis * &off_axis + &z * &z).sqrt();
            let below = exact(alpha) * distance + (exact(1.0) - exact(alpha)) * &z;
            (x / &below, y / below)
        }
        LensModel::Scaramuzza { c, skew } => {
            let angle = off_axis.atan2(&z);
            // Newton's method on theta(r) = atan2(r, g(r)) doubles the digits that the lens has found.
            let at = lens.project(ray).expect("drawn");
            let (row, column) = ((at.y - p.cy) / p.fy, (at.x - p.cx) / p.fx);
            let mut r = exact((column - skew * row).hypot(row));
            for _ in 0..4 {
                let [mut g, mut slope] = [exact(1.0), exact(0.0)];
                for (i, c) in c.iter().enumerate() {
                    g += exact(*c) * r.powi((i as i32 + 2).into());
                    slope += exact(*c) * exact((i + 2) as f64) * r.powi((i as i32 + 1).into());
                }
                let miss = r.atan2(&g) - &angle;
                r = &r - miss * (&r * &r + &g * &g) / (&g - &r * slope);
            }
            let (x, y) = (x * &r / &off_axis, y * &r / &off_axis);
            (x + exact(skew) * &y, y)
        }
    };
    [exact(p.cx) + exact(p.fx) * u, exact(p.cy) + exact(p.fy) * v]
}

#[test]
fn projection_agrees_with_256_bits() {
    let mut largest = 0.0f64;
    for (name, lens) in lenses() {
        let mut seen = 0;
        for index in 0..150u32 {
            let mut draw = Stream::new(2, Purpose::Start, 0, 0, index);
            let angle = lens.max_angle() * draw.uniform();
            let around = 6.25 * draw.uniform();
            let ray = DVec3::new(angle.sin() * around.cos(), angle.sin() * around.sin(), angle.cos()) * 3.7;
            let Some(pixel) = lens.project(ray) else { continue };
            let [u, v] = drawn(&lens, ray);
            let off = DVec2::new(absolute_error(pixel.x, &u), absolute_error(pixel.y, &v));
            largest = largest.max(off.length());
            seen += 1;
        }
        assert!(seen > 100, "{name}: {seen}");
    }
    largest_error(largest, 2e-13, "px");
}
