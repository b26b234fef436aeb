//! Files of a calibration: a lens file, a robot config, report and maps.

use std::path::Path;

use super::board::BoardReport;
use super::image_report::{MIN_FRAMES, MIN_PICTURES};
use super::maps::maps;
use super::report::Report;
use crate::cli::paths::write;
use crate::config::lens_text;
use crate::geometry::Euler;
use crate::localization::smoothing::Constants;
use crate::recording::SessionInfo;
use crate::tagging::board_calibration::BoardCalibration;
use crate::tagging::calibrated_lens::CalibratedLens;
use crate::tagging::walk_calibration::WalkCalibration;

const LENS: &str = "lens.toml";

/// Writes everything that the walk determines.
pub(super) fn write_all(found: &WalkCalibration, report: &Report, folder: &Path) -> anyhow::Result<()> {
    if found.determines_lens() {
        let text = lens_text(&found.image.lens, "Calibrated by a walk");
        write(&folder.join(LENS), &format!("# Found by `realitysim calibrate --walk`\n{text}"))?;
    }
    write(&folder.join("robot.toml"), &robot_text(found))?;
    write(&folder.join("report.txt"), &report.text())?;
    write(&folder.join("report.json"), &format!("{}\n", serde_json::to_string_pretty(report)?))?;
    write_maps(&found.image, ("lines", MIN_FRAMES), folder)
}

/// Writes the lens of a board with its report and maps; a lens that the pictures do not determine is left out.
pub(super) fn write_board(found: &BoardCalibration, report: &BoardReport, folder: &Path) -> anyhow::Result<()> {
    if found.determines_lens() {
        let text = lens_text(&found.image.lens, "Calibrated by a board");
        write(&folder.join(LENS), &format!("# Found by `realitysim calibrate --board`\n{text}"))?;
    }
    write(&folder.join("report.txt"), &report.text())?;
    write(&folder.join("report.json"), &format!("{}\n", serde_json::to_string_pretty(report)?))?;
    write_maps(&found.image, ("corners", MIN_PICTURES), folder)
}

fn write_maps(image: &CalibratedLens, (marks, min_frames): (&str, usize), folder: &Path) -> anyhow::Result<()> {
    maps(image, marks, min_frames).iter().try_for_each(|map| write(&folder.join(map.file), &map.svg))
}

/// Comment in the robot file that explains whose tilt it is.
const TILT_COMMENT: &str = "# The tilt is that of the camera against what the IMU calls level: one walk cannot tell a tilted mount from a tilted IMU,\n\
                    # and a pose needs both together only. With another IMU, or one that was set level anew, it is to be found again.\n";

fn robot_text(found: &WalkCalibration) -> String {
    let mut text =
        "# Found by `realitysim calibrate --walk`. What the walk does not determine is left out:\n".to_owned();
    for constant in &found.constants {
        let says = if constant.determined { "determined" } else { "not determined" };
        text.push_str(&format!(
            "#   {}: {:+.5} {} (sigma {:.5}): {says}\n",
            constant.name, constant.value, constant.unit, constant.sigma
        ));
    }
    if let Some([length_m, width_m]) = found.field_size_m {
        text.push_str(&format!(
            "field = {:?}\nfield_size_m = [{length_m:.4}, {width_m:.4}]\n",
            found.info.settings.field
        ));
    }
    if found.determines_lens() {
        text.push_str(&format!("\n[camera]\nlens = {LENS:?}\n"));
    }
    let is_determined = |name: &str| found.constants.iter().any(|found| found.name == name && found.determined);
    if is_determined("delay of the camera") {
        let delay_ms = found.info.settings.capture.delay_ms + 1e3 * found.corrections.delay_s;
        text.push_str(&format!("\n[capture]\ndelay_ms = {delay_ms:.2}\n"));
    }
    let is_mount = |name: &str| name.starts_with("tilt") || name == "height";
    if found.constants.iter().filter(|found| is_mount(found.name)).all(|found| found.determined) {
        text.push_str(&mount_text(&found.info, &found.corrections));
    }
    text
}

/// Config lines of the mount. `record` makes the transforms from its config's mount. Any other capture has them from its log,
/// whatever a config says.
pub(in crate::cli) fn mount_text(info: &SessionInfo, corrections: &Constants) -> String {
    let mount = &info.settings.mount;
    match mount.torso_height_m.filter(|_| info.live.is_some()) {
        Some(height) => {
            let [roll, pitch, yaw] = corrected(mount.camera_rpy_deg, corrections);
            let [x, y, z] = mount.camera_xyz_m;
            format!(
                "\n{TILT_COMMENT}[mount]\ntorso_height_m = {:.4}\ncamera_xyz_m = [{x:?}, {y:?}, {z:?}]\ncamera_rpy_deg = [{roll:.4}, {pitch:.4}, {yaw:.4}]\n",
                height + corrections.height_m
            )
        }
        None => {
            let [roll, pitch, yaw] = corrected([0.0; 3], corrections);
            format!(
                "\n{TILT_COMMENT}# The mount of this capture stands in the transforms of its log, which no config changes. Correct them where they are made:\n\
                 # the camera is {:+.4} m higher than they say, and turned in its own frame (camera_link) by roll, pitch, yaw of\n\
                 # [{roll:.4}, {pitch:.4}, {yaw:.4}] degrees.\n",
                corrections.height_m
            )
        }
    }
}

/// Roll, pitch and yaw of `camera_link`, degrees, corrected by the tilt that was found, which is about the camera's optical
/// axes.
fn corrected([roll, pitch, yaw]: [f64; 3], constants: &Constants) -> [f64; 3] {
    let believed = Euler { yaw: yaw.to_radians(), pitch: pitch.to_radians(), roll: roll.to_radians() };
    let turned = constants.corrected_link(believed.rotation());
    let found = Euler::from_rotation(turned);
    [found.roll, found.pitch, found.yaw].map(f64::to_degrees)
}
