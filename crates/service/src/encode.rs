//! Encodes pixels as the client's `Accept` asks for: JPEG, PNG or raw, or arrays for programs.

use image::ImageEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use jpeg_encoder::ColorType;

use super::HttpProblem;
use super::arrays::{Values, npy, npz};
use super::parameters::{Layer, MaskWanted, ViewRequest};
use hyper::StatusCode;
use realitysim_log_input::encode::jpeg;
use realitysim_views::Raster;

/// The form of an encoded image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Form {
    Jpeg,
    Png,
    /// Bytes row by row, channels interleaved.
    Raw,
    /// Arrays of numpy, `.npz`: the form of views that are asked for by layers.
    Arrays,
}

impl Form {
    pub(super) fn media_type(self) -> &'static str {
        match self {
            Self::Jpeg => "image/jpeg",
            Self::Png => "image/png",
            Self::Raw => "application/octet-stream",
            // An .npz is a ZIP archive and has no media type of its own.
            Self::Arrays => "application/zip",
        }
    }

    /// Returns the form of a stored image.
    pub(super) fn of(bytes: &[u8]) -> Self {
        if bytes.starts_with(b"\x89PNG") { Self::Png } else { Self::Jpeg }
    }
}

/// Returns the forms that a client accepts and in which all of these views can be sent, best first. Without `Accept` all are accepted.
///
/// Views that are asked for by layers come as [`Form::Arrays`], which must be accepted if there is one of them.
pub(super) fn accepted<'a>(
    accept: Option<&str>,
    views: impl Iterator<Item = &'a ViewRequest>,
) -> Result<Vec<Form>, HttpProblem> {
    let (arrays, pictures): (Vec<_>, Vec<_>) = views.partition(|asked| !asked.layers.is_empty());
    // The first is sent if the client has no preference.
    let possible: &[Form] = match pictures.iter().any(|asked| asked.mask != MaskWanted::None) {
        false => &[Form::Jpeg, Form::Png, Form::Raw],
        true => &[Form::Png, Form::Raw],
    };
    let none = Ok(Vec::new());
    let mut forms = if pictures.is_empty() { none.clone() } else { accepted_of(accept, possible) }?;
    forms.extend(if arrays.is_empty() { none } else { accepted_of(accept, &[Form::Arrays]) }?);
    Ok(forms)
}

/// Returns those of the possible forms that a client accepts, best first.
fn accepted_of(accept: Option<&str>, possible: &[Form]) -> Result<Vec<Form>, HttpProblem> {
    let mut weighted: Vec<(u16, Form)> = Vec::new();
    for range in accept.unwrap_or("*/*").split(',') {
        let mut parts = range.split(';').map(str::trim);
        let name = parts.next().unwrap_or_default().to_ascii_lowercase();
        let quality = parts.find_map(|part| part.strip_prefix("q=")?.parse::<f32>().ok()).unwrap_or(1.0);
        let fits = |form: &&Form| {
            let (kind, _) = form.media_type().split_once('/').unwrap_or_default();
            name == "*/*" || name == form.media_type() || name.strip_suffix("/*") == Some(kind)
        };
        let thousandths = (quality.clamp(0.0, 1.0) * 1000.0) as u16;
        weighted.extend(possible.iter().filter(fits).map(|form| (thousandths, *form)));
    }
    weighted.retain(|(quality, _)| *quality > 0);
    weighted.sort_by_key(|(quality, _)| core::cmp::Reverse(*quality));
    let mut forms: Vec<Form> = weighted.into_iter().map(|(_, form)| form).collect();
    let mut seen = Vec::new();
    forms.retain(|form| {
        !seen.contains(form) && {
            seen.push(*form);
            true
        }
    });
    if forms.is_empty() {
        let names: Vec<&str> = possible.iter().map(|form| form.media_type()).collect();
        return Err(HttpProblem::new(StatusCode::NOT_ACCEPTABLE, format!("Accept: there is {}", names.join(", "))));
    }
    Ok(forms)
}

/// Encodes the layers of a view as `.npz`. `depth_m` computes the depth, metres along each pixel's ray, `labels` the class of each pixel.
pub(super) fn encode_layers(
    image: &Raster,
    layers: &[Layer],
    depth_m: impl Fn() -> Vec<f32>,
    labels: impl Fn() -> Vec<u8>,
) -> Result<Vec<u8>, HttpProblem> {
    let size = [image.height, image.width];
    let array = |layer: &Layer| match layer {
        Layer::Image => ("image", npy(&[image.height, image.width, 3], Values::U8(&image.to_rgb()))),
        Layer::Depth => ("depth", npy(&size, Values::F32(&depth_m()))),
        Layer::Mask => ("mask", npy(&size, Values::U8(&image.mask()))),
        Layer::Labels => ("labels", npy(&size, Values::U8(&labels()))),
    };
    npz(&layers.iter().map(array).collect::<Vec<_>>()).map_err(|error| failed(error.to_string()))
}

fn failed(what: String) -> HttpProblem {
    HttpProblem::new(StatusCode::INTERNAL_SERVER_ERROR, what)
}

/// Encodes a picture. Returns its bytes and number of channels. `quality` is that of a JPEG.
pub(super) fn encode(
    image: &Raster,
    form: Form,
    mask: MaskWanted,
    quality: u8,
) -> Result<(Vec<u8>, usize), HttpProblem> {
    let (width, height) = (image.width, image.height);
    let (pixels, channels) = match mask {
        MaskWanted::None => (image.to_rgb(), 3),
        MaskWanted::Alpha => (image.pixels.as_flattened().to_vec(), 4),
        MaskWanted::Only => (image.mask(), 1),
    };
    let mut bytes = Vec::new();
    match form {
        Form::Raw | Form::Arrays => bytes = pixels,
        Form::Jpeg => {
            bytes = jpeg(&pixels, width, height, ColorType::Rgb, quality).map_err(|error| failed(error.to_string()))?;
        }
        Form::Png => {
            let kind = match channels {
                1 => image::ExtendedColorType::L8,
                3 => image::ExtendedColorType::Rgb8,
                _ => image::ExtendedColorType::Rgba8,
            };
            PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Adaptive)
                .write_image(&pixels, width as u32, height as u32, kind)
                .map_err(|error| failed(error.to_string()))?;
        }
    }
    Ok((bytes, channels))
}

#[cfg(test)]
mod tests {
    use super::super::parameters::Parameters;
    use super::*;

    fn asked(more: &str) -> ViewRequest {
        let query = format!("x=0&y=0&z=0.5&yaw_deg=0{more}");
        Parameters::from_query(&query).and_then(|parameters| parameters.view_request()).expect("right")
    }

    #[test]
    fn the_client_chooses_the_form() {
        let first = |accept, more| accepted(accept, [asked(more)].iter()).map(|forms| forms[0]);
        assert_eq!(first(None, ""), Ok(Form::Jpeg));
        assert_eq!(first(Some("image/png, image/jpeg;q=0.5"), ""), Ok(Form::Png));
        assert_eq!(first(Some("image/jpeg;q=0.1, application/octet-stream"), ""), Ok(Form::Raw));
        assert_eq!(first(Some("text/html, image/*"), ""), Ok(Form::Jpeg));
        assert_eq!(first(None, "&mask=only"), Ok(Form::Png));
        assert_eq!(first(Some("application/*"), "&mask=only&layers=depth"), Ok(Form::Arrays));
        for (accept, more) in [("text/html", ""), ("image/jpeg", "&mask=alpha"), ("image/png;q=0", "")] {
            let refusal = first(Some(accept), more).expect_err("refused");
            assert!(refusal.status == 406 && refusal.what.contains("image/png"), "{refusal:?}");
        }
        let refusal = first(Some("image/png"), "&layers=depth").expect_err("refused");
        assert!(refusal.status == 406 && refusal.what.contains("application/zip"), "{refusal:?}");
    }

    #[test]
    fn a_batch_of_pictures_and_arrays_needs_both_forms() {
        let both = [asked(""), asked("&layers=image,depth")];
        assert_eq!(accepted(Some("image/png, application/zip"), both.iter()), Ok(vec![Form::Png, Form::Arrays]));
        assert_eq!(accepted(Some("image/png"), both.iter()).expect_err("refused").status, 406);
        assert_eq!(accepted(Some("application/zip"), both.iter()).expect_err("refused").status, 406);
    }
}
