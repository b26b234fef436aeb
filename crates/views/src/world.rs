//! The known geometry: the ground plane as far as the field goes, the goals, and the hall around them.

use glam::{DVec2, DVec3, Vec3};

use super::camera::AREA;
use super::hall::{Hall, SeenHall};
use realitysim_geometry::{Field, multiversioned};

/// Known geometry in `map`: an area of ground, the bars of the goals, and the hall.
#[derive(Clone, Debug, PartialEq)]
pub struct World {
    /// Half extents of the area that counts as ground, metres. Beyond it are walls and people, not floor.
    ground_half: DVec2,
    bars: Vec<Bar>,
    hall: Hall,
}

/// A post or crossbar of a goal: a round bar, drawn as the plane through its axis that faces the camera. Metres, in `map`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Bar {
    from: DVec3,
    to: DVec3,
    radius: f64,
}

/// The kind of surface that a ray meets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Surface {
    /// The plane z = 0 within the area that counts as ground.
    Ground,
    /// A post or crossbar.
    Goal,
    /// The hall beyond the ground: floor, wall or ceiling. A wall or ceiling that is not known is infinitely far: only rotation matters.
    Far,
}

/// The first surface that a ray meets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Hit {
    /// Inverse of the distance along the unit ray, 1/m; 0 for what is far.
    pub(super) inverse_distance: f64,
    pub(super) surface: Surface,
}

impl Hit {
    /// The inverse distance if the ray meets the ground.
    pub(super) fn on_ground(&self) -> Option<f64> {
        (self.surface == Surface::Ground).then_some(self.inverse_distance)
    }
}

/// Width of the floor around the carpet that still counts as ground, metres.
const APRON_M: f64 = 0.5;

impl World {
    /// The ground of a field, with its goals if it has any.
    pub fn new(field: &Field) -> Self {
        let radius = field.dimensions().goal.map_or(0.0, |goal| goal.post_diameter_m / 2.0);
        let bars = field.goal_bars().into_iter().map(|[from, to]| Bar { from, to, radius }).collect();
        Self { ground_half: field.carpet_half_extent() + DVec2::splat(APRON_M), bars, hall: Hall::default() }
    }

    /// The hall.
    pub fn hall(&self) -> &Hall {
        &self.hall
    }

    /// The same in a hall.
    pub fn with_hall(self, hall: Hall) -> Self {
        Self { hall, ..self }
    }

    /// The ground of a field without goals, as in the paper's experiments or where goals have been removed.
    pub fn without_goals(field: &Field) -> Self {
        Self { bars: Vec::new(), ..Self::new(field) }
    }

    /// Whether there are goals.
    pub fn has_goals(&self) -> bool {
        !self.bars.is_empty()
    }

    /// Half extents of the area that counts as ground, metres.
    pub fn ground_half(&self) -> DVec2 {
        self.ground_half
    }

    pub(super) fn bars(&self) -> &[Bar] {
        &self.bars
    }

    /// Ground and hall as seen from a point above the ground.
    pub(super) fn background_from(&self, camera: DVec3) -> Background {
        Background { camera, ground_half: self.ground_half, hall: self.hall.seen_from(camera) }
    }

    /// A function that gives the distance, in metres, at which a unit ray from `camera` meets the nearest post or crossbar.
    pub fn goals_seen_from(&self, camera: DVec3) -> impl Fn(DVec3) -> Option<f64> + use<> {
        let goals = self.goals_from(camera, 0.0);
        move |ray| goals.intersections(ray).min_by(f64::total_cmp)
    }

    /// The goals as seen from a point. Bars are widened by `margin` radians to each side, to include their soft edges.
    pub(super) fn goals_from(&self, camera: DVec3, margin: f64) -> Goals {
        let seen = |bar: &Bar| {
            let (from, to) = (bar.from - camera, bar.to - camera);
            let nearest = bar.distance(camera).max(1e-3);
            let sine = (bar.radius / nearest + margin).min(1.0);
            SeenBar { bar: *bar, across: from.cross(to).normalize_or_zero(), sine }
        };
        Goals { camera, margin, bars: self.bars.iter().map(seen).collect() }
    }
}

/// Ground and hall as seen from the position of one camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Background {
    camera: DVec3,
    ground_half: DVec2,
    pub(super) hall: SeenHall,
}

impl Background {
    /// The surface that a unit ray meets, ignoring goals.
    pub(super) fn hit(&self, ray: DVec3) -> Hit {
        let floor = self.hall.floor(ray);
        let inverse_distance = self.hall.inverse_distance(ray);
        let is_floor = floor > 0.0 && floor >= inverse_distance;
        let place = (self.camera + ray / floor).truncate();
        let is_ground = is_floor && place.abs().cmple(self.ground_half).all();
        Hit { inverse_distance, surface: if is_ground { Surface::Ground } else { Surface::Far } }
    }
}

/// The goals as seen from the position of one camera.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Goals {
    camera: DVec3,
    margin: f64,
    bars: Vec<SeenBar>,
}

/// A bar with what is precomputed for one camera position.
#[derive(Clone, Copy, Debug, PartialEq)]
struct SeenBar {
    bar: Bar,
    /// Unit normal of the plane through camera and axis. A ray far from that plane misses the bar.
    across: DVec3,
    /// Largest sine of the angle between that plane and a ray that can meet the bar.
    sine: f64,
}

impl Goals {
    /// The first surface that a unit ray meets, where `behind` is what it would meet without goals.
    pub(super) fn nearest_hit(&self, ray: DVec3, behind: Hit) -> Hit {
        let mut hit = behind;
        for distance in self.intersections(ray) {
            if distance * hit.inverse_distance < 1.0 {
                hit = Hit { inverse_distance: 1.0 / distance, surface: Surface::Goal };
            }
        }
        hit
    }

    /// Whether the unit ray meets a bar at any distance.
    pub(super) fn intersects(&self, ray: DVec3) -> bool {
        self.intersections(ray).next().is_some()
    }

    /// For each ray of a cell, of any length: the distance to the first bar in units of the ray's length, or infinity without one.
    pub(super) fn first_hits(&self, rays: &[[f32; AREA]; 3]) -> [f32; AREA] {
        let goals = self;
        multiversioned!(|goals: &Goals, rays: &[[f32; AREA]; 3]| -> [f32; AREA] {
            let mut met = [f32::INFINITY; AREA];
            for seen in goals.bars.iter().filter(|seen| seen.may_be_met(rays)) {
                let bar = &seen.bar;
                let (axis, to_camera) = ((bar.to - bar.from).as_vec3(), (goals.camera - bar.from).as_vec3());
                let (aa, ac) = (axis.length_squared(), axis.dot(to_camera));
                let (radius, margin) = (bar.radius as f32, goals.margin as f32);
                for (i, met) in met.iter_mut().enumerate() {
                    let ray = Vec3::new(rays[0][i], rays[1][i], rays[2][i]);
                    let (ra, rc, rr) = (ray.dot(axis), ray.dot(to_camera), ray.length_squared());
                    let determinant = aa * rr - ra * ra;
                    let along = ((ac * rr - ra * rc) / determinant).clamp(0.0, 1.0);
                    let to_point = axis * along - to_camera;
                    let lengths = ray.dot(to_point) / rr;
                    let off = (ray * lengths - to_point).length_squared();
                    let wide = radius + margin * lengths * rr.sqrt();
                    // The comparison is false for NaN, which rays along the axis and undrawn pixels give.
                    let is_met = (lengths > 0.0) & (off <= wide * wide);
                    *met = if is_met & (lengths < *met) { lengths } else { *met };
                }
            }
            met
        })
    }

    /// For each ray of a cell, of any length: whether a bar stands before the point at this inverse distance, in units of that length.
    pub(super) fn hides_each(&self, rays: &[[f32; AREA]; 3], inverse_distances: &[f32; AREA]) -> [bool; AREA] {
        let met = self.first_hits(rays);
        core::array::from_fn(|i| met[i].is_finite() && met[i] * inverse_distances[i] < 1.0 - CONTACT_SHARE as f32)
    }

    /// Whether a bar stands before the point at this inverse distance along the unit ray.
    pub(super) fn hides(&self, ray: DVec3, inverse_distance: f64) -> bool {
        self.intersections(ray).any(|distance| distance * inverse_distance < 1.0 - CONTACT_SHARE)
    }

    /// The distances at which a unit ray meets bars, in no order.
    fn intersections(&self, ray: DVec3) -> impl Iterator<Item = f64> + '_ {
        let near = move |seen: &&SeenBar| ray.dot(seen.across).abs() <= seen.sine;
        self.bars.iter().filter(near).filter_map(move |seen| seen.bar.intersection(self.camera, ray, self.margin))
    }
}

/// Tolerance for the rounding of rays to f32, as a sine: rays this close to a bar's limit are still tested.
const ROUNDING: f32 = 1e-5;
/// A bar that is nearer than a point by less than this share of the distance does not hide it: the point belongs to the bar.
const CONTACT_SHARE: f64 = 0.02;

impl SeenBar {
    /// Whether any of these rays may meet the bar: a coarse test.
    #[inline(always)]
    fn may_be_met(&self, [xs, ys, zs]: &[[f32; AREA]; 3]) -> bool {
        let (across, sine) = (self.across.as_vec3(), self.sine as f32 + ROUNDING);
        let mut near = false;
        for i in 0..AREA {
            let (x, y, z) = (xs[i], ys[i], zs[i]);
            let off = across.x * x + across.y * y + across.z * z;
            near |= off * off <= sine * sine * (x * x + y * y + z * z);
        }
        near
    }
}

impl Bar {
    /// The distance along the unit ray at which it passes the bar's axis, if it passes closely enough to meet the bar.
    fn intersection(&self, camera: DVec3, ray: DVec3, margin: f64) -> Option<f64> {
        let axis = self.to - self.from;
        let to_camera = camera - self.from;
        let (ra, aa) = (ray.dot(axis), axis.length_squared());
        let (rc, ac) = (ray.dot(to_camera), axis.dot(to_camera));
        let determinant = aa - ra * ra;
        if determinant < 1e-12 {
            return None;
        }
        let along = ((ac - ra * rc) / determinant).clamp(0.0, 1.0);
        // The point of the ray that is nearest to that point of the axis.
        let point = self.from + axis * along;
        let distance = ray.dot(point - camera);
        let off = (camera + ray * distance - point).length();
        (distance > 0.0 && off <= self.radius + margin * distance).then_some(distance)
    }

    /// Distance of a point from the bar's axis, metres.
    fn distance(&self, place: DVec3) -> f64 {
        let axis = self.to - self.from;
        let along = ((place - self.from).dot(axis) / axis.length_squared()).clamp(0.0, 1.0);
        place.distance(self.from + axis * along)
    }

    /// Points along the axis, at most 4 cm apart.
    pub(super) fn places(&self) -> impl Iterator<Item = DVec3> + '_ {
        let count = libm::ceil(self.from.distance(self.to) / 0.04).max(1.0) as usize;
        (0..=count).map(move |index| self.from.lerp(self.to, index as f64 / count as f64))
    }

    pub(super) fn radius(&self) -> f64 {
        self.radius
    }
}

#[cfg(test)]
mod tests {
    use super::super::camera::CELL;
    use super::*;
    use realitysim_geometry::FieldDimensions;
    use realitysim_geometry::field::Goal;

    #[test]
    fn many_rays_meet_what_each_of_them_meets() {
        let goal = Some(Goal { width_m: 1.5, height_m: 0.9, depth_m: 0.5, post_diameter_m: 0.1 });
        let world = World::new(
            &Field::new(FieldDimensions {
                goal,
                ..realitysim_config::load_field("kid-2009").expect("a shipped field")
            })
            .expect("a field"),
        );
        let camera = DVec3::new(1.0, 0.3, 0.5);
        let goals = world.goals_from(camera, 0.004);
        let (mut met, mut different) = (0, 0);
        for cell in 0..2000 {
            let rays: [DVec3; AREA] = core::array::from_fn(|i| {
                // Cells of 8 x 8 rays about a degree apart, all around.
                let yaw = 0.0031 * f64::from(cell) + 0.004 * (i % CELL) as f64;
                let pitch = 0.6 * libm::sin(f64::from(cell)) + 0.004 * (i / CELL) as f64;
                let length = 1.0 + 0.5 * libm::cos(f64::from(cell));
                DVec3::new(libm::cos(yaw), libm::sin(yaw), libm::tan(pitch)).normalize() * length
            });
            let parts = |axis: usize| core::array::from_fn(|i| rays[i].to_array()[axis] as f32);
            let all = goals.first_hits(&[parts(0), parts(1), parts(2)]);
            for (ray, found) in rays.iter().zip(all) {
                let one =
                    goals.intersections(ray.normalize()).min_by(f64::total_cmp).map(|distance| distance / ray.length());
                met += u32::from(one.is_some());
                match one {
                    Some(one) if found.is_finite() => {
                        assert!((f64::from(found) / one - 1.0).abs() < 1e-4, "{found} {one}")
                    }
                    None if found.is_infinite() => {}
                    // The ray grazes the edge of a bar.
                    _ => different += 1,
                }
            }
        }
        assert!(met > 1000 && different * 1000 < met, "{different} of {met}");
        assert!(goals.first_hits(&[[f32::NAN; AREA]; 3]).iter().all(|distance| distance.is_infinite()));
    }

    #[test]
    fn rays_meet_ground_goal_and_what_is_far() {
        let goal = Some(Goal { width_m: 1.5, height_m: 0.9, depth_m: 0.5, post_diameter_m: 0.1 });
        let field =
            Field::new(FieldDimensions { goal, ..realitysim_config::load_field("kid-2009").expect("a shipped field") })
                .expect("a field");
        let world = World::new(&field);
        let camera = DVec3::new(1.0, 0.0, 0.5);
        let goals = world.goals_from(camera, 0.0);
        let look = |to: DVec3| {
            let ray = (to - camera).normalize();
            goals.nearest_hit(ray, world.background_from(camera).hit(ray))
        };
        let ground = look(DVec3::new(2.0, 0.3, 0.0));
        assert_eq!(ground.surface, Surface::Ground);
        assert!((1.0 / ground.inverse_distance - DVec3::new(1.0, 0.3, -0.5).length()).abs() < 1e-12);
        let post = look(DVec3::new(3.0, 0.77, 0.4));
        assert_eq!(post.surface, Surface::Goal);
        assert!((1.0 / post.inverse_distance - 2.14).abs() < 0.02, "{post:?}");
        assert_eq!(look(DVec3::new(3.0, 0.1, 0.9)).surface, Surface::Goal, "crossbar");
        assert_eq!(look(DVec3::new(3.0, 0.1, 0.6)).surface, Surface::Far, "through the goal, above the horizon");
        assert_eq!(look(DVec3::new(9.0, 0.0, 0.0)).surface, Surface::Far, "beyond the carpet");
        let behind = DVec3::new(3.3, 0.86, 0.0) - camera;
        assert!(goals.hides(behind.normalize(), 1.0 / behind.length()), "a post before the carpet");
    }
}
