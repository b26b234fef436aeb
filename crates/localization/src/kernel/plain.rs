//! The plain path, which defines what the other paths compute.

use super::{CELL_BIT, FRACTION_BIT, FULL, LANES, LAST, Placement};
use realitysim_vision::ground::SIDE;

/// Sums the interpolated levels of groups of points.
///
/// A group takes three plain loops; the compiler can vectorise the first and the last of them.
pub(super) fn sum(quads: &[u32], groups: &[[[i16; 2]; LANES]], p: Placement) -> u64 {
    let of_group = |group: &[[i16; 2]; LANES]| {
        let (mut us, mut vs) = ([0u32; LANES], [0u32; LANES]);
        for ((place, u), v) in group.iter().zip(&mut us).zip(&mut vs) {
            (*u, *v) = cells(*place, p);
        }
        let mut neighbours = [0u32; LANES];
        for ((quad, u), v) in neighbours.iter_mut().zip(&us).zip(&vs) {
            *quad = quads[((v >> CELL_BIT) * SIDE as u32 + (u >> CELL_BIT)) as usize];
        }
        let level = |((quad, u), v): ((&u32, &u32), &u32)| interpolated(*quad, *u, *v);
        u64::from(neighbours.iter().zip(&us).zip(&vs).map(level).sum::<u32>())
    };
    groups.iter().map(of_group).sum()
}

/// Sums the interpolated levels of points that do not fill a group.
pub(super) fn sum_rest(quads: &[u32], places: &[[i16; 2]], p: Placement) -> u64 {
    let read = |place: &[i16; 2]| {
        let (u, v) = cells(*place, p);
        u64::from(interpolated(quads[((v >> CELL_BIT) * SIDE as u32 + (u >> CELL_BIT)) as usize], u, v))
    };
    places.iter().map(read).sum()
}

/// Shifted table coordinates of a point.
#[inline(always)]
fn cells([x, y]: [i16; 2], p: Placement) -> (u32, u32) {
    let (x, y, cos, sin) = (i32::from(x), i32::from(y), i32::from(p.cos), i32::from(p.sin));
    let cells = |place: i32, first: i32| (place.wrapping_add(first) as u32 >> p.shift).min(LAST as u32);
    (cells(x * cos + y * sin, p.u0), cells(y * cos - x * sin, p.v0))
}

/// The level between the four cells of `quad`, times [`super::PER_LEVEL`].
#[inline(always)]
fn interpolated(quad: u32, u: u32, v: u32) -> u32 {
    // The weights of a cell and of the next one.
    let weights = |cells: u32| {
        let far = cells >> FRACTION_BIT & FULL as u32;
        (FULL as u32 - far, far)
    };
    let [(near_u, far_u), (near_v, far_v)] = [u, v].map(weights);
    // Interpolates along u in two halves of a word: this row in the lower half, the next row in the upper.
    let rows = (quad & 0x00ff_00ff) * near_u + (quad >> 8 & 0x00ff_00ff) * far_u;
    (rows & 0xffff) * near_v + (rows >> 16) * far_v
}
