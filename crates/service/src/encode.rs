//! Encodes pixels as the client's `Accept` asks for: JPEG, PNG or raw.

use image::ImageEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use jpeg_encoder::ColorType;

use super::HttpProblem;
use super::parameters::MaskWanted;
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
}

impl Form {
    pub(super) fn media_type(self) -> &'static str {
        match self {
            Self::Jpeg => "image/jpeg",
            Self::Png => "image/png",
            Self::Raw => "application/octet-stream",
        }
    }

    /// Returns the form of a stored image.
    pub(super) fn of(bytes: &[u8]) -> Self {
        if bytes.starts_with(b"\x89PNG") { Self::Png } else { Self::Jpeg }
    }
}

/// Returns the forms that a client accepts and that are possible with this mask, best first. Without `Accept` all are accepted.
pub(super) fn accepted(accept: Option<&str>, mask: MaskWanted) -> Result<Vec<Form>, HttpProblem> {
    // The first is sent if the client has no preference.
    let possible: &[Form] = match mask {
        MaskWanted::None => &[Form::Jpeg, Form::Png, Form::Raw],
        MaskWanted::Alpha | MaskWanted::Only => &[Form::Png, Form::Raw],
    };
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
    let failed = |what: String| HttpProblem::new(StatusCode::INTERNAL_SERVER_ERROR, what);
    let mut bytes = Vec::new();
    match form {
        Form::Raw => bytes = pixels,
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
    use super::*;

    #[test]
    fn the_client_chooses_the_form() {
        let first = |accept, mask| accepted(accept, mask).map(|forms| forms[0]);
        assert_eq!(first(None, MaskWanted::None), Ok(Form::Jpeg));
        assert_eq!(first(Some("image/png, image/jpeg;q=0.5"), MaskWanted::None), Ok(Form::Png));
        assert_eq!(first(Some("image/jpeg;q=0.1, application/octet-stream"), MaskWanted::None), Ok(Form::Raw));
        assert_eq!(first(Some("text/html, image/*"), MaskWanted::None), Ok(Form::Jpeg));
        assert_eq!(first(None, MaskWanted::Only), Ok(Form::Png));
        for (accept, mask) in
            [("text/html", MaskWanted::None), ("image/jpeg", MaskWanted::Alpha), ("image/png;q=0", MaskWanted::None)]
        {
            let refusal = accepted(Some(accept), mask).expect_err("refused");
            assert!(refusal.status == 406 && refusal.what.contains("image/png"), "{refusal:?}");
        }
    }
}
