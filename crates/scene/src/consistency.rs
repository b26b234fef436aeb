//! Checks of entries against each other: contradictions, and effects that would change nothing.

use super::SceneError;
use super::check::{check_range, refuse};
use super::effects::{Effect, OdometryError};
use super::file::{Route, SceneFile};

/// Checks that effects have what they need and do not contradict each other.
pub(super) fn check(file: &SceneFile) -> Result<(), SceneError> {
    has_something_to_act_on(file)?;
    for (index, effect) in file.effects.iter().enumerate() {
        let key = format!("effect[{index}]");
        match effect {
            Effect::Shutter(shutter) => {
                let period_ms = 1e3 / file.camera.rate_hz;
                let expected = format!(
                    "a frame is exposed and read out before the next one: exposure_ms and readout_ms are at most \
                     {period_ms:.2} ms together, at {} images per second",
                    file.camera.rate_hz
                );
                let takes_ms = shutter.exposure_ms + shutter.readout_ms;
                check_range(format_args!("{key}.exposure_ms, with readout_ms,"), takes_ms, 0.0..=period_ms, &expected)?;
            }
            Effect::OdometryError(OdometryError { freeze: Some(freeze), missing: Some(missing), .. })
                if freeze.overlaps(missing) =>
            {
                let value = format!("{} s", missing.from_s);
                let expected = format!(
                    "odometry cannot be frozen and missing at the same time, and it is frozen from {} to {} s",
                    freeze.from_s,
                    freeze.from_s + freeze.for_s
                );
                return Err(refuse(format_args!("{key}.missing.from_s"), value, expected));
            }
            _ => {}
        }
    }
    Ok(())
}

/// Checks that no fault begins after `end`, the end of the scene in seconds.
pub(super) fn check_times(file: &SceneFile, end: f64) -> Result<(), SceneError> {
    let begins = |key: String, time: f64| {
        if time < end { Ok(()) } else { Err(refuse(key, time, format_args!("below {end:.2} s, where the scene ends"))) }
    };
    for (index, effect) in file.effects.iter().enumerate() {
        let key = format!("effect[{index}]");
        match effect {
            Effect::CameraFault(fault) => begins(format!("{key}.unplugged.from_s"), fault.unplugged.from_s)?,
            Effect::OdometryError(error) => {
                for (name, span) in [("freeze", error.freeze), ("missing", error.missing)] {
                    span.map_or(Ok(()), |span| begins(format!("{key}.{name}.from_s"), span.from_s))?;
                }
                error.jump.map_or(Ok(()), |jump| begins(format!("{key}.jump.at_s"), jump.at_s))?;
            }
            _ => {}
        }
    }
    Ok(())
}

/// Checks that every effect changes something with its values.
///
/// This is not checked at the ends of ranges, which may be values that change nothing.
pub(super) fn check_effects_do_something(effects: &[Effect]) -> Result<(), SceneError> {
    for (index, effect) in effects.iter().enumerate() {
        if let Some(needed) = effect.lacks() {
            let value = format!("a {} of nothing", effect.name());
            let expected = format!("it does nothing: leave the entry out, or have {needed}");
            return Err(refuse(format_args!("effect[{index}]"), value, expected));
        }
    }
    Ok(())
}

/// Checks that the scene has what each effect acts on. An effect without it would change nothing.
fn has_something_to_act_on(file: &SceneFile) -> Result<(), SceneError> {
    let lists = |name: &str| file.effects.iter().any(|effect| effect.name() == name);
    for (index, effect) in file.effects.iter().enumerate() {
        let (present, expected) = match effect {
            Effect::GaitSway(_) | Effect::Kidnapping(_) => {
                (matches!(file.route, Route::Walk(_)), "it needs a route that is walked, this one stands still")
            }
            Effect::Fall(_) if lists("kidnapping") => {
                (false, "a walk is interrupted once, and kidnapping does so already")
            }
            Effect::Fall(_) => (lists("gait_sway"), "it needs gait_sway: whoever does not walk is not pushed over"),
            Effect::Shutter(_) => (
                file.effects.iter().any(Effect::moves_camera),
                "it needs gait_sway or head_motion with an amplitude above 0: without motion it shows nothing",
            ),
            Effect::SerialNoise(_) => (
                file.odometry.is_some() || file.imu.is_some(),
                "it needs the section [odometry] or [imu], both are absent",
            ),
            Effect::HeadMotion(_) => {
                (file.imu.is_some(), "joints are sent at the rate of the section [imu], which is absent")
            }
            // The yaw of the IMU comes from the odometry, so the error shows there, too.
            Effect::OdometryError(_) => (
                file.odometry.is_some() || file.imu.is_some(),
                "it needs the section [odometry] or [imu], both are absent",
            ),
            Effect::ImuError(_) => (file.imu.is_some(), "it needs the section [imu], which is absent"),
            Effect::SensorNoise(_)
            | Effect::Light(_)
            | Effect::Obstacles(_)
            | Effect::WornLines(_)
            | Effect::Turf(_)
            | Effect::SunPatches(_)
            | Effect::Optics(_)
            | Effect::ExposureHunting(_)
            | Effect::ImageProcessing(_)
            | Effect::BrightWindow(_)
            | Effect::CameraFault(_)
            | Effect::CalibrationError(_) => (true, ""),
        };
        if !present {
            return Err(refuse(format_args!("effect[{index}].kind"), effect.name(), expected));
        }
    }
    Ok(())
}
