//! Is this robot ready to record? Every part tried for a moment, with what to do about what is wrong.

mod camera;
mod cpu;
mod delay;
mod disk;
mod ports;

use std::path::Path;
use std::time::Duration;

use serde::Serialize;

use crate::config::{Settings, load_field, load_lens};
use crate::log_input::body_mask;

pub use delay::{DelayReport, DelayReportError, estimate_delay};

/// One line of the report.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    pub what: String,
    pub good: bool,
    pub said: String,
    /// What to do; empty when all is well.
    pub remedy: String,
}

/// No robot sees more of itself.
const MOST_HIDDEN: f64 = 0.8;
/// So long each device is listened to.
const LISTEN: Duration = Duration::from_secs(3);

pub fn examine(settings: &Settings, captures: &Path) -> Vec<Finding> {
    let mut findings = config(settings);
    findings.extend(camera::offer(settings));
    findings.push(match size(settings) {
        Some(size) => camera::camera(settings, size),
        None => camera::without_a_lens(settings),
    });
    findings.extend(ports::ports(&settings.serial));
    findings.extend(cpu::headroom(settings));
    findings.push(disk::disk(settings, captures));
    findings
}

fn good(what: impl Into<String>, said: impl Into<String>) -> Finding {
    Finding { what: what.into(), good: true, said: said.into(), remedy: String::new() }
}

fn bad(what: impl Into<String>, said: impl Into<String>, remedy: impl Into<String>) -> Finding {
    Finding { what: what.into(), good: false, said: said.into(), remedy: remedy.into() }
}

fn config(settings: &Settings) -> Vec<Finding> {
    let lens = match settings.camera.lens.as_deref().map(load_lens) {
        None => bad("lens", "none is named", "calibrate, and name the file in camera.lens (docs/hardware.md)"),
        Some(Err(error)) => bad("lens", error.to_string(), "correct the file or camera.lens"),
        Some(Ok(file)) => good("lens", format!("{} x {}", file.lens.width(), file.lens.height())),
    };
    let field = match load_field(&settings.field) {
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
    if let Some((width, height)) = size(settings) {
        let masks = settings.camera.body_mask.iter();
        findings.extend(masks.map(|mask| match body_mask(&mask.png, width, height) {
            Err(error) => {
                bad(format!("body mask {}", mask.png), error, "paint it anew (docs/hardware.md), or leave it out")
            }
            Ok(hides) => {
                let share =
                    hides.to_gray().iter().filter(|value| **value == 0).count() as f64 / f64::from(width * height);
                let (what, said) =
                    (format!("body mask {}", mask.png), format!("hides {:.0} % of the image", 100.0 * share));
                if share < MOST_HIDDEN {
                    good(what, said)
                } else {
                    bad(what, said, "dark pixels hide: is it inverted?")
                }
            }
        }));
    }
    findings
}

fn size(settings: &Settings) -> Option<(u32, u32)> {
    let lens = load_lens(settings.camera.lens.as_deref()?).ok()?.lens;
    Some((lens.width(), lens.height()))
}
