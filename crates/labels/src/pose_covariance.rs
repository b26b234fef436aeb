//! How far the error of a pose moves what an image shows.

use glam::DVec3;

/// Covariance of a camera's pose in `map`: x, y, z in metres, and rotations about the fixed axes x, y, z in radians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseCovariance([[f64; 6]; 6]);

impl PoseCovariance {
    /// From 36 numbers, row by row, as `geometry_msgs/PoseWithCovariance` has them. Numbers that are not finite count as unknown: the
    /// result is `None`.
    pub fn from_rows(rows: &[f64; 36]) -> Option<Self> {
        let covariance = core::array::from_fn(|row| core::array::from_fn(|column| rows[6 * row + column]));
        rows.iter().all(|number| number.is_finite()).then_some(Self(covariance))
    }

    /// Of a position and an orientation that are known equally well in each direction: standard deviations in metres and radians.
    pub fn isotropic(position_m: f64, rotation_rad: f64) -> Self {
        let sigma = |axis: usize| if axis < 3 { position_m } else { rotation_rad };
        Self(core::array::from_fn(|row| {
            core::array::from_fn(|column| if row == column { sigma(row) * sigma(row) } else { 0.0 })
        }))
    }

    /// Standard deviation, in metres, of `direction . p` for a point p that is fixed to the camera at `arm` from it, in axes of `map`.
    pub fn sigma_along(&self, direction: DVec3, arm: DVec3) -> f64 {
        libm::sqrt(self.covariance_along([direction; 2], arm).max(0.0))
    }

    /// Covariance of `a . p` and `b . p`, in square metres, for a point p as [`Self::sigma_along`] has it.
    pub fn covariance_along(&self, [a, b]: [DVec3; 2], arm: DVec3) -> f64 {
        let gradient = |direction: DVec3| {
            let turn = arm.cross(direction);
            [direction.x, direction.y, direction.z, turn.x, turn.y, turn.z]
        };
        let (a, b) = (gradient(a), gradient(b));
        let row = |row: &[f64; 6]| -> f64 { row.iter().zip(b).map(|(entry, part)| entry * part).sum() };
        self.0.iter().zip(a).map(|(entries, part)| part * row(entries)).sum()
    }

    /// Standard deviation, in metres, of where the unit ray of a pixel meets the ground, along the horizontal unit vector `normal`. The
    /// camera is `height_m` above the ground, and the ray points down.
    pub fn ground_sigma(&self, normal: DVec3, ray: DVec3, height_m: f64) -> f64 {
        let along = normal - DVec3::Z * (normal.dot(ray) / ray.z);
        self.sigma_along(along, ray * (height_m / -ray.z))
    }

    /// What bounds [`Self::ground_sigma`] for all directions.
    pub(crate) fn bound(&self) -> Bound {
        let trace = |from: usize| libm::sqrt((from..from + 3).map(|axis| self.0[axis][axis].max(0.0)).sum());
        Bound { position_m: trace(0), rotation_rad: trace(3) }
    }
}

/// Standard deviations of a pose that no direction exceeds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Bound {
    position_m: f64,
    rotation_rad: f64,
}

impl Bound {
    /// The greatest [`PoseCovariance::ground_sigma`] that is possible for a unit ray, metres.
    pub(crate) fn ground_m(&self, ray: DVec3, height_m: f64) -> f64 {
        let stretched = 1.0 / -ray.z;
        (self.position_m + height_m * stretched * self.rotation_rad) * stretched
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;
    use proptest::prelude::*;

    proptest! {
        /// The derivative is that of moving the camera a little.
        #[test]
        fn a_moved_camera_moves_the_ground_as_far_as_said(
            moved in prop::array::uniform6(-1.0..1.0f64),
            azimuth in 0.0..6.3f64,
            down in -1.5..-0.05f64,
            heading in 0.0..6.3f64,
        ) {
            let step = 1e-6;
            let height_m = 0.5;
            let ray = DVec3::new(azimuth.cos() * down.cos(), azimuth.sin() * down.cos(), down.sin());
            let normal = DVec3::new(heading.cos(), heading.sin(), 0.0);
            let shift = DVec3::new(moved[0], moved[1], moved[2]) * step;
            let turn = DQuat::from_scaled_axis(DVec3::new(moved[3], moved[4], moved[5]) * step);
            let meets = |from: DVec3, ray: DVec3| from + ray * (from.z / -ray.z);
            let from = DVec3::Z * height_m;
            let moved_by = normal.dot(meets(from + shift, turn * ray) - meets(from, ray)).abs() / step;
            let rows: [f64; 36] = core::array::from_fn(|at| moved[at / 6] * moved[at % 6]);
            let covariance = PoseCovariance::from_rows(&rows).unwrap();
            let sigma = covariance.ground_sigma(normal, ray, height_m);
            prop_assert!((sigma - moved_by).abs() < 1e-4 * (1.0 + moved_by), "{sigma} {moved_by}");
            prop_assert!(sigma <= covariance.bound().ground_m(ray, height_m) + 1e-9);
        }
    }

    #[test]
    fn numbers_that_are_not_finite_are_no_covariance() {
        let mut rows = [0.0; 36];
        rows[7] = f64::NAN;
        assert_eq!(PoseCovariance::from_rows(&rows), None);
    }
}
