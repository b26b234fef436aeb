use super::*;
use proptest::prelude::*;

fn parameters(model: LensModel) -> LensParameters {
    LensParameters { width: 640, height: 480, fx: 205.0, fy: 207.0, cx: 322.0, cy: 236.0, model, fov_deg: None }
}

fn lenses() -> Vec<Lens> {
    let pinhole = |d| LensParameters { fx: 410.0, fy: 412.0, ..parameters(LensModel::PlumbBob { d }) };
    [
        parameters(LensModel::KannalaBrandt { k: [-0.012, 0.003, -0.0008, 0.0] }),
        parameters(LensModel::KannalaBrandt { k: [0.0; 4] }),
        LensParameters { fov_deg: Some(240.0), ..parameters(LensModel::KannalaBrandt { k: [-0.05, 0.004, 0.0, 0.0] }) },
        parameters(LensModel::Equisolid),
        pinhole([0.0; 5]),
        pinhole([-0.28, 0.09, 0.001, -0.0007, -0.012]),
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
    assert!(with(|p| p.width = 0).contains("image size 0"));
    assert!(with(|p| p.fov_deg = Some(-3.0)).contains("field of view -3"));
}

proptest! {
    #[test]
    fn every_ray_in_view_comes_back(x in -1.0..1.0f64, y in -1.0..1.0f64, z in -1.0..1.0f64, which in 0usize..6) {
        let ray = DVec3::new(x, y, z);
        prop_assume!(ray.length() > 0.1);
        let lens = &lenses()[which];
        if let Some(pixel) = lens.project(ray) {
            let back = lens.unproject(pixel).expect("the ray of a drawn pixel");
            prop_assert!((back - ray.normalize()).length() < 1e-9, "{:?} {}", lens.parameters().model, (back - ray.normalize()).length());
        }
    }
}
