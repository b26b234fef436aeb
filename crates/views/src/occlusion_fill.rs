//! Filling of pixels that figures hide in every source.
//!
//! A figure that other sources show free is not in the view. One that hides something in all of them is drawn whole, from the
//! nearest source, as an upright board: never a part of a body smeared along the ground. What is still hidden then is
//! interpolated from what is beside it. All of this is marked unsure.

use super::compose::Composed;
use super::figure_board::FigureBoard;
use super::ground_warp::Warp;
use super::photometry::Gain;
use super::raster::{NOTHING, Raster, UNSURE};
use super::sample::read;
use super::synthesized_view::{Candidate, Request};
use super::target_rays::Target;
use super::world::Surface;

/// A pixel of the view that a figure hides in every source that would show it.
struct Hidden {
    /// Index of the pixel.
    at: usize,
    /// The nearest of these sources.
    source: usize,
    /// The figure there; `None` if the source says that something moves there, but not which figure.
    figure: Option<usize>,
    /// Whether something beyond the ground is hidden.
    is_far: bool,
}

/// A figure is drawn if this share of it hides something in all sources. Where less is hidden, the figure is not in the view, and
/// the carpet at its feet is interpolated.
const DRAWN_FROM_SHARE: f64 = 0.3;
/// The same for what is beyond the ground, which has too much structure to be interpolated.
const DRAWN_FROM_FAR_SHARE: f64 = 0.03;
/// Figures of two sources that stand within this distance are the same one, metres.
const SAME_FIGURE_M: f64 = 0.6;

/// Fills the pixels that the composition has left black because figures hide them.
pub(super) fn fill(
    composed: &mut Composed,
    request: &Request,
    target: &Target,
    warps: &[Warp],
    sources: &[Candidate],
    gains: &[Gain],
) {
    let hidden = hidden_pixels(&composed.image, target, warps);
    if hidden.is_empty() {
        return;
    }
    let behind = composed.image.clone();
    for (source, board) in boards(&hidden, request, target, sources, gains) {
        composed.pixels[source] += board.draw(&behind, composed) as f64;
    }
    let is_left = |image: &Raster, hidden: &&Hidden| image.pixels[hidden.at][3] == NOTHING;
    let left: Vec<&Hidden> = hidden.iter().filter(|hidden| is_left(&composed.image, hidden)).collect();
    for hidden in &left {
        composed.pixels[hidden.source] += 1.0;
    }
    let of_figures: Vec<&Hidden> = left.iter().copied().filter(|hidden| hidden.figure.is_some()).collect();
    interpolate(&mut composed.image, &of_figures);
    // There is nothing beside the others that could be interpolated.
    for hidden in left {
        if is_left(&composed.image, &hidden) {
            let warp = &warps[hidden.source];
            composed.image.pixels[hidden.at] = as_seen(hidden, request, target, warp, &gains[hidden.source]);
        }
    }
}

/// What the source shows in a hidden pixel, on ground or hall.
fn as_seen(hidden: &Hidden, request: &Request, target: &Target, warp: &Warp, gain: &Gain) -> [u8; 4] {
    let (camera, source) = (target.camera(), warp.source());
    let (u, v) = (hidden.at % camera.width(), hidden.at / camera.width());
    let Some((at, _)) = warp.pixel(u, v) else { return [0, 0, 0, NOTHING] };
    let rgb = read(source.image.full(), at.x as f32, at.y as f32);
    let there = source.vignetting.at(source.camera.lens(), at.x, at.y);
    let light = request.vignetting.at(camera.lens(), u as f64, v as f64) / there;
    let lit = |c: usize| (f64::from(rgb[c]) * gain.rgb[c] * light + 0.5).min(255.0) as u8;
    [lit(0), lit(1), lit(2), UNSURE]
}

/// The pixels that a figure hides in every source, row by row.
fn hidden_pixels(image: &Raster, target: &Target, warps: &[Warp]) -> Vec<Hidden> {
    let shows = target.camera().shows();
    let black = image.pixels.iter().enumerate().filter(|(at, pixel)| pixel[3] == NOTHING && shows[*at]);
    black
        .filter_map(|(at, _)| {
            let (u, v) = (at % image.width, at / image.width);
            warps.iter().enumerate().find_map(|(source, warp)| {
                let (there, surface) = warp.pixel(u, v)?;
                let of = &warp.source().image;
                let is_shown = read(of.full(), there.x as f32, there.y as f32)[3] >= UNSURE;
                let (left, top) = (there.x as usize, there.y as usize);
                let corners = [(0, 0), (1, 0), (0, 1), (1, 1)].into_iter().filter(|_| is_shown);
                let mut figures = corners.filter_map(|(x, y)| of.figures().at(left + x, top + y));
                let figure = figures.next();
                let is_far = surface == Surface::Far;
                is_shown.then_some(Hidden { at, source, figure, is_far })
            })
        })
        .collect()
}

/// The figures that are drawn, each with its source: the farthest first, so that nearer ones hide it.
fn boards<'a>(
    hidden: &[Hidden],
    request: &Request,
    target: &'a Target,
    sources: &'a [Candidate],
    gains: &[Gain],
) -> Vec<(usize, FigureBoard<'a>)> {
    // Hidden pixels of each figure, and those of them that are beyond the ground.
    let mut counts: Vec<((usize, usize), [usize; 2])> = Vec::new();
    for (hidden, figure) in hidden.iter().filter_map(|hidden| Some((hidden, hidden.figure?))) {
        let key = (hidden.source, figure);
        let known = counts.iter().position(|(known, _)| *known == key).unwrap_or(counts.len());
        if known == counts.len() {
            counts.push((key, [0; 2]));
        }
        let [all, far] = &mut counts[known].1;
        (*all, *far) = (*all + 1, *far + usize::from(hidden.is_far));
    }
    counts.sort_unstable_by_key(|(key, _)| *key);
    let mut boards: Vec<(usize, FigureBoard)> = Vec::new();
    for ((source, figure), [all, far]) in counts {
        let area = area(target, &sources[source], figure);
        if (all as f64) < DRAWN_FROM_SHARE * area && (far as f64) < DRAWN_FROM_FAR_SHARE * area {
            continue;
        }
        let board = FigureBoard::new(target, &sources[source], figure, &gains[source], &request.vignetting);
        let is_same = |other: &FigureBoard| other.foot().distance(board.foot()) < SAME_FIGURE_M;
        if !boards.iter().any(|(of, other)| *of != source && is_same(other)) {
            boards.push((source, board));
        }
    }
    boards.sort_by(|(_, a), (_, b)| b.distance_m().total_cmp(&a.distance_m()));
    boards
}

/// Approximate number of pixels of the view that a figure takes up.
fn area(target: &Target, source: &Candidate, figure: usize) -> f64 {
    let figures = source.image.figures();
    let scale = target.camera().lens().focal() / source.camera.lens().focal() * figures.side() as f64;
    figures.blocks(figure).count() as f64 * scale * scale
}

/// Fills hidden pixels between what is known to their left and right in the same row, or else from above.
fn interpolate(image: &mut Raster, hidden: &[&Hidden]) {
    let mut rest = hidden;
    while let Some(first) = rest.first() {
        // Indices ascend: a run is what follows the first without a gap, in the same row.
        let row_end = (first.at / image.width + 1) * image.width;
        let is_run = |(step, hidden): &(usize, &&Hidden)| hidden.at == first.at + step && hidden.at < row_end;
        let length = rest.iter().enumerate().take_while(is_run).count();
        let [left, right] = [first.at.checked_sub(1).filter(|at| at + image.width >= row_end), Some(first.at + length)];
        let known =
            |at: Option<usize>| at.filter(|at| *at < row_end).map(|at| image.pixels[at]).filter(|p| p[3] != NOTHING);
        let (left, right) = (known(left), known(right));
        let ends = left.or(right).zip(right.or(left));
        for (step, hidden) in rest[..length].iter().enumerate() {
            let share = (step + 1) as f32 / (length + 1) as f32;
            let above =
                hidden.at.checked_sub(image.width).map(|at| image.pixels[at]).filter(|pixel| pixel[3] != NOTHING);
            if let Some((a, b)) = ends.or(above.zip(above)) {
                let mixed = |c: usize| (f32::from(a[c]) * (1.0 - share) + f32::from(b[c]) * share + 0.5) as u8;
                image.pixels[hidden.at] = [mixed(0), mixed(1), mixed(2), UNSURE];
            }
        }
        rest = &rest[length..];
    }
}
