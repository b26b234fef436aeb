//! The bands of distance, angle, speed and light in which detections are counted.

use serde::Serialize;

/// A range of numbers; its upper end does not belong to it. As JSON `[from, to]`, with null for an infinite end.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(into = "[f64; 2]")]
pub struct Band {
    /// The lower end.
    pub from: f64,
    /// The upper end, or infinity.
    pub to: f64,
}

impl Band {
    const fn new(from: f64, to: f64) -> Self {
        Self { from, to }
    }

    /// Whether a number lies in the band. Infinity lies in a band without an end.
    pub fn contains(&self, value: f64) -> bool {
        value >= self.from && (value < self.to || self.to == f64::INFINITY)
    }
}

impl From<Band> for [f64; 2] {
    fn from(band: Band) -> Self {
        [band.from, band.to]
    }
}

impl core::fmt::Display for Band {
    fn fmt(&self, f: &mut core::fmt::Formatter) -> core::fmt::Result {
        if self.to == f64::INFINITY { write!(f, "{}-", self.from) } else { write!(f, "{}-{}", self.from, self.to) }
    }
}

/// Bands of the distance over the ground from the camera, metres. The error of a distance grows with its square, so that each band is
/// at most as wide as half its upper end, but the first two.
pub const DISTANCES_M: [Band; 7] = [
    Band::new(0.0, 1.0),
    Band::new(1.0, 2.0),
    Band::new(2.0, 3.0),
    Band::new(3.0, 4.0),
    Band::new(4.0, 6.0),
    Band::new(6.0, 9.0),
    Band::new(9.0, f64::INFINITY),
];

/// Bands of the angle off the optical axis, degrees: the middle of a picture, its border, and what only a wide lens sees.
pub const OFF_AXIS_DEG: [Band; 3] = [Band::new(0.0, 20.0), Band::new(20.0, 40.0), Band::new(40.0, f64::INFINITY)];

/// Bands of the camera's angular speed, degrees a second: at 20, an exposure of 10 ms smears about a pixel of a lens with 5 pixels a
/// degree.
pub const SPEEDS_DEG_S: [Band; 3] = [Band::new(0.0, 20.0), Band::new(20.0, 60.0), Band::new(60.0, f64::INFINITY)];

/// How bright a picture is around a landmark: mean luma, in quarters of the full scale.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Light {
    /// Below 64 of 255.
    Dark,
    /// From 64 to below 128.
    Middle,
    /// From 128.
    Bright,
}

impl Light {
    /// All of them, the darkest first.
    pub const ALL: [Self; 3] = [Self::Dark, Self::Middle, Self::Bright];

    /// Of a mean luma, 0 to 255.
    pub fn of(luma: f64) -> Self {
        match luma {
            luma if luma < 64.0 => Self::Dark,
            luma if luma < 128.0 => Self::Middle,
            _ => Self::Bright,
        }
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Dark => "dark",
            Self::Middle => "middle",
            Self::Bright => "bright",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn each_number_lies_in_one_band(value in prop_oneof![0.0..200.0f64, Just(f64::INFINITY), Just(0.0)]) {
            for bands in [&DISTANCES_M[..], &OFF_AXIS_DEG, &SPEEDS_DEG_S] {
                prop_assert_eq!(bands.iter().filter(|band| band.contains(value)).count(), 1);
            }
        }
    }
}
