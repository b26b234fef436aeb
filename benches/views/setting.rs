//! 640 x 480 pixels of 180 degrees, four places 25 cm around the one that is asked for.

use glam::DVec3;
use realitysim::config::load_field;
use realitysim::geometry::{Euler, Field, Isometry, Lens, LensModel, LensParameters};
use realitysim::views::{
    Camera, Candidate, Method, Pyramid, Raster, Request, TagError, ViewSettings, Vignetting, World,
};

pub fn field() -> Field {
    Field::new(load_field("kid-2009").expect("shipped")).expect("a field")
}

pub fn lens() -> LensParameters {
    let model = LensModel::KannalaBrandt { k: [0.0; 4] };
    LensParameters { width: 640, height: 480, fx: 203.7, fy: 203.7, cx: 319.5, cy: 239.5, model, fov_deg: Some(180.0) }
}

pub fn camera() -> Camera {
    Camera::new(&Lens::new(lens()).expect("a lens"))
}

/// Nothing that a cache or a branch could guess.
pub fn noise(camera: &Camera) -> Pyramid {
    let rgb: Vec<u8> = (0..640 * 480 * 3u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    Pyramid::new(Raster::from_rgb(640, 480, &rgb, camera.shows()).expect("fits"))
}

pub fn pose(x: f64, y: f64, yaw_deg: f64) -> Isometry {
    Isometry::from_euler(Euler { yaw: yaw_deg.to_radians(), pitch: 0.5, roll: 0.02 }, DVec3::new(x, y, 0.55))
}

pub fn wanted() -> Isometry {
    pose(0.3, -0.5, 20.0)
}

pub fn place(number: usize) -> Isometry {
    let (sin, cos) = libm::sincos(0.3 + number as f64 * core::f64::consts::FRAC_PI_2);
    pose(0.3 + 0.25 * cos, -0.5 + 0.25 * sin, if number.is_multiple_of(2) { 30.0 } else { 10.0 })
}

pub fn source<'a>(camera: &'a Camera, image: &'a Pyramid, number: usize) -> Candidate<'a> {
    let (tag, vignetting) = (TagError::default(), Vignetting::default());
    Candidate { id: number as u64, camera, map_from_link: place(number), image, tag, vignetting }
}

pub fn request<'a>(camera: &'a Camera, world: &'a World) -> Request<'a> {
    let (method, vignetting, settings) = (Method::Exact, Vignetting::default(), ViewSettings::default());
    Request { camera, map_from_link: wanted(), method, world, vignetting, settings }
}
