//! Saddles of brightness: where two dark and two light areas meet.

use glam::DVec2;

use crate::Picture;

/// A point where brightness is a saddle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Saddle {
    pub(super) pixel: DVec2,
    /// Unit vectors along both edges that cross here.
    pub(super) edges: [DVec2; 2],
}

/// Most saddles of one picture, the strongest first: a board has up to three thousand corners.
const MAX_SADDLES: usize = 4000;
/// Weakest saddle, as a share of the strongest: the rim of a fisheye is dark.
const MIN_SHARE: f32 = 0.01;
/// Weakest saddle, in squares of gray levels by pixels squared: less is noise.
const MIN_STRENGTH: f32 = 6.0;
/// A saddle is the strongest one within this distance, pixels.
const APART: usize = 2;
/// Farthest that the saddle lies from the middle of its pixel, pixels.
const REACH_PX: f64 = 1.5;

/// Second derivatives, and first ones, of the smoothed picture at a pixel.
struct Curvature {
    xx: f32,
    xy: f32,
    yy: f32,
    x: f32,
    y: f32,
}

/// The strongest saddles of a picture.
pub(super) fn saddles(picture: &Picture) -> Vec<Saddle> {
    let (width, height) = (picture.width, picture.height);
    if width < 16 || height < 16 {
        return Vec::new();
    }
    let smooth = smoothed(picture);
    let mut strength = vec![0.0f32; width * height];
    for row in 2..height - 2 {
        for column in 2..width - 2 {
            let Curvature { xx, xy, yy, .. } = curvature(&smooth, width, row * width + column);
            strength[row * width + column] = (xy * xy - xx * yy).max(0.0);
        }
    }
    let least = (MIN_SHARE * strength.iter().copied().fold(0.0, f32::max)).max(MIN_STRENGTH);
    let mut peaks: Vec<usize> = (APART..height - APART)
        .flat_map(|row| (APART..width - APART).map(move |column| row * width + column))
        .filter(|at| strength[*at] > least && is_peak(&strength, width, *at))
        .collect();
    peaks.sort_by(|a, b| strength[*b].total_cmp(&strength[*a]));
    peaks.truncate(MAX_SADDLES);
    peaks.into_iter().filter_map(|at| saddle(&curvature(&smooth, width, at), at, width)).collect()
}

/// The picture smoothed by a binomial filter of five by five pixels.
fn smoothed(picture: &Picture) -> Vec<f32> {
    const KERNEL: [f32; 5] = [1.0 / 16.0, 4.0 / 16.0, 6.0 / 16.0, 4.0 / 16.0, 1.0 / 16.0];
    let (width, height) = (picture.width, picture.height);
    let weighted = |values: [f32; 5]| KERNEL.iter().zip(values).map(|(weight, value)| weight * value).sum::<f32>();
    // Beyond the edge the picture goes on as at the edge.
    let tap = |here: usize, tap: usize, count: usize| (here + tap).saturating_sub(2).min(count - 1);
    let luma: Vec<f32> = picture.luma.iter().map(|value| f32::from(*value)).collect();
    let mut across = luma.clone();
    for (from, to) in luma.chunks_exact(width).zip(across.chunks_exact_mut(width)) {
        for (window, value) in from.windows(5).zip(&mut to[2..]) {
            *value = weighted([window[0], window[1], window[2], window[3], window[4]]);
        }
        for column in [0, 1, width - 2, width - 1] {
            to[column] = weighted(core::array::from_fn(|offset| from[tap(column, offset, width)]));
        }
    }
    let mut smooth = vec![0.0; luma.len()];
    for (row, to) in smooth.chunks_exact_mut(width).enumerate() {
        let rows: [&[f32]; 5] = core::array::from_fn(|offset| &across[tap(row, offset, height) * width..][..width]);
        for (column, value) in to.iter_mut().enumerate() {
            *value = weighted(rows.map(|row| row[column]));
        }
    }
    smooth
}

fn curvature(smooth: &[f32], width: usize, at: usize) -> Curvature {
    let value = |column: isize, row: isize| smooth[at.wrapping_add_signed(row * width as isize + column)];
    let here = 2.0 * value(0, 0);
    Curvature {
        xx: value(1, 0) + value(-1, 0) - here,
        yy: value(0, 1) + value(0, -1) - here,
        xy: 0.25 * (value(1, 1) + value(-1, -1) - value(1, -1) - value(-1, 1)),
        x: 0.5 * (value(1, 0) - value(-1, 0)),
        y: 0.5 * (value(0, 1) - value(0, -1)),
    }
}

fn is_peak(strength: &[f32], width: usize, at: usize) -> bool {
    let reach = APART as isize;
    let beside = (-reach..=reach).flat_map(|row| (-reach..=reach).map(move |column| row * width as isize + column));
    beside.filter(|step| *step != 0).all(|step| {
        let other = strength[at.wrapping_add_signed(step)];
        // Of two equal ones the first is taken.
        other < strength[at] || other == strength[at] && step > 0
    })
}

/// The saddle of the quadratic that a pixel's derivatives describe.
fn saddle(curvature: &Curvature, at: usize, width: usize) -> Option<Saddle> {
    let Curvature { xx, xy, yy, x, y } = *curvature;
    let [xx, xy, yy, x, y] = [xx, xy, yy, x, y].map(f64::from);
    let determinant = xx * yy - xy * xy;
    let off = DVec2::new(xy * y - yy * x, xy * x - xx * y) / determinant;
    if !off.is_finite() || off.abs().max_element() > REACH_PX {
        return None;
    }
    // Along an edge the quadratic form is 0: at equal angles on both sides of the axis of the positive eigenvalue.
    let (mean, half) = (0.5 * (xx + yy), libm::hypot(0.5 * (xx - yy), xy));
    let axis = 0.5 * libm::atan2(2.0 * xy, xx - yy);
    let angle = libm::atan2(libm::sqrt((half + mean).max(0.0)), libm::sqrt((half - mean).max(0.0)));
    let pixel = DVec2::new((at % width) as f64, (at / width) as f64) + off;
    Some(Saddle { pixel, edges: [axis + angle, axis - angle].map(DVec2::from_angle) })
}
