//! Lens models: from a ray in `camera_optical_frame` to a pixel and back.
//!
//! Pixel coordinates are those of ROS and OpenCV: (0, 0) is the centre of the top left pixel, u points right, v down.

mod pinhole;
mod projector;
mod radial;

use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use pinhole::Pinhole;
pub use projector::Projector;
use radial::Radial;

/// The parameters of a lens as files state them: plain data, which [`Lens::new`] checks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LensParameters {
    /// Width of the image, pixels.
    pub width: u32,
    /// Height of the image, pixels.
    pub height: u32,
    /// Horizontal focal length, pixels.
    pub fx: f64,
    /// Vertical focal length, pixels.
    pub fy: f64,
    /// Column of the principal point, pixels.
    pub cx: f64,
    /// Row of the principal point, pixels.
    pub cy: f64,
    /// Projection and distortion.
    pub model: LensModel,
    /// Full field of view for which the model is stated to hold, degrees. `None`: as far as the model is monotonic.
    pub fov_deg: Option<f64>,
}

impl LensParameters {
    /// Whether both lenses project every ray to the same pixel; stated fields of view are ignored.
    pub fn maps_as(&self, other: &Self) -> bool {
        let bare = |lens: &Self| Self { fov_deg: None, ..lens.clone() };
        bare(self) == bare(other)
    }

    /// Whether an image of `other` is as good as an image of this lens.
    ///
    /// Both must project alike ([`Self::maps_as`]), and the field of view of this lens must not be stated to be smaller.
    pub fn draws_as(&self, other: &Self) -> bool {
        let ends_before = self.fov_deg.zip(other.fov_deg).is_some_and(|(own, other)| own + FOV_TOLERANCE_DEG < other);
        self.maps_as(other) && !ends_before
    }
}

/// Fields of view that differ by less, in degrees, count as equal: the edge of the image circle is not known better.
const FOV_TOLERANCE_DEG: f64 = 3.0;

/// A lens model with its distortion coefficients.
///
/// The formulas give the distance r of the image point from the principal point, in focal lengths, for a ray at the angle theta off
/// the axis.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LensModel {
    /// r = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8): Kannala and Brandt 2006, ROS
    /// `equidistant`, OpenCV fisheye.
    KannalaBrandt {
        /// Coefficients k1 to k4. All zero is the ideal equidistant lens.
        k: [f64; 4],
    },
    /// r = 2 sin(theta / 2), without distortion.
    Equisolid,
    /// Pinhole (r = tan theta) with ROS `plumb_bob` distortion (Brown-Conrady).
    PlumbBob {
        /// Coefficients k1, k2, p1, p2, k3: k radial, p tangential.
        d: [f64; 5],
    },
    /// Pinhole with OpenCV's rational distortion, ROS `rational_polynomial`.
    RationalPolynomial {
        /// Coefficients k1, k2, p1, p2, k3, k4, k5, k6: k4 to k6 stand in the denominator.
        d: [f64; 8],
    },
    /// Pinhole with OpenCV's rational and thin prism distortion.
    ThinPrism {
        /// Coefficients of [`Self::RationalPolynomial`], then s1, s2, s3, s4.
        d: [f64; 12],
    },
    /// Usenko, Demmel and Cremers 2018: r = sin theta / (alpha d + (1 - alpha) (xi + cos theta)), where
    /// d^2 = sin^2 theta + (xi + cos theta)^2.
    DoubleSphere {
        /// Distance of the spheres' centres, -1 to 1.
        xi: f64,
        /// Blend from a pinhole (0) to an orthographic image (1) of the second sphere.
        alpha: f64,
    },
    /// Enhanced unified camera model, Khomutenko, Garcia and Martinet 2016:
    /// r = sin theta / (alpha d + (1 - alpha) cos theta), where d^2 = beta sin^2 theta + cos^2 theta.
    Eucm {
        /// Blend from a pinhole (0) to an orthographic image (1).
        alpha: f64,
        /// Shape of the surface, above 0; 1 is a sphere.
        beta: f64,
    },
    /// Scaramuzza, Martinelli and Siegwart 2006 (OCamCalib): theta = atan2(r, 1 + c2 r^2 + c3 r^3 + c4 r^4 + c5 r^5 + c6 r^6).
    Scaramuzza {
        /// Coefficients c2 to c6.
        c: [f64; 5],
        /// What a point's row adds to its column, both in focal lengths: the skew of the camera's matrix over fx.
        skew: f64,
    },
}

impl LensModel {
    /// The simplest pinhole model with the given coefficients in OpenCV's order, k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4 tau_x tau_y.
    ///
    /// Missing coefficients are 0. `None` if there are more than 14, or if the sensor is tilted (tau), which no model here has.
    pub fn of_opencv(d: &[f64]) -> Option<Self> {
        let mut all = [0.0; 14];
        all.get_mut(..d.len())?.copy_from_slice(d);
        let [k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, tau @ ..] = all;
        if tau != [0.0; 2] {
            return None;
        }
        Some(if [s1, s2, s3, s4] != [0.0; 4] {
            Self::ThinPrism { d: [k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4] }
        } else if [k4, k5, k6] != [0.0; 3] {
            Self::RationalPolynomial { d: [k1, k2, p1, p2, k3, k4, k5, k6] }
        } else {
            Self::PlumbBob { d: [k1, k2, p1, p2, k3] }
        })
    }
}

impl LensModel {
    /// The name of the model and its coefficients as `sensor_msgs/CameraInfo` and camera_calibration state them.
    ///
    /// ROS names `equidistant`, `plumb_bob` and `rational_polynomial`; the other names are this program's own.
    pub fn ros_distortion(&self) -> (&'static str, Vec<f64>) {
        match *self {
            Self::KannalaBrandt { k } => ("equidistant", k.to_vec()),
            Self::Equisolid => ("equisolid", Vec::new()),
            Self::PlumbBob { d } => ("plumb_bob", d.to_vec()),
            Self::RationalPolynomial { d } => ("rational_polynomial", d.to_vec()),
            Self::ThinPrism { d } => ("rational_polynomial", d.to_vec()),
            Self::DoubleSphere { xi, alpha } => ("double_sphere", vec![xi, alpha]),
            Self::Eucm { alpha, beta } => ("eucm", vec![alpha, beta]),
            Self::Scaramuzza { c: [c2, c3, c4, c5, c6], skew } => ("scaramuzza", vec![c2, c3, c4, c5, c6, skew]),
        }
    }
}

impl LensParameters {
    /// The parameters for the same lens when its images are scaled to another size, `[width, height]` in pixels.
    ///
    /// Where one of the two is `None`, the aspect ratio is kept.
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
        // The image begins half a pixel before the first pixel's centre.
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

impl LensParameters {
    /// The same lens for its images scaled to `[width, height]` pixels; `None` if the aspect ratio is another.
    ///
    /// It is the same if the factor of one side gives the other within a pixel.
    pub fn scaled_to(&self, [width, height]: [u32; 2]) -> Option<Self> {
        let off = |side: u32, own: u32, other: u32, other_own: u32| {
            (f64::from(other) - f64::from(other_own) * f64::from(side) / f64::from(own)).abs()
        };
        let nearest = off(width, self.width, height, self.height).min(off(height, self.height, width, self.width));
        (nearest <= 1.0).then(|| self.resized([Some(width), Some(height)]))
    }

    /// The lens of a part of its images that begins at `offset` (column, row) and has the size `[width, height]`, pixels.
    pub fn cropped(&self, offset: [u32; 2], [width, height]: [u32; 2]) -> Self {
        let [cx, cy] = [self.cx - f64::from(offset[0]), self.cy - f64::from(offset[1])];
        Self { width, height, cx, cy, ..self.clone() }
    }

    /// The lens of images whose pixels are made of `factors[0]` by `factors[1]` of its own, at least 1 each.
    ///
    /// Columns and rows that do not fill a pixel are cut off. `None` if nothing is left.
    pub fn binned(&self, factors: [u32; 2]) -> Option<Self> {
        let [width, height] = [self.width.checked_div(factors[0])?, self.height.checked_div(factors[1])?];
        let filled = [width.checked_mul(factors[0])?, height.checked_mul(factors[1])?];
        (width > 0 && height > 0).then(|| self.cropped([0, 0], filled).resized([Some(width), Some(height)]))
    }
}

/// Parameters that no lens can have.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum LensError {
    /// The image is empty or larger than [`MAX_SIDE`] or [`MAX_PIXELS`] allow.
    #[error(
        "image size {width} x {height}: both must be between 1 and {MAX_SIDE}, and their product at most {MAX_PIXELS}"
    )]
    Size {
        /// Width of the image, pixels.
        width: u32,
        /// Height of the image, pixels.
        height: u32,
    },
    /// A focal length is not within [`FOCAL_PX`].
    #[error(
        "{name} is {value:?}: a focal length must be a positive number of pixels, between {} and {:e}",
        FOCAL_PX.start(), FOCAL_PX.end()
    )]
    Focal {
        /// Name of the parameter, `fx` or `fy`.
        name: &'static str,
        /// The refused value, pixels.
        value: f64,
    },
    /// The principal point is not finite, or farther from the image than any lens puts it.
    #[error("{name} is {value:?}: a principal point lies within {MAX_CENTRE_OFFSET_PX:e} pixels of the image's corner")]
    Centre {
        /// Name of the parameter, `cx` or `cy`.
        name: &'static str,
        /// The refused value, pixels.
        value: f64,
    },
    /// A coefficient is outside the range of its model.
    #[error("{name} is {value}: it must be {expected}")]
    Coefficient {
        /// Name of the coefficient, such as `xi`.
        name: &'static str,
        /// The refused value.
        value: f64,
        /// Range that is possible.
        expected: &'static str,
    },
    /// The stated field of view is out of the model's range.
    #[error("field of view {fov_deg} deg: it must be above 0 and at most {max_deg} deg for this model")]
    Fov {
        /// The stated full field of view, degrees.
        fov_deg: f64,
        /// The largest field of view of the model, degrees.
        max_deg: f64,
    },
    /// The model is not monotonic in the stated field of view.
    #[error(
        "the distortion turns back at {at_deg:.2} deg off the axis, inside the stated field of view of \
         {fov_deg} deg: check the coefficients, or state a field of view below {:.1} deg", 2.0 * at_deg
    )]
    NotMonotonic {
        /// Angle off the axis at which the model turns back, degrees.
        at_deg: f64,
        /// The stated full field of view, degrees.
        fov_deg: f64,
    },
}

/// Largest width and height of an image, pixels. Larger images are refused when they are loaded.
pub const MAX_SIDE: u32 = 16_384;
/// Focal lengths of lenses, pixels. Products with a longer or shorter one leave the range of numbers.
pub const FOCAL_PX: core::ops::RangeInclusive<f64> = 0.1..=1e7;
/// Distance of the principal point from the image's first pixel along each axis, pixels, that no lens exceeds.
pub const MAX_CENTRE_OFFSET_PX: f64 = 1e7;
/// Largest magnitude of a coefficient of a distortion or of a lens's polynomial.
///
/// Calibrations have up to some hundreds. Beyond 1e6 the polynomials and their derivatives could leave the range of numbers.
pub const MAX_COEFFICIENT: f64 = 1e6;
/// Largest number of pixels of an image.
///
/// No camera on a robot has more. Decoded, so many pixels take some hundred megabytes.
pub const MAX_PIXELS: u64 = 1 << 25;

/// Whether an image of this width and height, in pixels, is within [`MAX_SIDE`] and [`MAX_PIXELS`] and not empty.
pub fn is_image_size(width: u64, height: u64) -> bool {
    let side = 1..=u64::from(MAX_SIDE);
    side.contains(&width) && side.contains(&height) && width * height <= MAX_PIXELS
}

/// A lens whose parameters have been checked. Its projection is monotonic up to [`Lens::max_angle`].
#[derive(Clone, Debug, PartialEq)]
pub struct Lens {
    parameters: LensParameters,
    curve: Curve,
}

/// The projection of a lens, prepared for evaluation.
#[derive(Clone, Debug, PartialEq)]
enum Curve {
    Radial(Radial),
    Pinhole(Pinhole),
}

impl Lens {
    /// Checks the parameters and prepares the projection and its inverse.
    ///
    /// # Errors
    /// [`LensError`] if the image size, a coefficient or the field of view is out of range, or if the model is not monotonic within
    /// the stated field of view. Without a stated field of view, the lens is cut where the model turns back.
    pub fn new(parameters: LensParameters) -> Result<Self, LensError> {
        let p = &parameters;
        if !is_image_size(p.width.into(), p.height.into()) {
            return Err(LensError::Size { width: p.width, height: p.height });
        }
        for (name, value) in [("fx", p.fx), ("fy", p.fy)] {
            if !FOCAL_PX.contains(&value) {
                return Err(LensError::Focal { name, value });
            }
        }
        for (name, value) in [("cx", p.cx), ("cy", p.cy)] {
            if !(-MAX_CENTRE_OFFSET_PX..=MAX_CENTRE_OFFSET_PX).contains(&value) {
                return Err(LensError::Centre { name, value });
            }
        }
        let reach = farthest_corner(p);
        let curve = match p.model {
            LensModel::KannalaBrandt { k } => Curve::Radial(Radial::kannala_brandt(k, reach, p.fov_deg)?),
            LensModel::Equisolid => Curve::Radial(Radial::equisolid(reach, p.fov_deg)?),
            LensModel::PlumbBob { d } => Curve::Pinhole(Pinhole::plumb_bob(d, reach, p.fov_deg)?),
            LensModel::RationalPolynomial { d } => Curve::Pinhole(Pinhole::rational(&d, reach, p.fov_deg)?),
            LensModel::ThinPrism { d } => Curve::Pinhole(Pinhole::rational(&d, reach, p.fov_deg)?),
            LensModel::DoubleSphere { xi, alpha } => Curve::Radial(Radial::double_sphere(xi, alpha, reach, p.fov_deg)?),
            LensModel::Eucm { alpha, beta } => Curve::Radial(Radial::eucm(alpha, beta, reach, p.fov_deg)?),
            LensModel::Scaramuzza { c, skew } => Curve::Radial(Radial::scaramuzza(c, skew, reach, p.fov_deg)?),
        };
        Ok(Self { parameters, curve })
    }

    /// The parameters that the lens was made from.
    pub fn parameters(&self) -> &LensParameters {
        &self.parameters
    }

    /// Width of the image, pixels.
    pub fn width(&self) -> u32 {
        self.parameters.width
    }

    /// Height of the image, pixels.
    pub fn height(&self) -> u32 {
        self.parameters.height
    }

    /// Pixels per radian on the axis, the mean of both directions.
    ///
    /// That is the focal length (fx + fy) / 2, but for a double sphere lens, whose radius grows by 1 / (1 + xi) of it.
    pub fn focal(&self) -> f64 {
        let focal_px = (self.parameters.fx + self.parameters.fy) / 2.0;
        match &self.curve {
            Curve::Radial(radial) => focal_px * radial.slope_on_axis(),
            Curve::Pinhole(_) => focal_px,
        }
    }

    /// The largest angle off the axis that the lens sees, radians. A lens with more than pi/2 sees behind itself.
    pub fn max_angle(&self) -> f64 {
        match &self.curve {
            Curve::Radial(radial) => radial.max_angle(),
            Curve::Pinhole(pinhole) => pinhole.max_angle(),
        }
    }

    /// Projects a ray of any length in `camera_optical_frame` to a pixel, or `None` outside the field of view.
    ///
    /// The pixel can lie outside the image: see [`Lens::contains`].
    pub fn project(&self, ray: DVec3) -> Option<DVec2> {
        let normalised = match &self.curve {
            Curve::Radial(radial) => radial.project(ray)?,
            Curve::Pinhole(pinhole) => pinhole.project(ray)?,
        };
        let p = &self.parameters;
        Some(DVec2::new(p.cx + p.fx * normalised.x, p.cy + p.fy * normalised.y))
    }

    /// Finds the unit ray of a pixel in `camera_optical_frame`, or `None` where the lens draws nothing.
    pub fn unproject(&self, pixel: DVec2) -> Option<DVec3> {
        let p = &self.parameters;
        let normalised = DVec2::new((pixel.x - p.cx) / p.fx, (pixel.y - p.cy) / p.fy);
        match &self.curve {
            Curve::Radial(radial) => radial.unproject(normalised),
            Curve::Pinhole(pinhole) => pinhole.unproject(normalised),
        }
    }

    /// Whether a pixel lies in the image so that bilinear interpolation finds its four neighbours.
    pub fn contains(&self, pixel: DVec2) -> bool {
        pixel.x >= 0.0
            && pixel.y >= 0.0
            && pixel.x <= f64::from(self.parameters.width - 1)
            && pixel.y <= f64::from(self.parameters.height - 1)
    }
}

/// Distance of the image's farthest corner from the principal point, in focal lengths.
fn farthest_corner(p: &LensParameters) -> f64 {
    let side = |centre: f64, size: u32| centre.abs().max((f64::from(size) - 1.0 - centre).abs());
    libm::hypot(side(p.cx, p.width) / p.fx, side(p.cy, p.height) / p.fy)
}

/// Checks the coefficients of a polynomial against [`MAX_COEFFICIENT`].
fn check_coefficients<'a>(coefficients: impl IntoIterator<Item = (&'static str, &'a f64)>) -> Result<(), LensError> {
    let range = -MAX_COEFFICIENT..=MAX_COEFFICIENT;
    match coefficients.into_iter().find(|(_, value)| !range.contains(*value)) {
        Some((name, value)) => Err(LensError::Coefficient {
            name,
            value: *value,
            expected: "within -1e6 and 1e6, as every calibration is",
        }),
        None => Ok(()),
    }
}

/// Half of a stated field of view in radians, checked against the largest of the model, `max_deg`.
fn half_fov(fov_deg: Option<f64>, max_deg: f64) -> Result<Option<f64>, LensError> {
    match fov_deg {
        None => Ok(None),
        Some(fov) if fov > 0.0 && fov <= max_deg => Ok(Some((fov / 2.0).to_radians())),
        Some(fov_deg) => Err(LensError::Fov { fov_deg, max_deg }),
    }
}

#[cfg(test)]
mod tests;
