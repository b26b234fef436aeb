//! A lens of which only the angle of view is known: `equidistant:180deg` in place of a file.

use core::fmt;

use super::{Content, LensFileError, LensFormat};
use realitysim_geometry::{LensModel, LensParameters};

/// An ideal lens with a full horizontal field of view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct FieldOfView {
    projection: Projection,
    horizontal_deg: f64,
}

/// A projection without distortion.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Projection {
    Equidistant,
    Equisolid,
    Pinhole,
}

impl FieldOfView {
    /// Reads `MODEL:DEGREESdeg`; `None` if the text does not begin with the name of a model and a colon.
    pub fn parse(text: &str) -> Option<Result<Self, LensFileError>> {
        let (name, angle) = text.split_once(':')?;
        let (projection, max_deg) = match name {
            "equidistant" => (Projection::Equidistant, 360.0),
            "equisolid" => (Projection::Equisolid, 360.0),
            "pinhole" => (Projection::Pinhole, 179.0),
            _ => return None,
        };
        let degrees = angle.strip_suffix("deg").and_then(|number| number.trim().parse().ok());
        Some(match degrees {
            Some(horizontal_deg) if horizontal_deg > 0.0 && horizontal_deg <= max_deg => {
                Ok(Self { projection, horizontal_deg })
            }
            _ => {
                let expected = format!(
                    "it must be the full horizontal field of view, above 0 and up to {max_deg}deg, as in 120deg"
                );
                Err(LensFileError::value("the angle", format_args!("{angle:?}"), expected))
            }
        })
    }

    /// The lens for an image of a width and height, pixels, whose middle is on the axis.
    ///
    /// The field of view reaches from the left edge of the first column of pixels to the right edge of the last.
    pub fn content(self, image_size: Option<[u32; 2]>) -> Result<Content, LensFileError> {
        let Some([width, height]) = image_size else { return Err(LensFileError::ImageSizeUnknown) };
        let half_rad = (self.horizontal_deg / 2.0).to_radians();
        let (model, radius) = match self.projection {
            Projection::Equidistant => (LensModel::KannalaBrandt { k: [0.0; 4] }, half_rad),
            Projection::Equisolid => (LensModel::Equisolid, 2.0 * libm::sin(half_rad / 2.0)),
            Projection::Pinhole => (LensModel::PlumbBob { d: [0.0; 5] }, libm::tan(half_rad)),
        };
        let focal_px = f64::from(width) / 2.0 / radius;
        let middle = |size: u32| f64::from(size) / 2.0 - 0.5;
        let (cx, cy) = (middle(width), middle(height));
        let parameters = LensParameters { width, height, fx: focal_px, fy: focal_px, cx, cy, model, fov_deg: None };
        Ok(Content { title: self.to_string(), format: LensFormat::FieldOfView, parameters, visual_mesh_pose: None })
    }
}

impl fmt::Display for FieldOfView {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let name = match self.projection {
            Projection::Equidistant => "equidistant",
            Projection::Equisolid => "equisolid",
            Projection::Pinhole => "pinhole",
        };
        write!(f, "{name}:{}deg", self.horizontal_deg)
    }
}
