//! Lenses in the two models that trainers read: OpenCV's fisheye, and OpenCV's pinhole with a rational distortion.

use glam::{DVec2, DVec3};
use nalgebra::{Matrix5, Vector5};

use realitysim_geometry::{Lens, LensModel, LensParameters};

/// A lens as trainers state it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TrainerLens {
    /// OpenCV's fisheye (Kannala-Brandt).
    Fisheye {
        /// Coefficients k1 to k4.
        k: [f64; 4],
    },
    /// OpenCV's pinhole.
    Pinhole {
        /// Coefficients k1, k2, p1, p2, k3, k4, k5, k6.
        d: [f64; 8],
    },
}

/// A lens, and how well the trainers' model stands for it.
#[derive(Clone, Debug, PartialEq)]
pub struct LensFit {
    /// Size of the image, pixels: width, height.
    pub size: [u32; 2],
    /// Focal lengths, pixels.
    pub focal: [f64; 2],
    /// Principal point in pixels, where the first pixel's centre is (0, 0).
    pub centre: DVec2,
    /// The model.
    pub lens: TrainerLens,
    /// Largest distance between where the lens and the model put a ray, pixels; 0 if the model is the lens's own.
    pub max_error_px: f64,
}

/// A fit that is off by more, in pixels, is refused: trainers would blur the border.
const REFUSED_ERROR_PX: f64 = 0.5;
/// Number of angles at which a model is fitted and checked.
const ANGLES: usize = 400;

impl LensFit {
    /// States a lens in a model that trainers read. Pinhole lenses and Kannala-Brandt's are stated as they are; to others that are
    /// symmetric about their axis, Kannala-Brandt's model is fitted.
    ///
    /// # Errors
    ///
    /// The reason, if neither is possible.
    pub fn of(lens: &LensParameters) -> Result<Self, String> {
        let own = Self {
            size: [lens.width, lens.height],
            focal: [lens.fx, lens.fy],
            centre: DVec2::new(lens.cx, lens.cy),
            lens: TrainerLens::Fisheye { k: [0.0; 4] },
            max_error_px: 0.0,
        };
        match lens.model {
            LensModel::KannalaBrandt { k } => Ok(Self { lens: TrainerLens::Fisheye { k }, ..own }),
            LensModel::PlumbBob { d: [k1, k2, p1, p2, k3] } => {
                Ok(Self { lens: TrainerLens::Pinhole { d: [k1, k2, p1, p2, k3, 0.0, 0.0, 0.0] }, ..own })
            }
            LensModel::RationalPolynomial { d } => Ok(Self { lens: TrainerLens::Pinhole { d }, ..own }),
            LensModel::ThinPrism { .. } => {
                Err("trainers have no pinhole lens with thin prism distortion: calibrate with another model".to_owned())
            }
            LensModel::Scaramuzza { skew, .. } if skew != 0.0 => {
                Err("trainers have no lens with skew: calibrate with another model".to_owned())
            }
            LensModel::Equisolid
            | LensModel::DoubleSphere { .. }
            | LensModel::Eucm { .. }
            | LensModel::Scaramuzza { .. } => own.fitted(lens),
        }
    }

    /// Fits focal length and coefficients of a fisheye by least squares to radii of rays from the axis to the border of the image.
    fn fitted(self, parameters: &LensParameters) -> Result<Self, String> {
        let lens = Lens::new(parameters.clone()).map_err(|error| error.to_string())?;
        let radius = |angle: f64| {
            let (sine, cosine) = libm::sincos(angle);
            lens.project(DVec3::new(sine, 0.0, cosine)).map(|pixel| (pixel.x - parameters.cx) / parameters.fx)
        };
        let angles = (1..=ANGLES).map(|step| lens.max_angle() * step as f64 / ANGLES as f64);
        let radii: Vec<(f64, f64)> = angles.filter_map(|angle| Some((angle, radius(angle)?))).collect();
        let powers = |angle: f64| Vector5::from_fn(|power, _| libm::pow(angle, 2.0 * power as f64 + 1.0));
        let (mut normal, mut right) = (Matrix5::zeros(), Vector5::zeros());
        for (angle, radius) in &radii {
            let row = powers(*angle);
            normal += row * row.transpose();
            right += row * *radius;
        }
        let solved = normal.cholesky().map(|factor| factor.solve(&right)).filter(|solution| solution[0] > 0.0);
        let solution = solved.ok_or("no fisheye model fits its lens")?;
        let off = |(angle, radius): &(f64, f64)| (powers(*angle).dot(&solution) - radius).abs() * lens.focal();
        let max_error_px = radii.iter().map(off).fold(0.0, f64::max);
        if max_error_px > REFUSED_ERROR_PX {
            return Err(format!("the fisheye model of trainers is {max_error_px:.1} px off its lens"));
        }
        let scale = solution[0];
        let k = core::array::from_fn(|i| solution[i + 1] / scale);
        let focal = self.focal.map(|pixels| pixels * scale);
        Ok(Self { focal, lens: TrainerLens::Fisheye { k }, max_error_px, ..self })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lens(model: LensModel) -> LensParameters {
        LensParameters {
            width: 640,
            height: 480,
            fx: 200.0,
            fy: 201.0,
            cx: 321.0,
            cy: 238.0,
            model,
            fov_deg: Some(180.0),
        }
    }

    #[test]
    fn a_fitted_fisheye_puts_rays_where_the_lens_does() {
        for model in [LensModel::Equisolid, LensModel::Eucm { alpha: 0.6, beta: 1.1 }] {
            let parameters = lens(model);
            let fit = LensFit::of(&parameters).unwrap();
            let TrainerLens::Fisheye { k } = fit.lens else { panic!("{fit:?}") };
            let model = LensModel::KannalaBrandt { k };
            let [fx, fy] = fit.focal;
            let fitted = Lens::new(LensParameters { fx, fy, model, ..parameters.clone() }).unwrap();
            let lens = Lens::new(parameters).unwrap();
            for step in 0..40 {
                let (angle, azimuth) = (0.035 * f64::from(step), 0.7 * f64::from(step));
                let (sine, cosine) = angle.sin_cos();
                let ray = DVec3::new(sine * azimuth.cos(), sine * azimuth.sin(), cosine);
                let off = lens.project(ray).unwrap().distance(fitted.project(ray).unwrap());
                assert!(off <= 1.01 * fit.max_error_px + 1e-9, "{angle}: {off}");
            }
            assert!(fit.max_error_px < 0.1, "{fit:?}");
        }
    }

    #[test]
    fn what_no_trainer_can_state_is_refused_with_the_reason() {
        assert!(LensFit::of(&lens(LensModel::ThinPrism { d: [0.01; 12] })).unwrap_err().contains("thin prism"));
        let skewed = LensModel::Scaramuzza { c: [-0.1, 0.0, 0.0, 0.0, 0.0], skew: 0.01 };
        assert!(LensFit::of(&lens(skewed)).unwrap_err().contains("skew"));
    }
}
