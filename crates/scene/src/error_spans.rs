//! Where a scene file is wrong within a table whose `kind` says what it holds. serde reads such a table twice, and knows of
//! the second time only where it begins.

use serde::de::DeserializeOwned;
use toml::Spanned;
use toml::de::{DeTable, DeValue, Error, ValueDeserializer};

use super::effects::{
    BrightWindow, CalibrationError, CameraFault, ExposureHunting, Fall, GaitSway, HeadMotion, ImageProcessing,
    ImuError, Kidnapping, Light, Obstacles, OdometryError, Optics, SensorNoise, SerialNoise, Shutter, SunPatches, Turf,
    WornLines,
};
use super::file::{Still, Walk};

/// The same error with the place of the key that is wrong, if it can be found.
pub(super) fn nearer(error: Error, text: &str) -> Error {
    let found = DeTable::parse(text).ok().and_then(|table| {
        let mut table = table.into_inner();
        let effects = match table.remove("effect").map(Spanned::into_inner) {
            Some(DeValue::Array(list)) => list.into_iter().collect(),
            _ => Vec::new(),
        };
        let route = table.remove("route");
        route.into_iter().chain(effects).filter_map(of_its_kind).find(|own| own.message() == error.message())
    });
    let Some(mut found) = found else { return error };
    found.set_input(Some(text));
    found
}

fn of_its_kind(table: Spanned<DeValue>) -> Option<Error> {
    let span = table.span();
    let DeValue::Table(mut table) = table.into_inner() else { return None };
    let kind = table.remove("kind")?;
    let keys = ValueDeserializer::from(Spanned::new(span, DeValue::Table(table)));
    match kind.get_ref().as_str()? {
        "walk" => of::<Walk>(keys),
        "still" => of::<Still>(keys),
        "gait_sway" => of::<GaitSway>(keys),
        "head_motion" => of::<HeadMotion>(keys),
        "kidnapping" => of::<Kidnapping>(keys),
        "fall" => of::<Fall>(keys),
        "light" => of::<Light>(keys),
        "bright_window" => of::<BrightWindow>(keys),
        "obstacles" => of::<Obstacles>(keys),
        "worn_lines" => of::<WornLines>(keys),
        "image_processing" => of::<ImageProcessing>(keys),
        "exposure_hunting" => of::<ExposureHunting>(keys),
        "optics" => of::<Optics>(keys),
        "sun_patches" => of::<SunPatches>(keys),
        "turf" => of::<Turf>(keys),
        "shutter" => of::<Shutter>(keys),
        "sensor_noise" => of::<SensorNoise>(keys),
        "camera_fault" => of::<CameraFault>(keys),
        "odometry_error" => of::<OdometryError>(keys),
        "imu_error" => of::<ImuError>(keys),
        "calibration_error" => of::<CalibrationError>(keys),
        "serial_noise" => of::<SerialNoise>(keys),
        _ => None,
    }
}

fn of<T: DeserializeOwned>(keys: ValueDeserializer) -> Option<Error> {
    T::deserialize(keys).err()
}
