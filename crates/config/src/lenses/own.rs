//! This crate's own lens format, TOML, as in `config/cameras`.

use serde::Deserialize;

use super::{Content, LensFileError, LensFormat};
use crate::wording::in_words;
use realitysim_geometry::{LensModel, LensParameters};

/// The keys of the file. Pixel coordinates are those of [`LensParameters`]: (0, 0) is the centre of the top left pixel.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    title: String,
    width: u32,
    height: u32,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    model: String,
    k: Option<Vec<f64>>,
    d: Option<Vec<f64>>,
    xi: Option<f64>,
    alpha: Option<f64>,
    beta: Option<f64>,
    c: Option<Vec<f64>>,
    skew: Option<f64>,
    fov_deg: Option<f64>,
}

/// Reads a lens file.
pub(super) fn read(text: &str) -> Result<Content, LensFileError> {
    let file: File = toml::from_str(text).map_err(|error| LensFileError::Syntax(in_words(&error)))?;
    let parameters = LensParameters {
        width: file.width,
        height: file.height,
        fx: file.fx,
        fy: file.fy,
        cx: file.cx,
        cy: file.cy,
        model: model(&file)?,
        fov_deg: file.fov_deg,
    };
    Ok(Content { title: file.title, format: LensFormat::Own, parameters, visual_mesh_pose: None })
}

/// The text of a lens file that `load_lens` reads back to the same lens.
pub fn lens_text(lens: &LensParameters, title: &str) -> String {
    let LensParameters { width, height, fx, fy, cx, cy, model, fov_deg } = lens;
    let list = |values: &[f64]| values.iter().map(|value| format!("{value:?}")).collect::<Vec<_>>().join(", ");
    let model = match model {
        LensModel::KannalaBrandt { k } => format!("model = \"kannala_brandt\"\nk = [{}]\n", list(k)),
        LensModel::Equisolid => "model = \"equisolid\"\n".to_owned(),
        LensModel::PlumbBob { d } => format!("model = \"plumb_bob\"\nd = [{}]\n", list(d)),
        LensModel::RationalPolynomial { d } => format!("model = \"rational_polynomial\"\nd = [{}]\n", list(d)),
        LensModel::ThinPrism { d } => format!("model = \"thin_prism\"\nd = [{}]\n", list(d)),
        LensModel::DoubleSphere { xi, alpha } => format!("model = \"double_sphere\"\nxi = {xi:?}\nalpha = {alpha:?}\n"),
        LensModel::Eucm { alpha, beta } => format!("model = \"eucm\"\nalpha = {alpha:?}\nbeta = {beta:?}\n"),
        LensModel::Scaramuzza { c, skew } => format!("model = \"scaramuzza\"\nc = [{}]\nskew = {skew:?}\n", list(c)),
    };
    let fov = fov_deg.map_or(String::new(), |fov| format!("fov_deg = {fov:?}\n"));
    format!(
        "title = {title:?}\nwidth = {width}\nheight = {height}\nfx = {fx:?}\nfy = {fy:?}\ncx = {cx:?}\ncy = {cy:?}\n{model}{fov}"
    )
}

/// The coefficients that a model takes; the others are a mistake in the file.
fn model(file: &File) -> Result<LensModel, LensFileError> {
    let name = file.model.as_str();
    let takes: &[&str] = match name {
        "kannala_brandt" => &["k"],
        "plumb_bob" | "rational_polynomial" | "thin_prism" => &["d"],
        "equisolid" => &[],
        "double_sphere" => &["xi", "alpha"],
        "eucm" => &["alpha", "beta"],
        "scaramuzza" => &["c", "skew"],
        other => {
            let expected = "it must be \"kannala_brandt\", \"equisolid\", \"plumb_bob\", \"rational_polynomial\", \
                            \"thin_prism\", \"double_sphere\", \"eucm\" or \"scaramuzza\"";
            return Err(LensFileError::value("model", format_args!("{other:?}"), expected));
        }
    };
    file.check_absent(name, takes)?;
    match name {
        "kannala_brandt" => {
            Ok(LensModel::KannalaBrandt { k: take_coefficients("k", &file.k, "four numbers, k1 to k4")? })
        }
        "plumb_bob" => {
            Ok(LensModel::PlumbBob { d: take_coefficients("d", &file.d, "five numbers, k1, k2, p1, p2, k3")? })
        }
        "rational_polynomial" => {
            let d: [f64; 8] = take_coefficients("d", &file.d, "eight numbers, k1, k2, p1, p2, k3 to k6")?;
            Ok(LensModel::of_opencv(&d).unwrap_or(LensModel::RationalPolynomial { d }))
        }
        "thin_prism" => {
            let d: [f64; 12] = take_coefficients("d", &file.d, "twelve numbers, k1, k2, p1, p2, k3 to k6, s1 to s4")?;
            Ok(LensModel::of_opencv(&d).unwrap_or(LensModel::ThinPrism { d }))
        }
        "double_sphere" => Ok(LensModel::DoubleSphere { xi: take("xi", file.xi)?, alpha: take("alpha", file.alpha)? }),
        "eucm" => Ok(LensModel::Eucm { alpha: take("alpha", file.alpha)?, beta: take("beta", file.beta)? }),
        "scaramuzza" => {
            let c = take_coefficients("c", &file.c, "five numbers, c2 to c6")?;
            Ok(LensModel::Scaramuzza { c, skew: take("skew", file.skew)? })
        }
        _ => Ok(LensModel::Equisolid),
    }
}

impl File {
    /// Refuses coefficients that the model would ignore.
    fn check_absent(&self, model: &str, takes: &[&str]) -> Result<(), LensFileError> {
        let list = |value: &Option<Vec<f64>>| value.as_ref().map(|found| format!("{found:?}"));
        let number = |value: Option<f64>| value.map(|found| format!("{found:?}"));
        let given = [
            ("k", list(&self.k)),
            ("d", list(&self.d)),
            ("xi", number(self.xi)),
            ("alpha", number(self.alpha)),
            ("beta", number(self.beta)),
            ("c", list(&self.c)),
            ("skew", number(self.skew)),
        ];
        let wrong = given
            .into_iter()
            .find_map(|(key, found)| found.filter(|_| !takes.contains(&key)).map(|found| (key, found)));
        let Some((key, found)) = wrong else { return Ok(()) };
        let taken = if takes.is_empty() { "no coefficients".to_owned() } else { takes.join(" and ") };
        Err(LensFileError::value(key, found, format!("{model} takes {taken}: remove it")))
    }
}

/// Takes a number that must be there.
fn take(key: &str, value: Option<f64>) -> Result<f64, LensFileError> {
    value.ok_or_else(|| LensFileError::Missing { key: key.into(), expected: "the model needs this number".into() })
}

/// Takes exactly `N` coefficients.
fn take_coefficients<const N: usize>(
    key: &str,
    value: &Option<Vec<f64>>,
    expected: &str,
) -> Result<[f64; N], LensFileError> {
    let Some(found) = value else {
        return Err(LensFileError::Missing { key: key.into(), expected: format!("it must have {expected}") });
    };
    <[f64; N]>::try_from(found.as_slice())
        .map_err(|_| LensFileError::value(key, format_args!("{found:?}"), format!("it must have {expected}")))
}
