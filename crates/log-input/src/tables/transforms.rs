//! Transforms between coordinate frames: constant ones, and ones that move.

use glam::{DQuat, DVec3};

use super::Measured;
use super::stamp::StampColumn;
use super::table::{Row, Table, TableError};
use super::units::{AngleUnit, Quantity};
use realitysim_geometry::physical::MAX_MOUNT_M;
use realitysim_geometry::{Euler, Isometry};

/// A transform of a table.
#[derive(Clone, Debug, PartialEq)]
pub struct TransformSample {
    /// Time at which it holds, nanoseconds; `None` for a constant one.
    pub stamp_ns: Option<i64>,
    /// Name of the parent coordinate frame.
    pub parent: String,
    /// Name of the child coordinate frame.
    pub child: String,
    /// Turns coordinates of `child` into those of `parent`, metres.
    pub parent_from_child: Isometry,
}

/// Largest number of characters in the name of a coordinate frame.
const MAX_NAME_CHARACTERS: usize = 100;

/// Reads a table of `parent`, `child`, `x`, `y`, `z`, and `roll`, `pitch`, `yaw` with a unit or `qx`, `qy`, `qz`, `qw`. With a column of
/// stamps the transforms move, and the rows of each child must follow each other in time.
pub fn read(table: &mut Table, angles: Option<AngleUnit>) -> Result<Measured<TransformSample>, TableError> {
    let stamps = StampColumn::find(table)?;
    let parent = table.take(&["parent", "frame_id"])?.ok_or_else(|| table.lacks("the column parent is missing"))?;
    let child = table.take(&["child", "child_frame_id"])?.ok_or_else(|| table.lacks("the column child is missing"))?;
    let position = table.take_numbers([&["x"], &["y"], &["z"]], Quantity::Length, None)?;
    let position = position.ok_or_else(|| table.lacks("the columns x, y and z are missing"))?;
    let quaternion = table.take_numbers([&["qx"], &["qy"], &["qz"], &["qw"]], Quantity::Plain, None)?;
    let euler = table.take_numbers([&["roll"], &["pitch"], &["yaw"]], Quantity::Angle, angles)?;
    if quaternion.is_none() && euler.is_none() {
        return Err(table.lacks("there is no rotation (roll_deg,pitch_deg,yaw_deg or qx,qy,qz,qw)"));
    }
    let rotation = |row: &Row| -> Result<DQuat, TableError> {
        if let Some(columns) = quaternion {
            return row.quaternion(columns);
        }
        let [roll, pitch, yaw] = euler.map_or(Ok([0.0; 3]), |columns| row.numbers(columns))?;
        Ok(Euler { yaw, pitch, roll }.rotation())
    };
    let mut rows: Vec<TransformSample> = Vec::new();
    let mut newest = std::collections::BTreeMap::new();
    for row in table.rows() {
        let row = row?;
        let stamp_ns = stamps.map(|column| column.read(&row)).transpose()?;
        let name = |index: usize| match row.text(index).trim_start_matches('/') {
            "" => Err(row.wrong(index, "must name a coordinate frame")),
            name if name.chars().count() > MAX_NAME_CHARACTERS => Err(row.wrong(index, "is longer than any name")),
            name => Ok(name.to_owned()),
        };
        let (parent, child) = (name(parent)?, name(child)?);
        let translation = DVec3::from_array(row.numbers(position)?);
        if translation.length() > MAX_MOUNT_M {
            return Err(row.error(format!("it leads {:.0} m away: is the unit right?", translation.length())));
        }
        if let Some(line) = newest.get(&child).filter(|(last_ns, _)| stamp_ns <= *last_ns).map(|(_, line)| line) {
            let what = format!(
                "the transform to {child} is not later than that of line {line}: each needs a stamp of its own"
            );
            return Err(row.error(what));
        }
        newest.insert(child.clone(), (stamp_ns, row.line));
        rows.push(TransformSample {
            stamp_ns,
            parent,
            child,
            parent_from_child: Isometry::new(rotation(&row)?, translation),
        });
    }
    if rows.is_empty() {
        return Err(table.error(None, "there is no row behind the head".to_owned()));
    }
    Ok(Measured { rows, stamps: stamps.map(|column| column.unit), assumed: Vec::new() })
}
