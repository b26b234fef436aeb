//! The bodies of figures, composed of convex solids.

use super::super::effects::{FigureShape, Member};
use super::macro_texture::Colour;
use super::solid::{Hit, Solid};

/// The body of a figure, in its own coordinate frame: x ahead, y left, z up from the ground, metres.
#[derive(Clone, Debug)]
pub(super) struct Body {
    pub(super) parts: Vec<Part>,
}

/// A solid of one colour. Limbs swing with the steps.
#[derive(Clone, Copy, Debug)]
pub(super) struct Part {
    solid: Solid,
    pub(super) colour: Colour,
    limb: Option<Limb>,
}

/// The swing of a limb about an axis across the body. For a positive swing the part below the axis moves ahead.
#[derive(Clone, Copy, Debug)]
struct Limb {
    /// Height of the axis, metres.
    height: f32,
    /// Share of the stride: +1 or -1 for left or right legs, less for arms.
    share: f32,
}

const SKIN: Colour = [192.0, 148.0, 122.0];
const HAIR: Colour = [58.0, 46.0, 38.0];
const SHOES: Colour = [40.0, 38.0, 40.0];
const JOINTS: Colour = [34.0, 34.0, 38.0];

/// Displacement of a leg at the widest point of a step, metres per metre below the hip.
const STRIDE: f32 = 0.28;

impl Body {
    /// The body of a figure.
    pub(super) fn new(member: &Member) -> Self {
        let (height, width) = (member.height as f32, member.width as f32);
        let (colour, accent) = (member.colour.map(|c| c as f32), member.accent.map(|c| c as f32));
        let plain = |solid| vec![Part { solid, colour, limb: None }];
        let (centre, half) = ([0.0, 0.0, height / 2.0], [width / 2.0, width / 2.0, height / 2.0]);
        let parts = match member.shape {
            FigureShape::Robot => robot(height, width, colour, accent),
            FigureShape::Person => person(height, width, colour, accent),
            FigureShape::Cylinder => plain(Solid::Pillar { centre, half }),
            FigureShape::Box => plain(Solid::Box { centre, half }),
            FigureShape::Ball => plain(Solid::Ball { centre, half }),
        };
        Self { parts }
    }
}

impl Part {
    /// Intersection with a ray in coordinates of the figure. `swing` is the phase of the step, -1 to 1.
    #[inline]
    pub(super) fn hit(&self, origin: [f32; 3], ray: [f32; 3], swing: f32) -> Option<Hit> {
        let Some(limb) = self.limb else { return self.solid.hit(origin, ray) };
        // The ray is sheared so that the limb is upright again. Distances along the ray do not change.
        let slope = STRIDE * limb.share * swing;
        let ahead = origin[0] - slope * (limb.height - origin[2]);
        self.solid.hit([ahead, origin[1], origin[2]], [ray[0] + slope * ray[2], ray[1], ray[2]])
    }

    /// Centres and radii of bounding balls that together contain the part.
    ///
    /// They are stacked vertically, because legs are long and thin.
    pub(super) fn balls(&self, swing: f32) -> Vec<([f32; 3], f32)> {
        let (centre, half) = self.solid.extent();
        let count = (half[2] / half[0].max(half[1]).max(1e-3)).clamp(1.0, 8.0) as usize;
        let slice = half[2] / count as f32;
        let ball = |index: usize| {
            let z = centre[2] - half[2] + (2 * index + 1) as f32 * slice;
            let slope = self.limb.map_or(0.0, |limb| STRIDE * limb.share * swing);
            let ahead = self.limb.map_or(0.0, |limb| slope * (limb.height - z));
            let length = half[0] + slope.abs() * slice;
            let radius = (length * length + half[1] * half[1] + slice * slice).sqrt();
            ([centre[0] + ahead, centre[1], z], radius)
        };
        (0..count).map(ball).collect()
    }
}

/// Builds a body from parts whose sizes are shares of the height and, for y, of the width.
struct Builder {
    height: f32,
    width: f32,
    parts: Vec<Part>,
}

/// The solid that fills a box-shaped space.
#[derive(Clone, Copy)]
enum Form {
    Box,
    Pillar,
    Ball,
}

impl Builder {
    /// Adds a part. `x` and `z` are from and to in heights, `y` in widths. `limb` is height of the axis and share of the stride.
    fn part(&mut self, form: Form, [x, y, z]: [[f32; 2]; 3], colour: Colour, limb: Option<(f32, f32)>) {
        let ranges = [x.map(|v| v * self.height), y.map(|v| v * self.width), z.map(|v| v * self.height)];
        let (centre, half) = (ranges.map(|[a, b]| (a + b) / 2.0), ranges.map(|[a, b]| (b - a) / 2.0));
        let solid = match form {
            Form::Box => Solid::Box { centre, half },
            Form::Pillar => Solid::Pillar { centre, half },
            Form::Ball => Solid::Ball { centre, half },
        };
        let limb = limb.map(|(height, share)| Limb { height: height * self.height, share });
        self.parts.push(Part { solid, colour, limb });
    }
}

fn robot(height: f32, width: f32, shell: Colour, jersey: Colour) -> Vec<Part> {
    let mut b = Builder { height, width, parts: Vec::new() };
    for side in [1.0, -1.0] {
        let y = |from: f32, to: f32| if side > 0.0 { [from, to] } else { [-to, -from] };
        let leg = Some((0.5, side));
        b.part(Form::Box, [[-0.08, 0.14], y(0.11, 0.39), [0.0, 0.05]], JOINTS, leg);
        b.part(Form::Box, [[-0.05, 0.05], y(0.14, 0.35), [0.05, 0.25]], shell, leg);
        b.part(Form::Box, [[-0.04, 0.055], y(0.15, 0.34), [0.25, 0.30]], JOINTS, leg);
        b.part(Form::Box, [[-0.05, 0.05], y(0.14, 0.36), [0.30, 0.46]], shell, leg);
        let arm = Some((0.78, -0.6 * side));
        b.part(Form::Pillar, [[-0.04, 0.04], y(0.34, 0.50), [0.73, 0.80]], shell, None);
        b.part(Form::Box, [[-0.035, 0.035], y(0.36, 0.50), [0.58, 0.75]], shell, arm);
        b.part(Form::Box, [[-0.03, 0.03], y(0.38, 0.48), [0.40, 0.58]], JOINTS, arm);
    }
    b.part(Form::Box, [[-0.07, 0.07], [-0.34, 0.34], [0.45, 0.52]], JOINTS, None);
    b.part(Form::Box, [[-0.08, 0.09], [-0.30, 0.30], [0.52, 0.72]], jersey, None);
    b.part(Form::Box, [[-0.09, 0.10], [-0.35, 0.35], [0.70, 0.80]], shell, None);
    b.part(Form::Pillar, [[-0.035, 0.035], [-0.08, 0.08], [0.80, 0.86]], JOINTS, None);
    b.part(Form::Ball, [[-0.085, 0.085], [-0.19, 0.19], [0.84, 1.0]], shell, None);
    b.part(Form::Box, [[0.03, 0.083], [-0.12, 0.12], [0.90, 0.945]], JOINTS, None);
    b.parts
}

fn person(height: f32, width: f32, shirt: Colour, trousers: Colour) -> Vec<Part> {
    let mut b = Builder { height, width, parts: Vec::new() };
    for side in [1.0, -1.0] {
        let y = |from: f32, to: f32| if side > 0.0 { [from, to] } else { [-to, -from] };
        let leg = Some((0.52, side));
        b.part(Form::Box, [[-0.05, 0.105], y(0.11, 0.31), [0.0, 0.045]], SHOES, leg);
        b.part(Form::Pillar, [[-0.035, 0.035], y(0.12, 0.32), [0.03, 0.28]], trousers, leg);
        b.part(Form::Pillar, [[-0.045, 0.045], y(0.08, 0.36), [0.26, 0.52]], trousers, leg);
        let arm = Some((0.81, -0.8 * side));
        b.part(Form::Ball, [[-0.045, 0.045], y(0.30, 0.50), [0.74, 0.84]], shirt, None);
        b.part(Form::Pillar, [[-0.03, 0.03], y(0.385, 0.50), [0.62, 0.80]], shirt, arm);
        b.part(Form::Pillar, [[-0.023, 0.023], y(0.40, 0.49), [0.47, 0.63]], SKIN, arm);
        b.part(Form::Ball, [[-0.025, 0.03], y(0.39, 0.48), [0.41, 0.49]], SKIN, arm);
    }
    b.part(Form::Pillar, [[-0.065, 0.065], [-0.37, 0.37], [0.47, 0.58]], trousers, None);
    b.part(Form::Pillar, [[-0.065, 0.065], [-0.38, 0.38], [0.55, 0.80]], shirt, None);
    b.part(Form::Ball, [[-0.065, 0.065], [-0.42, 0.42], [0.74, 0.855]], shirt, None);
    b.part(Form::Pillar, [[-0.03, 0.03], [-0.11, 0.11], [0.82, 0.89]], SKIN, None);
    b.part(Form::Ball, [[-0.05, 0.06], [-0.17, 0.17], [0.865, 0.99]], SKIN, None);
    b.part(Form::Ball, [[-0.065, 0.035], [-0.185, 0.185], [0.895, 1.0]], HAIR, None);
    b.parts
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::super::effects::Crowd;
    use super::*;
    use crate::SceneFile;
    use crate::effects::Effect;

    /// One body of every shape except the ball.
    fn bodies() -> Vec<Body> {
        let shapes = ["robot", "person", "cylinder", "box"];
        let list = shapes.map(|shape| format!("{{ shape = \"{shape}\", position_m = [0, 0], height_m = 1.2 }}"));
        let scene = include_str!("../../../../replay/scenes/straight.toml");
        let scene = scene.split("[[effect]]").next().expect("a first part");
        let toml = format!("{scene}\n[[effect]]\nkind = \"obstacles\"\nfigures = [{}]", list.join(", "));
        let file = SceneFile::from_toml(&toml).expect("readable");
        let Some(Effect::Obstacles(effect)) = file.effects.first() else { panic!("no obstacles") };
        let field = realitysim_config::load_field("kid-2009").expect("a shipped field");
        let Crowd { members } = effect.model(1, &realitysim_geometry::Field::new(field).expect("good"), &[]);
        members.iter().map(Body::new).collect()
    }

    proptest! {
        #[test]
        fn balls_hold_all_of_their_part(
            from in [-3f32..3.0, -3f32..3.0, 0f32..2.5],
            towards in [-0.3f32..0.3, -0.3f32..0.3, 0f32..1.2],
            swing in -1f32..1.0,
        ) {
            let way: [f32; 3] = core::array::from_fn(|i| towards[i] - from[i]);
            let length = (way[0] * way[0] + way[1] * way[1] + way[2] * way[2]).sqrt();
            prop_assume!(length > 0.1);
            let ray = way.map(|v| v / length);
            for part in bodies().iter().flat_map(|body| &body.parts) {
                let Some(hit) = part.hit(from, ray, swing) else { continue };
                let at: [f32; 3] = core::array::from_fn(|i| from[i] + hit.t * ray[i]);
                let inside = |(centre, radius): &([f32; 3], f32)| {
                    let d: [f32; 3] = core::array::from_fn(|i| at[i] - centre[i]);
                    (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt() <= radius + 1e-3
                };
                prop_assert!(part.balls(swing).iter().any(inside), "{part:?} {at:?}");
            }
        }
    }
}
