//! The picture of the robot's own body, from a PNG.

use crate::vision::BodyMask;

/// Dark pixels hide; the size must be the camera's. An error says what is wrong with the file.
pub fn body_mask(png: &str, width: u32, height: u32) -> Result<BodyMask, String> {
    let image = image::open(png).map_err(|error| error.to_string())?.into_luma8();
    if image.dimensions() != (width, height) {
        let (w, h) = image.dimensions();
        return Err(format!("the mask has {w} x {h} pixels, the camera {width} x {height}"));
    }
    BodyMask::from_gray(width as usize, height as usize, image.as_raw()).ok_or_else(|| "not a gray image".to_owned())
}
