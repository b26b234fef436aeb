//! The hall around a field: what a ray meets that passes beyond the ground and the goals.

use glam::{DVec2, DVec3, Vec3};
use serde::{Deserialize, Serialize};

/// The hall as an upright box around the centre of the field. A plane that is not known is infinitely far away.
///
/// The box is convex and the camera is inside, so the surface that a unit ray meets is the plane with the largest inverse distance. The
/// floor is always known: it is the plane z = 0. Whatever stands on it is nearer than the floor behind it, so that taking an unknown
/// wall below the horizon for floor is less wrong than taking it to be infinitely far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Hall {
    /// Direction of the first wall's outward normal in `map`, radians; the others follow anticlockwise by right angles.
    pub yaw_rad: f64,
    /// Distances of the four walls from the field's centre, metres.
    pub walls_m: [Option<f64>; 4],
    /// Height of the ceiling, metres.
    pub ceiling_m: Option<f64>,
}

/// Number of planes: floor, ceiling and four walls.
const PLANES: usize = 6;
/// A camera nearer to a plane than this, in metres, or beyond it, does not see the plane.
const MIN_CLEARANCE_M: f64 = 0.2;

impl Hall {
    /// The outward unit normal of a wall, in `map`.
    pub fn normal(&self, wall: usize) -> DVec2 {
        DVec2::from_angle(self.yaw_rad + wall as f64 * core::f64::consts::FRAC_PI_2)
    }

    /// Whether no plane but the floor is known.
    pub fn is_unknown(&self) -> bool {
        self.ceiling_m.is_none() && self.walls_m.iter().all(Option::is_none)
    }

    /// The hall as seen from a camera in `map`.
    pub(super) fn seen_from(&self, camera: DVec3) -> SeenHall {
        let mut planes = [DVec3::ZERO; PLANES];
        planes[0] = DVec3::NEG_Z / camera.z;
        let visible = |distance: f64| (distance >= MIN_CLEARANCE_M).then(|| 1.0 / distance);
        if let Some(per_m) = self.ceiling_m.and_then(|height| visible(height - camera.z)) {
            planes[1] = DVec3::Z * per_m;
        }
        for (wall, (plane, distance)) in planes[2..].iter_mut().zip(self.walls_m).enumerate() {
            let normal = self.normal(wall);
            if let Some(per_m) = distance.and_then(|distance| visible(distance - normal.dot(camera.truncate()))) {
                *plane = normal.extend(0.0) * per_m;
            }
        }
        SeenHall { planes }
    }
}

/// The planes of a hall as seen from one camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SeenHall {
    /// Outward normals, each divided by the camera's distance from the plane: the scalar product with a unit ray is the inverse distance
    /// at which the ray meets the plane, negative behind the camera. The first is the floor; unknown planes are zero.
    planes: [DVec3; PLANES],
}

impl SeenHall {
    /// The inverse distance at which a unit ray meets the floor, 1/m; 0 or less above the horizon.
    pub(super) fn floor(&self, ray: DVec3) -> f64 {
        self.planes[0].dot(ray)
    }

    /// The inverse distance at which a unit ray meets the box, 1/m; 0 if it meets no known plane.
    pub(super) fn inverse_distance(&self, ray: DVec3) -> f64 {
        self.planes.iter().map(|plane| plane.dot(ray)).fold(0.0, f64::max)
    }

    /// The planes, the floor first, for vectorised code.
    pub(super) fn planes(&self) -> [Vec3; PLANES] {
        self.planes.map(|plane| plane.as_vec3())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hall() -> Hall {
        Hall { yaw_rad: 0.1, walls_m: [Some(7.0), Some(5.0), None, Some(6.0)], ceiling_m: Some(4.0) }
    }

    #[test]
    fn a_ray_meets_the_nearest_plane_that_is_known() {
        let camera = DVec3::new(0.5, -1.0, 0.6);
        let hall = hall();
        let seen = hall.seen_from(camera);
        for (azimuth, elevation) in [(0.0, 0.0), (1.3, 0.2), (2.0, -0.3), (3.2, 0.01), (4.6, 1.2), (5.5, -1.0)] {
            let (sine, cosine) = f64::sin_cos(elevation);
            let ray = DVec3::new(cosine * f64::cos(azimuth), cosine * f64::sin(azimuth), sine);
            let inverse_distance = seen.inverse_distance(ray);
            let at = camera + ray / inverse_distance.max(1e-9);
            let on_wall = |wall: usize| {
                hall.walls_m[wall]
                    .is_some_and(|distance| (hall.normal(wall).dot(at.truncate()) - distance).abs() < 1e-9)
            };
            let is_on_plane = at.z.abs() < 1e-9 || (at.z - 4.0).abs() < 1e-9 || (0..4).any(on_wall);
            assert!(is_on_plane || inverse_distance == 0.0, "{azimuth} {elevation}: {at}");
            let beyond = |wall: usize| {
                hall.walls_m[wall].is_some_and(|distance| hall.normal(wall).dot(at.truncate()) > distance + 1e-9)
            };
            assert!(inverse_distance == 0.0 || !(0..4).any(beyond) && (-1e-9..=4.0 + 1e-9).contains(&at.z), "inside");
        }
    }

    #[test]
    fn what_is_unknown_is_far_above_and_floor_below_the_horizon() {
        let seen = Hall::default().seen_from(DVec3::new(0.0, 0.0, 0.5));
        assert_eq!(seen.inverse_distance(DVec3::new(0.8, 0.0, 0.6)), 0.0);
        assert_eq!(seen.inverse_distance(DVec3::new(0.8, 0.0, -0.6)), 1.2);
    }

    #[test]
    fn a_camera_outside_of_a_wall_does_not_see_it() {
        let hall = Hall { walls_m: [Some(7.0), None, None, None], ..Hall::default() };
        let seen = hall.seen_from(DVec3::new(20.0, 0.0, 0.5));
        assert_eq!(seen.inverse_distance(DVec3::new(1.0, 0.0, 0.0)), 0.0);
    }
}
