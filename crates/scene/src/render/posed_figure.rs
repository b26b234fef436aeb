//! A figure where it stands in one frame, and the camera that looks at it.

use super::super::effects::{LightModel, Member};
use super::body::Body;
use super::light::lit;
use super::macro_texture::Colour;
use super::rays::RayTable;
use super::solid::Hit;
use super::tiles::Ball;

/// One frame: the camera's place in `map`, its rotation column by column, and the light.
#[derive(Clone, Copy)]
pub(super) struct View<'a> {
    pub(super) rays: &'a RayTable,
    pub(super) rotation: &'a [f32; 9],
    pub(super) camera: &'a [f32; 3],
    pub(super) light: Option<&'a LightModel>,
}

/// A figure where it stands in this frame.
pub(super) struct Placed<'a> {
    pub(super) body: &'a Body,
    pub(super) place: [f32; 2],
    /// Cosine and sine of its yaw.
    turn: [f32; 2],
    pub(super) swing: f32,
    /// At its place.
    light: Colour,
    /// The camera, seen from the figure.
    pub(super) camera: [f32; 3],
    /// Around the body, around each of its parts, around its shadow.
    pub(super) ball: Ball,
    pub(super) parts: Vec<Vec<Ball>>,
    pub(super) shadow: Ball,
    pub(super) shadow_m: f32,
}

/// How far a shadow reaches beyond the body.
const SHADOW_BEYOND_M: f32 = 0.22;
/// Two steps, as a share of the height.
const TWO_STEPS: f32 = 0.75;
/// Towards the brighter side of the hall.
const SUN: [f32; 2] = [0.64, -0.77];

impl View<'_> {
    #[inline]
    pub(super) fn in_map(&self, ray: [f32; 3]) -> [f32; 3] {
        let r = self.rotation;
        core::array::from_fn(|i| r[i] * ray[0] + r[i + 3] * ray[1] + r[i + 6] * ray[2])
    }
}

impl<'a> Placed<'a> {
    pub(super) fn new(member: &Member, body: &'a Body, time: f64, view: &View) -> Self {
        let standpoint = member.at(time);
        let (sin, cos) = libm::sincos(standpoint.pose.yaw);
        let (place, turn) = ([standpoint.pose.x as f32, standpoint.pose.y as f32], [cos as f32, sin as f32]);
        let height = member.height as f32;
        let swing = |walked: f64| libm::sin(core::f64::consts::TAU * walked / f64::from(TWO_STEPS * height)) as f32;
        let shadow_m = member.width as f32 / 2.0 + SHADOW_BEYOND_M;
        let in_camera = |p: [f32; 3]| {
            let map = [place[0] + turn[0] * p[0] - turn[1] * p[1], place[1] + turn[1] * p[0] + turn[0] * p[1], p[2]];
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
        let dx = [view.camera[0] - place[0], view.camera[1] - place[1]];
        Self {
            body,
            place,
            turn,
            swing,
            light: lit(view.light, [1.0; 3], || place),
            camera: [turn[0] * dx[0] + turn[1] * dx[1], turn[0] * dx[1] - turn[1] * dx[0], view.camera[2]],
            ball: ball(&(middle, around)),
            parts: parts.iter().map(|balls| balls.iter().map(ball).collect()).collect(),
            shadow: ball(&([0.0; 3], shadow_m)),
            shadow_m,
        }
    }

    /// A ray in `map`, seen from the figure.
    #[inline]
    pub(super) fn turned(&self, ray: [f32; 3]) -> [f32; 3] {
        let [cos, sin] = self.turn;
        [cos * ray[0] + sin * ray[1], cos * ray[1] - sin * ray[0], ray[2]]
    }

    /// `ray` as the figure sees it.
    pub(super) fn colour(&self, part: usize, hit: &Hit, ray: [f32; 3]) -> Colour {
        let n = hit.normal;
        let scale = 1.0 / (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt().max(1e-9);
        let [cos, sin] = self.turn;
        let sun = [cos * SUN[0] + sin * SUN[1], cos * SUN[1] - sin * SUN[0]];
        let up = n[2] * scale;
        let aside = (n[0] * sun[0] + n[1] * sun[1]) * scale;
        let height = self.camera[2] + hit.t * ray[2];
        // Lamps hang from the ceiling; near the ground the carpet shines back less than the hall.
        let gain = (0.70 + 0.25 * up + 0.16 * aside) * (0.8 + 0.2 * (2.0 * height).clamp(0.0, 1.0));
        let colour = self.body.parts[part].colour;
        core::array::from_fn(|channel| colour[channel] * gain * self.light[channel])
    }
}
