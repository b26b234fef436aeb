//! Ellipses of position, which show how well a place is known.

use core::f64::consts::TAU;

use glam::DVec2;

/// Factor from standard deviations to the ellipse that holds the truth in 95 of 100 cases: sqrt of chi-squared with two degrees of
/// freedom at 0.95.
pub const SIGMAS_OF_95: f64 = 2.447_746_830_680_816;
/// Number of corners of an ellipse: each side is off by less than a thousandth of the longer axis.
const CORNERS: u32 = 72;

/// The ellipse that holds a position in 95 of 100 cases.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ellipse {
    /// Centre in `map`, metres.
    pub centre: DVec2,
    /// Covariance of x and y, square metres: xx, xy, yy.
    pub covariance: [f64; 3],
    /// Colour, RGB.
    pub colour: [u8; 3],
}

impl Ellipse {
    /// Returns the border as offsets from the centre, metres; `None` if the covariance is not one.
    pub(super) fn border(&self) -> Option<Vec<DVec2>> {
        let [major, minor] = self.half_axes()?;
        let turn = DVec2::from_angle(self.angle());
        let corner = |index| {
            let along = DVec2::from_angle(TAU * f64::from(index) / f64::from(CORNERS));
            turn.rotate(DVec2::new(major, minor) * along)
        };
        Some((0..=CORNERS).map(corner).collect())
    }

    /// Returns the longer and the shorter half axis, metres; `None` if the covariance is not one.
    pub fn half_axes(&self) -> Option<[f64; 2]> {
        let [xx, xy, yy] = self.covariance;
        let (mean, half) = ((xx + yy) / 2.0, libm::hypot((xx - yy) / 2.0, xy));
        let axis = |variance: f64| SIGMAS_OF_95 * libm::sqrt(variance.max(0.0));
        (mean.is_finite() && half.is_finite()).then(|| [axis(mean + half), axis(mean - half)])
    }

    /// Returns the direction of the longer axis, radians from x towards y.
    fn angle(&self) -> f64 {
        let [xx, xy, yy] = self.covariance;
        0.5 * libm::atan2(2.0 * xy, xx - yy)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_border_lies_where_the_mahalanobis_distance_is_that_of_95() {
        for covariance in [[4e-4, 1e-4, 9e-4], [1.0, 0.0, 0.25], [2e-6, -1e-6, 2e-6]] {
            let ellipse = Ellipse { centre: DVec2::ZERO, covariance, colour: [0; 3] };
            let [xx, xy, yy] = covariance;
            let determinant = xx * yy - xy * xy;
            for DVec2 { x, y } in ellipse.border().expect("a covariance") {
                let squared = (yy * x * x - 2.0 * xy * x * y + xx * y * y) / determinant;
                assert!((squared - SIGMAS_OF_95 * SIGMAS_OF_95).abs() < 1e-6, "{squared}");
            }
        }
    }

    #[test]
    fn what_is_no_covariance_has_no_ellipse() {
        let of = |covariance| Ellipse { centre: DVec2::ZERO, covariance, colour: [0; 3] }.border();
        assert_eq!(of([f64::NAN, 0.0, 1.0]), None);
        assert!(of([0.0; 3]).is_some_and(|border| border.iter().all(|point| *point == DVec2::ZERO)));
    }
}
