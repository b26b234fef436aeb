//! Files of mrcal, `.cameramodel`: a Python dictionary in text.

use serde::Deserialize;

use super::{Content, LensFileError, LensFormat, yaml};
use realitysim_geometry::{LensModel, LensParameters};

/// The keys that are read of the file.
#[derive(Deserialize)]
struct File {
    /// Old files write it with an underscore.
    #[serde(alias = "lens_model")]
    lensmodel: String,
    /// fx, fy, cx, cy, then the distortion.
    intrinsics: Vec<f64>,
    /// Width and height of the image, pixels.
    imagersize: [u32; 2],
}

/// Whether a text is a dictionary that names a lens model.
pub(super) fn is_mrcal(text: &str) -> bool {
    let line = text.lines().map(str::trim).find(|line| !line.is_empty() && !line.starts_with('#')).unwrap_or("");
    line.starts_with('{') && ["lensmodel", "lens_model"].iter().any(|key| text.contains(key))
}

/// Reads a file.
pub(super) fn read(text: &str) -> Result<Content, LensFileError> {
    let file: File = yaml(&without_bytes(text))?;
    let count = |expected: &str| LensFileError::value("intrinsics", format_args!("{:?}", file.intrinsics), expected);
    let [fx, fy, cx, cy, ref d @ ..] = file.intrinsics[..] else {
        return Err(count("it begins with fx, fy, cx, cy"));
    };
    let expected = match file.lensmodel.as_str() {
        "LENSMODEL_PINHOLE" | "LENSMODEL_STEREOGRAPHIC" => 0,
        "LENSMODEL_OPENCV4" => 4,
        "LENSMODEL_OPENCV5" => 5,
        "LENSMODEL_OPENCV8" => 8,
        "LENSMODEL_OPENCV12" => 12,
        other => {
            let expected = "supported are LENSMODEL_PINHOLE, LENSMODEL_STEREOGRAPHIC and LENSMODEL_OPENCV4, 5, 8 and 12; \
                            `mrcal-convert-lensmodel` fits one of them to a splined or CAHVOR model";
            return Err(LensFileError::value("lensmodel", format_args!("{other:?}"), expected));
        }
    };
    if d.len() != expected {
        return Err(count(&format!("{} has {} numbers", file.lensmodel, 4 + expected)));
    }
    let model = match file.lensmodel.as_str() {
        // 2 tan(theta / 2) = sin theta / (1/2 + 1/2 cos theta).
        "LENSMODEL_STEREOGRAPHIC" => Some(LensModel::Eucm { alpha: 0.5, beta: 1.0 }),
        _ => LensModel::of_opencv(d),
    };
    let model = model.ok_or_else(|| count("no supported lens has more coefficients"))?;
    let [width, height] = file.imagersize;
    Ok(Content {
        title: "mrcal camera".into(),
        format: LensFormat::Mrcal,
        parameters: LensParameters { width, height, fx, fy, cx, cy, model, fov_deg: None },
        visual_mesh_pose: None,
    })
}

/// The text with empty strings in place of Python's byte strings, which hold mrcal's packed inputs: the rest is YAML.
fn without_bytes(text: &str) -> String {
    let mut kept = String::with_capacity(text.len());
    let mut rest = text.chars().peekable();
    let mut within: Option<char> = None;
    while let Some(c) = rest.next() {
        match (c, within, rest.peek().copied()) {
            ('b', None, Some(quote @ ('\'' | '"'))) => {
                rest.next();
                skip_string(&mut rest, quote);
                kept.push_str("''");
                continue;
            }
            ('#', None, _) => {
                // The comment may hold quotes.
                for c in rest.by_ref() {
                    if c == '\n' {
                        break;
                    }
                }
                kept.push('\n');
                continue;
            }
            ('\'' | '"', None, _) => within = Some(c),
            (_, Some(quote), _) if c == quote => within = None,
            _ => {}
        }
        kept.push(c);
    }
    kept
}

/// Passes the rest of a string up to its closing quote.
fn skip_string(rest: &mut impl Iterator<Item = char>, quote: char) {
    while let Some(c) = rest.next() {
        if c == '\\' {
            rest.next();
        } else if c == quote {
            return;
        }
    }
}
