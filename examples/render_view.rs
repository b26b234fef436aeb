//! Makes the image that a camera would have taken from a pose, out of a database of recorded images.
//!
//!     cargo run --release --example render_view -- images/ 0.3 -0.5 0.5 30 view.png
//!
//! `realitysim db add CAPTURE --db images/` makes such a database.

use std::env::args;
use std::path::Path;

use glam::DVec3;
use image::{Rgba, RgbaImage};
use realitysim_config::ViewsSettings;
use realitysim_database::{ImageDatabase, ViewQuery};
use realitysim_geometry::{Euler, Isometry};
use realitysim_views::{FAR_M, Method};

/// How far down the camera looks.
const PITCH_DEG: f64 = 20.0;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = args().skip(1).collect();
    let [folder, x, y, z, yaw_deg, output] = &arguments[..] else {
        return Err("usage: render_view DATABASE X Y Z YAW_DEG PNG".into());
    };
    let database = ImageDatabase::open(Path::new(folder), &ViewsSettings::default())?;
    let attitude = Euler { yaw: yaw_deg.parse::<f64>()?.to_radians(), pitch: PITCH_DEG.to_radians(), roll: 0.0 };
    let query = ViewQuery {
        map_from_link: Isometry::from_euler(attitude, DVec3::new(x.parse()?, y.parse()?, z.parse()?)),
        method: Method::Exact,
        camera: None,
        max_distance_m: FAR_M,
        may_be_stored: false,
        without: Vec::new(),
    };
    let view = database.view(&query)?.answer;
    let picture = RgbaImage::from_fn(view.image.width as u32, view.image.height as u32, |u, v| {
        let [red, green, blue, _] = view.image.pixels[v as usize * view.image.width + u as usize];
        Rgba([red, green, blue, 255])
    });
    picture.save(output)?;
    println!(
        "{:.0} % known geometry, expected error {:.1} px, {} sources",
        100.0 * view.sure_share,
        view.expected_error_px,
        view.sources.len()
    );
    Ok(())
}
