//! Attitude and rates of an inertial measurement unit.

use glam::{DQuat, DVec3};

use super::Measured;
use super::stamp::{InOrder, StampColumn};
use super::table::{Table, TableError};
use super::units::{AngleUnit, Quantity};
use realitysim_geometry::Euler;

/// A sample of the inertial measurement unit, about the axes of `base_link` (REP 103: x forward, y left, z up).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuSample {
    /// Time of the measurement, nanoseconds.
    pub stamp_ns: i64,
    /// Attitude against gravity, if the table has it.
    pub orientation: Option<DQuat>,
    /// Radians per second, if the table has it.
    pub turn_rate: Option<DVec3>,
    /// Acceleration with gravity, metres per second squared, if the table has it.
    pub acceleration: Option<DVec3>,
}

/// Largest roll and pitch, radians: beyond it degrees were written as radians.
const MAX_ANGLE_RAD: f64 = 2.0 * core::f64::consts::PI + 0.01;
/// Mean acceleration of a robot on the ground, metres per second squared. Outside of it the unit is another, or gravity was
/// taken off.
const MEAN_ACCELERATIONS_M_S2: core::ops::RangeInclusive<f64> = 8.0..=12.0;

/// Reads a table of attitudes: `roll`, `pitch` and perhaps `yaw` with a unit, or `qx`, `qy`, `qz`, `qw`; perhaps `gx`, `gy`, `gz` and `ax`,
/// `ay`, `az`.
pub fn read(table: &mut Table, angles: Option<AngleUnit>) -> Result<Measured<ImuSample>, TableError> {
    let stamps = StampColumn::find(table)?.ok_or_else(|| table.lacks("the column stamp (or time, t) is missing"))?;
    let quaternion = table.take_numbers([&["qx"], &["qy"], &["qz"], &["qw"]], Quantity::Plain, None)?;
    let tilt = table.take_numbers([&["roll"], &["pitch"]], Quantity::Angle, angles)?;
    let yaw = table.take_number(&["yaw", "heading"], Quantity::Angle, angles)?;
    let rates = [&["gx", "gyro_x", "wx"][..], &["gy", "gyro_y", "wy"], &["gz", "gyro_z", "wz"]];
    let rates = table.take_numbers(rates, Quantity::TurnRate, angles)?;
    let accelerations = [&["ax", "acc_x"][..], &["ay", "acc_y"], &["az", "acc_z"]];
    let accelerations = table.take_numbers(accelerations, Quantity::Acceleration, None)?;
    let mut assumed = Vec::new();
    match (quaternion, tilt, rates) {
        (None, None, None) => {
            return Err(table
                .lacks("there is neither an attitude (roll_deg,pitch_deg or qx,qy,qz,qw) nor a turn rate (gx,gy,gz)"));
        }
        (None, None, Some(_)) => assumed.push("no attitude: the torso is taken to stand upright".to_owned()),
        (Some(_), Some(_), _) => assumed.push("the quaternion counts, not roll and pitch".to_owned()),
        _ => {}
    }
    let (mut rows, mut order, mut accelerations_sum) = (Vec::new(), InOrder::default(), 0.0);
    for row in table.rows() {
        let row = row?;
        let stamp_ns = stamps.read(&row)?;
        order.check(&row, stamp_ns)?;
        let orientation = match (quaternion, tilt) {
            (Some(columns), _) => Some(row.quaternion(columns)?),
            (None, Some(columns)) => {
                let [roll, pitch] = row.numbers(columns)?;
                let yaw = yaw.map_or(Ok(0.0), |column| row.number(column))?;
                if roll.abs().max(pitch.abs()) > MAX_ANGLE_RAD {
                    let (roll, pitch) = (roll.to_degrees(), pitch.to_degrees());
                    return Err(row.error(format!(
                        "roll {roll:.0} and pitch {pitch:.0} deg are no attitude: is the unit right?"
                    )));
                }
                Some(Euler { yaw, pitch, roll }.rotation())
            }
            (None, None) => None,
        };
        let vector =
            |columns: Option<[_; 3]>| columns.map(|columns| row.numbers(columns).map(DVec3::from_array)).transpose();
        let (turn_rate, acceleration) = (vector(rates)?, vector(accelerations)?);
        accelerations_sum += acceleration.map_or(0.0, DVec3::length);
        rows.push(ImuSample { stamp_ns, orientation, turn_rate, acceleration });
    }
    if rows.is_empty() {
        return Err(table.error(None, "there is no row behind the head".to_owned()));
    }
    let mean = accelerations_sum / rows.len() as f64;
    if accelerations.is_some() && !MEAN_ACCELERATIONS_M_S2.contains(&mean) {
        let what = format!(
            "the mean acceleration is {mean:.2} m/s^2, and a robot on the ground has 9.8 (gravity is part of it): name the columns ax_g, \
             ay_g, az_g if they count in g"
        );
        return Err(table.error(None, what));
    }
    if tilt.is_some() && quaternion.is_none() && yaw.is_none() {
        assumed.push("no yaw: odometry and lines give the heading".to_owned());
    }
    let stamps = Some(stamps.unit);
    Ok(Measured { rows, stamps, assumed })
}
