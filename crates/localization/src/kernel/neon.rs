//! The NEON path, which every aarch64 processor has: a group is two halves of four points.

use core::arch::aarch64::*;

use super::{CELL_BIT, FRACTION_BIT, FULL, LANES, LAST, Placement};
use realitysim_vision::ground::SIDE;

/// Sums the interpolated levels of groups of points.
///
/// # Safety
/// `quads` must hold SIDE x SIDE words.
#[target_feature(enable = "neon")]
pub(super) unsafe fn sum(quads: &[u32], groups: &[[[i16; 2]; LANES]], p: Placement) -> u64 {
    let (u0, v0) = (vdupq_n_s32(p.u0), vdupq_n_s32(p.v0));
    let (shift, last) = (vdupq_n_s32(-(p.shift as i32)), vdupq_n_u32(LAST as u32));
    let (low_byte, full) = (vdupq_n_u16(0xff), vdupq_n_u32(FULL as u32));
    let on_table = |cells: int32x4_t| vminq_u32(vshlq_u32(vreinterpretq_u32_s32(cells), shift), last);
    // Two sums of four lanes each, so that a lane adds up at most half the points.
    let (mut of_low, mut of_high) = (vdupq_n_u32(0), vdupq_n_u32(0));
    for group in groups {
        // SAFETY: a group is eight pairs of 16 bits.
        let int16x8x2_t(x, y) = unsafe { vld2q_s16(group.as_ptr().cast()) };
        for (x, y) in [(vget_low_s16(x), vget_low_s16(y)), (vget_high_s16(x), vget_high_s16(y))] {
            let u = on_table(vmlal_n_s16(vmlal_n_s16(u0, x, p.cos), y, p.sin));
            let v = on_table(vmlsl_n_s16(vmlal_n_s16(v0, y, p.cos), x, p.sin));
            let (column, row) = (vshrq_n_u32::<{ CELL_BIT as i32 }>(u), vshrq_n_u32::<{ CELL_BIT as i32 }>(v));
            // SAFETY: column and row lie in 0..SIDE, so every index lies in the table.
            let quad = unsafe { look_up(quads, vmlaq_n_u32(column, row, SIDE as u32)) };
            let quad = vreinterpretq_u16_u32(quad);
            let far_u = vandq_u32(vshrq_n_u32::<{ FRACTION_BIT as i32 }>(u), full);
            let far_v = vandq_u32(vshrq_n_u32::<{ FRACTION_BIT as i32 }>(v), full);
            let (near_u, near_v) = (veorq_u32(far_u, full), veorq_u32(far_v, full));
            // First interpolates both rows of a quad along u, then between the rows along v.
            let both = |weights: uint32x4_t| vreinterpretq_u16_u32(vsliq_n_u32::<16>(weights, weights));
            let rows = vmulq_u16(vandq_u16(quad, low_byte), both(near_u));
            let rows = vmlaq_u16(rows, vshrq_n_u16::<8>(quad), both(far_u));
            let of_v = vreinterpretq_u16_u32(vsliq_n_u32::<16>(near_v, far_v));
            of_low = vmlal_u16(of_low, vget_low_u16(rows), vget_low_u16(of_v));
            of_high = vmlal_high_u16(of_high, rows, of_v);
        }
    }
    vaddlvq_u32(of_low) + vaddlvq_u32(of_high)
}

/// Reads four words.
///
/// # Safety
/// Every lane of `index` must lie in `quads`.
#[target_feature(enable = "neon")]
unsafe fn look_up(quads: &[u32], index: uint32x4_t) -> uint32x4_t {
    let pairs = vreinterpretq_u64_u32(index);
    let (ab, cd) = (vgetq_lane_u64::<0>(pairs), vgetq_lane_u64::<1>(pairs));
    let at = |index: u64| quads.as_ptr().wrapping_add((index & 0xffff_ffff) as usize);
    // SAFETY: as the caller says.
    unsafe {
        let quad = vld1q_lane_u32::<0>(at(ab), vdupq_n_u32(0));
        let quad = vld1q_lane_u32::<1>(at(ab >> 32), quad);
        let quad = vld1q_lane_u32::<2>(at(cd), quad);
        vld1q_lane_u32::<3>(at(cd >> 32), quad)
    }
}
