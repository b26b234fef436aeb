//! Places of a picture that look like paint: they stand out of the carpet to both sides, and go on along a line.

use glam::DVec2;

use super::carpet::Surface;
use super::contrast::{COARSE, PARTS, STRAY_LEVELS, UNITS, coarse_size, line_response, surface};
use super::{Chroma, LineContrast, WorkingScale};

/// A place on a line that is seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ridge {
    /// Of the full-size image.
    pub pixel: DVec2,
    /// Length of line that it stands for, in pixels of the working image.
    pub length_px: f64,
}

/// What is needed to find the ridges of one picture.
pub(super) struct Ridges<'a> {
    pub(super) contrast: &'a LineContrast,
    /// Of the working image.
    pub(super) chroma: &'a Chroma,
    /// Columns of each row of `chroma`.
    pub(super) chroma_stride: usize,
    /// On the ground of the robot, of each cell of the coarse image; NaN where no floor is.
    pub(super) floor: &'a [DVec2],
    pub(super) on_carpet: &'a [bool],
    pub(super) scale: WorkingScale,
    /// Contrast of a line of the best width.
    pub(super) full_contrast: f32,
    pub(super) line_width_m: f64,
    /// The point below the camera, and its height.
    pub(super) foot: DVec2,
    pub(super) height_m: f64,
    /// Of the working image.
    pub(super) pixels_per_radian: f64,
}

/// A ridge has at least this share of the contrast of a line of its width.
const CLEAR: f64 = 0.5;
/// A ridge stands out to both sides by at least this share of its contrast, and its line does so a little farther along.
const BESIDE: f64 = 0.5;
/// Contrast that no carpet has.
const LEAST_CONTRAST: f64 = 0.04;
/// Paint is paler than the carpet beside it: it lacks at least this share of the carpet's hue. A strip of sunlight keeps its hue.
const PALER: f64 = 0.2;
/// A carpet of less hue than this is as good as gray, and tells nothing by its colour.
const LEAST_HUE: f64 = 0.06;
/// A hue is averaged over so many working pixels. Of a thinner line that includes carpet, so it must lack less in proportion.
const HUE_PX: f64 = 6.0;
/// Thinner lines than this are not looked for: working pixels.
const THINNEST_PX: f64 = 1.5;
const WIDEST_PX: f64 = 24.0;

impl Ridges<'_> {
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
                let least = (CLEAR * f64::from(self.full_contrast) * line_response(width_px)).max(LEAST_CONTRAST);
                for v in row * COARSE..(row + 1) * COARSE {
                    for u in column * COARSE..(column + 1) * COARSE {
                        if self.is_ridge(u, v, width_px, least) {
                            let pixel = self.scale.undo(DVec2::new(2.0 * u as f64 + 0.5, 2.0 * v as f64 + 0.5));
                            // Four working pixels, of a line as wide as that and the blur.
                            ridges.push(Ridge { pixel, length_px: 4.0 / width_px.max(4.0) });
                        }
                    }
                }
            }
        }
        ridges
    }

    /// How wide a line there would look: the geometric mean of one along the view and one across it. `None` if that is too thin or too wide.
    fn width_px(&self, at: DVec2) -> Option<f64> {
        let slant = libm::hypot(at.distance(self.foot), self.height_m);
        let per_metre = self.pixels_per_radian * libm::sqrt(self.height_m.max(0.01) / (slant * slant * slant));
        let width_px = self.line_width_m * per_metre;
        // NaN fails.
        (THINNEST_PX..=WIDEST_PX).contains(&width_px).then_some(width_px)
    }

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
            let paler = PALER * (width_px / HUE_PX).min(1.0);
            [(du, dv), (-du, -dv)].iter().all(|(du, dv)| {
                let beside = self.hue((u as isize + du) as usize, (v as isize + dv) as usize).unwrap_or(hue);
                beside.length() < LEAST_HUE || (beside - hue).dot(beside) >= paler * beside.length_squared()
            })
        };
        across.iter().any(|(du, dv)| {
            let flanks = value(*du, *dv).zip(value(-du, -dv));
            let ends = value(-dv, *du).zip(value(*dv, -du));
            let (Some(flanks), Some(ends)) = (flanks, ends) else { return false };
            let carpet = flanks.0.max(flanks.1);
            let share = |value: f64| (value - carpet) / (carpet + f64::from(STRAY_LEVELS));
            share(middle) >= BESIDE * own.max(least)
                && share(ends.0.min(ends.1)) >= BESIDE * least
                && is_paint(*du, *dv)
        })
    }

    /// Mean Cb and Cr over luma of the nine half-resolution pixels there. `None` at the image's edge, and of a gray picture.
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

    /// Ridges of a picture seen from 0.4 m above a floor that is everywhere 0.4 m away, where lines 5 cm wide look 9 pixels wide.
    fn ridges_of(value: impl Fn(usize, usize) -> u8) -> Vec<Ridge> {
        let luma = (0..HEIGHT).flat_map(|v| (0..WIDTH).map(move |u| (u, v))).map(|(u, v)| value(u, v)).collect();
        ridges_in(&Picture::from_gray(WIDTH, HEIGHT, luma).expect("a picture"))
    }

    fn ridges_in(picture: &Picture) -> Vec<Ridge> {
        let mut contrast = LineContrast::default();
        contrast.start(picture);
        contrast.finish(&vec![Surface::Carpet; contrast.width * contrast.height], &[]);
        let (columns, rows) = coarse_size(picture.width, picture.height);
        let found = Ridges {
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
        found.find()
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
            // The border's cells of 8 pixels, and what lies within reach of it, may be missing.
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
        // Of an odd size as well, whose planes of colour are half a pixel larger.
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
        let ridges = Ridges {
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
