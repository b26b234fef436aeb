//! A bright window in the wall of the hall with the sun behind it.
//!
//! It saturates the sensor, veils the picture with scattered light, and throws sunlight onto the carpet whose edges can be
//! mistaken for lines.

use serde::Deserialize;

use super::{EffectKind, Role};
use crate::SceneError;
use crate::check::check_range;
use crate::per_frame::Changing;
use realitysim_geometry::Field;

/// A bright window. Lengths are metres.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BrightWindow {
    /// Why the scene has this effect, for people.
    pub role: Option<Role>,
    /// The wall that the window is in.
    pub wall: Wall,
    /// Centre along the wall: y in `map` for a wall at an end of the field, x for one at a side.
    pub centre_m: f64,
    /// Width along the wall.
    pub width_m: f64,
    /// Height of the lower edge above the floor.
    pub sill_m: f64,
    /// Height of the window from the lower to the upper edge.
    pub height_m: f64,
    /// Brightness as a multiple of white paint. Above about 1.2 the sensor saturates.
    pub brightness: f64,
    /// Share of the window's light that the lens scatters over the whole picture.
    #[serde(default)]
    pub glare: f64,
    /// Elevation of the sun, degrees above the horizon. Without it no sunlight comes in.
    pub sun_elevation_deg: Option<f64>,
    /// Factor by which floor and carpet are brighter where the sun shines.
    #[serde(default = "sun_gain")]
    pub sun_gain: f64,
}

/// A wall of the hall, by its direction in `map` from the centre of the field.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
pub enum Wall {
    /// The wall in the direction of +x.
    #[serde(rename = "+x")]
    XPlus,
    /// The wall in the direction of -x.
    #[serde(rename = "-x")]
    XMinus,
    /// The wall in the direction of +y.
    #[serde(rename = "+y")]
    YPlus,
    /// The wall in the direction of -y.
    #[serde(rename = "-y")]
    YMinus,
}

fn sun_gain() -> f64 {
    1.8
}

impl EffectKind for BrightWindow {
    fn role(&self) -> Option<Role> {
        self.role
    }

    fn check(&self, key: &str, _: &Field) -> Result<(), SceneError> {
        check_range(format_args!("{key}.centre_m"), self.centre_m, -100.0..=100.0, "-100 to 100 m along the wall")?;
        check_range(format_args!("{key}.width_m"), self.width_m, 0.1..=50.0, "0.1 to 50 m")?;
        check_range(format_args!("{key}.sill_m"), self.sill_m, 0.0..=6.0, "0 to 6 m above the floor")?;
        check_range(format_args!("{key}.height_m"), self.height_m, 0.1..=6.0, "0.1 to 6 m")?;
        let brightness = self.brightness;
        check_range(format_args!("{key}.brightness"), brightness, 0.5..=50.0, "0.5 to 50 times white paint")?;
        check_range(format_args!("{key}.glare"), self.glare, 0.0..=0.5, "0 (a perfect lens) to 0.5")?;
        let elevation = self.sun_elevation_deg.unwrap_or(30.0);
        check_range(
            format_args!("{key}.sun_elevation_deg"),
            elevation,
            2.0..=80.0,
            "2 to 80 degrees above the horizon",
        )?;
        check_range(format_args!("{key}.sun_gain"), self.sun_gain, 1.0..=5.0, "1 to 5 times the light without it")
    }

    fn set_in(&self, changing: &mut Changing, _: u64) {
        changing.window = Some(self.clone());
    }
}
