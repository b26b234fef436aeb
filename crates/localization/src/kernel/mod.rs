//! The kernel of the filter: the sum over line points of the bilinearly interpolated ground table, for one pose.
//!
//! All numbers are integers: points are 16-bit multiples of a unit, rotated by one multiply-add, and interpolation has steps of
//! a 64th of a cell. Sums of integers are the same in any order, so all paths give the same bits.

// Vector instructions are used behind a check that the processor has them.
#![allow(unsafe_code)]

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "aarch64")]
mod neon;
mod plain;
mod points;
mod rotation;
#[cfg(target_arch = "x86_64")]
mod sse2;

use serde::{Deserialize, Serialize};

pub use points::Points;
use realitysim_geometry::Pose2;
use realitysim_vision::GroundTable;
use realitysim_vision::ground::SIDE;

/// The instructions that the kernel uses. The result is the same for all.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SimdPath {
    /// The fastest path that this processor has.
    #[default]
    Auto,
    /// No explicit vector instructions.
    Scalar,
    /// SSE2 of x86-64.
    Sse2,
    /// AVX2 of x86-64.
    Avx2,
    /// NEON of aarch64.
    Neon,
}

/// Number of points in a group; a group is selected, and summed up, as a whole.
pub const LANES: usize = 8;

/// The wanted path if this processor has it, else the next best one. Every x86-64 processor has SSE2, every aarch64 one NEON.
pub fn available(wanted: SimdPath) -> SimdPath {
    #[cfg(target_arch = "x86_64")]
    {
        match wanted {
            SimdPath::Auto | SimdPath::Avx2 if std::arch::is_x86_feature_detected!("avx2") => SimdPath::Avx2,
            SimdPath::Scalar => SimdPath::Scalar,
            _ => SimdPath::Sse2,
        }
    }
    #[cfg(target_arch = "aarch64")]
    {
        if wanted == SimdPath::Scalar { SimdPath::Scalar } else { SimdPath::Neon }
    }
    #[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
    {
        let _ = wanted;
        SimdPath::Scalar
    }
}

/// The transformation from points to table cells for one pose: u = cos x + sin y + u0, v = cos y - sin x + v0.
///
/// All are in cells x 2^(14 + `shift`), modulo 2^32. Points outside of the table come out beyond its far rim, which reads neutral.
#[derive(Clone, Copy)]
struct Placement {
    cos: i16,
    sin: i16,
    u0: i32,
    v0: i32,
    /// Right shift of u and v; at least 1, so that the shifted value is no negative number for signed instructions either.
    shift: u32,
}

/// Lowest bit of the cell's number in a shifted table coordinate.
const CELL_BIT: u32 = 14;
/// Shifted coordinate of the table's far rim.
const LAST: i32 = (SIDE as i32 - 1) << CELL_BIT;
/// Lowest of the 6 bits that interpolation takes of the position within a cell, f. The weights of the two neighbours are `FULL` - f and f.
const FRACTION_BIT: u32 = CELL_BIT - 6;
/// Largest interpolation weight.
const FULL: i32 = 63;
/// Factor of a sum over table levels, from two interpolations.
const PER_LEVEL: f64 = (FULL * FULL) as f64;
/// Number of points whose sum is kept in 32 bits: four sums side by side do not overflow.
const POINTS_PER_SUM: usize = 8192;

impl Placement {
    /// `None` if none of the points can lie on the table, or the pose is not finite.
    fn new(table: &GroundTable, points: &Points, pose: &Pose2) -> Option<Self> {
        let (scale, offset) = table.to_cells();
        let (sin, cos) = rotation::sin_cos(pose.yaw);
        let (x, y) = (points.centre.x - pose.x, points.centre.y - pose.y);
        let (u, v) = (offset + (cos * x + sin * y) * scale, offset + (cos * y - sin * x) * scale);
        let unit = points.unit_m * scale;
        let reach = core::f64::consts::SQRT_2 * f64::from(i16::MAX) * unit;
        let near = -reach..SIDE as f64 + reach;
        if !(near.contains(&u) && near.contains(&v)) {
            return None;
        }
        // As fine as 16 bits can hold the rotation, and 32 bits the points on both sides of the table without overlap.
        let finest = (f64::from(i16::MAX) / unit).min(4_294_967_296.0 / (2.0 * reach + SIDE as f64 + 2.0));
        let bits = (finest as u32).max(1).ilog2().clamp(CELL_BIT + 1, 30);
        let one = f64::from(1u32 << bits);
        let round = |value: f64| rotation::round(value * one);
        Some(Self {
            cos: round(cos * unit) as i16,
            sin: round(sin * unit) as i16,
            u0: round(u),
            v0: round(v),
            shift: bits - CELL_BIT,
        })
    }
}

/// Reads the word at the lower half of `index`.
///
/// # Safety
/// The lower half of `index` must lie in `quads`.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
unsafe fn word(quads: &[u32], index: u64) -> i32 {
    // SAFETY: as the caller says.
    unsafe { *quads.get_unchecked((index & 0xffff_ffff) as usize) as i32 }
}

/// Sums, over the points, the table's level less its neutral level, for the robot standing at `pose`.
///
/// # Panics
/// If the table does not hold SIDE x SIDE cells.
pub fn sum_levels(path: SimdPath, table: &GroundTable, points: &Points, pose: &Pose2) -> f64 {
    let quads = table.quads();
    assert_eq!(quads.len(), SIDE * SIDE, "the kernel reads without further checks");
    let Some(placement) = Placement::new(table, points, pose) else { return 0.0 };
    let sum = |places: &[[i16; 2]]| {
        let (groups, rest) = places.as_chunks::<LANES>();
        let of_groups = match path {
            #[cfg(target_arch = "x86_64")]
            SimdPath::Avx2 if std::arch::is_x86_feature_detected!("avx2") => {
                // SAFETY: the processor has AVX2, and `quads` holds SIDE x SIDE words.
                unsafe { avx2::sum(avx2::LookUp::of_this_processor(), quads, groups, placement) }
            }
            #[cfg(target_arch = "x86_64")]
            SimdPath::Sse2 => {
                // SAFETY: every x86-64 processor has SSE2, and `quads` holds SIDE x SIDE words.
                unsafe { sse2::sum(quads, groups, placement) }
            }
            #[cfg(target_arch = "aarch64")]
            SimdPath::Neon => {
                // SAFETY: every aarch64 processor has NEON, and `quads` holds SIDE x SIDE words.
                unsafe { neon::sum(quads, groups, placement) }
            }
            _ => plain::sum(quads, groups, placement),
        };
        of_groups + plain::sum_rest(quads, rest, placement)
    };
    let sum: u64 = points.places.chunks(POINTS_PER_SUM).map(sum).sum();
    sum as f64 / PER_LEVEL - points.len() as f64 * f64::from(table.readings().zero)
}

#[cfg(test)]
mod tests;
