//! Converts between the axes of aviation, which MAVLink uses, and those of REP 103.
//!
//! MAVLink's bodies are FRD (x forward, y right, z down), its worlds NED (north, east, down), or FRD and FLU with a heading
//! of their own. In this project bodies are FLU (x forward, y left, z up), and worlds ENU (east, north, up) or FLU.

use core::f64::consts::FRAC_1_SQRT_2;

use glam::{DMat3, DQuat, DVec3};

/// Rotation from FRD to FLU and back: half a turn about x.
pub const FLU_FROM_FRD: DQuat = DQuat::from_xyzw(1.0, 0.0, 0.0, 0.0);
/// Rotation from NED to ENU and back: half a turn about the bisector of x and y.
pub const ENU_FROM_NED: DQuat = DQuat::from_xyzw(FRAC_1_SQRT_2, FRAC_1_SQRT_2, 0.0, 0.0);

/// Converts a vector from FRD to FLU or back. This is exact, unlike a rotation by the quaternion.
pub fn flu_from_frd(v: DVec3) -> DVec3 {
    DVec3::new(v.x, -v.y, -v.z)
}

/// Converts a vector from NED to ENU or back, exactly.
pub fn enu_from_ned(v: DVec3) -> DVec3 {
    DVec3::new(v.y, v.x, -v.z)
}

/// Returns a 6 x 6 covariance (x, y, z, rotations about x, y, z) in turned axes, row by row.
///
/// `triangle` is its upper triangle, row by row; `turn` turns a vector into the new axes.
pub fn turned_covariance(triangle: &[f32; 21], turn: impl Fn(DVec3) -> DVec3) -> [f64; 36] {
    let mut full = [[0.0; 6]; 6];
    let places = (0..6).flat_map(|row| (row..6).map(move |column| (row, column)));
    for ((row, column), value) in places.zip(triangle) {
        full[row][column] = f64::from(*value);
        full[column][row] = f64::from(*value);
    }
    let turn = DMat3::from_cols(turn(DVec3::X), turn(DVec3::Y), turn(DVec3::Z));
    let mut turned = [0.0; 36];
    for (down, across) in [(0, 0), (0, 3), (3, 0), (3, 3)] {
        let block = DMat3::from_cols_array(&core::array::from_fn(|i| full[down + i % 3][across + i / 3]));
        let block = turn * block * turn.transpose();
        for row in 0..3 {
            for column in 0..3 {
                turned[6 * (down + row) + across + column] = block.col(column)[row];
            }
        }
    }
    turned
}
