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
            ("equidistant", d) => self.equidistant(d),
            // ROS has no such name: this program writes it for an ideal equisolid lens.
            ("equisolid", []) => Ok(LensModel::Equisolid),
            ("equisolid", _) => Err(self.coefficient_error(d, "equisolid takes no coefficients")),
            ("rational_polynomial", []) => Ok(LensModel::PlumbBob { d: [0.0; 5] }),
            // Where k4 to k6 are 0 the denominator is 1 and the model is plumb_bob. Thin prism and tilt terms follow.
            ("rational_polynomial", &[k1, k2, p1, p2, k3, ref rest @ ..]) if rest.iter().all(|c| *c == 0.0) => {
                Ok(LensModel::PlumbBob { d: [k1, k2, p1, p2, k3] })
            }
            ("rational_polynomial", _) => {
                let expected = "it is not supported unless k4, k5 and k6 are 0: calibrate as plumb_bob (wide) or \
                                equidistant (fisheye)";
                Err(LensFileError::value(self.model, "\"rational_polynomial\"", expected))
            }
            (other, _) => Err(self.unknown_model(other, "it must be \"plumb_bob\" or \"equidistant\"")),
        }
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
