//! Coverage of a view by recorded images, for choosing images that complement each other.

use glam::DVec3;

use super::camera::Camera;
use super::optical;
use super::world::World;
use realitysim_geometry::Isometry;

/// Sample points spread evenly over a view, with which images are asked how much of the view they show.
#[derive(Clone, Debug, PartialEq)]
pub struct CoverageMask {
    places: Vec<Place>,
}

/// A sample point in `map`.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Place {
    /// A point of the ground.
    Ground {
        at: DVec3,
        /// Largest distance, metres, from which an image shows the point well enough.
        seen_within_m: f64,
    },
    /// The direction of something far away, a unit vector.
    Far(DVec3),
}

/// A set of sample points, one bit for each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PlaceMask(u128);

const MAX_PLACES: usize = u128::BITS as usize;
/// An image taken from more than this many times the view's own distance is too coarse for the view ...
const DISTANCE_RATIO_LIMIT: f64 = 3.0;
/// ... unless it was taken from within this many metres.
const NEAR_M: f64 = 0.5;
/// Cosine of the angle within which points lie to one side: 45 degrees.
const ONE_SIDE: f64 = core::f64::consts::FRAC_1_SQRT_2;

impl CoverageMask {
    /// Samples the view of `camera` from `map_from_link`, its pose of `camera_link` in `map`.
    pub fn new(camera: &Camera, map_from_link: &Isometry, world: &World) -> Self {
        let map_from_optical = optical(map_from_link);
        let (columns, rows) = camera.cells();
        let (columns, rows) = (columns + 1, rows + 1);
        let step = (1..).find(|step| columns.div_ceil(*step) * rows.div_ceil(*step) <= MAX_PLACES).unwrap_or(columns);
        let nodes = (step / 2..rows).step_by(step).flat_map(|row| {
            (step / 2..columns).step_by(step).map(move |column| camera.node_rays()[row * columns + column])
        });
        let background = world.background_from(map_from_optical.translation);
        let place = |ray: DVec3| {
            let ray = map_from_optical.transform_vector(ray);
            match background.hit(ray).on_ground() {
                None => Place::Far(ray),
                Some(inverse_distance) => {
                    let at = (map_from_optical.translation + ray / inverse_distance).with_z(0.0);
                    Place::Ground { at, seen_within_m: DISTANCE_RATIO_LIMIT * inverse_distance.recip().max(NEAR_M) }
                }
            }
        };
        // At the edge of its field of view, a lens does not project everything that it unprojects.
        let drawn = nodes.filter(|ray| !ray.x.is_nan() && camera.projector().project_inside(*ray).is_some());
        Self { places: drawn.map(place).collect() }
    }

    /// The sample points that an image shows which was taken with `camera` from `map_from_link`.
    pub fn seen_by(&self, camera: &Camera, map_from_link: &Isometry) -> PlaceMask {
        let optical_from_map = optical(map_from_link).inverse();
        let mut seen = 0;
        for (number, place) in self.places.iter().enumerate() {
            let at = match place {
                Place::Far(ray) => optical_from_map.transform_vector(*ray),
                Place::Ground { at, seen_within_m } => {
                    let at = optical_from_map.transform_point(*at);
                    if at.length_squared() > seen_within_m * seen_within_m {
                        continue;
                    }
                    at
                }
            };
            seen |= u128::from(camera.projector().project_inside(at).is_some()) << number;
        }
        PlaceMask(seen)
    }

    /// The missing points around the one that is farthest from the view's axis.
    ///
    /// Returns those points that `seen` lacks and that lie within 45 degrees of the outermost one, and their mean direction
    /// from `map_from_link`, a unit vector in `map`. `None` if no point is missing.
    pub fn unseen(&self, map_from_link: &Isometry, seen: PlaceMask) -> Option<(PlaceMask, DVec3)> {
        let from = optical(map_from_link).translation;
        let forward = map_from_link.transform_vector(DVec3::X);
        let ray = |place: &Place| match place {
            Place::Far(ray) => *ray,
            Place::Ground { at, .. } => (*at - from).normalize_or(forward),
        };
        let missing = || {
            let places = self.places.iter().enumerate().filter(|(number, _)| seen.0 >> number & 1 == 0);
            places.map(|(number, place)| (number, ray(place)))
        };
        let (_, outermost) = missing().min_by(|a, b| a.1.dot(forward).total_cmp(&b.1.dot(forward)))?;
        let (mut part, mut sum) = (0, DVec3::ZERO);
        for (number, ray) in missing().filter(|(_, ray)| ray.dot(outermost) >= ONE_SIDE) {
            part |= 1 << number;
            sum += ray;
        }
        Some((PlaceMask(part), sum.normalize_or(outermost)))
    }

    /// The share of all sample points that `seen` holds.
    pub fn share(&self, seen: PlaceMask) -> f64 {
        f64::from(seen.0.count_ones()) / self.places.len().max(1) as f64
    }
}

impl PlaceMask {
    /// The union of both sets.
    pub fn with(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// The points of this set that `other` lacks.
    pub fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use realitysim_geometry::{Euler, Field};

    fn camera() -> Camera {
        Camera::new(&realitysim_config::load_lens("fisheye-640").expect("shipped").lens)
    }

    fn pose(x: f64, yaw_deg: f64, pitch_deg: f64) -> Isometry {
        let euler = Euler { yaw: f64::to_radians(yaw_deg), pitch: f64::to_radians(pitch_deg), roll: 0.0 };
        Isometry::from_euler(euler, DVec3::new(x, 0.0, 0.5))
    }

    #[test]
    fn an_image_shows_all_of_its_own_view_and_little_of_what_lies_behind_it() {
        let world = World::without_goals(
            &Field::new(realitysim_config::load_field("kid-2009").expect("a shipped field")).expect("a field"),
        );
        let camera = camera();
        let footprint = CoverageMask::new(&camera, &pose(0.0, 0.0, 20.0), &world);
        assert!((60..=128).contains(&footprint.places.len()), "{}", footprint.places.len());
        let share = |pose: &Isometry| footprint.share(footprint.seen_by(&camera, pose));
        assert_eq!(share(&pose(0.0, 0.0, 20.0)), 1.0);
        let beside = share(&pose(0.1, 10.0, 20.0));
        assert!((0.8..1.0).contains(&beside), "{beside}");
        assert!(share(&pose(0.0, 180.0, 20.0)) < 0.4);
        let (one, other) = (pose(0.0, 60.0, 20.0), pose(0.0, -60.0, 20.0));
        let both = footprint.seen_by(&camera, &one).with(footprint.seen_by(&camera, &other));
        assert!(footprint.share(both) > share(&one).max(share(&other)) + 0.1);
        assert_eq!(both.without(both), PlaceMask::default());
    }

    #[test]
    fn what_is_far_is_seen_from_everywhere_and_the_ground_from_near_by() {
        let world = World::without_goals(
            &Field::new(realitysim_config::load_field("kid-2009").expect("a shipped field")).expect("a field"),
        );
        let camera = camera();
        let up = CoverageMask::new(&camera, &pose(0.0, 0.0, -89.0), &world);
        let share = |footprint: &CoverageMask, pose: &Isometry| footprint.share(footprint.seen_by(&camera, pose));
        assert!(share(&up, &pose(3.0, 0.0, -89.0)) > 0.95);
        let down = CoverageMask::new(&camera, &pose(0.0, 0.0, 89.0), &world);
        assert!(share(&down, &pose(3.0, 0.0, 89.0)) < 0.5);
    }
}
