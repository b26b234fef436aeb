//! A figure at its pose in one frame, as seen by the camera.

use super::super::effects::{LightModel, Member};
use super::body::Body;
use super::light::illuminate;
use super::macro_texture::Colour;
use super::rays::RayTable;
use super::solid::Hit;
use super::tiles::Ball;

/// The camera of one frame: its rays, its pose in `map` (the rotation column by column), and the light.
#[derive(Clone, Copy)]
pub(super) struct View<'a> {
    pub(super) rays: &'a RayTable,
    pub(super) rotation: &'a [f32; 9],
    pub(super) camera: &'a [f32; 3],
    pub(super) light: Option<&'a LightModel>,
}

/// A figure at its pose in one frame.
pub(super) struct PlacedFigure<'a> {
    pub(super) body: &'a Body,
    /// Position in `map`, metres.
    pub(super) position: [f32; 2],
    /// Cosine and sine of the yaw.
    turn: [f32; 2],
    /// Phase of the step, -1 to 1.
    pub(super) swing: f32,
    /// Light at the position.
    light: Colour,
    /// Position of the camera in coordinates of the figure.
    pub(super) camera: [f32; 3],
    /// Bounding ball of the body.
    pub(super) ball: Ball,
    /// Bounding balls of each part.
    pub(super) parts: Vec<Vec<Ball>>,
    /// Bounding ball of the shadow.
    pub(super) shadow: Ball,
    /// Radius of the shadow, metres.
    pub(super) shadow_m: f32,
}

/// Distance by which a shadow reaches beyond the body, metres.
const SHADOW_BEYOND_M: f32 = 0.22;
/// Length of two steps as a share of the height.
const TWO_STEPS: f32 = 0.75;
/// Unit vector in `map` towards the brighter side of the hall.
const BRIGHT_SIDE: [f32; 2] = [0.64, -0.77];

impl View<'_> {
    /// Rotates a ray from `camera_link` to `map`.
    #[inline]
    pub(super) fn in_map(&self, ray: [f32; 3]) -> [f32; 3] {
        let r = self.rotation;
        core::array::from_fn(|i| r[i] * ray[0] + r[i + 3] * ray[1] + r[i + 6] * ray[2])
    }
}

impl<'a> PlacedFigure<'a> {
    /// The figure at `time`, seconds since the start of the scene.
    pub(super) fn new(member: &Member, body: &'a Body, time: f64, view: &View) -> Self {
        let standpoint = member.at(time);
        let (sin, cos) = libm::sincos(standpoint.pose.yaw);
        let (position, turn) = ([standpoint.pose.x as f32, standpoint.pose.y as f32], [cos as f32, sin as f32]);
        let height = member.height as f32;
        let swing = |walked: f64| libm::sin(core::f64::consts::TAU * walked / f64::from(TWO_STEPS * height)) as f32;
        let shadow_m = member.width as f32 / 2.0 + SHADOW_BEYOND_M;
        let in_camera = |p: [f32; 3]| {
            let map =
                [position[0] + turn[0] * p[0] - turn[1] * p[1], position[1] + turn[1] * p[0] + turn[0] * p[1], p[2]];
            let d: [f32; 3] = core::array::from_fn(|i| map[i] - view.camera[i]);
            let r = view.rotation;
            core::array::from_fn(|i| r[3 * i] * d[0] + r[3 * i + 1] * d[1] + r[3 * i + 2] * d[2])
        };
        let swing = standpoint.walked.map_or(0.0, swing);
        let ball = |(centre, radius): &([f32; 3], f32)| Ball::new(in_camera(*centre), *radius);
        let parts: Vec<Vec<_>> = body.parts.iter().map(|part| part.balls(swing)).collect();
        let middle = [0.0, 0.0, height / 2.0];
        let reach = |(centre, radius): &([f32; 3], f32)| {
            let d: [f32; 3] = core::array::from_fn(|i| centre[i] - middle[i]);
            radius + (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt()
        };
        let around = parts.iter().flatten().map(reach).fold(0.0, f32::max);
        let dx = [view.camera[0] - position[0], view.camera[1] - position[1]];
        Self {
            body,
            position,
            turn,
            swing,
            light: illuminate(view.light, [1.0; 3], || position),
            camera: [turn[0] * dx[0] + turn[1] * dx[1], turn[0] * dx[1] - turn[1] * dx[0], view.camera[2]],
            ball: ball(&(middle, around)),
            parts: parts.iter().map(|balls| balls.iter().map(ball).collect()).collect(),
            shadow: ball(&([0.0; 3], shadow_m)),
            shadow_m,
        }
    }

    /// Rotates a ray from `map` to coordinates of the figure.
    #[inline]
    pub(super) fn to_figure(&self, ray: [f32; 3]) -> [f32; 3] {
        let [cos, sin] = self.turn;
        [cos * ray[0] + sin * ray[1], cos * ray[1] - sin * ray[0], ray[2]]
    }

    /// Colour of a part at a hit. `ray` is in coordinates of the figure.
    pub(super) fn colour(&self, part: usize, hit: &Hit, ray: [f32; 3]) -> Colour {
        let n = hit.normal;
        let scale = 1.0 / (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt().max(1e-9);
        let [cos, sin] = self.turn;
        let sun = [cos * BRIGHT_SIDE[0] + sin * BRIGHT_SIDE[1], cos * BRIGHT_SIDE[1] - sin * BRIGHT_SIDE[0]];
        let up = n[2] * scale;
        let aside = (n[0] * sun[0] + n[1] * sun[1]) * scale;
        let height = self.camera[2] + hit.t * ray[2];
        // Lamps hang from the ceiling, and near the ground the carpet reflects less light than the hall.
        let gain = (0.70 + 0.25 * up + 0.16 * aside) * (0.8 + 0.2 * (2.0 * height).clamp(0.0, 1.0));
        let colour = self.body.parts[part].colour;
        core::array::from_fn(|channel| colour[channel] * gain * self.light[channel])
    }
}
