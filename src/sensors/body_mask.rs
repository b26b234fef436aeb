//! The picture of the robot's own body, from a PNG.

use crate::vision::BodyMask;

/// A session keeps its masks, and a body has few edges.
const MAX_RUNS: usize = 20_000;

/// Dark pixels hide; the size must be the camera's. An error says what is wrong with the file.
pub fn mask(png: &str, width: u32, height: u32) -> Result<BodyMask, String> {
    let image = image::open(png).map_err(|error| error.to_string())?.into_luma8();
    if image.dimensions() != (width, height) {
        let (w, h) = image.dimensions();
        return Err(format!("the mask has {w} x {h} pixels, the camera {width} x {height}"));
    }
    let mask = BodyMask::from_gray(width as usize, height as usize, image.as_raw());
    mask.ok_or_else(|| "not a gray image".to_owned())
}

/// The same of a robot's body.
pub fn body_mask(png: &str, width: u32, height: u32) -> Result<BodyMask, String> {
    let mask = mask(png, width, height)?;
    match mask.runs().len() {
        edges if edges > MAX_RUNS => Err(format!("{edges} edges along its rows: paint areas, not specks")),
        _ => Ok(mask),
    }
}
