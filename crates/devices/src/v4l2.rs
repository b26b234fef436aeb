//! Asks a Video4Linux camera for its formats, sizes and rates.

use std::path::Path;

use serde::Serialize;
use thiserror::Error;
use v4l::Device;
use v4l::frameinterval::FrameIntervalEnum;
use v4l::video::Capture;

/// What a camera says about itself.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CameraOffer {
    /// Name of the camera.
    pub card: String,
    /// Name of its kernel driver.
    pub driver: String,
    /// Where it is connected, for example a USB port.
    pub bus: String,
    /// The formats that it offers.
    pub formats: Vec<FormatOffer>,
}

/// One pixel format of a camera.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FormatOffer {
    /// Four-character code of the format: `MJPG`, `YUYV`, ...
    pub fourcc: String,
    /// Name of the format, as the driver gives it.
    pub description: String,
    /// The image sizes in this format, 64 at most.
    pub sizes: Vec<SizeOffer>,
}

/// One image size of a camera.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SizeOffer {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// The frame rates at this size, Hz, 64 at most; of a range the two ends.
    pub rates_hz: Vec<f64>,
}

/// Why a camera cannot be asked.
#[derive(Debug, Error)]
pub enum CameraError {
    /// The device cannot be opened.
    #[error("{path}: {source}{}", if source.kind() == std::io::ErrorKind::PermissionDenied {
        " (your user must be in the group video: sudo usermod -aG video $USER)"
    } else {
        ""
    })]
    Open {
        /// The device.
        path: String,
        /// What the operating system says.
        source: std::io::Error,
    },
    /// The device does not answer as a camera does.
    #[error("{path}: not a camera that this program can ask: {source}")]
    Query {
        /// The device.
        path: String,
        /// What the operating system says.
        source: std::io::Error,
    },
}

impl CameraOffer {
    /// Returns the formats in one line: `YUYV 640x480 (30, 15), 320x240 (30); MJPG ...`, rates in Hz.
    pub fn summary(&self) -> String {
        let size = |size: &SizeOffer| {
            let rates: Vec<String> = size.rates_hz.iter().take(MAX_PER_LINE).map(|hz| format!("{hz:.0}")).collect();
            format!("{}x{} ({})", size.width, size.height, rates.join(", "))
        };
        let format = |format: &FormatOffer| {
            let more = if format.sizes.len() > MAX_PER_LINE { ", ..." } else { "" };
            let sizes: Vec<String> = format.sizes.iter().take(MAX_PER_LINE).map(size).collect();
            format!("{} {}{more}", format.fourcc, sizes.join(", "))
        };
        if self.formats.is_empty() {
            return "nothing".to_owned();
        }
        self.formats.iter().map(format).collect::<Vec<_>>().join("; ")
    }
}

/// Largest number of sizes of a format, and of rates of a size, in that line.
const MAX_PER_LINE: usize = 12;

/// Largest number of sizes or rates that are listed: some drivers offer every multiple of 8.
const MAX_LISTED: usize = 64;

/// Asks the camera at this path what it offers.
pub fn offer(path: &Path) -> Result<CameraOffer, CameraError> {
    let shown = || path.display().to_string();
    let device = Device::with_path(path).map_err(|source| CameraError::Open { path: shown(), source })?;
    let query = |source| CameraError::Query { path: shown(), source };
    let capabilities = device.query_caps().map_err(query)?;
    let formats = Capture::enum_formats(&device).map_err(query)?;
    let formats = formats
        .into_iter()
        .map(|format| {
            let sizes = device.enum_framesizes(format.fourcc).unwrap_or_default();
            let sizes = sizes.into_iter().flat_map(|size| size.size.to_discrete()).take(MAX_LISTED);
            FormatOffer {
                fourcc: format.fourcc.to_string(),
                description: format.description,
                sizes: sizes
                    .map(|size| {
                        let (width, height) = (size.width, size.height);
                        SizeOffer { width, height, rates_hz: rates(&device, format.fourcc, width, height) }
                    })
                    .collect(),
            }
        })
        .collect();
    Ok(CameraOffer { card: capabilities.card, driver: capabilities.driver, bus: capabilities.bus, formats })
}

/// Lists the frame rates at one size, Hz; of a range the two ends.
fn rates(device: &Device, fourcc: v4l::FourCC, width: u32, height: u32) -> Vec<f64> {
    let intervals = device.enum_frameintervals(fourcc, width, height).unwrap_or_default();
    let rate = |f: v4l::Fraction| (f.numerator > 0).then(|| f64::from(f.denominator) / f64::from(f.numerator));
    intervals
        .into_iter()
        .flat_map(|interval| match interval.interval {
            FrameIntervalEnum::Discrete(fraction) => vec![rate(fraction)],
            FrameIntervalEnum::Stepwise(steps) => vec![rate(steps.max), rate(steps.min)],
        })
        .flatten()
        .take(MAX_LISTED)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_offer_fits_into_a_line() {
        let size = |width, height, rates_hz: &[f64]| SizeOffer { width, height, rates_hz: rates_hz.to_vec() };
        let format = |fourcc: &str, sizes| FormatOffer { fourcc: fourcc.into(), description: String::new(), sizes };
        let formats = vec![
            format("YUYV", vec![size(640, 480, &[30.0, 15.0]), size(320, 240, &[30.0])]),
            format("MJPG", vec![size(8, 8, &[]); 13]),
        ];
        let offer = CameraOffer { card: String::new(), driver: String::new(), bus: String::new(), formats };
        let said = offer.summary();
        assert!(said.starts_with("YUYV 640x480 (30, 15), 320x240 (30); MJPG 8x8 (), "), "{said}");
        assert!(said.ends_with(", ...") && said.matches("8x8").count() == 12, "{said}");
        assert_eq!(CameraOffer { formats: Vec::new(), ..offer }.summary(), "nothing");
    }
}
