//! From the distortion models' names and coefficients, as ROS and Kalibr write them, to a [`LensModel`].

use super::LensFileError;
use realitysim_geometry::LensModel;

/// What a file calls the two entries, for messages.
pub(super) struct Keys {
    pub model: &'static str,
    pub coefficients: &'static str,
}

impl Keys {
    /// `sensor_msgs/CameraInfo`'s names for the models. No coefficients means none of the model's distortion.
    pub fn ros(&self, model: &str, d: &[f64]) -> Result<LensModel, LensFileError> {
        match (model, d) {
            // Drivers of ideal cameras leave both empty.
            ("plumb_bob" | "", []) => Ok(LensModel::PlumbBob { d: [0.0; 5] }),
            ("plumb_bob", &[k1, k2, p1, p2]) => Ok(LensModel::PlumbBob { d: [k1, k2, p1, p2, 0.0] }),
            ("plumb_bob", &[k1, k2, p1, p2, k3]) => Ok(LensModel::PlumbBob { d: [k1, k2, p1, p2, k3] }),
            ("plumb_bob", _) => Err(self.count(d, "plumb_bob takes 4 (k1, k2, p1, p2), 5 (and k3) or none")),
            ("equidistant", d) => self.equidistant(d),
            // No name of ROS: what this program writes for an ideal equisolid lens.
            ("equisolid", []) => Ok(LensModel::Equisolid),
            ("equisolid", _) => Err(self.count(d, "equisolid takes no coefficients")),
            ("rational_polynomial", []) => Ok(LensModel::PlumbBob { d: [0.0; 5] }),
            // With a denominator of 1 it is plumb_bob; what follows are thin prism and tilt terms.
            ("rational_polynomial", &[k1, k2, p1, p2, k3, ref rest @ ..]) if rest.iter().all(|c| *c == 0.0) => {
                Ok(LensModel::PlumbBob { d: [k1, k2, p1, p2, k3] })
            }
            ("rational_polynomial", _) => {
                let expected = "it is not supported unless k4, k5 and k6 are 0: calibrate as plumb_bob (wide) or \
                                equidistant (fisheye)";
                Err(LensFileError::value(self.model, "\"rational_polynomial\"", expected))
            }
            (other, _) => Err(self.unknown(other, "it must be \"plumb_bob\" or \"equidistant\"")),
        }
    }

    /// Kalibr's names for the models.
    pub fn kalibr(&self, model: &str, d: &[f64]) -> Result<LensModel, LensFileError> {
        match (model, d) {
            ("none", d) if d.iter().all(|c| *c == 0.0) => Ok(LensModel::PlumbBob { d: [0.0; 5] }),
            ("none", d) => Err(self.count(d, "the model none takes no coefficients")),
            ("radtan", &[k1, k2, p1, p2]) => Ok(LensModel::PlumbBob { d: [k1, k2, p1, p2, 0.0] }),
            ("radtan", _) => Err(self.count(d, "radtan takes 4: k1, k2, p1, p2")),
            ("equidistant", d) => self.equidistant(d),
            (other, _) => Err(self.unknown(other, "it must be \"radtan\", \"equidistant\" or \"none\"")),
        }
    }

    fn equidistant(&self, d: &[f64]) -> Result<LensModel, LensFileError> {
        match d {
            [] => Ok(LensModel::KannalaBrandt { k: [0.0; 4] }),
            &[k1, k2, k3, k4] => Ok(LensModel::KannalaBrandt { k: [k1, k2, k3, k4] }),
            _ => Err(self.count(d, "equidistant takes 4 (k1 to k4) or none")),
        }
    }

    fn count(&self, d: &[f64], expected: &str) -> LensFileError {
        LensFileError::value(self.coefficients, format_args!("{d:?}"), expected)
    }

    fn unknown(&self, model: &str, expected: &str) -> LensFileError {
        LensFileError::value(self.model, format_args!("{model:?}"), expected)
    }
}
