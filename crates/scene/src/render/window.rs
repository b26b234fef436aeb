//! Drawing of a bright window, its sunlight on the floor, and its veil of scattered light over the picture.

use super::super::effects::{BrightWindow, Wall};
use super::fixed::byte;
use super::footprint::Turned;
use super::posed_figure::View;

/// A bright window, prepared for drawing. Lengths are metres.
#[derive(Clone, Debug)]
pub(super) struct Window {
    /// Axis of `map` across the wall: 0 for a wall at an end of the field, 1 for one at a side.
    axis: usize,
    /// Position of the wall on this axis.
    wall: f32,
    /// Extent along the wall.
    along: [f32; 2],
    /// Heights of the lower and the upper edge.
    up: [f32; 2],
    hall_half: [f32; 2],
    /// Image value of the window, which may exceed 255.
    value: f32,
    glare: f32,
    /// Distances from the wall at which the sunlight on the floor begins and ends.
    sun: Option<[f32; 2]>,
    sun_gain: f32,
}

/// Image value of white paint.
const WHITE: f32 = 222.0;
/// Width of the soft edges of the sunlight, metres. The sun is not a point.
const SOFT_M: f32 = 0.04;

impl Window {
    /// Prepares the window for a hall with these half extents.
    pub(super) fn new(effect: &BrightWindow, hall_half: [f32; 2]) -> Self {
        let (axis, sign) = match effect.wall {
            Wall::XPlus => (0, 1.0),
            Wall::XMinus => (0, -1.0),
            Wall::YPlus => (1, 1.0),
            Wall::YMinus => (1, -1.0),
        };
        let (centre, half) = (effect.centre_m as f32, effect.width_m as f32 / 2.0);
        let up = [effect.sill_m as f32, (effect.sill_m + effect.height_m) as f32];
        let steep = effect.sun_elevation_deg.map(|elevation| libm::tan(elevation.to_radians()) as f32);
        Self {
            axis,
            wall: sign * hall_half[axis],
            along: [centre - half, centre + half],
            up,
            hall_half,
            value: effect.brightness as f32 * WHITE,
            glare: effect.glare as f32,
            sun: steep.map(|steep| up.map(|height| height / steep)),
            sun_gain: effect.sun_gain as f32,
        }
    }

    /// Draws window and sunlight over some rows of a picture of the empty hall. Returns the scattered light in image values.
    pub(super) fn draw(&self, view: &View, rows: core::ops::Range<usize>, pixels: &mut [u8]) -> f32 {
        let width = view.rays.width();
        let mut turned = Turned::new(width);
        let (mut bright, mut seen_pixels) = (0usize, 0usize);
        for row in rows.clone() {
            turned.turn(view.rays, row + 1, view.rotation);
            let seen = view.rays.visible_columns(row);
            seen_pixels += seen.len();
            let line = &mut pixels[(row - rows.start) * width * 3..][..width * 3];
            for column in seen {
                let ray = turned.direction(column);
                let pixel = &mut line[3 * column..3 * column + 3];
                if self.is_in_window(view.camera, ray) {
                    bright += 1;
                    pixel.fill(byte(self.value));
                } else if let Some(gain) = self.sunlight(view.camera, ray) {
                    pixel.iter_mut().for_each(|value| *value = byte(f32::from(*value) * gain));
                }
            }
        }
        self.glare * self.value * bright as f32 / seen_pixels.max(1) as f32
    }

    /// Whether a ray ends in the window.
    fn is_in_window(&self, camera: &[f32; 3], ray: [f32; 3]) -> bool {
        let ahead = ray[self.axis] * self.wall.signum();
        if ahead <= 1e-6 {
            return false;
        }
        let t = (self.wall - camera[self.axis]).abs() / ahead;
        let (along, up) = (camera[1 - self.axis] + t * ray[1 - self.axis], camera[2] + t * ray[2]);
        // Beyond the corner of the hall the ray meets another wall.
        along.abs() < self.hall_half[1 - self.axis] && inside(along, self.along) && inside(up, self.up)
    }

    /// Factor of the brightness of the floor where a ray ends. `None` off the floor and where the sun does not shine.
    fn sunlight(&self, camera: &[f32; 3], ray: [f32; 3]) -> Option<f32> {
        let sun = self.sun?;
        if ray[2] > -1e-4 {
            return None;
        }
        let t = camera[2] / -ray[2];
        let place = [camera[0] + t * ray[0], camera[1] + t * ray[1]];
        if place[0].abs() > self.hall_half[0] || place[1].abs() > self.hall_half[1] {
            return None;
        }
        let depth = (self.wall - place[self.axis]).abs();
        let lit = soft(depth, sun) * soft(place[1 - self.axis], self.along);
        (lit > 0.0).then_some(1.0 + (self.sun_gain - 1.0) * lit)
    }
}

/// Adds scattered light, an image value, to all pixels.
pub(super) fn add_veil(pixels: &mut [u8], value: f32) {
    if value > 0.0 {
        pixels.iter_mut().for_each(|pixel| *pixel = byte(f32::from(*pixel) + value));
    }
}

fn inside(value: f32, [low, high]: [f32; 2]) -> bool {
    (low..=high).contains(&value)
}

/// 1 inside the range, 0 outside, and a ramp of [`SOFT_M`] between.
fn soft(value: f32, [low, high]: [f32; 2]) -> f32 {
    let inside = (value - low).min(high - value);
    (inside / SOFT_M + 0.5).clamp(0.0, 1.0)
}
