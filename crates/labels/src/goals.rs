//! The goals as areas of an image: frames of round bars, and the boxes that their nets hang in.

use glam::{DVec2, DVec3};

use realitysim_geometry::{Field, Isometry, Lens};

use crate::pose_covariance::PoseCovariance;

/// The goals of a field.
#[derive(Clone, Debug)]
pub(crate) struct Goals {
    bars: Vec<[DVec3; 2]>,
    radius: f64,
    /// The corners of each net's box: least and greatest x, y, z.
    nets: Vec<[DVec3; 2]>,
}

/// What a ray meets of the goals.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum GoalPart {
    /// A post or crossbar.
    Frame,
    /// The edge of a post or crossbar, as far as the pose's error moves it.
    Edge,
    /// The box of a net.
    Net,
}

/// Points along a bar at which it is projected.
const POINTS: usize = 33;

impl Goals {
    /// The goals of a field, if they stand there.
    pub(crate) fn new(field: &Field, are_there: bool) -> Self {
        let d = field.dimensions();
        let Some(goal) = d.goal.filter(|_| are_there) else {
            return Self { bars: Vec::new(), radius: 0.0, nets: Vec::new() };
        };
        let [near, far] = [d.length_m / 2.0, d.length_m / 2.0 + goal.depth_m];
        let net = |side: f64| {
            let [a, b] = [side * near, side * far];
            [DVec3::new(a.min(b), -goal.width_m / 2.0, 0.0), DVec3::new(a.max(b), goal.width_m / 2.0, goal.height_m)]
        };
        let nets = if goal.depth_m > 0.0 { vec![net(-1.0), net(1.0)] } else { Vec::new() };
        Self { bars: field.goal_bars(), radius: goal.post_diameter_m / 2.0, nets }
    }

    /// The goals as seen by one camera.
    pub(crate) fn seen_by<'a>(&'a self, lens: &Lens, map_from_optical: &Isometry) -> SeenGoals<'a> {
        let optical_from_map = map_from_optical.inverse();
        let pixel = |point: DVec3| lens.project(optical_from_map.transform_point(point));
        let margin_px = |point: DVec3| {
            4.0 + 2.0 * self.radius * lens.focal() / point.distance(map_from_optical.translation).max(self.radius)
        };
        let around = |points: &mut dyn Iterator<Item = DVec3>| {
            let mut found = Area::NONE;
            for (at, margin) in points.filter_map(|point| Some((pixel(point)?, margin_px(point)))) {
                found.take(at, margin);
            }
            found
        };
        let along = |[from, to]: [DVec3; 2]| (0..POINTS).map(move |i| from.lerp(to, i as f64 / (POINTS - 1) as f64));
        let bars: Vec<Area> = self.bars.iter().map(|bar| around(&mut along(*bar))).collect();
        let nets: Vec<Area> =
            self.nets.iter().map(|net| around(&mut edges(*net).into_iter().flat_map(along))).collect();
        let all = bars.iter().chain(&nets).fold(Area::NONE, |all, area| all.with(area));
        SeenGoals { goals: self, from: map_from_optical.translation, bars, nets, all }
    }
}

/// The twelve edges of a box.
fn edges([low, high]: [DVec3; 2]) -> Vec<[DVec3; 2]> {
    let corner = |index: usize| {
        let pick = |axis: usize| if index >> axis & 1 == 1 { high[axis] } else { low[axis] };
        DVec3::new(pick(0), pick(1), pick(2))
    };
    let pairs = (0..8usize).flat_map(|a| (0..3).map(move |axis| (a, a | 1 << axis))).filter(|(a, b)| a != b);
    pairs.map(|(a, b)| [corner(a), corner(b)]).collect()
}

/// A rectangle of an image, pixels.
#[derive(Clone, Copy, Debug)]
struct Area([DVec2; 2]);

impl Area {
    const NONE: Self = Self([DVec2::INFINITY, DVec2::NEG_INFINITY]);

    fn take(&mut self, at: DVec2, margin: f64) {
        self.0 = [self.0[0].min(at - margin), self.0[1].max(at + margin)];
    }

    fn with(self, other: &Self) -> Self {
        Self([self.0[0].min(other.0[0]), self.0[1].max(other.0[1])])
    }

    fn holds(&self, at: DVec2) -> bool {
        at.cmpge(self.0[0]).all() && at.cmple(self.0[1]).all()
    }
}

/// The goals as seen by one camera.
pub(crate) struct SeenGoals<'a> {
    goals: &'a Goals,
    /// Position of the camera in `map`, metres.
    from: DVec3,
    bars: Vec<Area>,
    nets: Vec<Area>,
    /// What holds all of them.
    all: Area,
}

impl SeenGoals<'_> {
    /// The part of the goals that the unit ray of a pixel meets before `ground_m`, the distance of the ground; edges are as wide as
    /// `sigmas` standard deviations of the pose move them.
    pub(crate) fn part(
        &self,
        pixel: DVec2,
        ray: DVec3,
        ground_m: f64,
        covariance: &PoseCovariance,
        sigmas: f64,
    ) -> Option<GoalPart> {
        if !self.all.holds(pixel) {
            return None;
        }
        let mut edge = false;
        for (bar, _) in self.goals.bars.iter().zip(&self.bars).filter(|(_, area)| area.holds(pixel)) {
            let Some((distance, off)) = nearest_approach(*bar, self.from, ray) else { continue };
            if distance - self.goals.radius > ground_m {
                continue;
            }
            let outside = off.length() - self.goals.radius;
            let across = off.normalize_or(ray.any_orthonormal_vector());
            let sigma = covariance.sigma_along(across, ray * distance);
            if outside < -sigmas * sigma {
                return Some(GoalPart::Frame);
            }
            edge |= outside <= sigmas * sigma;
        }
        if edge {
            return Some(GoalPart::Edge);
        }
        let mut nets = self.goals.nets.iter().zip(&self.nets).filter(|(_, area)| area.holds(pixel));
        nets.any(|(net, _)| enters(*net, self.from, ray).is_some_and(|enters| enters < ground_m))
            .then_some(GoalPart::Net)
    }

    /// Whether a bar stands before a point that is `distance` along a ray.
    pub(crate) fn hides(&self, pixel: DVec2, ray: DVec3, distance: f64) -> bool {
        let mut bars = self.goals.bars.iter().zip(&self.bars).filter(|(_, area)| area.holds(pixel));
        bars.any(|(bar, _)| {
            let met = nearest_approach(*bar, self.from, ray);
            met.is_some_and(|(at, off)| off.length() < self.goals.radius && at < distance - 2.0 * self.goals.radius)
        })
    }
}

/// Where a unit ray comes nearest to a bar's axis: the distance along the ray, and the vector from the axis to the ray. `None` behind
/// the camera.
fn nearest_approach([foot, top]: [DVec3; 2], from: DVec3, ray: DVec3) -> Option<(f64, DVec3)> {
    let (axis, to_camera) = (top - foot, from - foot);
    let (aa, ra, ac, rc) = (axis.length_squared(), ray.dot(axis), axis.dot(to_camera), ray.dot(to_camera));
    let determinant = aa - ra * ra;
    let along = if determinant > 1e-12 { ((ac - ra * rc) / determinant).clamp(0.0, 1.0) } else { 0.0 };
    let point = foot + axis * along;
    let distance = ray.dot(point - from);
    (distance > 0.0).then(|| (distance, from + ray * distance - point))
}

/// The distance at which a ray enters a box; 0 from inside.
fn enters([low, high]: [DVec3; 2], from: DVec3, ray: DVec3) -> Option<f64> {
    let [a, b] = [(low - from) / ray, (high - from) / ray];
    let (near, far) = (a.min(b).max_element().max(0.0), a.max(b).min_element());
    (near <= far).then_some(near)
}
