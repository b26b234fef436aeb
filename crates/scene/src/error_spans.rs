//! Exact positions of errors in tables with a `kind` (routes and effects).
//!
//! serde first buffers such a table to find its kind and then deserializes it a second time. For an error in the second
//! pass it knows only where the table begins.

use serde::de::DeserializeOwned;
use toml::Spanned;
use toml::de::{DeTable, DeValue, Error, ValueDeserializer};

use super::effects::{
    BrightWindow, CalibrationError, CameraFault, ExposureHunting, Fall, GaitSway, HeadMotion, ImageProcessing,
    ImuError, Kidnapping, Light, Obstacles, OdometryError, Optics, SensorNoise, SerialNoise, Shutter, SunPatches, Turf,
    WornLines,
};
use super::file::{Still, Walk};

/// The same error with the position of the wrong key, if that can be found.
pub(super) fn locate(error: Error, text: &str) -> Error {
    let found = DeTable::parse(text).ok().and_then(|table| {
        let mut table = table.into_inner();
        let effects = match table.remove("effect").map(Spanned::into_inner) {
            Some(DeValue::Array(list)) => list.into_iter().collect(),
            _ => Vec::new(),
        };
        let route = table.remove("route");
        route.into_iter().chain(effects).filter_map(error_of_its_kind).find(|own| own.message() == error.message())
    });
    let Some(mut found) = found else { return error };
    found.set_input(Some(text));
    found
}

/// The error that deserializing a route or effect as its kind gives, if any.
fn error_of_its_kind(table: Spanned<DeValue>) -> Option<Error> {
    let span = table.span();
    let DeValue::Table(mut table) = table.into_inner() else { return None };
    let kind = table.remove("kind")?;
    let keys = ValueDeserializer::from(Spanned::new(span, DeValue::Table(table)));
    match kind.get_ref().as_str()? {
        "walk" => error_of::<Walk>(keys),
        "still" => error_of::<Still>(keys),
        "gait_sway" => error_of::<GaitSway>(keys),
        "head_motion" => error_of::<HeadMotion>(keys),
        "kidnapping" => error_of::<Kidnapping>(keys),
        "fall" => error_of::<Fall>(keys),
        "light" => error_of::<Light>(keys),
        "bright_window" => error_of::<BrightWindow>(keys),
        "obstacles" => error_of::<Obstacles>(keys),
        "worn_lines" => error_of::<WornLines>(keys),
        "image_processing" => error_of::<ImageProcessing>(keys),
        "exposure_hunting" => error_of::<ExposureHunting>(keys),
        "optics" => error_of::<Optics>(keys),
        "sun_patches" => error_of::<SunPatches>(keys),
        "turf" => error_of::<Turf>(keys),
        "shutter" => error_of::<Shutter>(keys),
        "sensor_noise" => error_of::<SensorNoise>(keys),
        "camera_fault" => error_of::<CameraFault>(keys),
        "odometry_error" => error_of::<OdometryError>(keys),
        "imu_error" => error_of::<ImuError>(keys),
        "calibration_error" => error_of::<CalibrationError>(keys),
        "serial_noise" => error_of::<SerialNoise>(keys),
        _ => None,
    }
}

/// The error that deserializing as `T` gives, if any.
fn error_of<T: DeserializeOwned>(keys: ValueDeserializer) -> Option<Error> {
    T::deserialize(keys).err()
}
