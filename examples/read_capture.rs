//! Reads the tags of a capture.
//!
//!     cargo run --release --example read_capture -- captures/SESSION

use std::env::args;
use std::path::Path;

use realitysim_geometry::Isometry;
use realitysim_recording::read_tags;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let capture = args().nth(1).ok_or("usage: read_capture CAPTURE")?;
    let tags = read_tags(Path::new(&capture))?;
    for tag in &tags.found {
        let map_from_camera = Isometry::from(tag.pose.pose);
        let [x, y, z] = map_from_camera.translation.to_array();
        let yaw_deg = map_from_camera.euler().yaw.to_degrees();
        let state = if tag.valid { "valid" } else { &tag.reason };
        println!("{}: x {x:.3} m, y {y:.3} m, z {z:.3} m, yaw {yaw_deg:.1} deg, {state}", tag.sequence);
    }
    for loss in &tags.losses {
        eprintln!("lost: {loss}");
    }
    Ok(())
}
