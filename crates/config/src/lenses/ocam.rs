//! `calib_results.txt` of OCamCalib (Scaramuzza, Martinelli and Siegwart 2006), as [`LensModel::Scaramuzza`].
//!
//! The file's polynomial runs from the pixel to the ray: a pixel at distance rho from the centre sees along (x, y, f(rho)). Its
//! camera looks along -z, x runs down the image and y to the right. With the focal length -f(0), the model's polynomial is
//! f(rho) / f(0) in terms of r = rho / -f(0). Kannala-Brandt lenses follow such polynomials badly: of eight public calibrations one
//! was met within 0.3 px over the whole image.

use super::{Content, LensFileError, LensFormat};
use realitysim_geometry::{LensModel, LensParameters};

/// Largest degree of the polynomial. OCamCalib proposes 4.
const MAX_DEGREE: usize = 6;

/// The content of a file.
struct Calibration {
    /// Coefficients of f(rho), pixels.
    direct: Vec<f64>,
    /// Row and column of the centre, pixels from the centre of the first pixel.
    centre: [f64; 2],
    /// Factors c, d, e: a point (x, y) of the sensor lies (c x + d y, e x + y) from the centre, down and to the right.
    affine: [f64; 3],
    /// Width and height, pixels.
    size: [u32; 2],
}

/// Whether a text begins as a `calib_results.txt` does.
pub(super) fn is_ocam(text: &str) -> bool {
    let line = text.lines().map(str::trim).find(|line| !line.is_empty()).unwrap_or("");
    line.starts_with('#') && line.to_ascii_lowercase().contains("direct mapping function")
}

/// Reads a file.
///
/// The turn of the sensor about the axis is left out. A calibration cannot tell it from a turn of the camera, and mounts are
/// measured by the rows of the image. What is left of c, d and e is a scale of each axis and a skew.
pub(super) fn read(text: &str) -> Result<Content, LensFileError> {
    let Calibration { direct, centre: [cy, cx], affine: [c, d, e], size: [width, height] } = Calibration::parse(text)?;
    let focal = -direct[0];
    let mut coefficients = [0.0; MAX_DEGREE - 1];
    for (power, (to, from)) in coefficients.iter_mut().zip(direct.iter().skip(2)).enumerate() {
        *to = -from * libm::pow(focal, (power + 1) as f64);
    }
    // Columns and rows of the sensor's right and down: [[1, e], [d, c]] = [[x, s], [0, y]] * rotation.
    let (sin, cos) = libm::sincos(libm::atan2(d, c));
    let [x, s, y] = [cos - e * sin, sin + e * cos, d * sin + c * cos];
    let parameters = LensParameters {
        width,
        height,
        fx: focal * x,
        fy: focal * y,
        cx,
        cy,
        model: LensModel::Scaramuzza { c: coefficients, skew: s / x },
        fov_deg: None,
    };
    Ok(Content { title: "OCamCalib camera".into(), format: LensFormat::OCamCalib, parameters, visual_mesh_pose: None })
}

/// What errors call the polynomial.
const DIRECT: &str = "the DIRECT mapping function";

impl Calibration {
    fn parse(text: &str) -> Result<Self, LensFileError> {
        let direct = values(text, "direct mapping", DIRECT, "a number of coefficients and the coefficients")?;
        let [count, direct @ ..] = direct.as_slice() else {
            return Err(LensFileError::value(DIRECT, "empty", "it has a number of coefficients and the coefficients"));
        };
        if direct.len() as f64 != *count || !(2..=MAX_DEGREE + 1).contains(&direct.len()) {
            let found = format!("{count} and {} coefficients", direct.len());
            let expected = format!("the first number counts those behind it, 2 to {}", MAX_DEGREE + 1);
            return Err(LensFileError::value(DIRECT, found, expected));
        }
        if direct[1] != 0.0 {
            let expected = "it must be 0, as OCamCalib makes it";
            return Err(LensFileError::value(format!("the second coefficient of {DIRECT}"), direct[1], expected));
        }
        let centre = fixed(text, "center", "center", "row and column")?;
        let affine = fixed(text, "affine", "affine parameters", "c, d and e")?;
        let size: [f64; 2] = fixed(text, "image size", "image size", "height and width")?;
        let [height, width] = size.map(|side| side as u32);
        if [height, width].map(f64::from) != size {
            return Err(LensFileError::value("image size", format!("{size:?}"), "it must have two whole numbers"));
        }
        if direct[0] >= 0.0 {
            let expected = "it must be below 0: the camera looks along -z";
            return Err(LensFileError::value(format!("the first coefficient of {DIRECT}"), direct[0], expected));
        }
        let [c, d, e] = affine;
        if !((0.5..=2.0).contains(&c) && d.abs() <= 0.2 && e.abs() <= 0.2) {
            let expected = "c must be near 1, d and e near 0";
            return Err(LensFileError::value("affine parameters", format!("{affine:?}"), expected));
        }
        Ok(Self { direct: direct.to_vec(), centre, affine, size: [width, height] })
    }
}

/// The numbers of the first line with content behind the comment that contains `title`, in lower case.
fn values(text: &str, title: &str, key: &str, what: &str) -> Result<Vec<f64>, LensFileError> {
    let mut lines = text.lines().map(str::trim);
    let is_title = |line: &str| line.starts_with('#') && line.to_ascii_lowercase().contains(title);
    let line = lines.find(|line| is_title(line)).and_then(|_| lines.find(|line| !line.is_empty()));
    let Some(line) = line.filter(|line| !line.starts_with('#')) else {
        return Err(LensFileError::Missing { key: key.into(), expected: format!("behind its comment it has {what}") });
    };
    let number = |word: &str| word.parse().ok().filter(|value: &f64| value.is_finite());
    line.split_whitespace()
        .map(|word| {
            number(word).ok_or_else(|| LensFileError::value(key, format_args!("{word:?}"), "it must be a number"))
        })
        .collect()
}

/// [`values`] of a fixed number.
fn fixed<const N: usize>(text: &str, title: &str, key: &str, what: &str) -> Result<[f64; N], LensFileError> {
    let found = values(text, title, key, what)?;
    <[f64; N]>::try_from(found.as_slice())
        .map_err(|_| LensFileError::value(key, format_args!("{found:?}"), format!("it must have {N} numbers: {what}")))
}
