//! Units that the names of columns carry.

/// Unit of the angles of columns that name none.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AngleUnit {
    /// Degrees, and degrees per second.
    Degrees,
    /// Radians, and radians per second.
    Radians,
}

/// What the numbers of a column measure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Quantity {
    /// Without a unit, as the parts of a quaternion.
    Plain,
    /// Metres, if the name has no other unit.
    Length,
    /// Metres per second, if the name has no other unit.
    Speed,
    /// Metres per second squared, if the name has no other unit.
    Acceleration,
    /// Degrees or radians; the name must say which.
    Angle,
    /// Degrees or radians per second; the name must say which.
    TurnRate,
}

/// Standard acceleration of free fall, m/s² (ISO 80000-3): the unit `g` of accelerometers.
pub(super) const STANDARD_GRAVITY_M_S2: f64 = 9.806_65;

const DEGREE: f64 = core::f64::consts::PI / 180.0;

/// A unit behind a name, and the factor that makes SI of it.
type Units = &'static [(&'static str, f64)];

impl Quantity {
    fn units(self) -> Units {
        match self {
            Self::Plain => &[],
            Self::Length => &[("m", 1.0), ("cm", 0.01), ("mm", 0.001)],
            Self::Speed => &[("m_s", 1.0), ("mps", 1.0), ("cm_s", 0.01), ("mm_s", 0.001)],
            Self::Acceleration => &[("m_s2", 1.0), ("mps2", 1.0), ("g", STANDARD_GRAVITY_M_S2)],
            Self::Angle => &[("deg", DEGREE), ("rad", 1.0)],
            Self::TurnRate => {
                &[("deg_s", DEGREE), ("rad_s", 1.0), ("dps", DEGREE), ("radps", 1.0), ("deg", DEGREE), ("rad", 1.0)]
            }
        }
    }

    /// Factor of a unit; `None` if it is none of this quantity.
    pub(super) fn factor(self, unit: &str) -> Option<f64> {
        self.units().iter().find(|(name, _)| *name == unit).map(|(_, factor)| *factor)
    }

    /// Factor of a name without unit.
    pub(super) fn factor_without_unit(self, angles: Option<AngleUnit>) -> Option<f64> {
        match self {
            Self::Plain | Self::Length | Self::Speed | Self::Acceleration => Some(1.0),
            Self::Angle | Self::TurnRate => angles.map(|unit| match unit {
                AngleUnit::Degrees => DEGREE,
                AngleUnit::Radians => 1.0,
            }),
        }
    }

    /// Units that an error proposes.
    pub(super) fn advised(self) -> Vec<&'static str> {
        self.units().iter().take(2).map(|(name, _)| *name).collect()
    }

    /// What else would help than another name.
    pub(super) fn advice(self) -> &'static str {
        match self {
            Self::Angle | Self::TurnRate => {
                ", or say --angles deg or --angles rad for all columns of angles without a unit"
            }
            _ => "",
        }
    }
}
