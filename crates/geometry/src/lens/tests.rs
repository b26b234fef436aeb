use super::*;
use proptest::prelude::*;

fn parameters(model: LensModel) -> LensParameters {
    LensParameters { width: 640, height: 480, fx: 205.0, fy: 207.0, cx: 322.0, cy: 236.0, model, fov_deg: None }
}

/// A rational lens of the kind that depth cameras announce: large coefficients that nearly cancel.
const OAK: LensModel = LensModel::RationalPolynomial { d: [4.1, -2.3, 0.0011, -0.0007, 0.31, 4.3, -0.7, -0.2] };
const PRISM: LensModel = LensModel::ThinPrism {
    d: [-0.31, 0.11, 0.0012, -0.0008, -0.014, 0.02, -0.003, 0.0004, 0.0021, -0.0003, -0.0013, 0.0002],
};

fn lenses() -> Vec<Lens> {
    let pinhole = |d| LensParameters { fx: 410.0, fy: 412.0, ..parameters(LensModel::PlumbBob { d }) };
    [
        parameters(LensModel::KannalaBrandt { k: [-0.012, 0.003, -0.0008, 0.0] }),
        parameters(LensModel::KannalaBrandt { k: [0.0; 4] }),
        LensParameters { fov_deg: Some(240.0), ..parameters(LensModel::KannalaBrandt { k: [-0.05, 0.004, 0.0, 0.0] }) },
        parameters(LensModel::Equisolid),
        pinhole([0.0; 5]),
        pinhole([-0.28, 0.09, 0.001, -0.0007, -0.012]),
        LensParameters { fx: 410.0, fy: 412.0, ..parameters(OAK) },
        LensParameters { fx: 410.0, fy: 412.0, ..parameters(PRISM) },
        parameters(LensModel::DoubleSphere { xi: -0.2, alpha: 0.6 }),
        parameters(LensModel::Eucm { alpha: 0.62, beta: 1.1 }),
        parameters(LensModel::Scaramuzza { c: [-0.31, 0.05, -0.06, 0.01, 0.0], skew: 0.003 }),
    ]
    .into_iter()
    .map(|p| Lens::new(p).expect("a good lens"))
    .collect()
}

#[test]
fn every_pixel_comes_back() {
    for lens in lenses() {
        let mut seen = 0;
        for v in (0..lens.height()).step_by(7) {
            for u in (0..lens.width()).step_by(7) {
                let pixel = DVec2::new(f64::from(u), f64::from(v));
                let Some(ray) = lens.unproject(pixel) else { continue };
                let back = lens.project(ray).expect("a ray of the image has a pixel");
                assert!((back - pixel).length() < 1e-8, "{:?} {pixel} {back}", lens.parameters().model);
                seen += 1;
            }
        }
        assert!(seen > 3000, "{:?} sees only {seen}", lens.parameters().model);
    }
}

#[test]
fn a_fisheye_sees_behind_itself() {
    let lens = &lenses()[0];
    assert!(lens.max_angle() > 1.8);
    let ray = DVec3::new(0.99, 0.0, -0.14);
    let pixel = lens.project(ray).expect("98 deg off the axis");
    assert!((lens.unproject(pixel).expect("its ray") - ray.normalize()).length() < 1e-12);
}

#[test]
fn behind_a_pinhole_is_nothing() {
    let lens = &lenses()[4];
    assert_eq!(lens.project(DVec3::new(0.1, 0.1, -1.0)), None);
    assert_eq!(lens.project(DVec3::new(0.1, 0.1, 0.0)), None);
    assert_eq!(lens.project(DVec3::new(f64::NAN, 0.0, 1.0)), None);
}

#[test]
fn a_polynomial_that_turns_back_is_refused_within_the_stated_view() {
    let model = LensModel::KannalaBrandt { k: [-0.2, 0.0, 0.0, 0.0] };
    let stated = |fov| Lens::new(LensParameters { fov_deg: Some(fov), ..parameters(model) });
    // 1 - 0.6 theta^2 = 0 at 73.97 deg.
    assert!(matches!(stated(180.0), Err(LensError::NotMonotonic { at_deg, .. }) if (at_deg - 73.97).abs() < 0.01));
    let lens = stated(140.0).expect("monotonic up to 70 deg");
    assert!((lens.max_angle() - 70f64.to_radians()).abs() < 1e-12);
    let unstated = Lens::new(parameters(model)).expect("cut where it turns back");
    assert!(unstated.max_angle() < 73.98f64.to_radians());
}

#[test]
fn the_new_models_refuse_what_they_cannot_draw() {
    let refused =
        |model, fov_deg| Lens::new(LensParameters { fov_deg, ..parameters(model) }).expect_err("refused").to_string();
    let ds = |xi, alpha| LensModel::DoubleSphere { xi, alpha };
    assert!(refused(ds(1.0, 0.5), None).contains("xi is 1: it must be above -1"));
    assert!(refused(ds(f64::NAN, 0.5), None).contains("xi is NaN"));
    assert!(refused(ds(0.1, 1.1), None).contains("alpha is 1.1: it must be 0 to 1"));
    assert!(refused(LensModel::Eucm { alpha: 0.5, beta: 0.0 }, None).contains("beta is 0"));
    // Orthographic: the radius turns back at 90 degrees.
    assert!(refused(LensModel::Eucm { alpha: 1.0, beta: 1.0 }, Some(190.0)).contains("turns back at 90.00 deg"));
    let with = |index: usize, value: f64| {
        let mut d = [0.0; 12];
        d[index] = value;
        LensModel::ThinPrism { d }
    };
    assert!(refused(with(7, 1e10), None).contains("k6 is 10000000000"));
    assert!(refused(with(9, f64::INFINITY), None).contains("s2 is inf"));
    // The denominator 1 - s vanishes at 45 degrees.
    assert!(refused(with(5, -1.0), Some(100.0)).contains("turns back at 45.00 deg"));
}

#[test]
fn a_double_sphere_lens_knows_its_pixels_per_radian() {
    let lens = Lens::new(parameters(LensModel::DoubleSphere { xi: 0.25, alpha: 0.5 })).expect("a good lens");
    let step = lens.project(ray(1e-6, 0.0)).expect("in view").x - lens.parameters().cx;
    let across = lens.project(ray(1e-6, core::f64::consts::FRAC_PI_2)).expect("in view").y - lens.parameters().cy;
    assert!(((step + across) / 2e-6 - lens.focal()).abs() < 1e-3, "{step} {across} {}", lens.focal());
}

#[test]
fn zero_denominators_draw_what_plumb_bob_draws_bit_for_bit() {
    let [k1, k2, p1, p2, k3] = [-0.28, 0.09, 0.001, -0.0007, -0.012];
    let plain = LensParameters { fx: 410.0, ..parameters(LensModel::PlumbBob { d: [k1, k2, p1, p2, k3] }) };
    let rational = LensModel::RationalPolynomial { d: [k1, k2, p1, p2, k3, 0.0, 0.0, 0.0] };
    let rational = Lens::new(LensParameters { model: rational, ..plain.clone() }).expect("a good lens");
    let plain = Lens::new(plain).expect("a good lens");
    for i in 0..200 {
        let ray = ray(0.003 * f64::from(i), f64::from(i));
        assert_eq!(plain.project(ray), rational.project(ray));
    }
    assert_eq!(LensModel::of_opencv(&[k1, k2, p1, p2, k3, 0.0, 0.0, 0.0]), Some(plain.parameters().model));
}

#[test]
fn impossible_parameters_are_named() {
    let with = |change: fn(&mut LensParameters)| {
        let mut p = parameters(LensModel::Equisolid);
        change(&mut p);
        Lens::new(p).expect_err("refused").to_string()
    };
    assert!(with(|p| p.fx = 0.0).contains("fx is 0"));
    assert!(with(|p| p.fy = 1e308).contains("fy is 1e308"), "an image of a lens like that has infinite errors");
    assert!(with(|p| p.fy = f64::NAN).contains("fy is NaN"));
    assert!(with(|p| p.cx = 1e300).contains("cx is 1e300"));
    assert!(with(|p| p.cy = f64::NAN).contains("cy is NaN"));
    for wild in [1e308, -1e7, f64::NAN] {
        for model in [
            LensModel::KannalaBrandt { k: [-0.012, wild, -0.0008, 0.0] },
            LensModel::PlumbBob { d: [0.0, wild, 0.0, 0.0, 0.0] },
            LensModel::Scaramuzza { c: [0.0, wild, 0.0, 0.0, 0.0], skew: 0.0 },
        ] {
            let told = Lens::new(parameters(model)).expect_err("a picture's rim would lie at infinity").to_string();
            assert!(told.contains("within -1e6 and 1e6"), "{told}");
        }
    }
    assert!(with(|p| p.width = 0).contains("image size 0"));
    assert!(with(|p| p.fov_deg = Some(-3.0)).contains("field of view -3"));
}

/// A ray at an angle off the axis, radians, in a direction around it.
fn ray(angle: f64, around: f64) -> DVec3 {
    DVec3::new(libm::sin(angle) * libm::cos(around), libm::sin(angle) * libm::sin(around), libm::cos(angle))
}

/// Checks over the whole range of a lens that rays come back, and that the radius grows with the angle.
fn check_whole_range(parameters: LensParameters) -> Result<(), TestCaseError> {
    let model = parameters.model;
    let Ok(lens) = Lens::new(parameters) else { return Ok(()) };
    let (end, projector) = (lens.max_angle(), Projector::new(&lens));
    prop_assert!(end > 0.0 && end <= core::f64::consts::PI, "{model:?} {end}");
    for i in 0..60 {
        // Just before the turning point the inverse is infinitely steep.
        let angle = end * (f64::from(i) + 0.5) / 61.0;
        let mut last = 0.0;
        for j in 0..9 {
            let ray = ray(angle, f64::from(j) * 0.7);
            let Some(pixel) = lens.project(ray) else { panic!("{model:?}: nothing at {angle} of {end}") };
            let Some(back) = lens.unproject(pixel) else {
                panic!("{model:?}: {pixel} has no ray, at {angle} of {end}")
            };
            prop_assert!((back - ray).length() < 1e-7, "{model:?}: {angle} of {end}: {}", (back - ray).length());
            let fast = projector.project(ray).expect("in view");
            // Pinholes that bend outwards and their like draw far beyond any image there.
            prop_assert!(fast.distance(pixel) < 1e-3 * pixel.length().max(1.0), "{model:?}: {fast} {pixel}");
            last = pixel.length().max(last);
        }
        prop_assert!(last.is_finite());
    }
    Ok(())
}

/// Makes a coefficient vary around a plausible value.
fn around(value: f64, by: f64) -> core::ops::Range<f64> {
    value - by..value + by
}

proptest! {
    #[test]
    fn rational_rays_come_back_over_the_whole_range(
        k in proptest::array::uniform3(around(0.0, 0.5)), below in proptest::array::uniform3(around(0.0, 0.5)),
        p in proptest::array::uniform2(around(0.0, 0.01)), wide in 60.0..600.0f64, scale in prop::bool::ANY
    ) {
        // Figures of depth cameras: numerator and denominator are both large and nearly cancel.
        let common = if scale { 8.0 } else { 0.0 };
        let d = [k[0] + common, k[1], p[0], p[1], 0.1 * k[2], below[0] + common, below[1], 0.1 * below[2]];
        check_whole_range(LensParameters { fx: wide, fy: wide, ..parameters(LensModel::RationalPolynomial { d }) })?;
    }

    #[test]
    fn thin_prism_rays_come_back_over_the_whole_range(
        k in proptest::array::uniform6(around(0.0, 0.3)), p in proptest::array::uniform2(around(0.0, 0.01)),
        s in proptest::array::uniform4(around(0.0, 0.02)), wide in 100.0..600.0f64
    ) {
        let d = [k[0], k[1], p[0], p[1], 0.1 * k[2], k[3], k[4], 0.1 * k[5], s[0], s[1], s[2], s[3]];
        check_whole_range(LensParameters { fx: wide, fy: wide, ..parameters(LensModel::ThinPrism { d }) })?;
    }

    #[test]
    fn double_sphere_rays_come_back_over_the_whole_range(xi in -0.95..0.95f64, alpha in 0.0..=1.0f64, wide in 60.0..600.0f64) {
        let model = LensModel::DoubleSphere { xi, alpha };
        check_whole_range(LensParameters { fx: wide, fy: wide, ..parameters(model) })?;
    }

    #[test]
    fn eucm_rays_come_back_over_the_whole_range(alpha in 0.0..=1.0f64, beta in 0.1..10.0f64, wide in 60.0..600.0f64) {
        let model = LensModel::Eucm { alpha, beta };
        check_whole_range(LensParameters { fx: wide, fy: wide, ..parameters(model) })?;
    }

    #[test]
    fn scaramuzza_rays_come_back_over_the_whole_range(
        c in proptest::array::uniform5(around(0.0, 0.4)), skew in around(0.0, 0.1), wide in 60.0..600.0f64
    ) {
        let model = LensModel::Scaramuzza { c, skew };
        check_whole_range(LensParameters { fx: wide, fy: wide, ..parameters(model) })?;
    }

    /// The formulas of the papers, point by point, as an oracle: projection and inverse of Usenko et al., section 3.5.
    #[test]
    fn double_sphere_agrees_with_the_paper(
        xi in -0.9..0.9f64, alpha in 0.0..=1.0f64, angle in 0.0..3.1f64, turn in 0.0..6.3f64
    ) {
        let lens = Lens::new(LensParameters { cx: 0.0, cy: 0.0, ..parameters(LensModel::DoubleSphere { xi, alpha }) });
        let lens = lens.expect("possible");
        let DVec3 { x, y, z } = ray(angle, turn) * 2.5;
        let d1 = (x * x + y * y + z * z).sqrt();
        let d2 = (x * x + y * y + (xi * d1 + z) * (xi * d1 + z)).sqrt();
        let found = lens.project(DVec3::new(x, y, z));
        // The angle at the second sphere, seen from its centre, ends where the image turns back.
        let w1 = if alpha > 0.5 { (1.0 - alpha) / alpha } else { alpha / (1.0 - alpha) };
        prop_assert!(found.is_none() || xi * d1 + z > -w1 * d2 - 1e-9);
        let Some(found) = found else { return Ok(()) };
        let below = alpha * d2 + (1.0 - alpha) * (xi * d1 + z);
        let published = DVec2::new(205.0 * x / below, 207.0 * y / below);
        prop_assert!(found.distance(published) < 1e-9 * (1.0 + published.length()), "{found} {published}");
        let (mx, my) = (published.x / 205.0, published.y / 207.0);
        let square = mx * mx + my * my;
        let mz = (1.0 - alpha * alpha * square) / (alpha * (1.0 - (2.0 * alpha - 1.0) * square).sqrt() + 1.0 - alpha);
        let scale = (mz * xi + (mz * mz + (1.0 - xi * xi) * square).sqrt()) / (mz * mz + square);
        let published = DVec3::new(scale * mx, scale * my, scale * mz - xi);
        let back = lens.unproject(found).expect("drawn");
        prop_assert!((back - published).length() < 1e-6, "{back} {published}");
    }

    /// Projection and inverse as Usenko et al. write the model of Khomutenko et al., section 3.3.
    #[test]
    fn eucm_agrees_with_the_paper(
        alpha in 0.0..=1.0f64, beta in 0.2..5.0f64, angle in 0.0..3.1f64, turn in 0.0..6.3f64
    ) {
        let lens = Lens::new(LensParameters { cx: 0.0, cy: 0.0, ..parameters(LensModel::Eucm { alpha, beta }) });
        let lens = lens.expect("possible");
        let DVec3 { x, y, z } = ray(angle, turn) * 0.4;
        let d = (beta * (x * x + y * y) + z * z).sqrt();
        let w = if alpha > 0.5 { (1.0 - alpha) / alpha } else { alpha / (1.0 - alpha) };
        let Some(found) = lens.project(DVec3::new(x, y, z)) else { return Ok(()) };
        prop_assert!(z > -w * d, "the paper draws it");
        let below = alpha * d + (1.0 - alpha) * z;
        let published = DVec2::new(205.0 * x / below, 207.0 * y / below);
        prop_assert!(found.distance(published) < 1e-9 * (1.0 + published.length()), "{found} {published}");
        let (mx, my) = (published.x / 205.0, published.y / 207.0);
        let square = mx * mx + my * my;
        let mz = (1.0 - beta * alpha * alpha * square)
            / (alpha * (1.0 - (2.0 * alpha - 1.0) * beta * square).sqrt() + 1.0 - alpha);
        let published = DVec3::new(mx, my, mz).normalize();
        let back = lens.unproject(found).expect("drawn");
        prop_assert!((back - published).length() < 1e-6, "{back} {published}");
    }

    #[test]
    fn every_ray_in_view_comes_back(x in -1.0..1.0f64, y in -1.0..1.0f64, z in -1.0..1.0f64, which in 0usize..11) {
        let ray = DVec3::new(x, y, z);
        prop_assume!(ray.length() > 0.1);
        let lens = &lenses()[which];
        if let Some(pixel) = lens.project(ray) {
            let back = lens.unproject(pixel).expect("the ray of a drawn pixel");
            prop_assert!((back - ray.normalize()).length() < 1e-9, "{:?} {}", lens.parameters().model, (back - ray.normalize()).length());
        }
    }
}
