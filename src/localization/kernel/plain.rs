//! The plain path, and the definition of what the others compute.

use super::{CELL_BIT, FRACTION_BIT, FULL, LAST, Placement};
use crate::vision::ground::SIDE;

pub(super) fn sum(quads: &[u32], places: &[[i16; 2]], p: Placement) -> u64 {
    let (cos, sin) = (i32::from(p.cos), i32::from(p.sin));
    let cells = |place: i32, first: i32| (place.wrapping_add(first) as u32 >> p.shift).min(LAST as u32);
    let read = |&[x, y]: &[i16; 2]| {
        let (x, y) = (i32::from(x), i32::from(y));
        let (u, v) = (cells(x * cos + y * sin, p.u0), cells(y * cos - x * sin, p.v0));
        let quad = quads[((v >> CELL_BIT) * SIDE as u32 + (u >> CELL_BIT)) as usize];
        let [(near_u, far_u), (near_v, far_v)] = [u, v].map(weights);
        // Two bytes side by side: those of this row and of the next.
        let rows = (quad & 0x00ff_00ff) * near_u + (quad >> 8 & 0x00ff_00ff) * far_u;
        u64::from((rows & 0xffff) * near_v + (rows >> 16) * far_v)
    };
    places.iter().map(read).sum()
}

/// Of a cell and of the next one.
fn weights(cells: u32) -> (u32, u32) {
    let far = cells >> FRACTION_BIT & FULL as u32;
    (FULL as u32 - far, far)
}
