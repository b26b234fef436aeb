//! Checks of the values in a scene file. Every error names the key, its value and what would be right.

use core::fmt::Display;
use core::ops::RangeInclusive;

use glam::DVec2;
use thiserror::Error;

use super::effects;
use super::file::{CameraSection, InitialPose, Route, SceneFile, Still, Walk};
use super::key_lines::KeyLines;
use super::ranges::{Per, Range, Template};
use realitysim_geometry::{Field, FieldError, LensError};

/// Reason why a scene file is refused.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum SceneError {
    /// The text is not TOML, or a key is unknown, missing or of the wrong type.
    #[error("{0}")]
    Toml(String),
    /// A value is out of range or contradicts another one.
    #[error("{}{key} is {value}: {expected}", line.map(|line| format!("line {line}: ")).unwrap_or_default())]
    Value {
        /// Line of the key in the file, from 1, if known.
        line: Option<usize>,
        /// Key, for example `effect[1].gain`.
        key: String,
        /// The value that is wrong.
        value: String,
        /// What would be right.
        expected: String,
    },
    /// The field is not possible.
    #[error("field: {0}")]
    Field(#[from] FieldError),
    /// The lens is not possible.
    #[error("lens: {0}")]
    Lens(#[from] LensError),
}

impl SceneError {
    /// Adds the line of the key, if it is in the file.
    pub(super) fn with_line(self, key_lines: &KeyLines) -> Self {
        match self {
            Self::Value { line: None, key, value, expected } => {
                Self::Value { line: key_lines.line(&key), key, value, expected }
            }
            other => other,
        }
    }

    /// Adds the drawn values of the effect that is refused, because they do not stand in the file.
    pub(super) fn with_drawn_values(self, template: &Template, value: impl Fn(&Range) -> f64) -> Self {
        let Self::Value { line, key, value: found, expected } = self else { return self };
        let effect = key.split([']', '.']).next().unwrap_or_default();
        let own = template.ranges.iter().filter(|range| range.key.starts_with(&format!("{effect}]")));
        let numbers: Vec<String> = own.map(|range| format!("{} = {}", range.name, value(range))).collect();
        let with = if numbers.is_empty() { String::new() } else { format!("; may be drawn: {}", numbers.join(", ")) };
        Self::Value { line, key, value: found, expected: format!("{expected}{with}") }
    }
}

/// Maximum duration of a scene, seconds. A longer one would not fit any recording, and a mistyped speed is the likely cause.
const MAX_DURATION_S: f64 = 7200.0;
/// Maximum distance of the robot from the carpet, metres. Farther out it would walk into the clutter of the hall.
const MAX_OFF_CARPET_M: f64 = 1.0;

/// Checks every value of a scene file by itself, and then the effects against the rest of the file.
pub(super) fn check(file: &SceneFile, field: &Field) -> Result<(), SceneError> {
    check_camera(&file.camera)?;
    match &file.route {
        Route::Walk(walk) => check_walk(walk, field)?,
        Route::Still(still) => check_still(still, field)?,
    }
    for (key, section) in [("odometry.rate_hz", file.odometry), ("imu.rate_hz", file.imu)] {
        if let Some(section) = section {
            check_range(key, section.rate_hz, 0.1..=1000.0, "0.1 to 1000 messages per second")?;
        }
    }
    if let InitialPose::Off(error) = file.scene.initial_pose {
        check_range("scene.initial_pose.x_m", error.x_m, -20.0..=20.0, "-20 to 20 m off")?;
        check_range("scene.initial_pose.y_m", error.y_m, -20.0..=20.0, "-20 to 20 m off")?;
        check_range("scene.initial_pose.yaw_deg", error.yaw_deg, -180.0..=180.0, "-180 to 180 degrees off")?;
    }
    effects::check(&file.effects, field)?;
    effects::check_in(file)
}

/// Number of samples between the ends of every range that are checked.
///
/// For most values it is enough to check both ends. But a robot that is turned may leave the field at an angle in
/// between, and one span of time may overlap another.
const PLACES: u64 = 128;

/// Checks that every value that may be drawn is possible, so that a scene that is right with one seed is right with all.
///
/// `check_resolved` checks the file with values in place of its ranges. It is called with both ends of each range beside
/// the lowest and the highest values of the others, and with [`PLACES`] samples in between.
pub(super) fn check_ranges(
    file: &SceneFile,
    check_resolved: impl Fn(SceneFile) -> Result<(), SceneError>,
) -> Result<(), SceneError> {
    let Some(template) = &file.template else { return Ok(()) };
    for range in template.ranges.iter().filter(|range| range.per == Per::Frame) {
        effects::check_may_change(range)?;
    }
    let check_with = |value: &dyn Fn(&Range) -> f64| {
        let mut effects = SceneFile::effects_with(template, value)?;
        // A scene that was reduced to its first effects still has the text of all.
        effects.truncate(file.effects.len());
        check_resolved(SceneFile { effects, template: None, ..file.clone() })
    };
    let ends = |range: &Range| [range.low, range.high];
    for range in &template.ranges {
        for (own, others) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            check_with(&|other| ends(other)[if other == range { own } else { others }])?;
        }
    }
    if template.has_ranges_per(Per::Episode) {
        for sample in 0..PLACES {
            let value = |range: &Range| template.stratified_value(range, sample, PLACES);
            check_with(&value).map_err(|error| error.with_drawn_values(template, value))?;
        }
    }
    Ok(())
}

/// Returns an error unless `value` is in `range`. `expected` says in words what is right.
pub(super) fn check_range(
    key: impl Display,
    value: f64,
    range: RangeInclusive<f64>,
    expected: &str,
) -> Result<(), SceneError> {
    // NaN is in no range and is refused.
    if range.contains(&value) { Ok(()) } else { Err(refuse(key, value, expected)) }
}

/// The error for a wrong value, without a line.
pub(super) fn refuse(key: impl Display, value: impl Display, expected: impl Display) -> SceneError {
    SceneError::Value { line: None, key: key.to_string(), value: value.to_string(), expected: expected.to_string() }
}

/// Checks the duration of the scene.
pub(super) fn check_duration(seconds: f64) -> Result<(), SceneError> {
    let expected = "shorten the route or speed up: a scene lasts at most 7200 s";
    check_range("route's duration", seconds, 0.0..=MAX_DURATION_S, expected)
}

fn check_camera(camera: &CameraSection) -> Result<(), SceneError> {
    check_range("camera.rate_hz", camera.rate_hz, 0.1..=1000.0, "0.1 to 1000 images per second")?;
    if let Some(quality) = camera.jpeg_quality {
        check_range("camera.jpeg_quality", f64::from(quality), 1.0..=100.0, "1 to 100")?;
    }
    check_range(
        "camera.torso_height_m",
        camera.torso_height_m,
        0.05..=2.0,
        "the torso is 0.05 to 2 m above the ground",
    )?;
    for (axis, value) in ["x", "y", "z"].iter().zip(camera.mount_xyz_m) {
        let key = format_args!("camera.mount_xyz_m ({axis})").to_string();
        check_range(key, value, -1.0..=1.0, "the camera is within 1 m of the torso")?;
    }
    let height = camera.torso_height_m + camera.mount_xyz_m[2];
    check_range(
        "camera height above the ground",
        height,
        0.05..=3.0,
        "torso_height_m plus the mount's z is 0.05 to 3 m",
    )?;
    check_range("camera.mount_pitch_deg", camera.mount_pitch_deg, -90.0..=90.0, "-90 (up) to 90 (down) degrees")
}

fn check_walk(walk: &Walk, field: &Field) -> Result<(), SceneError> {
    let points = &walk.waypoints;
    if !(2..=1000).contains(&points.len()) {
        return Err(refuse("route.waypoints", format_args!("{} points long", points.len()), "2 to 1000 points"));
    }
    for (index, point) in points.iter().enumerate() {
        check_on_field(format_args!("route.waypoints[{index}]"), *point, field)?;
    }
    for (index, pair) in points.windows(2).enumerate() {
        let length = DVec2::from(pair[0]).distance(DVec2::from(pair[1]));
        if length < 0.01 {
            let key = format_args!("route.waypoints[{}]", index + 1).to_string();
            return Err(refuse(key, format_args!("{:?}", pair[1]), "at least 0.01 m from the waypoint before it"));
        }
    }
    check_range("route.speed_m_s", walk.speed_m_s, 0.01..=5.0, "a robot walks at 0.01 to 5 m/s")?;
    check_range("route.stand_s", walk.stand_s, 0.0..=3600.0, "a robot stands 0 to 3600 s at each waypoint")?;
    check_range("route.turn_deg_s", walk.turn_deg_s, 1.0..=720.0, "a robot turns at 1 to 720 degrees per second")?;
    match walk.start_yaw_deg {
        Some(yaw) => check_range("route.start_yaw_deg", yaw, -360.0..=360.0, "-360 to 360 degrees"),
        None => Ok(()),
    }
}

fn check_still(still: &Still, field: &Field) -> Result<(), SceneError> {
    let count = still.poses.len();
    if !(1..=100_000).contains(&count) {
        return Err(refuse("route.poses", format_args!("{count} poses long"), "1 to 100000 poses"));
    }
    for (index, [x, y, yaw]) in still.poses.iter().enumerate() {
        check_on_field(format_args!("route.poses[{index}]"), [*x, *y], field)?;
        let key = format_args!("route.poses[{index}] (yaw)").to_string();
        check_range(key, *yaw, -360.0..=360.0, "-360 to 360 degrees")?;
    }
    check_range("route.hold_s", still.hold_s, 0.001..=3600.0, "0.001 to 3600 s")
}

/// Checks that a point [x, y] in `map`, metres, is on the carpet or at most [`MAX_OFF_CARPET_M`] beside it.
pub(super) fn check_on_field(key: impl Display, point: [f64; 2], field: &Field) -> Result<(), SceneError> {
    let limit = field.carpet_half_extent() + DVec2::splat(MAX_OFF_CARPET_M);
    if DVec2::from(point).abs().cmple(limit).all() {
        return Ok(());
    }
    let expected = format!("at most {} m in x and {} m in y from the centre of this field", limit.x, limit.y);
    Err(refuse(key, format_args!("{point:?}"), expected))
}
