//! Line contrast: how much brighter a pixel is than the carpet around it, as a share of the carpet's brightness.
//!
//! It is a narrow blur (sigma 2.1 px) minus a wide one (sigma 12 px), over the wide one. Plain carpet gives 0 whatever its
//! brightness and whatever the light's gradient, which makes a sum over points a fair measure (docs/explanation/paper.md, Eq. 2).
//! Paint gives the same in sun and shade: light multiplies carpet and paint alike, and the camera's gamma keeps ratios.
//! The narrow blur is computed at a half, the wide one at an eighth of the resolution, both in integers. The quotient is one division
//! in IEEE arithmetic, so that every processor gives the same bits.

use glam::DVec2;

use super::carpet::Surface;
use super::picture::Picture;
use realitysim_geometry::multiversion::rounded;
use realitysim_geometry::multiversioned;

/// Half-resolution images, row by row: pixel (i, j) covers the picture's pixels (2i, 2i + 1) x (2j, 2j + 1).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LineContrast {
    /// Columns, half those of the picture.
    pub width: usize,
    /// Rows, half those of the picture.
    pub height: usize,
    /// Sum of the luma of the four pixels.
    pub half: Vec<u16>,
    /// Narrow blur of the luma, in [`UNITS`].
    pub narrow: Vec<u16>,
    /// Line contrast in [`PARTS`], negative where the pixel is darker than its surroundings. The two lowest bits hold what
    /// the pixel shows ([`surface`]).
    pub contrast: Vec<i16>,
    scratch: Scratch,
}

/// Intermediate images.
#[derive(Clone, Debug, Default, PartialEq)]
struct Scratch {
    rows: Vec<u16>,
    sums: Vec<f32>,
    counts: Vec<f32>,
    blurred: Vec<f32>,
    levels: Vec<u16>,
    /// The wide blur, with coarse rows and half-resolution columns.
    expanded: Vec<u16>,
}

/// Units of a gray level in blurred images.
pub const UNITS: f32 = 16.0;
/// Units of a line contrast of 1, at which a pixel is twice as bright as the carpet.
pub const PARTS: f32 = 4096.0;
/// Gray levels that are added to the carpet's brightness in the denominator of a line contrast.
///
/// Where little light falls, stray light and the sensor's noise do not fall with the carpet's own light.
pub const STRAY_LEVELS: f32 = 16.0;
/// Side of a cell of the coarse image, in half-resolution pixels.
pub(super) const COARSE: usize = 4;

/// Standard deviation of the narrow blur, in pixels of the working image, halving included.
const NARROW_SIGMA_PX: f64 = 2.1;
/// Standard deviation of the wide blur, in pixels of the working image, halving and quartering included.
const WIDE_SIGMA_PX: f64 = 11.8;
/// The largest difference of the two blurs in the middle of a line of height 1, that of a line 8 px wide.
pub const BEST_RESPONSE: f64 = 0.672;

/// Contrast in the middle of a long line of this width in working pixels, as a share of that of a line of the best width: 0 to 1.
pub fn line_response(width_px: f64) -> f64 {
    let within = |sigma: f64| libm::erf(width_px / (2.0 * core::f64::consts::SQRT_2 * sigma));
    ((within(NARROW_SIGMA_PX) - within(WIDE_SIGMA_PX)) / BEST_RESPONSE).clamp(1e-3, 1.0)
}

/// Decodes what a pixel shows from its line contrast.
pub fn surface(contrast: i16) -> Surface {
    Surface::from_bits(contrast as u8)
}

/// Number of columns and rows of the wide blur's coarse cells in a picture of this size.
pub fn coarse_size(width: usize, height: usize) -> (usize, usize) {
    (width / 2 / COARSE, height / 2 / COARSE)
}

/// The half-resolution column or row in the middle of a coarse column or row.
pub fn coarse_middle(cell: usize) -> usize {
    cell * COARSE + (COARSE - 1) / 2
}

/// Iterates over the centres of the coarse cells, row by row, in the picture's pixels.
pub fn coarse_centres(width: usize, height: usize) -> impl Iterator<Item = DVec2> {
    let (columns, rows) = coarse_size(width, height);
    let centre = |cell: usize| (cell * 2 * COARSE) as f64 + COARSE as f64 - 0.5;
    (0..rows).flat_map(move |row| (0..columns).map(move |column| DVec2::new(centre(column), centre(row))))
}

impl LineContrast {
    /// Computes what needs the picture alone: half resolution and narrow blur. Call [`Self::finish`] afterwards.
    pub fn start(&mut self, picture: &Picture) {
        (self.width, self.height) = (picture.width / 2, picture.height / 2);
        if self.width < COARSE || self.height < COARSE {
            (self.width, self.height) = (0, 0);
        }
        let count = self.width * self.height;
        self.half.resize(count, 0);
        self.narrow.resize(count, 0);
        self.contrast.resize(count, 0);
        self.scratch.rows.resize(count, 0);
        if count == 0 {
            return;
        }
        let contrast = self;
        multiversioned!(|contrast: &mut LineContrast, picture: &Picture| {
            let LineContrast { width, half, narrow, scratch, .. } = contrast;
            halve(picture, *width, half);
            blur_rows(half, *width, &mut scratch.rows);
            blur_columns(&scratch.rows, *width, narrow);
        });
    }

    /// Computes the wide blur and the contrast.
    ///
    /// `surfaces` says what each half-resolution pixel shows; `on_carpet` has one entry per cell of [`coarse_centres`].
    /// The wide blur averages only carpet and lines, so that walls beyond the field, robots on it or the black rim of a fisheye
    /// do not look like a change of light.
    pub fn finish(&mut self, surfaces: &[Surface], on_carpet: &[bool]) {
        if self.width == 0 {
            return;
        }
        let contrast = self;
        multiversioned!(|contrast: &mut LineContrast, surfaces: &[Surface], on_carpet: &[bool]| {
            let LineContrast { width, height, half, narrow, contrast, scratch } = contrast;
            coarse_means(half, surfaces, *width, *height, on_carpet, scratch);
            expand(*width, *height, scratch);
            subtract(narrow, &scratch.expanded, surfaces, *width, contrast);
        });
    }
}

/// Sums the luma of 2 x 2 pixels.
#[inline(always)]
fn halve(picture: &Picture, width: usize, half: &mut [u16]) {
    for (v, target) in half.chunks_exact_mut(width).enumerate() {
        let upper = &picture.luma[2 * v * picture.width..][..2 * width];
        let lower = &picture.luma[(2 * v + 1) * picture.width..][..2 * width];
        let ((upper, _), (lower, _)) = (upper.as_chunks::<2>(), lower.as_chunks::<2>());
        for ((t, a), b) in target.iter_mut().zip(upper).zip(lower) {
            // Two bytes are read as one word, and its halves are added.
            let (a, b) = (u16::from_le_bytes(*a), u16::from_le_bytes(*b));
            *t = (a & 255) + (a >> 8) + (b & 255) + (b >> 8);
        }
    }
}

/// Blurs along rows by the binomial filter 1 4 6 4 1 (sigma 1 pixel); edges repeat the last pixel.
///
/// It turns sums of four pixels into sixteenths of gray levels: at most 4 x 255 x 16 / 4.
#[inline(always)]
fn blur_rows(half: &[u16], width: usize, rows: &mut [u16]) {
    let tap = |a: u16, b: u16, c: u16, d: u16, e: u16| (a + e + 4 * (b + d) + 6 * c + 2) >> 2;
    for (source, target) in half.chunks_exact(width).zip(rows.chunks_exact_mut(width)) {
        let at = |u: isize| source[u.clamp(0, width as isize - 1) as usize];
        for u in [0, 1, width - 2, width - 1] {
            let i = u as isize;
            target[u] = tap(at(i - 2), at(i - 1), at(i), at(i + 1), at(i + 2));
        }
        let inner = width - 4;
        let (a, b, c, d, e) = (
            &source[..inner],
            &source[1..][..inner],
            &source[2..][..inner],
            &source[3..][..inner],
            &source[4..][..inner],
        );
        for (u, t) in target[2..][..inner].iter_mut().enumerate() {
            *t = tap(a[u], b[u], c[u], d[u], e[u]);
        }
    }
}

/// Blurs along columns by the same filter; sixteenths of gray levels in and out. Sums are at most 16 x 4080 + 8, which fits 16 bits.
#[inline(always)]
fn blur_columns(rows: &[u16], width: usize, narrow: &mut [u16]) {
    let height = narrow.len() / width;
    for (v, target) in narrow.chunks_exact_mut(width).enumerate() {
        let row = |dv: isize| &rows[(v as isize + dv).clamp(0, height as isize - 1) as usize * width..][..width];
        let (a, b, c, d, e) = (row(-2), row(-1), row(0), row(1), row(2));
        for (u, t) in target.iter_mut().enumerate() {
            *t = (a[u] + e[u] + 4 * (b[u] + d[u]) + 6 * c[u] + 8) >> 4;
        }
    }
}

/// Averages the carpet within about 12 pixels of each coarse cell; where there is none, takes the pixel in the middle of the cell.
///
/// The result is in `scratch.sums`, in [`UNITS`].
#[inline(always)]
fn coarse_means(
    half: &[u16],
    surfaces: &[Surface],
    width: usize,
    height: usize,
    on_carpet: &[bool],
    scratch: &mut Scratch,
) {
    let (cw, ch) = (width / COARSE, height / COARSE);
    let Scratch { sums, counts, blurred, rows, .. } = scratch;
    sums.clear();
    counts.clear();
    blurred.resize(cw * ch, 0.0);
    // The rows of a coarse row are summed first, because they are contiguous in memory.
    let (columns, lit) = rows.split_at_mut(width);
    let lit = &mut lit[..width];
    for cv in 0..ch {
        columns.fill(0);
        lit.fill(0);
        for v in cv * COARSE..(cv + 1) * COARSE {
            let (values, surfaces) = (&half[v * width..][..width], &surfaces[v * width..][..width]);
            for u in 0..width {
                let shows = u16::from(!surfaces[u].is_occluder());
                columns[u] += values[u] * shows;
                lit[u] += shows;
            }
        }
        for cu in 0..cw {
            let carpet = on_carpet.get(cv * cw + cu).copied().unwrap_or(true);
            let of =
                |values: &[u16]| values[cu * COARSE..][..COARSE].iter().map(|value| u32::from(*value)).sum::<u32>();
            sums.push(if carpet { of(columns) as f32 } else { 0.0 });
            counts.push(if carpet { of(lit) as f32 } else { 0.0 });
        }
    }
    for image in [&mut *sums, &mut *counts] {
        for _ in 0..2 {
            blur_coarse(image, blurred, cw);
        }
    }
    for (cell, (sum, count)) in sums.iter_mut().zip(counts.iter()).enumerate() {
        // A sum of four pixels for each counted half-resolution pixel, in units.
        *sum = if *count > 0.05 {
            *sum / *count * (UNITS / 4.0)
        } else {
            let (cv, cu) = (cell / cw, cell % cw);
            f32::from(half[(cv * COARSE + COARSE / 2) * width + cu * COARSE + COARSE / 2]) * (UNITS / 4.0)
        };
    }
}

/// Blurs a coarse image of any size by the binomial filter 1 4 6 4 1 in both directions; edges repeat the last cell.
#[inline(always)]
fn blur_coarse(image: &mut [f32], scratch: &mut [f32], width: usize) {
    let height = image.len() / width;
    let tap = |a: f32, b: f32, c: f32, d: f32, e: f32| ((a + e) + 4.0 * (b + d) + 6.0 * c) * 0.0625;
    for (source, target) in image.chunks_exact(width).zip(scratch.chunks_exact_mut(width)) {
        let at = |u: isize| source[u.clamp(0, width as isize - 1) as usize];
        for (u, t) in target.iter_mut().enumerate() {
            let i = u as isize;
            *t = if u >= 2 && u + 2 < width {
                tap(source[u - 2], source[u - 1], source[u], source[u + 1], source[u + 2])
            } else {
                tap(at(i - 2), at(i - 1), at(i), at(i + 1), at(i + 2))
            };
        }
    }
    for (v, target) in image.chunks_exact_mut(width).enumerate() {
        let row = |dv: isize| &scratch[(v as isize + dv).clamp(0, height as isize - 1) as usize * width..][..width];
        let (a, b, c, d, e) = (row(-2), row(-1), row(0), row(1), row(2));
        for (u, t) in target.iter_mut().enumerate() {
            *t = tap(a[u], b[u], c[u], d[u], e[u]);
        }
    }
}

/// Interpolates linearly between coarse cells along rows: pixels lie 1/8, 3/8, 5/8 and 7/8 of the way from one centre to the next.
#[inline(always)]
fn expand(width: usize, height: usize, scratch: &mut Scratch) {
    let (cw, ch) = (width / COARSE, height / COARSE);
    let Scratch { sums, levels, expanded, .. } = scratch;
    expanded.resize(width * ch, 0);
    levels.clear();
    levels.extend(sums.iter().map(|value| (value + 0.5) as u16));
    for (source, target) in levels.chunks_exact(cw).zip(expanded.chunks_exact_mut(width)) {
        // The outer half of the first and last cell has a neighbour on one side only.
        let (start, inner) = target.split_at_mut(COARSE / 2);
        let (cells, end) = inner.split_at_mut((cw - 1) * COARSE);
        start.fill(source[0]);
        end.fill(source[cw - 1]);
        for (cells, pair) in cells.as_chunks_mut::<COARSE>().0.iter_mut().zip(source.windows(2)) {
            let (a, b) = (pair[0], pair[1]);
            *cells = [7 * a + b, 5 * a + 3 * b, 3 * a + 5 * b, a + 7 * b].map(|sum| sum >> 3);
        }
    }
}

/// The coarse cell before a half-resolution pixel, and how far the pixel lies towards the next cell, in eighths.
#[inline(always)]
fn phase(pixel: usize) -> (isize, u16) {
    let eighths = 2 * pixel as isize + 1 - COARSE as isize;
    (eighths.div_euclid(2 * COARSE as isize), eighths.rem_euclid(2 * COARSE as isize) as u16)
}

/// Computes the line contrast from both blurs and adds the surface bits.
#[inline(always)]
fn subtract(narrow: &[u16], expanded: &[u16], surfaces: &[Surface], width: usize, contrast: &mut [i16]) {
    let last = (expanded.len() / width) as isize - 1;
    for (v, target) in contrast.chunks_exact_mut(width).enumerate() {
        let (low, share) = phase(v);
        let row = |cv: isize| &expanded[cv.clamp(0, last) as usize * width..][..width];
        let (upper, lower) = (row(low), row(low + 1));
        let (narrow, surfaces) = (&narrow[v * width..][..width], &surfaces[v * width..][..width]);
        for (u, t) in target.iter_mut().enumerate() {
            let wide = (upper[u] * (8 - share) + lower[u] * share) >> 3;
            let above = f32::from(narrow[u] as i16 - wide as i16);
            let parts = above * PARTS / (f32::from(wide as i16) + STRAY_LEVELS * UNITS);
            *t = (round_to_i16(parts) & !3) | surfaces[u] as i16;
        }
    }
}

/// Rounds to the nearest integer that 16 bits hold.
#[inline(always)]
fn round_to_i16(parts: f32) -> i16 {
    (rounded((parts + 32768.0).clamp(0.0, 65535.0)) ^ 0x8000) as u16 as i16
}

#[cfg(test)]
mod tests {
    use super::*;

    fn contrast_of(width: usize, height: usize, value: impl Fn(usize, usize) -> u8) -> LineContrast {
        let luma = (0..height).flat_map(|v| (0..width).map(move |u| (u, v))).map(|(u, v)| value(u, v)).collect();
        let picture = Picture::from_gray(width, height, luma).expect("a picture");
        let mut contrast = LineContrast::default();
        contrast.start(&picture);
        let surfaces = vec![Surface::Carpet; contrast.width * contrast.height];
        contrast.finish(&surfaces, &[]);
        contrast
    }

    #[test]
    fn plain_and_sloping_light_have_no_contrast() {
        for slope in [0.0, 0.3] {
            let c = contrast_of(160, 120, |u, _| (60.0 + slope * u as f64) as u8);
            let middle = &c.contrast[30 * c.width + 20..30 * c.width + 60];
            assert!(middle.iter().all(|value| f32::from(*value).abs() < 0.01 * PARTS), "{middle:?}");
        }
    }

    #[test]
    fn the_best_line_has_response_1() {
        let best = (1..400).map(|tenths| line_response(f64::from(tenths) / 10.0)).fold(0.0, f64::max);
        assert!(best > 0.999, "{best}");
        assert!(line_response(0.3) < 0.1 && line_response(25.0) < 0.7);
    }

    #[test]
    fn a_line_stands_out_as_two_gaussians_say() {
        // A bright line 6 px wide, 100 gray levels above the carpet.
        let c = contrast_of(320, 240, |u, _| if (157..163).contains(&u) { 160 } else { 60 });
        let got = f64::from(c.contrast[60 * c.width + 79].max(c.contrast[60 * c.width + 80])) / f64::from(PARTS);
        // erf(3 / (sqrt 2 sigma)) x 100 for sigma 2.1 (narrow, with the halving) and 11.8 (wide).
        let share = |sigma: f64| 100.0 * libm::erf(3.0 / (core::f64::consts::SQRT_2 * sigma));
        let expected = (share(2.1) - share(11.8)) / (60.0 + share(11.8) + f64::from(STRAY_LEVELS));
        assert!((got - expected).abs() < 0.08, "{got} against {expected}");
    }

    #[test]
    fn a_line_has_the_same_contrast_in_sun_and_shade() {
        let of = |light: f64| {
            let gray = |level: f64| (level * light - f64::from(STRAY_LEVELS)).round() as u8;
            let c = contrast_of(320, 240, |u, _| gray(if (157..163).contains(&u) { 110.0 } else { 70.0 }));
            f64::from(c.contrast[60 * c.width + 79]) / f64::from(PARTS)
        };
        let [shade, plain, sun] = [0.5, 1.0, 2.0].map(of);
        assert!(plain > 0.2 && (shade - plain).abs() < 0.02 && (sun - plain).abs() < 0.02, "{shade} {plain} {sun}");
    }

    #[test]
    fn a_contrast_is_rounded_and_never_leaves_its_16_bits() {
        let values = [-1e9, -32768.0, -2.6, -0.4, 0.0, 2.6, 32767.0, 1e9].map(round_to_i16);
        assert_eq!(values, [i16::MIN, i16::MIN, -3, 0, 0, 3, i16::MAX, i16::MAX]);
    }

    #[test]
    fn the_brightest_picture_does_not_overflow() {
        let c = contrast_of(64, 64, |_, _| 255);
        assert!(c.contrast.iter().all(|value| value.abs() < 16), "{:?}", c.contrast);
        assert!(c.narrow.iter().all(|value| *value == 4080));
    }

    #[test]
    fn a_picture_too_small_to_hold_a_line_gives_an_empty_map() {
        assert!(contrast_of(1, 1, |_, _| 9).contrast.is_empty());
        assert!(!contrast_of(8, 9, |_, _| 9).contrast.is_empty());
    }
}
