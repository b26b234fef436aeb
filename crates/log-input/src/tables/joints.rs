//! Angles of the head's joints.

use super::Measured;
use super::stamp::{InOrder, StampColumn};
use super::table::{Table, TableError};
use super::units::{AngleUnit, Quantity};

/// Angles of the head's joints at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointsSample {
    /// Time of the measurement, nanoseconds.
    pub stamp_ns: i64,
    /// Angle about the torso's z axis, radians, positive to the left.
    pub pan: f64,
    /// Angle about the panned head's y axis, radians, positive downwards.
    pub tilt: f64,
}

/// Reads a table of `pan` and `tilt`, each with a unit; one that is missing is 0.
pub fn read(table: &mut Table, angles: Option<AngleUnit>) -> Result<Measured<JointsSample>, TableError> {
    let stamps = StampColumn::find(table)?.ok_or_else(|| table.lacks("the column stamp (or time, t) is missing"))?;
    let pan = table.take_number(&["pan", "head_pan"], Quantity::Angle, angles)?;
    let tilt = table.take_number(&["tilt", "head_tilt"], Quantity::Angle, angles)?;
    let assumed = match (pan, tilt) {
        (None, None) => return Err(table.lacks("there is neither pan_deg nor tilt_deg")),
        (None, Some(_)) => vec!["no pan: 0 is taken".to_owned()],
        (Some(_), None) => vec!["no tilt: 0 is taken".to_owned()],
        (Some(_), Some(_)) => Vec::new(),
    };
    let (mut rows, mut order) = (Vec::new(), InOrder::default());
    for row in table.rows() {
        let row = row?;
        let stamp_ns = stamps.read(&row)?;
        order.check(&row, stamp_ns)?;
        let angle = |column: Option<_>| column.map_or(Ok(0.0), |column| row.number(column));
        let (pan, tilt) = (angle(pan)?, angle(tilt)?);
        if pan.abs().max(tilt.abs()) > MAX_JOINT_RAD {
            let (pan, tilt) = (pan.to_degrees(), tilt.to_degrees());
            return Err(row.error(format!("pan {pan:.0} and tilt {tilt:.0} deg are no head's: is the unit right?")));
        }
        rows.push(JointsSample { stamp_ns, pan, tilt });
    }
    if rows.is_empty() {
        return Err(table.error(None, "there is no row behind the head".to_owned()));
    }
    Ok(Measured { rows, stamps: Some(stamps.unit), assumed })
}

/// Largest angle of a head's joint, radians.
const MAX_JOINT_RAD: f64 = core::f64::consts::PI + 0.01;
