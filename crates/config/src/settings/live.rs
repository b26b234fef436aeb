//! What only a robot needs: how its camera is set, what speaks on its serial lines, where the camera stands.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::within;

/// Of a live camera; its size is that of `camera.lens`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CaptureSettings {
    /// A V4L2 device, or `unix:PATH`: frames from another process.
    pub device: String,
    /// `MJPG`, `YUYV`, `NV12`, `GREY`, `RGGB`, `BA81`, `GBRG` or `GRBG`; none: the first of these that it has.
    pub format: Option<String>,
    pub rate_hz: f64,
    /// Frames beyond it are left out and counted; 0: none.
    pub max_rate_hz: f64,
    /// Of the JPEG made of raw pixels; 0: the pixels themselves are recorded.
    pub jpeg_quality: u8,
    /// The camera's stamps are later than the exposure by this.
    pub delay_ms: f64,
    /// By the names that `v4l2-ctl --list-ctrls` shows.
    pub controls: BTreeMap<String, i64>,
    /// A V4L2 device to which every frame is passed on, for other programs.
    pub republish: Option<String>,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SerialSettings {
    pub ports: Vec<SerialPortSettings>,
    /// The robot's number in MAVLink.
    pub system_id: u8,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SerialPortSettings {
    pub device: String,
    pub baud: u32,
    /// Every valid tag is sent there as ODOMETRY.
    #[serde(default)]
    pub poses: bool,
}

/// Where the camera is while the robot stands, head straight ahead: what `/tf_static` says in a log.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MountSettings {
    /// Of `base_link` above the ground.
    pub torso_height_m: Option<f64>,
    /// Of `camera_link` in `base_link`.
    pub camera_xyz_m: [f64; 3],
    /// Roll, pitch, yaw of `camera_link` in `base_link`; pitch > 0 looks down.
    pub camera_rpy_deg: [f64; 3],
}

/// More ports than any robot has.
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
        within("capture.rate_hz", self.rate_hz, 1.0, 1000.0)?;
        within("capture.max_rate_hz", self.max_rate_hz, 0.0, 1000.0)?;
        within("capture.jpeg_quality", self.jpeg_quality.into(), 0.0, 100.0)?;
        within("capture.delay_ms", self.delay_ms, -1000.0, 1000.0)?;
        match self.format.as_deref() {
            None | Some("MJPG" | "YUYV" | "NV12" | "GREY" | "RGGB" | "BA81" | "GBRG" | "GRBG") => Ok(()),
            Some(other) => {
                Err(format!("capture.format is {other:?}: it must be MJPG, YUYV, NV12, GREY, RGGB, BA81, GBRG or GRBG"))
            }
        }
    }

    /// About what frames of this size will take: JPEGs a quarter of a byte a pixel, raw ones two.
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
            within(&format!("serial.ports[{index}].baud"), port.baud.into(), 1200.0, 4_000_000.0)?;
        }
        within("serial.system_id", self.system_id.into(), 1.0, 255.0)
    }
}

impl MountSettings {
    pub(super) fn check(&self) -> Result<(), String> {
        if let Some(height) = self.torso_height_m {
            within("mount.torso_height_m", height, 0.02, 5.0)?;
        }
        for value in self.camera_xyz_m {
            within("mount.camera_xyz_m", value, -5.0, 5.0)?;
        }
        for value in self.camera_rpy_deg {
            within("mount.camera_rpy_deg", value, -180.0, 180.0)?;
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
