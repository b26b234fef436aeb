//! The file of `realitysim view --depth`: metres as numbers of numpy, or millimetres as a picture.

use std::path::Path;

use image::{ImageBuffer, ImageFormat, Luma};

use super::paths::write_bytes;
use super::settings::UsageError;
use crate::service::{Values, npy};

/// The forms of a depth file, by the ending of its name.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum DepthForm {
    /// `.npy`: metres, 32-bit floating point; infinite where far or unknown, NaN where the lens draws nothing.
    Npy,
    /// `.png`: millimetres, 16 bits, as depth cameras send them; 0 where there is no distance or one of more than 65.535 m.
    Png,
}

impl DepthForm {
    /// The form of a file of this name.
    pub fn of(path: &Path) -> Result<Self, UsageError> {
        let ending = path.extension().and_then(|ending| ending.to_str()).unwrap_or_default().to_ascii_lowercase();
        match ending.as_str() {
            "npy" => Ok(Self::Npy),
            "png" => Ok(Self::Png),
            _ => {
                Err(UsageError(format!("{}: its name must end in .npy (metres) or .png (millimetres)", path.display())))
            }
        }
    }

    /// Writes the depths of a picture of this width, metres row by row.
    pub fn write(self, path: &Path, depths_m: &[f32], width: usize) -> anyhow::Result<()> {
        let height = depths_m.len() / width.max(1);
        match self {
            Self::Npy => write_bytes(path, &npy(&[height, width], Values::F32(depths_m))),
            Self::Png => {
                let pixels: Vec<u16> = depths_m.iter().map(|depth| millimetres(*depth)).collect();
                let picture = ImageBuffer::<Luma<u16>, _>::from_raw(width as u32, height as u32, pixels);
                let mut png = std::io::Cursor::new(Vec::new());
                picture.unwrap_or_default().write_to(&mut png, ImageFormat::Png)?;
                write_bytes(path, png.get_ref())
            }
        }
    }
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

    #[test]
    fn the_ending_names_the_form() {
        assert_eq!(DepthForm::of(Path::new("a/depth.NPY")).ok(), Some(DepthForm::Npy));
        assert_eq!(DepthForm::of(Path::new("depth.png")).ok(), Some(DepthForm::Png));
        assert!(DepthForm::of(Path::new("depth.exr")).is_err());
    }
}
