//! Views against rendered truth and real images.

mod darkened;
mod exactness;
mod goals;
mod hall;
mod moving;
mod real;

use std::thread;

use glam::DVec3;
use realitysim::config::load_field;
use realitysim::evaluation::views::{Displacement, Plan, Row, displacements};
use realitysim::geometry::{Euler, Field, Isometry, Lens, LensModel, LensParameters};
use realitysim::views::{Camera, Candidate, Method, Pyramid, Request, TagError, ViewSettings, Vignetting, World};

pub fn field() -> Field {
    Field::new(load_field("kid-2009").expect("shipped")).expect("a field")
}

/// 320 x 240, 180 degrees across.
pub fn lens() -> Lens {
    let model = LensModel::KannalaBrandt { k: [0.0; 4] };
    let parameters = LensParameters {
        width: 320,
        height: 240,
        fx: 101.8,
        fy: 101.8,
        cx: 159.5,
        cy: 119.5,
        model,
        fov_deg: Some(180.0),
    };
    Lens::new(parameters).expect("a lens")
}

pub fn pose(x: f64, y: f64, yaw_deg: f64) -> Isometry {
    let euler = Euler { yaw: yaw_deg.to_radians(), pitch: 0.5, roll: 0.02 };
    Isometry::from_euler(euler, DVec3::new(x, y, 0.55))
}

pub fn candidate<'a>(camera: &'a Camera, map_from_link: Isometry, image: &'a Pyramid) -> Candidate<'a> {
    let (tag, vignetting) = (TagError::default(), Vignetting::default());
    Candidate { id: 0, camera, map_from_link, image, tag, vignetting }
}

pub fn request<'a>(camera: &'a Camera, map_from_link: Isometry, world: &'a World) -> Request<'a> {
    let (method, vignetting, settings) = (Method::Exact, Vignetting::default(), ViewSettings::default());
    Request { camera, map_from_link, method, world, vignetting, settings }
}

/// The figures of docs/explanation/views.md, from fewer poses: paper and exact map, one source and four.
#[test]
fn views_of_a_lawn_reach_their_figures() {
    let row = |metres| {
        let plan = Plan { displacements: vec![Displacement { metres, yaw_deg: 10.0 }], poses: 2 };
        displacements(&field(), &plan, &mut |_, _| ()).expect("views").remove(0)
    };
    let [turned, near, usual, far]: [Row; 4] = thread::scope(|scope| {
        let rows = [0.0, 0.1, 0.25, 0.5].map(|metres| scope.spawn(move || row(metres)));
        rows.map(|row| row.join().expect("a row"))
    });
    for (row, residual, paper_db) in [(&turned, 0.24, 32.3), (&near, 3.1, 21.6), (&usual, 7.9, 18.6)] {
        assert!((row.residual_px / residual - 1.0).abs() < 0.15, "residual: {row:?}");
        assert!((row.paper.psnr_db - paper_db).abs() < 1.0, "paper: {row:?}");
        assert!(row.map_p99_px < 0.15 && row.four.covered > 0.97, "{row:?}");
    }
    assert!(usual.exact.psnr_db >= 36.0 && usual.exact.ssim >= 0.96, "{usual:?}");
    assert!(usual.four.psnr_db >= 36.0 && usual.four.ssim >= 0.96, "{usual:?}");
    assert!(far.four.psnr_db >= 34.5 && far.four.covered > 0.97, "{far:?}");
    assert!(usual.nearest.psnr_db < 18.0, "the lawn must not be easy: {usual:?}");
}
