//! The paper's map between two images, Eq. 3-4: each coordinate in one image is a quadratic polynomial of both coordinates
//! in the other, fitted by least squares to points of the ground that both show.

use glam::DVec2;
use nalgebra::{DMatrix, Matrix6, SMatrix};
use thiserror::Error;

/// Terms of the polynomial: 1, x, y, x^2, x y, y^2.
const TERMS: usize = 6;
/// Largest condition number of the normalised system that is accepted. Views of a field have a tenth of it; points on a
/// line have far more.
const CONDITION_LIMIT: f64 = 1e3;

/// A quadratic map from pixels to pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quadratic {
    from: Normalization,
    to: Normalization,
    /// Coefficients for x and for y, in normalised coordinates.
    coefficients: [[f64; TERMS]; 2],
    condition: f64,
    residual: Residual,
}

/// Distance between where the map puts points and where they should be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Residual {
    /// Root mean square, pixels.
    pub rms_px: f64,
    /// Largest distance, pixels.
    pub max_px: f64,
}

/// The reason why a map cannot be fitted.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum FitError {
    /// There are fewer points than the polynomial has terms.
    #[error("{found} common points of the ground, and a quadratic map needs at least {TERMS}")]
    FewPoints {
        /// Number of points.
        found: usize,
    },
    /// The points do not determine the polynomial.
    #[error(
        "the common points of the ground lie on a line or curve that leaves the map open (condition number \
         {condition:.1e}, at most {CONDITION_LIMIT:.0e} is usable)"
    )]
    Degenerate {
        /// Condition number of the normalised system.
        condition: f64,
    },
    /// A coordinate is NaN or infinite.
    #[error("a point is not finite")]
    NotFinite,
}

/// Translation and scaling that give points the mean 0 and the root mean square distance sqrt(2) from it (Hartley 1997). In
/// raw pixels the normal equations have a condition number of 2e13.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Normalization {
    centre: DVec2,
    scale: f64,
}

impl Normalization {
    fn of(points: impl Iterator<Item = DVec2> + Clone) -> Self {
        let count = points.clone().count().max(1) as f64;
        let centre = points.clone().sum::<DVec2>() / count;
        let spread = libm::sqrt(points.map(|point| point.distance_squared(centre)).sum::<f64>() / count);
        Self { centre, scale: core::f64::consts::SQRT_2 / spread.max(1e-9) }
    }

    fn apply(&self, point: DVec2) -> DVec2 {
        (point - self.centre) * self.scale
    }

    fn undo(&self, point: DVec2) -> DVec2 {
        point / self.scale + self.centre
    }
}

fn terms(p: DVec2) -> [f64; TERMS] {
    [1.0, p.x, p.y, p.x * p.x, p.x * p.y, p.y * p.y]
}

impl Quadratic {
    /// Fits the map that takes each first point to its second one.
    pub fn fit(pairs: &[(DVec2, DVec2)]) -> Result<Self, FitError> {
        if pairs.iter().any(|(from, to)| !from.is_finite() || !to.is_finite()) {
            return Err(FitError::NotFinite);
        }
        if pairs.len() < TERMS {
            return Err(FitError::FewPoints { found: pairs.len() });
        }
        let from = Normalization::of(pairs.iter().map(|pair| pair.0));
        let to = Normalization::of(pairs.iter().map(|pair| pair.1));
        let rows: Vec<[f64; TERMS]> = pairs.iter().map(|pair| terms(from.apply(pair.0))).collect();
        let wanted: Vec<DVec2> = pairs.iter().map(|pair| to.apply(pair.1)).collect();
        let system = DMatrix::from_fn(pairs.len(), TERMS, |row, column| rows[row][column]);
        let right = DMatrix::from_fn(pairs.len(), 2, |row, column| wanted[row][column]);
        let qr = system.qr();
        let triangle: Matrix6<f64> = qr.r().fixed_view::<TERMS, TERMS>(0, 0).into_owned();
        let singular = triangle.singular_values();
        let condition = singular.max() / singular.min().max(f64::MIN_POSITIVE);
        if condition.is_nan() || condition > CONDITION_LIMIT {
            return Err(FitError::Degenerate { condition });
        }
        let turned: SMatrix<f64, TERMS, 2> = (qr.q().transpose() * right).fixed_view::<TERMS, 2>(0, 0).into_owned();
        let solved = triangle.solve_upper_triangular(&turned).ok_or(FitError::Degenerate { condition })?;
        let coefficients = [0, 1].map(|which| core::array::from_fn(|term| solved[(term, which)]));
        let mut map = Self { from, to, coefficients, condition, residual: Residual { rms_px: 0.0, max_px: 0.0 } };
        map.residual = map.residual_of(pairs);
        Ok(map)
    }

    /// Maps a pixel.
    pub fn apply(&self, point: DVec2) -> DVec2 {
        let terms = terms(self.from.apply(point));
        let [x, y] = self.coefficients.map(|c| c.iter().zip(terms).map(|(c, t)| c * t).sum::<f64>());
        self.to.undo(DVec2::new(x, y))
    }

    /// Condition number of the normalised system; 1 is best.
    pub fn condition(&self) -> f64 {
        self.condition
    }

    /// Residual at the points that the map was fitted to.
    pub fn residual(&self) -> Residual {
        self.residual
    }

    /// Residual at other points.
    pub fn residual_of(&self, pairs: &[(DVec2, DVec2)]) -> Residual {
        let squares = || pairs.iter().map(|(from, to)| self.apply(*from).distance_squared(*to));
        let mean = squares().sum::<f64>() / pairs.len().max(1) as f64;
        Residual { rms_px: libm::sqrt(mean), max_px: libm::sqrt(squares().fold(0.0, f64::max)) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn grid() -> Vec<DVec2> {
        (0..100).map(|i| DVec2::new(f64::from(i % 10) * 64.0, f64::from(i / 10) * 48.0)).collect()
    }

    proptest! {
        #[test]
        fn a_quadratic_is_found_exactly(c in proptest::array::uniform12(-1.0..1.0f64)) {
            let truth = |p: DVec2| {
                let q = (p - DVec2::new(320.0, 240.0)) / 320.0;
                let at = |c: &[f64]| c.iter().zip(terms(q)).map(|(c, t)| c * t).sum::<f64>();
                // The linear part makes the map invertible.
                DVec2::new(100.0 * at(&c[..6]) + 2.0 * p.x, 100.0 * at(&c[6..]) + 2.0 * p.y)
            };
            let pairs: Vec<(DVec2, DVec2)> = grid().into_iter().map(|p| (p, truth(p))).collect();
            let map = Quadratic::fit(&pairs).expect("a fit");
            prop_assert!(map.residual().max_px < 1e-9, "{:?}", map.residual());
            let elsewhere = DVec2::new(333.0, 111.0);
            prop_assert!(map.apply(elsewhere).distance(truth(elsewhere)) < 1e-9);
            prop_assert!(map.condition() < 10.0);
        }
    }

    #[test]
    fn no_other_map_has_a_smaller_residual() {
        let bent = |p: DVec2| DVec2::new(p.x + 20.0 * libm::sin(p.y / 90.0), p.y + 15.0 * libm::cos(p.x / 70.0));
        let pairs: Vec<(DVec2, DVec2)> = grid().into_iter().map(|p| (p, bent(p))).collect();
        let map = Quadratic::fit(&pairs).expect("a fit");
        assert!(map.residual().rms_px > 1.0);
        for which in 0..2 {
            for term in 0..TERMS {
                for change in [-1e-3, 1e-3] {
                    let mut other = map;
                    other.coefficients[which][term] += change;
                    assert!(other.residual_of(&pairs).rms_px > map.residual().rms_px);
                }
            }
        }
    }

    #[test]
    fn points_that_leave_the_map_open_are_an_error() {
        let fit = |points: &[DVec2]| Quadratic::fit(&points.iter().map(|p| (*p, *p)).collect::<Vec<_>>());
        assert_eq!(fit(&grid()[..5]), Err(FitError::FewPoints { found: 5 }));
        assert_eq!(fit(&[]), Err(FitError::FewPoints { found: 0 }));
        let line: Vec<DVec2> = (0..50).map(|i| DVec2::new(f64::from(i), 3.0 * f64::from(i) + 5.0)).collect();
        assert!(matches!(fit(&line), Err(FitError::Degenerate { .. })));
        let circle: Vec<DVec2> =
            (0..50).map(|i| libm::sincos(f64::from(i) * 0.1)).map(|(s, c)| DVec2::new(s, c) * 100.0).collect();
        assert!(matches!(fit(&circle), Err(FitError::Degenerate { .. })), "a conic is a quadratic's zero");
        assert!(matches!(fit(&[DVec2::ONE; 30]), Err(FitError::Degenerate { .. })), "one place");
        let mut points = grid();
        points[3].x = f64::NAN;
        assert_eq!(fit(&points), Err(FitError::NotFinite));
    }
}
