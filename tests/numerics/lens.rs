//! From ray to pixel and back, where lenses are hard: at the axis, the rim, beyond 90 degrees, nearly flat.

use core::f64::consts::PI;

use glam::{DVec2, DVec3};
use realitysim::config::load_lens;
use realitysim::geometry::{Lens, LensModel, LensParameters, Projector};

use realitysim_test_support::measured::largest_error;

/// Numerator and denominator nearly cancel, as in what depth cameras announce.
const RATIONAL: [f64; 8] = [4.1, -2.3, 0.0011, -0.0007, 0.31, 4.3, -0.7, -0.2];
const THIN_PRISM: [f64; 12] =
    [-0.31, 0.11, 0.0012, -0.0008, -0.014, 0.02, -0.003, 0.0004, 0.0021, -0.0003, -0.0013, 0.0002];

/// Each shipped lens, and others at the edge of what their models can do.
pub fn lenses() -> Vec<(String, Lens)> {
    let shipped = ["equisolid-640", "fisheye-1280", "fisheye-640", "paper-640", "wide-640", "wide-800"];
    let mut lenses: Vec<_> =
        shipped.iter().map(|name| (name.to_string(), load_lens(name).expect("a shipped lens").lens)).collect();
    let square = |model, fov_deg| LensParameters {
        width: 500,
        height: 500,
        fx: 100.0,
        fy: 103.0,
        cx: 251.3,
        cy: 248.1,
        model,
        fov_deg,
    };
    let extremes = [
        ("all around, equidistant", LensModel::KannalaBrandt { k: [0.0; 4] }, Some(360.0)),
        ("280 deg, strongly bent", LensModel::KannalaBrandt { k: [0.05, -0.01, 0.001, 0.0] }, Some(280.0)),
        ("all around, equisolid", LensModel::Equisolid, Some(360.0)),
        ("pinhole, strongly bent", LensModel::PlumbBob { d: [-0.28, 0.09, 0.002, -0.003, -0.012] }, None),
        ("pinhole, cushion", LensModel::PlumbBob { d: [0.3, 0.2, -0.002, 0.001, 0.1] }, None),
        ("rational, large terms", LensModel::RationalPolynomial { d: RATIONAL }, None),
        ("thin prism", LensModel::ThinPrism { d: THIN_PRISM }, None),
        ("double sphere, beyond 90 deg", LensModel::DoubleSphere { xi: -0.23, alpha: 0.59 }, Some(230.0)),
        ("scaramuzza", LensModel::Scaramuzza { c: [-0.31, 0.05, -0.06, 0.01, 0.0], skew: 0.003 }, Some(200.0)),
        ("enhanced unified, beyond 90 deg", LensModel::Eucm { alpha: 0.62, beta: 1.1 }, Some(210.0)),
    ];
    for (name, model, fov_deg) in extremes {
        let wider =
            if name.contains("pinhole") || name.contains("rational") || name.contains("prism") { 4.0 } else { 1.0 };
        let parameters = square(model, fov_deg);
        let parameters = LensParameters { fx: wider * parameters.fx, fy: wider * parameters.fy, ..parameters };
        lenses.push((name.to_owned(), Lens::new(parameters).expect("a possible lens")));
    }
    lenses
}

/// Two unit vectors across a unit ray.
fn across(ray: DVec3) -> [DVec3; 2] {
    let first = ray.any_orthonormal_vector();
    [first, ray.cross(first)]
}

/// How much the map from ray (rad) to pixel stretches most and least there, px per rad; `None` at the rim.
fn stretch(lens: &Lens, ray: DVec3) -> Option<[f64; 2]> {
    const STEP: f64 = 1e-6;
    let mut columns = [DVec2::ZERO; 2];
    for (column, axis) in columns.iter_mut().zip(across(ray)) {
        *column = (lens.project(ray + axis * STEP)? - lens.project(ray - axis * STEP)?) / (2.0 * STEP);
    }
    let [a, b] = columns;
    // Singular values of a 2 x 2 matrix.
    let (sum, product) = (a.length_squared() + b.length_squared(), a.perp_dot(b).abs());
    let root = (sum * sum / 4.0 - product * product).max(0.0).sqrt();
    let most = (sum / 2.0 + root).sqrt();
    Some([most, product / most])
}

#[test]
fn pixels_come_back_on_the_whole_image_of_every_lens() {
    let mut largest = 0.0f64;
    for (name, lens) in lenses() {
        let mut seen = 0;
        for v in (0..lens.height()).step_by(3).chain([lens.height() - 1]) {
            for u in (0..lens.width()).step_by(3).chain([lens.width() - 1]) {
                let pixel = DVec2::new(f64::from(u), f64::from(v));
                let Some(ray) = lens.unproject(pixel) else { continue };
                assert!((ray.length() - 1.0).abs() < 1e-15, "{name} {pixel}");
                let back = lens.project(ray).unwrap_or_else(|| panic!("{name}: {pixel} has a ray, the ray no pixel"));
                let condition = stretch(&lens, ray).map_or(f64::INFINITY, |[most, least]| most / least);
                largest = largest.max(back.distance(pixel) / condition.max(1.0));
                seen += 1;
            }
        }
        assert!(seen > 10_000, "{name} sees only {seen}");
    }
    largest_error(largest, 7e-12, "px over the condition");
}

#[test]
fn rays_come_back_over_the_whole_view_of_every_lens() {
    let mut largest = 0.0f64;
    for (name, lens) in lenses() {
        // Straight behind, every direction is drawn at one pixel or one ray on a whole circle.
        let reach = (lens.max_angle() * (1.0 - 1e-9)).min(PI - 1e-3);
        let mut seen = 0;
        for i in 0..=500 {
            for j in 0..60 {
                let (sin, cos) = (reach * f64::from(i) / 500.0).sin_cos();
                let (y, x) = (f64::from(j) * 0.1047).sin_cos();
                let ray = DVec3::new(sin * x, sin * y, cos);
                let Some(pixel) = lens.project(ray) else { continue };
                let Some(back) = lens.unproject(pixel) else { panic!("{name}: {ray} has a pixel, the pixel no ray") };
                let [most, least] = stretch(&lens, ray).unwrap_or([1.0, 0.0]);
                // The angle between unit vectors without the loss of the arc cosine.
                let angle = 2.0 * (0.5 * back.distance(ray)).min(1.0).asin();
                largest = largest.max(angle / (most / least).max(1.0));
                seen += 1;
            }
        }
        assert!(seen > 10_000, "{name}: {seen}");
    }
    largest_error(largest, 2e-14, "rad over the condition");
}

#[test]
fn on_the_axis_nothing_is_divided_by_zero() {
    for (name, lens) in lenses() {
        let p = lens.parameters();
        let centre = DVec2::new(p.cx, p.cy);
        assert_eq!(lens.project(DVec3::Z * 3.0), Some(centre), "{name}");
        assert_eq!(lens.unproject(centre), Some(DVec3::Z), "{name}");
        for size in [1e-300, 1e-160, 1e-20, 1e-12, 1e-9] {
            let ray = DVec3::new(size, -size, 1.0);
            let pixel = lens.project(ray).expect("beside the axis");
            let scale = 2.0 * lens.focal() / (p.fx + p.fy);
            let skew = if let LensModel::Scaramuzza { skew, .. } = p.model { skew } else { 0.0 };
            let expected = DVec2::new(p.cx + scale * p.fx * (1.0 - skew) * size, p.cy - scale * p.fy * size);
            assert!(pixel.distance(expected) <= 1e-12, "{name} {size}: {pixel}");
            let back = lens.unproject(pixel).expect("beside the axis");
            assert!(back.is_finite() && back.distance(ray.normalize()) < 1e-15, "{name} {size}");
        }
    }
}

/// What lies beyond the rim has no pixel; what is behind a camera that sees all around has one, and it is finite.
#[test]
fn at_the_rim_beyond_90_degrees_and_behind_pixels_are_right_or_none() {
    for (name, lens) in lenses() {
        let max = lens.max_angle();
        let at = |angle: f64| lens.project(DVec3::new(angle.sin(), 0.0, angle.cos()));
        assert!(at(max * (1.0 - 1e-12)).is_some(), "{name}: the rim itself");
        if max < PI {
            assert_eq!(at(max + 1e-6), None, "{name}: beyond the rim");
            assert_eq!(at(PI), None, "{name}: behind");
            assert_eq!(lens.project(-DVec3::Z), None, "{name}: straight behind");
        }
        for degree in 91..180 {
            let angle = f64::from(degree).to_radians();
            if (angle - max).abs() > 1e-9 {
                assert_eq!(at(angle).is_some(), angle < max, "{name}: {degree} deg");
            }
        }
        for pixel in [DVec2::NAN, DVec2::INFINITY, DVec2::splat(-1e300), DVec2::splat(1e9)] {
            assert_eq!(lens.unproject(pixel), None, "{name}: {pixel}");
        }
    }
}

/// d r / d theta = (1 - theta^2)^2 + 2e-9: nearly 0 at one radian, where Newton's step leaves every bracket.
#[test]
fn where_the_lens_is_nearly_flat_newton_stays_in_its_bracket() {
    let k = [-2.0 / 3.0 * (1.0 - 1e-9), 1.0 / 5.0, 0.0, 0.0];
    let radius = |angle: f64| angle + k[0] * angle.powi(3) + k[1] * angle.powi(5);
    let slope = |angle: f64| 1.0 + 3.0 * k[0] * angle.powi(2) + 5.0 * k[1] * angle.powi(4);
    let plain = 1.0 + (0.5334 - radius(1.0)) / slope(1.0);
    assert!(plain > 1e4, "a plain step to an angle of 1.04 goes to {plain}");
    let lens = Lens::new(LensParameters {
        width: 640,
        height: 480,
        fx: 400.0,
        fy: 400.0,
        cx: 319.5,
        cy: 239.5,
        model: LensModel::KannalaBrandt { k },
        fov_deg: Some(150.0),
    })
    .expect("just monotonic");
    let (mut last, mut largest) = (0.0, 0.0f64);
    for step in 1..200_000 {
        let radius = 240.0 * f64::from(step) / 200_000.0;
        let Some(ray) = lens.unproject(DVec2::new(319.5 + radius, 239.5)) else { break };
        let angle = ray.x.atan2(ray.z);
        assert!(angle >= last && angle <= lens.max_angle() + 1e-12, "{radius}: {angle} after {last}");
        last = angle;
        let back = lens.project(ray).expect("its pixel");
        largest = largest.max((back.x - 319.5 - radius).abs());
    }
    assert!(last > 1.1, "{last}");
    largest_error(largest, 3e-13, "px");
}

/// Infinity times a scale of 0 made a pixel that was no number; so did the square of a length that is too large.
#[test]
fn a_ray_that_is_no_direction_has_no_pixel() {
    for (name, lens) in lenses() {
        let projector = Projector::new(&lens);
        for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            for ray in [DVec3::new(value, 0.0, 1.0), DVec3::new(0.0, value, 1.0), DVec3::splat(value)] {
                assert_eq!((lens.project(ray), projector.project(ray)), (None, None), "{name}: {ray}");
            }
        }
        assert_eq!((lens.project(DVec3::ZERO), projector.project(DVec3::ZERO)), (None, None), "{name}");
        let ray = DVec3::new(0.3, -0.2, 1.0);
        let pixel = lens.project(ray).expect("in view");
        for length in [1e-200, 1e-100, 1e100, 1e200] {
            for found in [lens.project(ray * length), projector.project(ray * length)] {
                let off = found.expect("the same direction").distance(pixel);
                assert!(off < 1e-3, "{name}: {off} px at a length of {length:e}");
            }
        }
    }
}
