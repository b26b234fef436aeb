//! Checks whether a robot is ready to record: tries each part for a moment and says how to mend what is wrong.

mod camera;
mod cpu;
mod delay;
mod disk;
mod ports;

use std::path::Path;
use std::time::Duration;

use serde::Serialize;

use crate::config::{Settings, load_lens};
use crate::log_input::body_mask;

pub use delay::{DelayReport, DelayReportError, estimate_delay, newest_capture};

/// One line of the report.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    pub what: String,
    pub good: bool,
    pub said: String,
    /// What to do about it; empty if the finding is good.
    pub remedy: String,
}

/// Share of the image that a plausible body mask hides at most; a larger one is probably inverted.
const PLAUSIBLE_HIDDEN_SHARE: f64 = 0.8;
/// Time for which each device is observed.
const LISTEN: Duration = Duration::from_secs(3);

/// Examines config, camera, serial ports, processor and disk, in this order.
pub fn examine(settings: &Settings, captures: &Path) -> Vec<Finding> {
    let mut findings = check_config(settings);
    findings.extend(camera::list_formats(settings));
    findings.push(match image_size(settings) {
        Some(size) => camera::check_stream(settings, size),
        None => camera::check_without_lens(settings),
    });
    findings.extend(ports::check_ports(&settings.serial));
    findings.extend(cpu::check_headroom(settings));
    findings.push(disk::check_disk(settings, captures));
    findings
}

fn good(what: impl Into<String>, said: impl Into<String>) -> Finding {
    Finding { what: what.into(), good: true, said: said.into(), remedy: String::new() }
}

fn bad(what: impl Into<String>, said: impl Into<String>, remedy: impl Into<String>) -> Finding {
    Finding { what: what.into(), good: false, said: said.into(), remedy: remedy.into() }
}

fn check_config(settings: &Settings) -> Vec<Finding> {
    let lens = match settings.camera.lens.as_deref().map(load_lens) {
        None => bad("lens", "none is named", "calibrate, and name the file in camera.lens (docs/howto/robot.md)"),
        Some(Err(error)) => bad("lens", error.to_string(), "correct the file or camera.lens"),
        Some(Ok(file)) => good("lens", format!("{} x {}", file.lens.width(), file.lens.height())),
    };
    let field = match settings.field_dimensions() {
        Err(error) => bad("field", error.to_string(), "correct the file or field"),
        Ok(_) => good("field", settings.field.clone()),
    };
    let mount = match settings.mount.torso_height_m {
        None => bad("mount", "torso_height_m is not set", "measure where the camera is and fill in [mount]"),
        Some(torso) => {
            let height = torso + settings.mount.camera_xyz_m[2];
            good("mount", format!("the camera is {height:.2} m above the ground"))
        }
    };
    let mut findings = vec![lens, field, mount];
    if let Some((width, height)) = image_size(settings) {
        let masks = settings.camera.body_mask.iter();
        findings.extend(masks.map(|mask| match body_mask(&mask.png, width, height) {
            Err(error) => {
                bad(format!("body mask {}", mask.png), error, "paint it anew (docs/howto/robot.md), or leave it out")
            }
            Ok(hides) => {
                let share =
                    hides.to_gray().iter().filter(|value| **value == 0).count() as f64 / f64::from(width * height);
                let (what, said) =
                    (format!("body mask {}", mask.png), format!("hides {:.0} % of the image", 100.0 * share));
                if share < PLAUSIBLE_HIDDEN_SHARE {
                    good(what, said)
                } else {
                    bad(what, said, "dark pixels hide: is it inverted?")
                }
            }
        }));
    }
    findings
}

fn image_size(settings: &Settings) -> Option<(u32, u32)> {
    let lens = load_lens(settings.camera.lens.as_deref()?).ok()?.lens;
    Some((lens.width(), lens.height()))
}
