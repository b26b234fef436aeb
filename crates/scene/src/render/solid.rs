//! Convex solids and their intersection with rays.

/// A solid, upright and aligned with the axes of its figure. Centre and half sizes in x, y and z are metres.
#[derive(Clone, Copy, Debug)]
pub(super) enum Solid {
    /// A box.
    Box { centre: [f32; 3], half: [f32; 3] },
    /// An upright cylinder with elliptic section.
    Pillar { centre: [f32; 3], half: [f32; 3] },
    /// An ellipsoid.
    Ball { centre: [f32; 3], half: [f32; 3] },
}

/// The point at which a ray enters a solid.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hit {
    /// Distance along the ray, in lengths of the ray vector.
    pub(super) t: f32,
    /// Outward normal, not normalised.
    pub(super) normal: [f32; 3],
}

/// Minimum distance at which a solid is drawn. Nearer than that the camera would be inside.
const MIN_DISTANCE_M: f32 = 0.02;
/// Replaces smaller divisors where a ray runs along an axis. Quotients become large, but not NaN.
const MIN_DIVISOR: f32 = 1e-9;

impl Solid {
    /// Centre and half sizes.
    pub(super) fn extent(&self) -> ([f32; 3], [f32; 3]) {
        let (Solid::Box { centre, half } | Solid::Pillar { centre, half } | Solid::Ball { centre, half }) = *self;
        (centre, half)
    }

    /// The point at which a ray from outside enters the solid.
    #[inline]
    pub(super) fn hit(&self, origin: [f32; 3], ray: [f32; 3]) -> Option<Hit> {
        let from = |centre: [f32; 3]| core::array::from_fn(|i| origin[i] - centre[i]);
        match *self {
            Solid::Box { centre, half } => hit_box(from(centre), ray, half),
            Solid::Pillar { centre, half } => hit_pillar(from(centre), ray, half),
            Solid::Ball { centre, half } => hit_ball(from(centre), ray, half),
        }
    }
}

/// Range of t in which the ray is between -`half` and +`half` along one axis.
#[inline]
fn slab(o: f32, d: f32, half: f32) -> (f32, f32) {
    let inverse = 1.0 / if d.abs() < MIN_DIVISOR { MIN_DIVISOR } else { d };
    let (a, b) = ((-half - o) * inverse, (half - o) * inverse);
    (a.min(b), a.max(b))
}

#[inline]
fn hit_box(o: [f32; 3], d: [f32; 3], half: [f32; 3]) -> Option<Hit> {
    let [x, y, z] = core::array::from_fn(|i| slab(o[i], d[i], half[i]));
    let enters = x.0.max(y.0).max(z.0);
    if !is_visible(enters, x.1.min(y.1).min(z.1)) {
        return None;
    }
    let mut normal = [0.0; 3];
    let axis = if enters == x.0 {
        0
    } else if enters == y.0 {
        1
    } else {
        2
    };
    normal[axis] = -d[axis].signum();
    Some(Hit { t: enters, normal })
}

#[inline]
fn hit_pillar(o: [f32; 3], d: [f32; 3], half: [f32; 3]) -> Option<Hit> {
    let (ox, oy, dx, dy) = (o[0] / half[0], o[1] / half[1], d[0] / half[0], d[1] / half[1]);
    let (round_in, round_out) = roots(dx * dx + dy * dy, ox * dx + oy * dy, ox * ox + oy * oy - 1.0)?;
    let flat = slab(o[2], d[2], half[2]);
    let enters = round_in.max(flat.0);
    if !is_visible(enters, round_out.min(flat.1)) {
        return None;
    }
    let normal = if round_in > flat.0 {
        [(ox + enters * dx) / half[0], (oy + enters * dy) / half[1], 0.0]
    } else {
        [0.0, 0.0, -d[2].signum()]
    };
    Some(Hit { t: enters, normal })
}

#[inline]
fn hit_ball(o: [f32; 3], d: [f32; 3], half: [f32; 3]) -> Option<Hit> {
    let scaled = |v: [f32; 3]| -> [f32; 3] { core::array::from_fn(|i| v[i] / half[i]) };
    let (o, d) = (scaled(o), scaled(d));
    let dot = |a: [f32; 3], b: [f32; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let (enters, _) = roots(dot(d, d), dot(o, d), dot(o, o) - 1.0)?;
    if !is_visible(enters, enters) {
        return None;
    }
    Some(Hit { t: enters, normal: core::array::from_fn(|i| (o[i] + enters * d[i]) / half[i]) })
}

/// Whether the range from `enters` to `leaves` is a visible hit. It is false for NaN.
#[inline]
fn is_visible(enters: f32, leaves: f32) -> bool {
    enters <= leaves && enters >= MIN_DISTANCE_M
}

/// Range of t in which a t^2 + 2 b t + c is below 0.
#[inline]
fn roots(a: f32, b: f32, c: f32) -> Option<(f32, f32)> {
    if a < MIN_DIVISOR {
        // The ray runs along the axis: it is always inside or never.
        return (c < 0.0).then_some((f32::NEG_INFINITY, f32::INFINITY));
    }
    let discriminant = b * b - a * c;
    (discriminant >= 0.0).then(|| {
        let (root, inverse) = (discriminant.sqrt(), 1.0 / a);
        ((-b - root) * inverse, (root - b) * inverse)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const HALF: [f32; 3] = [0.3, 0.2, 0.5];

    fn solids() -> [Solid; 3] {
        let centre = [0.0, 0.0, 0.5];
        [Solid::Box { centre, half: HALF }, Solid::Pillar { centre, half: HALF }, Solid::Ball { centre, half: HALF }]
    }

    /// Implicit function of the solid: below 0 inside, 0 on the surface.
    fn outside(solid: &Solid, p: [f32; 3]) -> f32 {
        let [x, y, z] = [p[0] / HALF[0], p[1] / HALF[1], (p[2] - 0.5) / HALF[2]];
        match solid {
            Solid::Box { .. } => x.abs().max(y.abs()).max(z.abs()) - 1.0,
            Solid::Pillar { .. } => x.hypot(y).max(z.abs()) - 1.0,
            Solid::Ball { .. } => x.hypot(y).hypot(z) - 1.0,
        }
    }

    proptest! {
        #[test]
        fn a_hit_is_on_the_surface_and_its_normal_faces_the_ray(
            from in [-4f32..4.0, -4f32..4.0, 0f32..3.0],
            towards in [-0.5f32..0.5, -0.5f32..0.5, 0f32..1.0],
        ) {
            let way: [f32; 3] = core::array::from_fn(|i| towards[i] - from[i]);
            let length = (way[0] * way[0] + way[1] * way[1] + way[2] * way[2]).sqrt();
            prop_assume!(length > 0.5);
            let ray = way.map(|v| v / length);
            for solid in solids() {
                prop_assume!(outside(&solid, from) > 0.1);
                let hit = solid.hit(from, ray);
                // A ray that is aimed at the inside cannot miss.
                prop_assert!(hit.is_some() || outside(&solid, towards) > -1e-3);
                if let Some(hit) = hit {
                    let at: [f32; 3] = core::array::from_fn(|i| from[i] + hit.t * ray[i]);
                    prop_assert!(outside(&solid, at).abs() < 1e-3, "{solid:?} {at:?}");
                    let facing: f32 = (0..3).map(|i| hit.normal[i] * ray[i]).sum();
                    prop_assert!(facing <= 1e-4, "{solid:?} {facing}");
                }
            }
        }
    }

    #[test]
    fn rays_along_an_axis_and_rays_of_nan_are_handled() {
        for solid in solids() {
            assert!(solid.hit([-2.0, 0.0, 0.5], [1.0, 0.0, 0.0]).is_some());
            assert!(solid.hit([0.0, 0.0, 3.0], [0.0, 0.0, -1.0]).is_some());
            assert!(solid.hit([2.0, 0.0, 0.5], [1.0, 0.0, 0.0]).is_none());
            assert!(solid.hit([0.0, 0.0, 0.5], [1.0, 0.0, 0.0]).is_none(), "from inside");
            assert!(solid.hit([f32::NAN; 3], [f32::NAN; 3]).is_none());
        }
    }
}
