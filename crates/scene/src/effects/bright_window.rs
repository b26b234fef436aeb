//! A window in the hall's wall with the sun behind it: far too bright for the sensor, it veils the picture, and its light
//! lies on the carpet with edges that nobody painted.

use serde::Deserialize;

use super::Role;
use crate::SceneError;
use crate::check::within;

#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BrightWindow {
    pub role: Option<Role>,
    pub wall: Wall,
    /// Along the wall: y in `map` of a wall at an end of the field, x of one at a side.
    pub centre_m: f64,
    pub width_m: f64,
    /// Its lower edge above the floor.
    pub sill_m: f64,
    pub height_m: f64,
    /// Times the brightness of white paint; above about 1.2 the sensor clips.
    pub brightness: f64,
    /// Of the light that comes in through the lens, what it scatters over the whole picture.
    #[serde(default)]
    pub glare: f64,
    /// Height of the sun; without it no sunlight comes in.
    pub sun_elevation_deg: Option<f64>,
    /// How much brighter floor and carpet are where the sun shines.
    #[serde(default = "sun_gain")]
    pub sun_gain: f64,
}

/// Seen from the field's centre.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
pub enum Wall {
    #[serde(rename = "+x")]
    XPlus,
    #[serde(rename = "-x")]
    XMinus,
    #[serde(rename = "+y")]
    YPlus,
    #[serde(rename = "-y")]
    YMinus,
}

fn sun_gain() -> f64 {
    1.8
}

impl BrightWindow {
    pub(super) fn check(&self, key: &str) -> Result<(), SceneError> {
        within(format_args!("{key}.centre_m"), self.centre_m, -100.0..=100.0, "-100 to 100 m along the wall")?;
        within(format_args!("{key}.width_m"), self.width_m, 0.1..=50.0, "0.1 to 50 m")?;
        within(format_args!("{key}.sill_m"), self.sill_m, 0.0..=6.0, "0 to 6 m above the floor")?;
        within(format_args!("{key}.height_m"), self.height_m, 0.1..=6.0, "0.1 to 6 m")?;
        let brightness = self.brightness;
        within(format_args!("{key}.brightness"), brightness, 0.5..=50.0, "0.5 to 50 times white paint")?;
        within(format_args!("{key}.glare"), self.glare, 0.0..=0.5, "0 (a perfect lens) to 0.5")?;
        let elevation = self.sun_elevation_deg.unwrap_or(30.0);
        within(format_args!("{key}.sun_elevation_deg"), elevation, 2.0..=80.0, "2 to 80 degrees above the horizon")?;
        within(format_args!("{key}.sun_gain"), self.sun_gain, 1.0..=5.0, "1 to 5 times the light without it")
    }
}
