//! `calib_results.txt` of OCamCalib (Scaramuzza, Martinelli and Siegwart 2006), converted to a Kannala-Brandt lens.
//!
//! The file's polynomial runs from the pixel to the ray: a pixel at distance rho from the centre sees along (x, y, f(rho)). Its
//! camera looks along -z, x runs down the rows of the image and y along its columns.

use core::f64::consts::PI;

use glam::{DMat2, DVec2, DVec3};

use super::{Content, LensFileError, LensFormat};
use realitysim_geometry::{Lens, LensModel, LensParameters};

/// Largest distance of a pixel from where the Kannala-Brandt lens draws its ray, pixels.
const MAX_RESIDUAL_PX: f64 = 0.3;
/// Largest number of coefficients of the polynomial. OCamCalib writes 5.
const MAX_COEFFICIENTS: usize = 32;
/// Number of radii at which the lens is fitted.
const FITTED_RADII: u32 = 400;
/// Number of rows and columns of pixels at which the fit is judged.
const JUDGED: u32 = 60;

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

/// Reads a file, and converts its lens.
///
/// The fit reaches to the farthest corner of the image. The polynomial means nothing outside the image circle, so where that does
/// not fit, it reaches to the farthest side, and the lens ends there.
pub(super) fn read(text: &str) -> Result<Content, LensFileError> {
    let file = Calibration::parse(text)?;
    let [corner, side] = file.reaches();
    let (parameters, residual_px) = file.fit(corner, false)?;
    let (parameters, residual_px) =
        if residual_px <= MAX_RESIDUAL_PX { (parameters, residual_px) } else { file.fit(side, true)? };
    if residual_px > MAX_RESIDUAL_PX {
        let found = format!("a polynomial that a Kannala-Brandt lens misses by up to {residual_px:.2} px");
        let expected = format!(
            "at most {MAX_RESIDUAL_PX} px would be right: calibrate with Kalibr (pinhole-equi, ds or eucm) or OpenCV's fisheye"
        );
        return Err(LensFileError::value(DIRECT, found, expected));
    }
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
        if direct.len() as f64 != *count || !(2..=MAX_COEFFICIENTS).contains(&direct.len()) {
            let found = format!("{count} and {} coefficients", direct.len());
            let expected = format!("the first number counts those behind it, 2 to {MAX_COEFFICIENTS}");
            return Err(LensFileError::value(DIRECT, found, expected));
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

    /// The sensor's point in pixels, right and down, to the offset of its pixel from the centre.
    ///
    /// The turn of the sensor about the axis is left out. A calibration cannot tell it from a turn of the camera, and mounts are
    /// measured by the rows of the image.
    fn pixel_from_sensor(&self) -> DMat2 {
        let [c, d, e] = self.affine;
        // Columns: where x (right) and y (down) go. The file's order is down, right.
        let whole = DMat2::from_cols(DVec2::new(1.0, d), DVec2::new(e, c));
        let turn = libm::atan2(whole.x_axis.y - whole.y_axis.x, whole.x_axis.x + whole.y_axis.y);
        let (sin, cos) = libm::sincos(turn);
        whole * DMat2::from_cols(DVec2::new(cos, -sin), DVec2::new(sin, cos))
    }

    /// Distance of the image's farthest corner and of its farthest side from the centre, pixels.
    fn reaches(&self) -> [f64; 2] {
        let [row, column] = self.centre;
        let [width, height] = self.size.map(|side| f64::from(side) - 1.0);
        let [x, y] = [column.max(width - column), row.max(height - row)];
        [libm::hypot(x, y), x.max(y)]
    }

    /// Angle off the axis at a distance from the centre, radians.
    fn angle(&self, rho: f64) -> f64 {
        libm::atan2(rho, -self.direct.iter().rev().fold(0.0, |sum, c| sum * rho + c))
    }

    /// Fits a Kannala-Brandt lens up to a distance from the centre, pixels; returns it with the worst residual, pixels.
    fn fit(&self, reach_px: f64, ends_there: bool) -> Result<(LensParameters, f64), LensFileError> {
        let failed = || LensFileError::value(DIRECT, format!("{:?}", self.direct), "no lens follows such a polynomial");
        let matrix = self.pixel_from_sensor();
        let radii = (1..=FITTED_RADII).map(|i| reach_px * f64::from(i) / f64::from(FITTED_RADII));
        let samples: Vec<[f64; 2]> = radii.map(|rho| [self.angle(rho), rho]).collect();
        let rises = samples.windows(2).all(|pair| pair[1][0] > pair[0][0]);
        let Some([reach_rad, _]) = samples.last().copied().filter(|_| rises) else {
            return Ok((self.parameters(matrix, [1.0; 5], None), f64::INFINITY));
        };
        let found = odd_polynomial(&samples, reach_rad).ok_or_else(failed)?;
        let fov_deg = ends_there.then(|| (2.0 * reach_rad).to_degrees().min(360.0));
        let parameters = self.parameters(matrix, found, fov_deg);
        let Ok(lens) = Lens::new(parameters.clone()) else { return Ok((parameters, f64::INFINITY)) };
        let back = matrix.inverse();
        let mut worst = 0.0f64;
        for i in 0..=JUDGED {
            for j in 0..=JUDGED {
                let [u, v] = [(i, self.size[0]), (j, self.size[1])]
                    .map(|(step, size)| (f64::from(size) - 1.0) * f64::from(step) / f64::from(JUDGED));
                let sensor = back * DVec2::new(u - self.centre[1], v - self.centre[0]);
                let rho = sensor.length();
                if rho == 0.0 || rho > 0.999 * reach_px {
                    continue;
                }
                let (sin, cos) = libm::sincos(self.angle(rho));
                let drawn = lens.project(DVec3::new(sensor.x / rho * sin, sensor.y / rho * sin, cos));
                worst = worst.max(drawn.map_or(f64::INFINITY, |drawn| drawn.distance(DVec2::new(u, v))));
            }
        }
        Ok((parameters, worst))
    }

    /// A lens whose radius in pixels is `polynomial[0] theta + polynomial[1] theta^3` and so on.
    fn parameters(&self, matrix: DMat2, polynomial: [f64; 5], fov_deg: Option<f64>) -> LensParameters {
        let [focal, k1, k2, k3, k4] = polynomial;
        let [width, height] = self.size;
        LensParameters {
            width,
            height,
            fx: focal * matrix.x_axis.x,
            fy: focal * matrix.y_axis.y,
            cx: self.centre[1],
            cy: self.centre[0],
            model: LensModel::KannalaBrandt { k: [k1, k2, k3, k4].map(|k| k / focal) },
            fov_deg,
        }
    }
}

/// The coefficients of theta, theta^3 to theta^9 of the polynomial nearest to the samples [theta, rho] by least squares.
///
/// `end` is the largest theta. Orthogonal columns (modified Gram-Schmidt) keep the digits that normal equations would lose.
fn odd_polynomial(samples: &[[f64; 2]], end: f64) -> Option<[f64; 5]> {
    const N: usize = 5;
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    // Powers of theta / end, all of one size.
    let mut columns: Vec<Vec<f64>> =
        (0..N).map(|i| samples.iter().map(|[theta, _]| libm::pow(theta / end, (2 * i + 1) as f64)).collect()).collect();
    let mut rest: Vec<f64> = samples.iter().map(|[_, rho]| *rho).collect();
    let (mut upper, mut right) = ([[0.0; N]; N], [0.0; N]);
    for i in 0..N {
        let norm = libm::sqrt(dot(&columns[i], &columns[i]));
        if norm.is_nan() || norm < 1e-12 {
            return None;
        }
        upper[i][i] = norm;
        let unit: Vec<f64> = columns[i].iter().map(|x| x / norm).collect();
        for j in i + 1..N {
            upper[i][j] = dot(&unit, &columns[j]);
            columns[j].iter_mut().zip(&unit).for_each(|(x, unit)| *x -= upper[i][j] * unit);
        }
        right[i] = dot(&unit, &rest);
        rest.iter_mut().zip(&unit).for_each(|(x, unit)| *x -= right[i] * unit);
    }
    let mut found = [0.0; N];
    for i in (0..N).rev() {
        let known: f64 = (i + 1..N).map(|j| upper[i][j] * found[j]).sum();
        found[i] = (right[i] - known) / upper[i][i];
    }
    for (i, value) in found.iter_mut().enumerate() {
        *value /= libm::pow(end, (2 * i + 1) as f64);
    }
    (found.iter().all(|value| value.is_finite()) && end <= PI).then_some(found)
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
        .map(|word| number(word).ok_or_else(|| LensFileError::value(key, format_args!("{word:?}"), "it must be a number")))
        .collect()
}

/// [`values`] of a fixed number.
fn fixed<const N: usize>(text: &str, title: &str, key: &str, what: &str) -> Result<[f64; N], LensFileError> {
    let found = values(text, title, key, what)?;
    <[f64; N]>::try_from(found.as_slice())
        .map_err(|_| LensFileError::value(key, format_args!("{found:?}"), format!("it must have {N} numbers: {what}")))
}
