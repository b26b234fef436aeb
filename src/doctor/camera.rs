//! Checks of the camera: the formats it offers, and whether the configured stream arrives.

use std::time::Instant;

use super::{Finding, LISTEN, bad, good};
use crate::config::Settings;
use crate::devices::camera::{
    CameraError, CameraOptions, Capture, CaptureEvent, CaptureRules, Driver, Negotiated, SCHEME, driver_of,
};
use crate::devices::host_clock::monotonic_ns;

/// Lists the formats, sizes and rates of a V4L2 camera. `None` if the camera cannot be asked; `check_stream` reports on it then.
pub(super) fn list_formats(settings: &Settings) -> Option<Finding> {
    let device = settings.capture.device.as_str();
    if device.starts_with(SCHEME) {
        return None;
    }
    #[cfg(feature = "v4l2")]
    return crate::devices::v4l2::offer(std::path::Path::new(device))
        .ok()
        .map(|offer| good(format!("formats of {device}"), offer.summary()));
    #[cfg(not(feature = "v4l2"))]
    None
}

/// Checks that frames arrive as configured.
pub(super) fn check_stream(settings: &Settings, size: (u32, u32)) -> Finding {
    let capture = &settings.capture;
    let options = CameraOptions::new(capture, size);
    let what = format!("camera {}", capture.device);
    if capture.device.starts_with(SCHEME) {
        return good(what, "frames come from another process: not tried");
    }
    match driver_of(&capture.device, None) {
        Ok(driver) => measure_stream(what, driver, options),
        Err(error) => bad(what, error.to_string(), "build it with the feature v4l2, which is on by default"),
    }
}

/// Reports on the camera when no lens is configured: the lens says which size to ask for, so no stream can be tried.
pub(super) fn check_without_lens(settings: &Settings) -> Finding {
    let device = &settings.capture.device;
    let what = format!("camera {device}");
    #[cfg(feature = "v4l2")]
    if !device.starts_with(SCHEME)
        && let Err(error) = crate::devices::v4l2::offer(std::path::Path::new(device))
    {
        return bad(what, error.to_string(), "plug it in, or name another in capture.device");
    }
    bad(what, "not tried: no lens says how large its images are", "name the lens file in camera.lens first")
}

/// Measures rate, drops and stamps of the frames that arrive in a few seconds.
fn measure_stream(what: String, driver: Box<dyn Driver>, options: CameraOptions) -> Finding {
    let wanted_hz = options.rate_hz;
    let mut capture = Capture::new(driver, CaptureRules { options, max_rate_hz: None });
    let (mut camera, mut stamps, mut dropped, mut lost): (Option<Negotiated>, Vec<i64>, u64, Option<CameraError>) =
        (None, Vec::new(), 0, None);
    let mut clock = None;
    let began = Instant::now();
    while began.elapsed() < LISTEN && lost.is_none() {
        capture.step(monotonic_ns, |event| match event {
            CaptureEvent::Opened(negotiated) => camera = Some(negotiated),
            CaptureEvent::Frame(frame) => {
                clock = Some(frame.clock);
                stamps.push(frame.stamp_ns);
            }
            CaptureEvent::Dropped(_, count) => dropped += count,
            CaptureEvent::Lost { error, .. } => lost = Some(error),
        });
    }
    if let Some(error) = lost {
        return bad(what, error.to_string(), "see the message; `realitysim log info DEVICE` lists what it offers");
    }
    let (Some(camera), [first, .., last]) = (camera, stamps.as_slice()) else {
        return bad(what, "sends no frames", "is it the right node? UVC cameras have a second one for metadata");
    };
    let rate_hz = (stamps.len() - 1) as f64 * 1e9 / (last - first).max(1) as f64;
    let said = format!(
        "{} {} {} x {}, {rate_hz:.1} frames a second, {dropped} dropped, stamps: {clock:?}",
        camera.card,
        camera.format.fourcc(),
        camera.width,
        camera.height
    );
    match camera.refused.as_slice() {
        [] if rate_hz >= 0.9 * wanted_hz => good(what, said),
        [] => {
            bad(what, said, format!("{wanted_hz} were asked for: more light or a shorter exposure, or another format"))
        }
        refused => bad(what, said, format!("controls refused: {}", refused.join("; "))),
    }
}
