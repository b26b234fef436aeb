//! The plain path, and the definition of what the others compute.

use super::{CELL_BIT, FRACTION_BIT, FULL, LANES, LAST, Placement};
use realitysim_vision::ground::SIDE;

/// Three plain loops a group: a compiler can make the first and the last of them into whatever vectors a processor has.
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

/// Of fewer points than make a group.
pub(super) fn sum_rest(quads: &[u32], places: &[[i16; 2]], p: Placement) -> u64 {
    let read = |place: &[i16; 2]| {
        let (u, v) = cells(*place, p);
        u64::from(interpolated(quads[((v >> CELL_BIT) * SIDE as u32 + (u >> CELL_BIT)) as usize], u, v))
    };
    places.iter().map(read).sum()
}

#[inline(always)]
fn cells([x, y]: [i16; 2], p: Placement) -> (u32, u32) {
    let (x, y, cos, sin) = (i32::from(x), i32::from(y), i32::from(p.cos), i32::from(p.sin));
    let cells = |place: i32, first: i32| (place.wrapping_add(first) as u32 >> p.shift).min(LAST as u32);
    (cells(x * cos + y * sin, p.u0), cells(y * cos - x * sin, p.v0))
}

#[inline(always)]
fn interpolated(quad: u32, u: u32, v: u32) -> u32 {
    // Of a cell and of the next one.
    let weights = |cells: u32| {
        let far = cells >> FRACTION_BIT & FULL as u32;
        (FULL as u32 - far, far)
    };
    let [(near_u, far_u), (near_v, far_v)] = [u, v].map(weights);
    // Two bytes side by side: those of this row and of the next.
    let rows = (quad & 0x00ff_00ff) * near_u + (quad >> 8 & 0x00ff_00ff) * far_u;
    (rows & 0xffff) * near_v + (rows >> 16) * far_v
}
