//! `[capture]`, `[serial]` and `[mount]`: settings that only a live recording on a robot needs.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::check_range;

/// How a live camera is operated. The size of its images is that of `camera.lens`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CaptureSettings {
    /// Path of a V4L2 device, or `unix:PATH` for frames from another process.
    pub device: String,
    /// Pixel format: `MJPG`, `YUYV`, `NV12`, `GREY`, `RGGB`, `BA81`, `GBRG` or `GRBG`; `None`: the first of these that the camera has.
    pub format: Option<String>,
    /// Frame rate asked of the camera, hertz.
    pub rate_hz: f64,
    /// Largest frame rate, hertz; frames beyond it are left out and counted. 0: no frame is left out.
    pub max_rate_hz: f64,
    /// Quality of the JPEG made of raw pixels, 1 to 100; 0: the pixels themselves are recorded.
    pub jpeg_quality: u8,
    /// Delay of the camera's stamps behind the exposure, milliseconds.
    pub delay_ms: f64,
    /// Values of the camera's controls, by the names that `v4l2-ctl --list-ctrls` shows.
    pub controls: BTreeMap<String, i64>,
    /// V4L2 device to which every frame is passed on, for other programs.
    pub republish: Option<String>,
}

/// Serial ports on which microcontrollers send MAVLink 2.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SerialSettings {
    /// The ports, at most eight.
    pub ports: Vec<SerialPortSettings>,
    /// MAVLink system id of the robot.
    pub system_id: u8,
}

/// One serial port.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SerialPortSettings {
    /// Path of the device.
    pub device: String,
    /// Baud rate.
    pub baud: u32,
    /// Whether every valid tag is sent there as an ODOMETRY message.
    #[serde(default)]
    pub poses: bool,
}

/// Pose of the camera while the robot stands with its head straight ahead. In a log, `/tf_static` states it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MountSettings {
    /// Height of `base_link` above the ground, metres; a live recording needs it.
    pub torso_height_m: Option<f64>,
    /// Position of `camera_link` in `base_link`, metres.
    pub camera_xyz_m: [f64; 3],
    /// Roll, pitch and yaw of `camera_link` in `base_link`, degrees; pitch > 0 looks down.
    pub camera_rpy_deg: [f64; 3],
}

/// Largest number of serial ports, more than any robot has.
const MAX_PORTS: usize = 8;

impl CaptureSettings {
    pub(super) fn check(&self) -> Result<(), String> {
        if let "" | "unix:" = self.device.as_str() {
            return Err(format!(
                "capture.device is {:?}: it must be a device, as /dev/robot-camera, or a socket, as unix:/run/realitysim/camera.sock",
                self.device
            ));
        }
        if self.republish.as_deref() == Some("") {
            return Err("capture.republish is empty: it must be a device, as /dev/video10, or left out".to_owned());
        }
        check_range("capture.rate_hz", self.rate_hz, 1.0, 1000.0)?;
        check_range("capture.max_rate_hz", self.max_rate_hz, 0.0, 1000.0)?;
        check_range("capture.jpeg_quality", self.jpeg_quality.into(), 0.0, 100.0)?;
        check_range("capture.delay_ms", self.delay_ms, -1000.0, 1000.0)?;
        match self.format.as_deref() {
            None | Some("MJPG" | "YUYV" | "NV12" | "GREY" | "RGGB" | "BA81" | "GBRG" | "GRBG") => Ok(()),
            Some(other) => {
                Err(format!("capture.format is {other:?}: it must be MJPG, YUYV, NV12, GREY, RGGB, BA81, GBRG or GRBG"))
            }
        }
    }

    /// Estimates the data rate of frames of this width and height, pixels, in bytes per second.
    ///
    /// A JPEG takes about a quarter of a byte per pixel, a raw image two bytes.
    pub fn bytes_per_s(&self, (width, height): (u32, u32)) -> u64 {
        let is_raw = self.jpeg_quality == 0 && self.format.as_deref() != Some("MJPG");
        let bytes_per_pixel = if is_raw { 2.0 } else { 0.25 };
        (f64::from(width) * f64::from(height) * bytes_per_pixel * self.rate_hz) as u64
    }
}

impl SerialSettings {
    pub(super) fn check(&self) -> Result<(), String> {
        if self.ports.len() > MAX_PORTS {
            return Err(format!("serial.ports has {} entries: at most {MAX_PORTS}", self.ports.len()));
        }
        for (index, port) in self.ports.iter().enumerate() {
            check_range(&format!("serial.ports[{index}].baud"), port.baud.into(), 1200.0, 4_000_000.0)?;
        }
        check_range("serial.system_id", self.system_id.into(), 1.0, 255.0)
    }
}

impl MountSettings {
    pub(super) fn check(&self) -> Result<(), String> {
        if let Some(height) = self.torso_height_m {
            check_range("mount.torso_height_m", height, 0.02, 5.0)?;
        }
        for value in self.camera_xyz_m {
            check_range("mount.camera_xyz_m", value, -5.0, 5.0)?;
        }
        for value in self.camera_rpy_deg {
            check_range("mount.camera_rpy_deg", value, -180.0, 180.0)?;
        }
        Ok(())
    }
}

impl Default for CaptureSettings {
    fn default() -> Self {
        Self {
            device: "/dev/robot-camera".into(),
            format: None,
            rate_hz: 30.0,
            max_rate_hz: 0.0,
            jpeg_quality: 90,
            delay_ms: 0.0,
            controls: BTreeMap::new(),
            republish: None,
        }
    }
}

impl Default for SerialSettings {
    fn default() -> Self {
        Self { ports: Vec::new(), system_id: 1 }
    }
}

impl Default for MountSettings {
    fn default() -> Self {
        Self { torso_height_m: None, camera_xyz_m: [0.0; 3], camera_rpy_deg: [0.0; 3] }
    }
}
