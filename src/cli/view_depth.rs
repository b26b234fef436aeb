//! The file of `realitysim view --depth`: metres as numbers of numpy, or millimetres as a picture.

use std::path::Path;

use super::depth_picture::depth_png;
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
            Self::Png => write_bytes(path, &depth_png(depths_m, width)?),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ending_names_the_form() {
        assert_eq!(DepthForm::of(Path::new("a/depth.NPY")).ok(), Some(DepthForm::Npy));
        assert_eq!(DepthForm::of(Path::new("depth.png")).ok(), Some(DepthForm::Png));
        assert!(DepthForm::of(Path::new("depth.exr")).is_err());
    }
}
