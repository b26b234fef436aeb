//! Depths as a picture: millimetres, 16 bits, as depth cameras send them.

use image::{ImageBuffer, ImageFormat, ImageResult, Luma};

/// A PNG of the depths of a picture of this width, metres row by row; 0 where there is none, or one of more than 65.535 m.
pub fn depth_png(depths_m: &[f32], width: usize) -> ImageResult<Vec<u8>> {
    let height = depths_m.len() / width.max(1);
    let pixels: Vec<u16> = depths_m.iter().map(|depth| millimetres(*depth)).collect();
    let picture = ImageBuffer::<Luma<u16>, _>::from_raw(width as u32, height as u32, pixels);
    let mut png = std::io::Cursor::new(Vec::new());
    picture.unwrap_or_default().write_to(&mut png, ImageFormat::Png)?;
    Ok(png.into_inner())
}

/// A depth in whole millimetres, or 0 where there is none that fits.
fn millimetres(depth_m: f32) -> u16 {
    let value = (1000.0 * depth_m).round();
    if value <= f32::from(u16::MAX) { value as u16 } else { 0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_depth_without_a_number_of_millimetres_is_0() {
        for (depth_m, value) in [(1.2344, 1234), (65.535, 65535), (65.54, 0), (f32::INFINITY, 0), (f32::NAN, 0)] {
            assert_eq!(millimetres(depth_m), value, "{depth_m}");
        }
    }
}
