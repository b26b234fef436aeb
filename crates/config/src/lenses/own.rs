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

fn model(file: &File) -> Result<LensModel, LensFileError> {
    match file.model.as_str() {
        "kannala_brandt" => {
            check_absent("d", &file.d, "kannala_brandt takes k")?;
            Ok(LensModel::KannalaBrandt { k: take_coefficients("k", &file.k, "four numbers, k1 to k4")? })
        }
        "plumb_bob" => {
            check_absent("k", &file.k, "plumb_bob takes d")?;
            Ok(LensModel::PlumbBob { d: take_coefficients("d", &file.d, "five numbers, k1, k2, p1, p2, k3")? })
        }
        "equisolid" => {
            check_absent("k", &file.k, "equisolid takes no coefficients")?;
            check_absent("d", &file.d, "equisolid takes no coefficients")?;
            Ok(LensModel::Equisolid)
        }
        other => {
            let expected = "it must be \"kannala_brandt\", \"equisolid\" or \"plumb_bob\"";
            Err(LensFileError::value("model", format_args!("{other:?}"), expected))
        }
    }
}

/// Refuses coefficients that the model would ignore: they are a mistake in the file.
fn check_absent(key: &str, value: &Option<Vec<f64>>, expected: &str) -> Result<(), LensFileError> {
    match value {
        None => Ok(()),
        Some(found) => Err(LensFileError::value(key, format_args!("{found:?}"), format!("{expected}: remove it"))),
    }
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
