//! Lenses: from a ray in `camera_optical_frame` to a pixel and back.
//!
//! Pixels as in ROS and OpenCV: (0, 0) is the centre of the top left pixel, u to the right, v down.

mod pinhole;
mod projector;
mod radial;

use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use pinhole::PlumbBob;
pub use projector::Projector;
use radial::Radial;

/// What the files say about a lens: plain data, checked by [`Lens::new`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LensParameters {
    /// Pixels.
    pub width: u32,
    pub height: u32,
    /// Focal lengths, pixels.
    pub fx: f64,
    pub fy: f64,
    /// Where the axis meets the image, pixels.
    pub cx: f64,
    pub cy: f64,
    pub model: LensModel,
    /// Full angle of view that the model is stated to hold for; without it, as far as the model is monotonic.
    pub fov_deg: Option<f64>,
}

impl LensParameters {
    /// Whether both draw a place on the same pixel, however far from the axis they draw anything.
    pub fn maps_as(&self, other: &Self) -> bool {
        let bare = |lens: &Self| Self { fov_deg: None, ..lens.clone() };
        bare(self) == bare(other)
    }

    /// Whether an image of `other` is one of this lens: it maps as that one, and is not stated to end nearer to the axis.
    pub fn draws_as(&self, other: &Self) -> bool {
        let ends_before = self.fov_deg.zip(other.fov_deg).is_some_and(|(own, other)| own + SAME_FOV_DEG < other);
        self.maps_as(other) && !ends_before
    }
}

/// A circle's edge is not known better than this.
const SAME_FOV_DEG: f64 = 3.0;

/// The distance from the axis that a ray at angle theta is drawn at, in focal lengths.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LensModel {
    /// theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8): Kannala and Brandt 2006, ROS
    /// `equidistant`, OpenCV fisheye. All zero is the ideal equidistant lens.
    KannalaBrandt { k: [f64; 4] },
    /// 2 sin(theta / 2).
    Equisolid,
    /// Pinhole with ROS `plumb_bob` distortion (Brown-Conrady): k1, k2, p1, p2, k3.
    PlumbBob { d: [f64; 5] },
}

impl LensParameters {
    /// The same lens on a sensor with other pixels: width and height as given; where one is `None`, in the proportions that
    /// there were.
    pub fn resized(&self, size: [Option<u32>; 2]) -> Self {
        let (own, in_proportion) = ([self.width, self.height], |pixels: u32, to: u32, from: u32| {
            ((f64::from(pixels) * f64::from(to) / f64::from(from)).round() as u32).max(1)
        });
        let [width, height] = match size {
            [None, None] => own,
            [Some(width), None] => [width, in_proportion(own[1], width, own[0])],
            [None, Some(height)] => [in_proportion(own[0], height, own[1]), height],
            [Some(width), Some(height)] => [width, height],
        };
        let [x, y] = [f64::from(width) / f64::from(own[0]), f64::from(height) / f64::from(own[1])];
        // Half a pixel lies before the first pixel's centre.
        let centre = |centre: f64, scale: f64| (centre + 0.5) * scale - 0.5;
        Self {
            width,
            height,
            fx: self.fx * x,
            fy: self.fy * y,
            cx: centre(self.cx, x),
            cy: centre(self.cy, y),
            ..self.clone()
        }
    }
}

#[derive(Clone, Debug, Error, PartialEq)]
pub enum LensError {
    #[error(
        "image size {width} x {height}: both must be between 1 and {MAX_SIDE}, and their product at most {MAX_PIXELS}"
    )]
    Size { width: u32, height: u32 },
    #[error("{name} is {value}: a focal length must be a positive number of pixels")]
    Focal { name: &'static str, value: f64 },
    #[error("{name} is {value}: it must be a finite number")]
    NotFinite { name: &'static str, value: f64 },
    #[error("field of view {fov_deg} deg: it must be above 0 and at most {max_deg} deg for this model")]
    Fov { fov_deg: f64, max_deg: f64 },
    #[error(
        "the distortion polynomial turns back at {at_deg:.2} deg off the axis, inside the stated field of view of \
         {fov_deg} deg: check the coefficients, or state a field of view below {:.1} deg", 2.0 * at_deg
    )]
    NotMonotonic { at_deg: f64, fov_deg: f64 },
}

/// Larger images are refused at load.
pub const MAX_SIDE: u32 = 16_384;
/// More than any camera on a robot has. Decoded, so many pixels take some hundred megabytes.
pub const MAX_PIXELS: u64 = 1 << 25;

/// Whether an image of this width and height, pixels, is decoded, and a lens for it prepared.
pub fn is_image_size(width: u64, height: u64) -> bool {
    let side = 1..=u64::from(MAX_SIDE);
    side.contains(&width) && side.contains(&height) && width * height <= MAX_PIXELS
}

/// A lens that has been checked: monotonic up to [`Lens::max_angle`].
#[derive(Clone, Debug, PartialEq)]
pub struct Lens {
    parameters: LensParameters,
    curve: Curve,
}

#[derive(Clone, Debug, PartialEq)]
enum Curve {
    Radial(Radial),
    PlumbBob(PlumbBob),
}

impl Lens {
    pub fn new(parameters: LensParameters) -> Result<Self, LensError> {
        let p = &parameters;
        if !is_image_size(p.width.into(), p.height.into()) {
            return Err(LensError::Size { width: p.width, height: p.height });
        }
        for (name, value) in [("fx", p.fx), ("fy", p.fy)] {
            if !(value.is_finite() && value > 0.0) {
                return Err(LensError::Focal { name, value });
            }
        }
        for (name, value) in [("cx", p.cx), ("cy", p.cy)] {
            if !value.is_finite() {
                return Err(LensError::NotFinite { name, value });
            }
        }
        let reach = farthest_corner(p);
        let curve = match p.model {
            LensModel::KannalaBrandt { k } => Curve::Radial(Radial::kannala_brandt(k, reach, p.fov_deg)?),
            LensModel::Equisolid => Curve::Radial(Radial::equisolid(reach, p.fov_deg)?),
            LensModel::PlumbBob { d } => Curve::PlumbBob(PlumbBob::new(d, reach, p.fov_deg)?),
        };
        Ok(Self { parameters, curve })
    }

    pub fn parameters(&self) -> &LensParameters {
        &self.parameters
    }

    pub fn width(&self) -> u32 {
        self.parameters.width
    }

    pub fn height(&self) -> u32 {
        self.parameters.height
    }

    /// Pixels per radian on the axis: the mean of fx and fy.
    pub fn focal(&self) -> f64 {
        (self.parameters.fx + self.parameters.fy) / 2.0
    }

    /// The largest angle off the axis that the lens sees, radians; above pi/2 it sees behind itself.
    pub fn max_angle(&self) -> f64 {
        match &self.curve {
            Curve::Radial(radial) => radial.max_angle(),
            Curve::PlumbBob(pinhole) => pinhole.max_angle(),
        }
    }

    /// The pixel of a ray in `camera_optical_frame` (any length), or `None` outside the field of view.
    /// The pixel can lie outside the image: see [`Lens::contains`].
    pub fn project(&self, ray: DVec3) -> Option<DVec2> {
        let normalised = match &self.curve {
            Curve::Radial(radial) => radial.project(ray)?,
            Curve::PlumbBob(pinhole) => pinhole.project(ray)?,
        };
        let p = &self.parameters;
        Some(DVec2::new(p.cx + p.fx * normalised.x, p.cy + p.fy * normalised.y))
    }

    /// The unit ray of a pixel, or `None` where the lens draws nothing.
    pub fn unproject(&self, pixel: DVec2) -> Option<DVec3> {
        let p = &self.parameters;
        let normalised = DVec2::new((pixel.x - p.cx) / p.fx, (pixel.y - p.cy) / p.fy);
        match &self.curve {
            Curve::Radial(radial) => radial.unproject(normalised),
            Curve::PlumbBob(pinhole) => pinhole.unproject(normalised),
        }
    }

    /// Whether the pixel's centre lies so that bilinear interpolation finds its four neighbours.
    pub fn contains(&self, pixel: DVec2) -> bool {
        pixel.x >= 0.0
            && pixel.y >= 0.0
            && pixel.x <= f64::from(self.parameters.width - 1)
            && pixel.y <= f64::from(self.parameters.height - 1)
    }
}

/// Distance of the image's farthest corner from the axis, in focal lengths.
fn farthest_corner(p: &LensParameters) -> f64 {
    let side = |centre: f64, size: u32| centre.abs().max((f64::from(size) - 1.0 - centre).abs());
    libm::hypot(side(p.cx, p.width) / p.fx, side(p.cy, p.height) / p.fy)
}

/// Half of a stated field of view in radians, checked against what the model can show.
fn half_fov(fov_deg: Option<f64>, max_deg: f64) -> Result<Option<f64>, LensError> {
    match fov_deg {
        None => Ok(None),
        Some(fov) if fov > 0.0 && fov <= max_deg => Ok(Some((fov / 2.0).to_radians())),
        Some(fov_deg) => Err(LensError::Fov { fov_deg, max_deg }),
    }
}

#[cfg(test)]
mod tests;
