//! What stands where: the ground as far as the field goes, and the goals as second planes. All else is far away.

use glam::{DVec2, DVec3, Vec3};

use super::camera::AREA;
use realitysim_geometry::{Field, multiversioned};

/// Known geometry, in `map`.
#[derive(Clone, Debug, PartialEq)]
pub struct World {
    /// Half extents of what counts as ground: beyond it are walls and people, not floor.
    ground_half: DVec2,
    bars: Vec<Bar>,
}

/// A post or crossbar of a goal: a round bar, drawn as the plane through its axis that faces the camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Bar {
    from: DVec3,
    to: DVec3,
    radius: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Surface {
    Ground,
    Goal,
    /// Above the horizon or beyond the carpet: taken to be infinitely far, so that only rotation counts.
    Far,
}

/// What a ray meets first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Hit {
    /// 1/m along the unit ray; 0 is far.
    pub(super) inverse_distance: f64,
    pub(super) surface: Surface,
}

impl Hit {
    /// The inverse distance if it is the ground that is met.
    pub(super) fn on_ground(&self) -> Option<f64> {
        (self.surface == Surface::Ground).then_some(self.inverse_distance)
    }
}

/// Floor around the carpet that still counts as ground.
const APRON_M: f64 = 0.5;

impl World {
    pub fn new(field: &Field) -> Self {
        let radius = field.dimensions().goal.map_or(0.0, |goal| goal.post_diameter_m / 2.0);
        let bars = field.goal_bars().into_iter().map(|[from, to]| Bar { from, to, radius }).collect();
        Self { ground_half: field.carpet_half_extent() + DVec2::splat(APRON_M), bars }
    }

    /// Without goals: as the field of the paper's experiments, or where they have been taken away.
    pub fn without_goals(field: &Field) -> Self {
        Self { bars: Vec::new(), ..Self::new(field) }
    }

    pub(super) fn ground_half(&self) -> DVec2 {
        self.ground_half
    }

    pub(super) fn bars(&self) -> &[Bar] {
        &self.bars
    }

    /// What a unit ray from a place above the ground meets, goals left out.
    pub(super) fn behind_goals(&self, camera: DVec3, ray: DVec3) -> Hit {
        let inverse_distance = -ray.z / camera.z;
        let far = Hit { inverse_distance: 0.0, surface: Surface::Far };
        if inverse_distance <= 0.0 || !inverse_distance.is_finite() {
            return far;
        }
        let place = (camera + ray / inverse_distance).truncate();
        if place.abs().cmple(self.ground_half).all() { Hit { inverse_distance, surface: Surface::Ground } } else { far }
    }

    /// How far along a unit ray from this place a post or crossbar stands, metres.
    pub fn goals_seen_from(&self, camera: DVec3) -> impl Fn(DVec3) -> Option<f64> + use<> {
        let goals = self.goals_from(camera, 0.0);
        move |ray| goals.met(ray).min_by(f64::total_cmp)
    }

    /// The goals as seen from a place; bars are `margin` radians wider to each side, so that their soft edges come along.
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

/// The goals from one camera's place.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Goals {
    camera: DVec3,
    margin: f64,
    bars: Vec<SeenBar>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct SeenBar {
    bar: Bar,
    /// Perpendicular to the plane that holds camera and axis: a ray that is far from that plane passes by.
    across: DVec3,
    sine: f64,
}

impl Goals {
    /// What a unit ray meets first, `behind` being what it meets if no goal stands there.
    pub(super) fn before(&self, ray: DVec3, behind: Hit) -> Hit {
        let mut hit = behind;
        for distance in self.met(ray) {
            if distance * hit.inverse_distance < 1.0 {
                hit = Hit { inverse_distance: 1.0 / distance, surface: Surface::Goal };
            }
        }
        hit
    }

    /// Whether a bar is met anywhere along the unit ray.
    pub(super) fn are_met_by(&self, ray: DVec3) -> bool {
        self.met(ray).next().is_some()
    }

    /// The nearest one for a cell's rays, of any length: how many of these lengths away the first bar is; infinite without one.
    pub(super) fn met_by_all(&self, rays: &[[f32; AREA]; 3]) -> [f32; AREA] {
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
                    // Not for NaN, which a ray along the axis and one that nothing draws give.
                    let is_met = (lengths > 0.0) & (off <= wide * wide);
                    *met = if is_met & (lengths < *met) { lengths } else { *met };
                }
            }
            met
        })
    }

    /// For a cell's rays, of any length: whether a bar stands before what lies at this inverse of that length away.
    pub(super) fn hide_all(&self, rays: &[[f32; AREA]; 3], inverse_distances: &[f32; AREA]) -> [bool; AREA] {
        let met = self.met_by_all(rays);
        core::array::from_fn(|i| met[i].is_finite() && met[i] * inverse_distances[i] < 1.0 - BEFORE as f32)
    }

    /// Whether a bar stands before what lies at this inverse distance along the unit ray.
    pub(super) fn hide(&self, ray: DVec3, inverse_distance: f64) -> bool {
        self.met(ray).any(|distance| distance * inverse_distance < 1.0 - BEFORE)
    }

    fn met(&self, ray: DVec3) -> impl Iterator<Item = f64> + '_ {
        let near = move |seen: &&SeenBar| ray.dot(seen.across).abs() <= seen.sine;
        self.bars.iter().filter(near).filter_map(move |seen| seen.bar.meets(self.camera, ray, self.margin))
    }
}

/// A ray in f32 passes a bar so much nearer or farther than it should.
const ROUNDING: f32 = 1e-5;
/// What is nearer than a place by less than this share of the distance belongs to it.
const BEFORE: f64 = 0.02;

impl SeenBar {
    /// Whether any of these rays does not pass far from it.
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
    /// How far along the unit ray its axis is passed, if it is passed closely enough.
    fn meets(&self, camera: DVec3, ray: DVec3, margin: f64) -> Option<f64> {
        let axis = self.to - self.from;
        let to_camera = camera - self.from;
        let (ra, aa) = (ray.dot(axis), axis.length_squared());
        let (rc, ac) = (ray.dot(to_camera), axis.dot(to_camera));
        let determinant = aa - ra * ra;
        if determinant < 1e-12 {
            return None;
        }
        let along = ((ac - ra * rc) / determinant).clamp(0.0, 1.0);
        // The ray's point nearest to that point of the axis.
        let point = self.from + axis * along;
        let distance = ray.dot(point - camera);
        let off = (camera + ray * distance - point).length();
        (distance > 0.0 && off <= self.radius + margin * distance).then_some(distance)
    }

    fn distance(&self, place: DVec3) -> f64 {
        let axis = self.to - self.from;
        let along = ((place - self.from).dot(axis) / axis.length_squared()).clamp(0.0, 1.0);
        place.distance(self.from + axis * along)
    }

    /// Places along it, no farther apart than a few centimetres.
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
            let all = goals.met_by_all(&[parts(0), parts(1), parts(2)]);
            for (ray, found) in rays.iter().zip(all) {
                let one = goals.met(ray.normalize()).min_by(f64::total_cmp).map(|distance| distance / ray.length());
                met += u32::from(one.is_some());
                match one {
                    Some(one) if found.is_finite() => {
                        assert!((f64::from(found) / one - 1.0).abs() < 1e-4, "{found} {one}")
                    }
                    None if found.is_infinite() => {}
                    // At the very edge of a bar.
                    _ => different += 1,
                }
            }
        }
        assert!(met > 1000 && different * 1000 < met, "{different} of {met}");
        assert!(goals.met_by_all(&[[f32::NAN; AREA]; 3]).iter().all(|distance| distance.is_infinite()));
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
            goals.before(ray, world.behind_goals(camera, ray))
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
        assert!(goals.hide(behind.normalize(), 1.0 / behind.length()), "a post before the carpet");
    }
}
