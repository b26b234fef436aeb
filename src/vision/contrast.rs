//! Line contrast: how much brighter a place is than its wider surroundings on the carpet.
//!
//! A narrow blur (sigma 2.5 px) minus a wide one (sigma 12 px). Plain carpet gives 0 whatever its brightness and
//! whatever the light's gradient, which is what makes a sum over points a fair measure (docs/paper.md, Eq. 2).
//! The narrow blur runs at half, the wide one at an eighth of the resolution.

use glam::DVec2;

use super::carpet::{Carpet, Surface};
use super::picture::Picture;

/// Half-resolution maps: pixel (i, j) averages the picture's pixels 2i, 2i+1 x 2j, 2j+1.
#[derive(Clone, Debug, PartialEq)]
pub struct LineContrast {
    pub width: usize,
    pub height: usize,
    /// Blurred gray, 0 to 255.
    pub narrow: Vec<f32>,
    /// Narrow minus wide, gray levels; negative where darker than the surroundings.
    pub contrast: Vec<f32>,
    /// What each pixel shows, as far as its colour tells.
    pub surfaces: Vec<Surface>,
}

/// Side of a cell of the coarse image, in half-resolution pixels.
const COARSE: usize = 4;
/// Below this a pixel shows nothing: the black surround of a fisheye's circle (a sensor's own black is 0 to 3).
const BLACK: f32 = 6.0;

/// Standard deviations of the two blurs in pixels, halving and quartering included.
const NARROW_SIGMA_PX: f64 = 2.1;
const WIDE_SIGMA_PX: f64 = 11.8;
/// The largest response, that of a line 8 px wide.
const BEST_RESPONSE: f64 = 0.672;

/// Contrast in the middle of a long line of this width, against that of a line of the best width: 0 to 1.
pub fn line_response(width_px: f64) -> f64 {
    let within = |sigma: f64| libm::erf(width_px / (2.0 * core::f64::consts::SQRT_2 * sigma));
    ((within(NARROW_SIGMA_PX) - within(WIDE_SIGMA_PX)) / BEST_RESPONSE).clamp(1e-3, 1.0)
}

impl LineContrast {
    /// `on_carpet` has one entry per cell of [`coarse_centres`]. The wide blur averages only carpet, so that walls
    /// beyond the field, robots on it or the black rim of a fisheye do not look like a change of light.
    pub fn of(picture: &Picture, on_carpet: &[bool], carpet: Option<&Carpet>) -> Self {
        let (width, height) = (picture.width / 2, picture.height / 2);
        if width < COARSE || height < COARSE {
            return Self { width: 0, height: 0, narrow: Vec::new(), contrast: Vec::new(), surfaces: Vec::new() };
        }
        let half = halved(picture, width, height);
        let narrow = blurred(&half, width, height);
        let surfaces = match carpet {
            Some(carpet) => carpet.surfaces(picture),
            None => half.iter().map(|value| if *value < BLACK { Surface::Dark } else { Surface::Carpet }).collect(),
        };
        let wide = wide_blur(&half, &surfaces, width, height, on_carpet);
        let contrast = subtract_upsampled(&narrow, width, height, &wide);
        Self { width, height, narrow, contrast, surfaces }
    }
}

/// Where the wide blur's cells lie in a picture of this size, row by row, in its pixels.
pub fn coarse_centres(width: usize, height: usize) -> impl Iterator<Item = DVec2> {
    let (columns, rows) = (width / 2 / COARSE, height / 2 / COARSE);
    let centre = |cell: usize| (cell * 2 * COARSE) as f64 + COARSE as f64 - 0.5;
    (0..rows).flat_map(move |row| (0..columns).map(move |column| DVec2::new(centre(column), centre(row))))
}

fn halved(picture: &Picture, width: usize, height: usize) -> Vec<f32> {
    let mut half = Vec::with_capacity(width * height);
    for v in 0..height {
        let upper = &picture.luma[2 * v * picture.width..][..2 * width];
        let lower = &picture.luma[(2 * v + 1) * picture.width..][..2 * width];
        half.extend(upper.chunks_exact(2).zip(lower.chunks_exact(2)).map(|(a, b)| {
            let sum = u16::from(a[0]) + u16::from(a[1]) + u16::from(b[0]) + u16::from(b[1]);
            f32::from(sum) * 0.25
        }));
    }
    half
}

/// Binomial 1 4 6 4 1 in both directions: sigma 1 pixel. Edges repeat the last pixel.
fn blurred(image: &[f32], width: usize, height: usize) -> Vec<f32> {
    let tap = |a: f32, b: f32, c: f32, d: f32, e: f32| ((a + e) + 4.0 * (b + d) + 6.0 * c) * 0.0625;
    let mut rows = vec![0.0f32; image.len()];
    for (source, target) in image.chunks_exact(width).zip(rows.chunks_exact_mut(width)) {
        let at = |u: isize| source[u.clamp(0, width as isize - 1) as usize];
        for u in [0, 1, width - 2, width - 1] {
            let i = u as isize;
            target[u] = tap(at(i - 2), at(i - 1), at(i), at(i + 1), at(i + 2));
        }
        for (t, w) in target[2..width - 2].iter_mut().zip(source.windows(5)) {
            *t = tap(w[0], w[1], w[2], w[3], w[4]);
        }
    }
    let mut result = vec![0.0f32; image.len()];
    for (v, target) in result.chunks_exact_mut(width).enumerate() {
        let row = |dv: isize| {
            let v = (v as isize + dv).clamp(0, height as isize - 1) as usize;
            &rows[v * width..][..width]
        };
        let (a, b, c, d, e) = (row(-2), row(-1), row(0), row(1), row(2));
        for u in 0..width {
            target[u] = tap(a[u], b[u], c[u], d[u], e[u]);
        }
    }
    result
}

struct Coarse {
    width: usize,
    height: usize,
    values: Vec<f32>,
}

/// Mean of the carpet within about 12 pixels; `NaN`-free: where no carpet is near, the plain mean.
fn wide_blur(half: &[f32], surfaces: &[Surface], width: usize, height: usize, on_carpet: &[bool]) -> Coarse {
    let (cw, ch) = (width / COARSE, height / COARSE);
    let mut sums = vec![0.0f32; cw * ch];
    let mut counts = vec![0.0f32; cw * ch];
    let mut plain = vec![0.0f32; cw * ch];
    for cv in 0..ch {
        for cu in 0..cw {
            let (mut sum, mut lit_sum, mut lit) = (0.0f32, 0.0f32, 0.0f32);
            for dv in 0..COARSE {
                let first = (cv * COARSE + dv) * width + cu * COARSE;
                for (value, surface) in half[first..][..COARSE].iter().zip(&surfaces[first..][..COARSE]) {
                    sum += value;
                    if !surface.is_occluder() {
                        lit_sum += value;
                        lit += 1.0;
                    }
                }
            }
            let cell = cv * cw + cu;
            plain[cell] = sum / (COARSE * COARSE) as f32;
            if on_carpet.get(cell).copied().unwrap_or(true) {
                sums[cell] = lit_sum;
                counts[cell] = lit;
            }
        }
    }
    let twice = |image: &[f32]| small_blur(&small_blur(image, cw, ch), cw, ch);
    let (sums, counts, plain) = (twice(&sums), twice(&counts), twice(&plain));
    let values = sums
        .iter()
        .zip(&counts)
        .zip(&plain)
        .map(|((sum, count), plain)| if *count > 0.05 { sum / count } else { *plain })
        .collect();
    Coarse { width: cw, height: ch, values }
}

/// As [`blurred`], for images of any size.
fn small_blur(image: &[f32], width: usize, height: usize) -> Vec<f32> {
    let at = |u: isize, v: isize| {
        let u = u.clamp(0, width as isize - 1) as usize;
        let v = v.clamp(0, height as isize - 1) as usize;
        (u, v)
    };
    let pass = |source: &[f32], du: isize, dv: isize| -> Vec<f32> {
        let mut target = Vec::with_capacity(source.len());
        for v in 0..height as isize {
            for u in 0..width as isize {
                let tap = |k: isize| {
                    let (u, v) = at(u + k * du, v + k * dv);
                    source[v * width + u]
                };
                target.push(((tap(-2) + tap(2)) + 4.0 * (tap(-1) + tap(1)) + 6.0 * tap(0)) * 0.0625);
            }
        }
        target
    };
    pass(&pass(image, 1, 0), 0, 1)
}

/// `narrow` minus the coarse image, interpolated bilinearly.
fn subtract_upsampled(narrow: &[f32], width: usize, height: usize, coarse: &Coarse) -> Vec<f32> {
    let axis = |i: usize, size: usize| {
        let x = ((i as f32 + 0.5) / COARSE as f32 - 0.5).clamp(0.0, (size - 1) as f32);
        let low = (x as usize).min(size.saturating_sub(2));
        (low, (low + 1).min(size - 1), x - low as f32)
    };
    let columns: Vec<_> = (0..width).map(|u| axis(u, coarse.width)).collect();
    let mut result = Vec::with_capacity(narrow.len());
    let mut blended = vec![0.0f32; coarse.width];
    for v in 0..height {
        let (top, bottom, fv) = axis(v, coarse.height);
        let upper = &coarse.values[top * coarse.width..][..coarse.width];
        let lower = &coarse.values[bottom * coarse.width..][..coarse.width];
        for ((blend, a), b) in blended.iter_mut().zip(upper).zip(lower) {
            *blend = a + (b - a) * fv;
        }
        let row = &narrow[v * width..][..width];
        result.extend(
            columns
                .iter()
                .zip(row)
                .map(|((left, right, fu), value)| value - (blended[*left] + (blended[*right] - blended[*left]) * fu)),
        );
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(width: usize, height: usize, value: impl Fn(usize, usize) -> u8) -> Picture {
        let luma = (0..height).flat_map(|v| (0..width).map(move |u| (u, v))).map(|(u, v)| value(u, v)).collect();
        Picture::from_gray(width, height, luma).expect("a picture")
    }

    #[test]
    fn plain_and_sloping_light_have_no_contrast() {
        for slope in [0.0, 0.3] {
            let p = picture(160, 120, |u, _| (60.0 + slope * u as f64) as u8);
            let c = LineContrast::of(&p, &[], None);
            let middle = &c.contrast[30 * c.width + 20..30 * c.width + 60];
            assert!(middle.iter().all(|value| value.abs() < 0.6), "{middle:?}");
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
        let p = picture(320, 240, |u, _| if (157..163).contains(&u) { 160 } else { 60 });
        let c = LineContrast::of(&p, &[], None);
        let got = c.contrast[60 * c.width + 79].max(c.contrast[60 * c.width + 80]);
        // erf(3 / (sqrt 2 sigma)) x 100 for sigma 2.1 (narrow, with the halving) and 11.8 (wide).
        let share = |sigma: f64| 100.0 * libm::erf(3.0 / (core::f64::consts::SQRT_2 * sigma));
        let expected = share(2.1) - share(11.8);
        assert!((f64::from(got) - expected).abs() < 6.0, "{got} against {expected}");
    }

    #[test]
    fn a_picture_too_small_to_hold_a_line_gives_an_empty_map() {
        assert!(LineContrast::of(&picture(1, 1, |_, _| 9), &[], None).contrast.is_empty());
        assert!(!LineContrast::of(&picture(8, 9, |_, _| 9), &[], None).contrast.is_empty());
    }
}
