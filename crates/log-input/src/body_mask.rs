//! Reads a mask that hides parts of the camera image, such as the robot's own body, from a PNG.

use std::io::Cursor;
use std::path::Path;

use image::{DynamicImage, ImageDecoder, ImageReader};

use super::decode::MAX_IMAGE_FILE_BYTES;
use realitysim_config::plain_file;
use realitysim_vision::BodyMask;

/// Largest number of edges along the rows of a body mask. A session stores its masks, and a body has few edges.
const MAX_RUNS: usize = 20_000;

/// Reads a mask from a file: dark pixels hide. `width` and `height` are those of the camera, pixels.
///
/// The error says what is wrong with the file, or that its size is another.
pub fn mask(png: &str, width: u32, height: u32) -> Result<BodyMask, String> {
    let bytes = plain_file::read(Path::new(png), MAX_IMAGE_FILE_BYTES).map_err(|error| error.to_string())?;
    let reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(|error| error.to_string())?;
    let decoder = reader.into_decoder().map_err(|error| error.to_string())?;
    // A header of a few bytes may claim far more pixels than any camera has.
    let (w, h) = decoder.dimensions();
    if (w, h) != (width, height) {
        return Err(format!("the mask has {w} x {h} pixels, the camera {width} x {height}"));
    }
    let image = DynamicImage::from_decoder(decoder).map_err(|error| error.to_string())?.into_luma8();
    let mask = BodyMask::from_gray(width as usize, height as usize, image.as_raw());
    mask.ok_or_else(|| "not a gray image".to_owned())
}

/// Reads the mask of a robot's body like [`mask`], and refuses one with more than 20,000 edges along its rows.
pub fn body_mask(png: &str, width: u32, height: u32) -> Result<BodyMask, String> {
    let mask = mask(png, width, height)?;
    match mask.runs().len() {
        edges if edges > MAX_RUNS => Err(format!("{edges} edges along its rows: paint areas, not specks")),
        _ => Ok(mask),
    }
}
