//! Ridges: pixels that look like paint, because they are brighter than the carpet on both sides and continue along a line.

use glam::DVec2;

use super::carpet::Surface;
use super::contrast::{COARSE, PARTS, STRAY_LEVELS, UNITS, coarse_size, line_response, surface};
use super::{Chroma, LineContrast, WorkingScale};

/// A pixel of a line that is seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ridge {
    /// Position in the full-size image, pixels.
    pub pixel: DVec2,
    /// Length of line that this pixel represents, in pixels of the working image.
    pub length_px: f64,
}

/// Finds the ridges of one picture.
pub(super) struct RidgeDetector<'a> {
    pub(super) contrast: &'a LineContrast,
    /// Chroma of the working image; empty for a gray picture.
    pub(super) chroma: &'a Chroma,
    /// Columns of each row of `chroma`.
    pub(super) chroma_stride: usize,
    /// Point on the ground of `base_footprint` (metres) that each coarse cell shows; NaN where it shows none.
    pub(super) floor: &'a [DVec2],
    /// Whether that point lies within the carpet's border.
    pub(super) on_carpet: &'a [bool],
    /// Transformation from the full-size to the working image.
    pub(super) scale: WorkingScale,
    /// Line contrast of a line of the best width.
    pub(super) full_contrast: f32,
    /// Width of the field's painted lines, metres.
    pub(super) line_width_m: f64,
    /// Point below the camera on the ground of `base_footprint`, metres.
    pub(super) foot: DVec2,
    /// Height of the camera above the ground, metres.
    pub(super) height_m: f64,
    /// Focal length in the working image.
    pub(super) pixels_per_radian: f64,
}

/// Smallest line contrast of a ridge, as a share of that of a line of its width.
const MIN_CONTRAST_SHARE: f64 = 0.5;
/// Smallest contrast of a ridge to both sides, as a share of its line contrast. Its line has as much a little farther along.
const MIN_FLANK_SHARE: f64 = 0.5;
/// Smallest line contrast of a ridge. Plain carpet has less.
const MIN_CONTRAST: f64 = 0.04;
/// Share of the carpet's hue that paint lacks at least, because it is paler than the carpet. A strip of sunlight keeps the hue.
const MIN_PALENESS: f64 = 0.2;
/// Hue of a carpet below which it is as good as gray, so that its colour tells nothing.
const MIN_HUE: f64 = 0.06;
/// Width over which a hue is averaged, working pixels. A thinner line is averaged with carpet, and may lack less hue in proportion.
const HUE_PX: f64 = 6.0;
/// Width of the thinnest lines that are looked for, working pixels.
const MIN_WIDTH_PX: f64 = 1.5;
/// Width of the widest lines that are looked for, working pixels.
const WIDTH_LIMIT_PX: f64 = 24.0;

impl RidgeDetector<'_> {
    /// Looks at each half-resolution pixel on the carpet.
    pub(super) fn find(&self) -> Vec<Ridge> {
        let mut ridges = Vec::new();
        let LineContrast { width, height, .. } = *self.contrast;
        let (columns, rows) = coarse_size(2 * width, 2 * height);
        if columns == 0 || rows == 0 || !self.full_contrast.is_finite() {
            return ridges;
        }
        for row in 0..rows {
            for column in 0..columns {
                let cell = row * columns + column;
                if self.on_carpet.get(cell) != Some(&true) {
                    continue;
                }
                let Some(width_px) = self.width_px(self.floor[cell]) else { continue };
                let least =
                    (MIN_CONTRAST_SHARE * f64::from(self.full_contrast) * line_response(width_px)).max(MIN_CONTRAST);
                for v in row * COARSE..(row + 1) * COARSE {
                    for u in column * COARSE..(column + 1) * COARSE {
                        if self.is_ridge(u, v, width_px, least) {
                            let pixel = self.scale.undo(DVec2::new(2.0 * u as f64 + 0.5, 2.0 * v as f64 + 0.5));
                            // The pixel covers 2 x 2 working pixels of a line that looks at least four wide in the blur.
                            ridges.push(Ridge { pixel, length_px: 4.0 / width_px.max(4.0) });
                        }
                    }
                }
            }
        }
        ridges
    }

    /// Width at which a line would be drawn at a point on the ground, working pixels; `None` if that is too thin or too wide.
    ///
    /// It is the geometric mean of the widths along and across the view.
    fn width_px(&self, at: DVec2) -> Option<f64> {
        let slant = libm::hypot(at.distance(self.foot), self.height_m);
        let per_metre = self.pixels_per_radian * libm::sqrt(self.height_m.max(0.01) / (slant * slant * slant));
        let width_px = self.line_width_m * per_metre;
        // NaN fails this comparison.
        (MIN_WIDTH_PX..=WIDTH_LIMIT_PX).contains(&width_px).then_some(width_px)
    }

    /// Whether a half-resolution pixel is a ridge of a line `width_px` wide, with a line contrast of at least `least`.
    fn is_ridge(&self, u: usize, v: usize, width_px: f64, least: f64) -> bool {
        let LineContrast { width, height, narrow, contrast, .. } = self.contrast;
        let at = v * width + u;
        let own = f64::from(contrast[at] & !3) / f64::from(PARTS);
        if own < least || surface(contrast[at]).is_occluder() {
            return false;
        }
        let beside = libm::ceil(0.25 * width_px + 1.5) as isize;
        let value = |du: isize, dv: isize| {
            let (u, v) = (u as isize + du, v as isize + dv);
            let inside = u >= 0 && v >= 0 && u < *width as isize && v < *height as isize;
            let at = if inside { v as usize * width + u as usize } else { return None };
            (surface(contrast[at]) != Surface::Other).then(|| f64::from(narrow[at]) / f64::from(UNITS))
        };
        let Some(middle) = value(0, 0) else { return false };
        let diagonal = (beside * 7 + 9) / 10;
        let across = [(beside, 0), (0, beside), (diagonal, diagonal), (diagonal, -diagonal)];
        let is_paint = |du: isize, dv: isize| {
            let Some(hue) = self.hue(u, v) else { return true };
            let paler = MIN_PALENESS * (width_px / HUE_PX).min(1.0);
            [(du, dv), (-du, -dv)].iter().all(|(du, dv)| {
                let beside = self.hue((u as isize + du) as usize, (v as isize + dv) as usize).unwrap_or(hue);
                beside.length() < MIN_HUE || (beside - hue).dot(beside) >= paler * beside.length_squared()
            })
        };
        across.iter().any(|(du, dv)| {
            let flanks = value(*du, *dv).zip(value(-du, -dv));
            let ends = value(-dv, *du).zip(value(*dv, -du));
            let (Some(flanks), Some(ends)) = (flanks, ends) else { return false };
            let carpet = flanks.0.max(flanks.1);
            let share = |value: f64| (value - carpet) / (carpet + f64::from(STRAY_LEVELS));
            share(middle) >= MIN_FLANK_SHARE * own.max(least)
                && share(ends.0.min(ends.1)) >= MIN_FLANK_SHARE * least
                && is_paint(*du, *dv)
        })
    }

    /// Mean (Cb, Cr) over luma of the nine half-resolution pixels around one; `None` at the image's edge and for a gray picture.
    fn hue(&self, u: usize, v: usize) -> Option<DVec2> {
        let LineContrast { width, height, half, .. } = self.contrast;
        let Chroma { blue, red } = self.chroma;
        if self.chroma.is_empty() || !(1..width - 1).contains(&u) || !(1..height - 1).contains(&v) {
            return None;
        }
        let (mut chroma, mut luma) = (DVec2::ZERO, 0.0);
        for row in v - 1..=v + 1 {
            for column in u - 1..=u + 1 {
                let at = row * self.chroma_stride + column;
                chroma += DVec2::new(f64::from(blue[at]) - 128.0, f64::from(red[at]) - 128.0);
                luma += f64::from(half[row * width + column]) / 4.0;
            }
        }
        Some(chroma / luma.max(1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Picture;

    const WIDTH: usize = 320;
    const HEIGHT: usize = 240;

    /// Finds ridges in a picture seen from 0.4 m above a floor that is everywhere 0.4 m away, where lines 5 cm wide look 9 pixels wide.
    fn ridges_of(value: impl Fn(usize, usize) -> u8) -> Vec<Ridge> {
        let luma = (0..HEIGHT).flat_map(|v| (0..WIDTH).map(move |u| (u, v))).map(|(u, v)| value(u, v)).collect();
        ridges_in(&Picture::from_gray(WIDTH, HEIGHT, luma).expect("a picture"))
    }

    fn ridges_in(picture: &Picture) -> Vec<Ridge> {
        let mut contrast = LineContrast::default();
        contrast.start(picture);
        contrast.finish(&vec![Surface::Carpet; contrast.width * contrast.height], &[]);
        let (columns, rows) = coarse_size(picture.width, picture.height);
        let detector = RidgeDetector {
            contrast: &contrast,
            chroma: &picture.chroma,
            chroma_stride: picture.width.div_ceil(2),
            floor: &vec![DVec2::new(0.4, 0.0); columns * rows],
            on_carpet: &vec![true; columns * rows],
            scale: WorkingScale::new(1),
            full_contrast: 0.6,
            line_width_m: 0.05,
            foot: DVec2::ZERO,
            height_m: 0.4,
            pixels_per_radian: 120.0,
        };
        detector.find()
    }

    /// Gray levels of a carpet and of the paint on it.
    const CARPET: u8 = 60;
    const PAINT: u8 = 160;

    #[test]
    fn a_line_is_found_along_its_length_whichever_way_it_runs() {
        for degrees in [0.0_f64, 30.0, 45.0, 75.0, 90.0, 120.0] {
            let across = DVec2::from_angle(degrees.to_radians()).perp();
            let middle = DVec2::new(160.0, 120.0);
            let offset = |at: DVec2| across.dot(at - middle).abs();
            let ridges = ridges_of(|u, v| if offset(DVec2::new(u as f64, v as f64)) <= 4.5 { PAINT } else { CARPET });
            assert!(ridges.iter().all(|ridge| offset(ridge.pixel) <= 5.0), "{degrees}");
            // Ridges in the outermost cells of 8 pixels, and close to them, may be missing.
            let length: f64 = ridges.iter().map(|ridge| ridge.length_px).sum();
            assert!((120.0..330.0).contains(&length), "{degrees}: {length}");
        }
    }

    #[test]
    fn what_is_no_line_is_none() {
        let middle = DVec2::new(160.0, 120.0);
        let from = |u: usize, v: usize| middle.distance(DVec2::new(u as f64, v as f64));
        assert_eq!(ridges_of(|_, _| CARPET), [], "carpet");
        assert_eq!(ridges_of(|u, v| if from(u, v) < 5.0 { PAINT } else { CARPET }), [], "a dot");
        assert_eq!(ridges_of(|u, _| if u < 160 { PAINT } else { CARPET }), [], "the edge of something bright");
        assert_eq!(ridges_of(|u, _| if u.abs_diff(160) < 5 { CARPET / 3 } else { CARPET }), [], "a dark line");
        assert_eq!(ridges_of(|u, _| CARPET + (u / 4) as u8), [], "light from one side");
    }

    #[test]
    fn paint_is_a_line_and_a_strip_of_sunlight_on_green_carpet_is_none() {
        let (carpet, sunny, painted) = ([40, 70, 42], [104, 182, 109], [150, 156, 148]);
        // A picture of odd size is tested as well: its chroma planes are half a pixel larger.
        for (width, height) in [(WIDTH, HEIGHT), (WIDTH + 1, HEIGHT - 1)] {
            let picture = |strip: [u8; 3]| {
                let pixels =
                    (0..height * width).flat_map(|at| if (at % width).abs_diff(160) < 5 { strip } else { carpet });
                Picture::from_rgb(width, height, &pixels.collect::<Vec<u8>>()).expect("a picture")
            };
            assert!(ridges_in(&picture(painted)).len() > 200, "{width} x {height}");
            assert_eq!(ridges_in(&picture(sunny)), [], "{width} x {height}");
        }
    }

    #[test]
    fn what_is_too_far_off_to_tell_is_left_out() {
        let nowhere = DVec2::NAN;
        let contrast = LineContrast::default();
        let ridges = RidgeDetector {
            contrast: &contrast,
            chroma: &Chroma::default(),
            chroma_stride: 0,
            floor: &[],
            on_carpet: &[],
            scale: WorkingScale::new(1),
            full_contrast: f32::NAN,
            line_width_m: 0.05,
            foot: DVec2::ZERO,
            height_m: 0.4,
            pixels_per_radian: 120.0,
        };
        assert_eq!(ridges.find(), []);
        assert_eq!(ridges.width_px(nowhere), None);
        assert_eq!(ridges.width_px(DVec2::new(4.0, 0.0)), None);
        assert!(ridges.width_px(DVec2::new(0.4, 0.0)).is_some_and(|px| (7.0..11.0).contains(&px)));
    }
}
