//! Fast projection by a table, for many projections a frame.
//!
//! A fisheye draws a unit ray at `focal x r(theta) / sin(theta)` times its part across the axis. That factor is a smooth function of
//! cos(theta), tabulated here, so that a projection costs a square root instead of an arc tangent. The error
//! against [`Lens::project`] is below 1e-3 px for 1000 px a radian (tested).

use glam::{DVec2, DVec3};

use super::{Curve, Lens};

/// A lens with a table of its projection.
#[derive(Clone, Debug, PartialEq)]
pub struct Projector {
    lens: Lens,
    /// r(theta) / sin(theta) at even steps of cos(theta) from `min_cos` up to 1. Empty for pinholes, which are cheap without a table,
    /// and for models that are too steep for one.
    factors: Vec<f64>,
    /// cos(theta) of the first entry.
    min_cos: f64,
    /// Number of entries for a step of 1 in cos(theta).
    nodes_per_unit: f64,
    /// What a point's row adds to its column, both in focal lengths.
    skew: f64,
}

/// Number of entries of the table.
const NODES: usize = 4096;
/// Largest error of the table, in focal lengths: 1e-3 px at a focal length of 1000 px.
const MAX_TABLE_ERROR: f64 = 1e-6;

impl Projector {
    /// Tabulates the projection of a lens.
    pub fn new(lens: &Lens) -> Self {
        let lens = lens.clone();
        let Curve::Radial(radial) = &lens.curve else {
            return Self { lens, factors: Vec::new(), min_cos: 1.0, nodes_per_unit: 0.0, skew: 0.0 };
        };
        let max_angle = radial.max_angle();
        // The factor is infinite straight behind the lens: the last thousandth of a radian is left to the exact path.
        let min_cos = libm::cos(max_angle.min(core::f64::consts::PI - 1e-3));
        let step = (1.0 - min_cos) / (NODES - 1) as f64;
        let factors = (0..NODES)
            .map(|node| {
                let angle = libm::acos((min_cos + node as f64 * step).clamp(-1.0, 1.0)).max(1e-9);
                radial.radius(angle) / libm::sin(angle)
            })
            .collect();
        let (can_be_steep, skew) = (radial.can_be_steep(), radial.skew());
        let projector = Self { min_cos, nodes_per_unit: 1.0 / step, factors, skew, lens };
        if can_be_steep && !projector.is_fine_enough() {
            return Self { factors: Vec::new(), ..projector };
        }
        projector
    }

    /// Whether the table is within [`MAX_TABLE_ERROR`] of the lens between all its entries.
    fn is_fine_enough(&self) -> bool {
        let Curve::Radial(radial) = &self.lens.curve else { return true };
        self.factors.windows(2).enumerate().all(|(node, around)| {
            let angle = libm::acos((self.min_cos + (node as f64 + 0.5) / self.nodes_per_unit).clamp(-1.0, 1.0));
            let (sin, middle) = (libm::sin(angle), (around[0] + around[1]) / 2.0);
            (middle * sin - radial.radius(angle)).abs() <= MAX_TABLE_ERROR
        })
    }

    /// The lens that the table was made from.
    pub fn lens(&self) -> &Lens {
        &self.lens
    }

    /// Projects a ray like [`Lens::project`], with the error that the module states.
    pub fn project(&self, ray: DVec3) -> Option<DVec2> {
        let square = ray.length_squared();
        if square == f64::INFINITY {
            return self.lens.project(ray);
        }
        let inverse = 1.0 / libm::sqrt(square);
        let at = (ray.z * inverse - self.min_cos) * self.nodes_per_unit;
        // NaN, rays outside the table and lenses without a table take the exact path.
        if !(at >= 0.0 && at < (NODES - 1) as f64) || self.factors.is_empty() {
            return if at < 0.0 && !self.factors.is_empty() { None } else { self.lens.project(ray) };
        }
        let node = at as usize;
        let (low, high) = (self.factors[node], self.factors[node + 1]);
        let factor = (low + (high - low) * (at - node as f64)) * inverse;
        let p = &self.lens.parameters;
        let x = if self.skew == 0.0 { ray.x } else { ray.x + self.skew * ray.y };
        Some(DVec2::new(p.cx + p.fx * x * factor, p.cy + p.fy * ray.y * factor))
    }

    /// Projects `N` rays at a time like [`Self::project`], with the precision of f32.
    ///
    /// The argument holds x, y and z of the rays, which may have any length. The result holds u and v of the pixels, NaN outside the
    /// field of view.
    #[inline(always)]
    pub fn project_all<const N: usize>(&self, [xs, ys, zs]: &[[f32; N]; 3]) -> [[f32; N]; 2] {
        let mut pixels = [[f32::NAN; N]; 2];
        if self.factors.is_empty() {
            for i in 0..N {
                if let Some(pixel) = self.lens.project(DVec3::new(xs[i].into(), ys[i].into(), zs[i].into())) {
                    (pixels[0][i], pixels[1][i]) = (pixel.x as f32, pixel.y as f32);
                }
            }
            return pixels;
        }
        // The compiler vectorises the loops before and after the one that reads the table.
        let (min_cos, nodes_per_unit) = (self.min_cos as f32, self.nodes_per_unit as f32);
        let (mut inverses, mut ats) = ([0f32; N], [0f32; N]);
        for i in 0..N {
            inverses[i] = 1.0 / (xs[i] * xs[i] + ys[i] * ys[i] + zs[i] * zs[i]).sqrt();
            ats[i] = (zs[i] * inverses[i] - min_cos) * nodes_per_unit;
        }
        let mut factors = [f32::NAN; N];
        for (factor, at) in factors.iter_mut().zip(&ats) {
            // NaN fails this comparison.
            if *at >= 0.0 {
                let node = (*at as usize).min(NODES - 2);
                let (low, high) = (self.factors[node] as f32, self.factors[node + 1] as f32);
                *factor = low + (high - low) * (at - node as f32);
            }
        }
        let p = &self.lens.parameters;
        let (cx, cy, fx, fy) = (p.cx as f32, p.cy as f32, p.fx as f32, p.fy as f32);
        for i in 0..N {
            let factor = factors[i] * inverses[i];
            pixels[0][i] = cx + fx * xs[i] * factor;
            pixels[1][i] = cy + fy * ys[i] * factor;
        }
        if self.skew != 0.0 {
            let skew = self.skew as f32;
            for i in 0..N {
                pixels[0][i] += fx * skew * ys[i] * (factors[i] * inverses[i]);
            }
        }
        pixels
    }

    /// Projects a ray, or gives `None` if the pixel lies outside the image.
    pub fn project_inside(&self, ray: DVec3) -> Option<DVec2> {
        self.project(ray).filter(|pixel| self.lens.contains(*pixel))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{LensModel, LensParameters};

    #[test]
    fn the_table_draws_where_the_lens_does() {
        let (mut worst, mut count) = (0.0f64, 0);
        for (model, fov_deg) in [
            (LensModel::KannalaBrandt { k: [0.0; 4] }, Some(200.0)),
            (LensModel::KannalaBrandt { k: [-0.02, 0.004, -0.0015, 0.0002] }, Some(180.0)),
            (LensModel::Equisolid, Some(220.0)),
            (LensModel::PlumbBob { d: [-0.2, 0.05, 0.001, -0.001, 0.0] }, None),
            (LensModel::DoubleSphere { xi: -0.2, alpha: 0.6 }, Some(210.0)),
            (LensModel::Eucm { alpha: 0.62, beta: 1.1 }, Some(190.0)),
            (LensModel::Scaramuzza { c: [-0.31, 0.05, -0.06, 0.0, 0.0], skew: 0.003 }, Some(200.0)),
        ] {
            let parameters = LensParameters {
                width: 4000,
                height: 4000,
                fx: 1000.0,
                fy: 990.0,
                cx: 2000.0,
                cy: 1990.0,
                model,
                fov_deg,
            };
            let lens = Lens::new(parameters).expect("a good lens");
            let projector = Projector::new(&lens);
            for i in 0..400 {
                for j in 0..40 {
                    let (angle, around) = (lens.max_angle() * (f64::from(i) + 0.5) / 400.0, f64::from(j) * 0.157);
                    let (sin, cos) = libm::sincos(angle);
                    let ray = DVec3::new(sin * libm::cos(around), sin * libm::sin(around), cos) * 1.7;
                    let (exact, fast) = (lens.project(ray), projector.project(ray));
                    let [[u], [v]] = projector.project_all(&ray.as_vec3().to_array().map(|part| [part]));
                    match exact {
                        // Coordinates of some thousand pixels have 24 bits in f32.
                        Some(exact) => {
                            assert!(exact.distance(DVec2::new(u.into(), v.into())) < 2e-2, "{exact} {u} {v}")
                        }
                        None => assert!(u.is_nan() && v.is_nan()),
                    }
                    if let (Some(exact), Some(fast)) = (exact, fast) {
                        worst = worst.max(exact.distance(fast));
                        count += 1;
                    } else {
                        assert_eq!(exact, fast);
                    }
                }
            }
        }
        assert!(count > 50_000, "{count} rays");
        realitysim_test_support::measured::largest_error(worst, 4e-5, "px at 1000 px a radian");
    }

    #[test]
    fn what_has_no_pixel_has_none() {
        let parameters = LensParameters {
            width: 640,
            height: 480,
            fx: 210.0,
            fy: 210.0,
            cx: 320.0,
            cy: 240.0,
            model: LensModel::KannalaBrandt { k: [0.0; 4] },
            fov_deg: Some(180.0),
        };
        let projector = Projector::new(&Lens::new(parameters).expect("a good lens"));
        for ray in [DVec3::ZERO, DVec3::NAN, -DVec3::Z, DVec3::new(1.0, 0.0, -0.1)] {
            assert_eq!(projector.project(ray), None, "{ray}");
        }
        assert_eq!(projector.project(DVec3::Z), Some(DVec2::new(320.0, 240.0)));
    }
}
