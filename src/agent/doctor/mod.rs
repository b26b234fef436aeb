//! Is this robot ready to record? Every part tried for a moment, with what to do about what is wrong.

mod cpu;
mod delay;

use std::fs::File;
use std::io::Write;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use serde::Serialize;

use crate::config::{Settings, load_field, load_lens};
use crate::recording::storage::Disk;
use crate::recording::{DiskMeasured, loss_bound_ms};
use crate::sensors::camera::{
    CameraError, CameraOptions, Capture, CaptureEvent, CaptureRules, Driver, Negotiated, SCHEME, driver_of,
};
use crate::sensors::host_clock::monotonic_ns;
use crate::sensors::serial::{LineStatus, PortEvent, PortOptions, SerialError, run};

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

/// So long each device is listened to.
const LISTEN: Duration = Duration::from_secs(3);
/// As much as a second of camera frames, as often as tells the worst from the usual.
const DISK_BLOCK_BYTES: usize = 512 << 10;
const DISK_BLOCKS: usize = 40;
/// Of a recording, in a power cut.
const MOST_LOST_MS: f64 = 1000.0;

pub fn examine(settings: &Settings, captures: &Path) -> Vec<Finding> {
    let mut findings = config(settings);
    if let Some(size) = size(settings) {
        findings.push(camera(settings, size));
    }
    if settings.serial.ports.is_empty() {
        findings.push(bad("serial", "no port is named", "name the microcontrollers' ports in serial.ports"));
    }
    findings.extend(settings.serial.ports.iter().map(|port| {
        let options = PortOptions {
            device: port.device.clone(),
            baud: port.baud,
            system: settings.serial.system_id,
            poses: None,
        };
        serial(&options)
    }));
    findings.extend(cpu::headroom(settings));
    findings.push(disk(settings, captures));
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
    vec![lens, field, mount]
}

fn size(settings: &Settings) -> Option<(u32, u32)> {
    let lens = load_lens(settings.camera.lens.as_deref()?).ok()?.lens;
    Some((lens.width(), lens.height()))
}

fn camera(settings: &Settings, size: (u32, u32)) -> Finding {
    let capture = &settings.capture;
    let options = CameraOptions::new(capture, size);
    let what = format!("camera {}", capture.device);
    if capture.device.starts_with(SCHEME) {
        return good(what, "frames come from another process: not tried");
    }
    match driver_of(&capture.device, None) {
        Ok(driver) => watch(what, driver, options),
        Err(error) => bad(what, error.to_string(), "build it with the feature v4l2, which is on by default"),
    }
}

/// Rate, drops and stamps of what comes in a few seconds.
fn watch(what: String, driver: Box<dyn Driver>, options: CameraOptions) -> Finding {
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
        return bad(what, error.to_string(), "see the message; `realitysim info DEVICE` lists what it offers");
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

fn serial(options: &PortOptions) -> Finding {
    let what = format!("serial {}", options.device);
    let stop = AtomicBool::new(false);
    let (mut status, mut lost): (Option<LineStatus>, Option<SerialError>) = (None, None);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            std::thread::sleep(LISTEN);
            stop.store(true, Ordering::Relaxed);
        });
        run(options, &stop, |event| match event {
            PortEvent::Status(line) => status = Some(line),
            PortEvent::Lost(error) => lost = Some(error),
            PortEvent::Opened { .. } | PortEvent::Measured(_) => {}
        });
    });
    if let Some(error) = lost {
        return bad(what, error.to_string(), "see the message");
    }
    let Some(LineStatus { counts, clocks }) = status else { return bad(what, "nothing was heard", "try again") };
    if counts.frames.bytes == 0 {
        return bad(what, "silent", "is the device switched on, and are its lines crossed (TX to RX)?");
    }
    if counts.frames.frames == 0 {
        let said = format!("{} bytes and no MAVLink 2 message", counts.frames.bytes);
        return bad(what, said, format!("is {} its baud rate, and MAVLink 2 its protocol?", options.baud));
    }
    let used: Vec<String> = counts
        .used
        .iter()
        .map(|(name, count)| format!("{name} {:.0} Hz", *count as f64 / LISTEN.as_secs_f64()))
        .collect();
    let clock = clocks.iter().map(|clock| {
        let (source, uncertainty) = (clock.clock.source, clock.clock.uncertainty_ns as f64 * 1e-6);
        format!("clock of {}.{} to {uncertainty:.1} ms by {source:?}", clock.sender.system, clock.sender.component)
    });
    let said = format!("{}; {}", used.join(", "), clock.collect::<Vec<_>>().join(", "));
    let missing: Vec<&str> =
        ["ATTITUDE_QUATERNION", "ODOMETRY"].into_iter().filter(|name| !counts.used.contains_key(name)).collect();
    match counts.unusable.iter().next() {
        Some((reason, count)) => bad(what, said, format!("{count} messages cannot be used: {reason}")),
        None if counts.lost > 0 => {
            bad(what, said, format!("{} messages were lost: the line is too slow or noisy", counts.lost))
        }
        None if !missing.is_empty() => bad(what, said, format!("it does not send {}", missing.join(" and "))),
        None => good(what, said),
    }
}

/// The worst of many writes that reach the disk, and what follows from it: memory for frames, and what a power cut costs.
fn disk(settings: &Settings, captures: &Path) -> Finding {
    let what = format!("disk {}", captures.display());
    let [typical_ms, worst_ms] = match slowest_write_ms(captures) {
        Err(error) => return bad(what, error.to_string(), "the recorder's user must be able to write there"),
        Ok(measured) => measured,
    };
    let measured = DiskMeasured { block_bytes: DISK_BLOCK_BYTES as u64, typical_ms, worst_ms };
    // The recorder makes its queue of it; without it, it takes a usual one.
    let noted = measured.save(&Disk, captures).map_or_else(|error| format!(" ({error})"), |()| String::new());
    let bytes_per_s = size(settings).map_or(0, |size| settings.capture.bytes_per_s(size));
    let queue_mb = measured.queue_mb(&settings.recording, bytes_per_s);
    let cut_ms = loss_bound_ms(settings.recording.sync_interval_ms as f64, worst_ms);
    let said = format!(
        "512 KiB to the disk: {typical_ms:.1} ms, the worst of {DISK_BLOCKS} {worst_ms:.1} ms: {queue_mb} MiB for frames that wait, \
         and a power cut costs at most {:.1} s{noted}",
        cut_ms * 1e-3
    );
    if !measured.fits(queue_mb, bytes_per_s) {
        bad(
            what,
            said,
            "a faster disk, a larger recording.queue_mb or fewer frames: they are dropped while it stands still",
        )
    } else if cut_ms > MOST_LOST_MS {
        bad(what, said, "a faster disk: with this one, a power cut costs more than a second")
    } else {
        good(what, said)
    }
}

fn slowest_write_ms(captures: &Path) -> std::io::Result<[f64; 2]> {
    std::fs::create_dir_all(captures)?;
    let path = captures.join("doctor.tmp");
    let mut times = Vec::with_capacity(DISK_BLOCKS);
    let written = (|| {
        let mut file = File::create(&path)?;
        let block = vec![0x5a; DISK_BLOCK_BYTES];
        for _ in 0..DISK_BLOCKS {
            let start = Instant::now();
            file.write_all(&block)?;
            file.sync_data()?;
            times.push(start.elapsed().as_secs_f64() * 1e3);
        }
        Ok(())
    })();
    let _ = std::fs::remove_file(&path);
    let failed: std::io::Result<()> = written;
    failed?;
    times.sort_by(f64::total_cmp);
    Ok([times[DISK_BLOCKS / 2], times[DISK_BLOCKS - 1]])
}
