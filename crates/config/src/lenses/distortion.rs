//! Converts the names and coefficients of distortion models, as ROS and Kalibr write them, to a [`LensModel`].

use super::LensFileError;
use realitysim_geometry::LensModel;

/// The keys under which a file states its distortion, for error messages.
pub(super) struct DistortionKeys {
    /// Key of the model's name.
    pub model: &'static str,
    /// Key of the coefficients.
    pub coefficients: &'static str,
}

impl DistortionKeys {
    /// Converts a model as `sensor_msgs/CameraInfo` names it. Without coefficients the lens has no distortion.
    pub fn ros(&self, model: &str, d: &[f64]) -> Result<LensModel, LensFileError> {
        match (model, d) {
            // Drivers of ideal cameras leave name and coefficients empty.
            ("plumb_bob" | "", []) => Ok(LensModel::PlumbBob { d: [0.0; 5] }),
            ("plumb_bob", &[k1, k2, p1, p2]) => Ok(LensModel::PlumbBob { d: [k1, k2, p1, p2, 0.0] }),
            ("plumb_bob", &[k1, k2, p1, p2, k3]) => Ok(LensModel::PlumbBob { d: [k1, k2, p1, p2, k3] }),
            ("plumb_bob", _) => {
                Err(self.coefficient_error(d, "plumb_bob takes 4 (k1, k2, p1, p2), 5 (and k3) or none"))
            }
            // Some drivers call OpenCV's fisheye by its name there.
            ("equidistant" | "fisheye", d) => self.equidistant(d),
            // ROS has no name for these four: this program writes them (`CameraInfo::of_lens`).
            ("double_sphere", &[xi, alpha]) => Ok(LensModel::DoubleSphere { xi, alpha }),
            ("double_sphere", _) => Err(self.coefficient_error(d, "double_sphere takes 2: xi, alpha")),
            ("eucm", &[alpha, beta]) => Ok(LensModel::Eucm { alpha, beta }),
            ("scaramuzza", &[c2, c3, c4, c5, c6, skew]) => Ok(LensModel::Scaramuzza { c: [c2, c3, c4, c5, c6], skew }),
            ("scaramuzza", _) => Err(self.coefficient_error(d, "scaramuzza takes 6: c2 to c6, skew")),
            ("eucm", _) => Err(self.coefficient_error(d, "eucm takes 2: alpha, beta")),
            ("equisolid", []) => Ok(LensModel::Equisolid),
            ("equisolid", _) => Err(self.coefficient_error(d, "equisolid takes no coefficients")),
            ("rational_polynomial", []) => Ok(LensModel::PlumbBob { d: [0.0; 5] }),
            // Where k4 to k6 are 0 the denominator is 1 and the model is plumb_bob. Thin prism and tilt terms follow.
            ("rational_polynomial", &[k1, k2, p1, p2, k3, ref rest @ ..]) if rest.iter().all(|c| *c == 0.0) => {
                Ok(LensModel::PlumbBob { d: [k1, k2, p1, p2, k3] })
            }
            ("rational_polynomial", d) if [8, 12, 14].contains(&d.len()) => self.opencv(d),
            ("rational_polynomial", _) => Err(self.coefficient_error(
                d,
                "rational_polynomial takes 8 (k1, k2, p1, p2, k3 to k6), 12 (and s1 to s4), 14 (and a tilt of 0) or none",
            )),
            ("thin_prism", d) if [12, 14].contains(&d.len()) => self.opencv(d),
            ("thin_prism", _) => {
                Err(self.coefficient_error(d, "thin_prism takes 12: k1, k2, p1, p2, k3 to k6, s1 to s4"))
            }
            (other, _) => {
                let expected = "it must be \"plumb_bob\", \"rational_polynomial\", \"thin_prism\", \"equidistant\" or \
                                \"fisheye\"";
                Err(self.unknown_model(other, expected))
            }
        }
    }

    /// Makes a pinhole lens of OpenCV's coefficients.
    fn opencv(&self, d: &[f64]) -> Result<LensModel, LensFileError> {
        let expected = "its last two, the tilt of the sensor, must be 0: calibrate without a tilted sensor";
        LensModel::of_opencv(d).ok_or_else(|| self.coefficient_error(d, expected))
    }

    /// Converts a model as Kalibr names it.
    pub fn kalibr(&self, model: &str, d: &[f64]) -> Result<LensModel, LensFileError> {
        match (model, d) {
            ("none", d) if d.iter().all(|c| *c == 0.0) => Ok(LensModel::PlumbBob { d: [0.0; 5] }),
            ("none", d) => Err(self.coefficient_error(d, "the model none takes no coefficients")),
            ("radtan", &[k1, k2, p1, p2]) => Ok(LensModel::PlumbBob { d: [k1, k2, p1, p2, 0.0] }),
            ("radtan", _) => Err(self.coefficient_error(d, "radtan takes 4: k1, k2, p1, p2")),
            ("equidistant", d) => self.equidistant(d),
            (other, _) => Err(self.unknown_model(other, "it must be \"radtan\", \"equidistant\" or \"none\"")),
        }
    }

    /// Makes a Kannala-Brandt lens, which ROS and Kalibr call `equidistant`.
    fn equidistant(&self, d: &[f64]) -> Result<LensModel, LensFileError> {
        match d {
            [] => Ok(LensModel::KannalaBrandt { k: [0.0; 4] }),
            &[k1, k2, k3, k4] => Ok(LensModel::KannalaBrandt { k: [k1, k2, k3, k4] }),
            _ => Err(self.coefficient_error(d, "equidistant takes 4 (k1 to k4) or none")),
        }
    }

    /// An error about the coefficients.
    fn coefficient_error(&self, d: &[f64], expected: &str) -> LensFileError {
        LensFileError::value(self.coefficients, format_args!("{d:?}"), expected)
    }

    /// An error about the name of the model.
    fn unknown_model(&self, model: &str, expected: &str) -> LensFileError {
        LensFileError::value(self.model, format_args!("{model:?}"), expected)
    }
}
