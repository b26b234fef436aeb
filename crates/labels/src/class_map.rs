//! What each pixel of an image shows.

use glam::{DMat3, DVec2, DVec3};

use realitysim_geometry::Isometry;
use realitysim_views::{Camera, SURE};

use crate::goals::GoalPart;
use crate::pose_covariance::Bound;
use crate::{Labeller, PoseCovariance};

/// The class of a pixel. The numbers are those of the class maps' PNG files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Class {
    /// The hall beyond the carpet.
    Beyond = 0,
    /// Carpet without paint.
    Carpet = 1,
    /// A painted line or mark.
    Line = 2,
    /// A post or crossbar.
    GoalFrame = 3,
    /// The box behind a goal in which its net hangs.
    Net = 4,
    /// The robot itself.
    Body = 5,
    /// Not known: outside of the lens's circle, something that moves, or so near to an edge that the pose does not tell the side.
    Ignore = 255,
}

impl Class {
    /// All classes but [`Self::Ignore`], in the order of their numbers.
    pub const KNOWN: [Self; 6] = [Self::Beyond, Self::Carpet, Self::Line, Self::GoalFrame, Self::Net, Self::Body];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Beyond => "beyond",
            Self::Carpet => "carpet",
            Self::Line => "line",
            Self::GoalFrame => "goal_frame",
            Self::Net => "net",
            Self::Body => "body",
            Self::Ignore => "ignore",
        }
    }
}

/// An image with the pose of its camera.
#[derive(Clone, Copy, Debug)]
pub struct PosedImage<'a> {
    /// Its lens.
    pub camera: &'a Camera,
    /// Pose of `camera_link` in `map`.
    pub map_from_link: Isometry,
    /// Covariance of that pose.
    pub covariance: PoseCovariance,
    /// For each pixel, row by row: [`SURE`] if it shows the scene; other values if something that moves, or nothing.
    pub shown: &'a [u8],
    /// For each pixel: whether it shows the robot itself. Empty if it never does.
    pub body: &'a [bool],
}

/// Edges are ignored within this many standard deviations: the side is known in 95 of 100 cases.
pub(crate) const SIGMAS: f64 = 2.0;

impl Labeller {
    /// The class of each pixel, row by row.
    pub fn classes(&self, image: &PosedImage) -> Vec<Class> {
        let pose = image.map_from_link * Isometry::link_from_optical();
        let (from, rotation) = (pose.translation, DMat3::from_quat(pose.rotation));
        let goals = self.goals.seen_by(image.camera.lens(), &pose);
        let (width, bound) = (image.camera.width(), image.covariance.bound());
        let class = |index: usize| {
            let (u, v) = (index % width, index / width);
            if image.body.get(index).is_some_and(|body| *body) {
                return Class::Body;
            }
            let ray = image.camera.ray(u, v).filter(|_| image.shown.get(index) == Some(&SURE));
            let Some(ray) = ray else { return Class::Ignore };
            let ray = rotation * ray;
            let ground_m = if ray.z < 0.0 { from.z / -ray.z } else { f64::INFINITY };
            match goals.part(DVec2::new(u as f64, v as f64), ray, ground_m, &image.covariance, SIGMAS) {
                Some(GoalPart::Frame) => Class::GoalFrame,
                Some(GoalPart::Edge) => Class::Ignore,
                Some(GoalPart::Net) => Class::Net,
                None => self.background(from, ray, ground_m, &image.covariance, bound),
            }
        };
        (0..width * image.camera.height()).map(class).collect()
    }

    /// The class of what a ray meets that passes the goals. `bound` is of the covariance.
    fn background(&self, from: DVec3, ray: DVec3, ground_m: f64, covariance: &PoseCovariance, bound: Bound) -> Class {
        if ground_m == f64::INFINITY {
            return Class::Beyond;
        }
        let at = (from + ray * ground_m).truncate();
        let inside = self.half - at.abs();
        let (end, normal) = if inside.x < inside.y { (inside.x, DVec2::X) } else { (inside.y, DVec2::Y) };
        let reach_m = SIGMAS * bound.ground_m(ray, from.z);
        let is_near = |distance: f64, normal: DVec2| {
            let distance = distance.abs();
            distance < reach_m && distance < SIGMAS * covariance.ground_sigma(normal.extend(0.0), ray, from.z)
        };
        if is_near(end, normal) {
            return Class::Ignore;
        }
        if end < 0.0 {
            return Class::Beyond;
        }
        match self.paint.nearest_edge(at, reach_m) {
            Some(edge) if is_near(edge.distance, edge.normal) => Class::Ignore,
            Some(edge) if edge.distance <= 0.0 => Class::Line,
            _ => Class::Carpet,
        }
    }
}
