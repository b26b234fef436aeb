//! The carpet's colour, learnt in each frame anew.

use super::picture::{Chroma, Picture};
use crate::vectorised::vectorised;

/// Hue is Cb and Cr over luma: what stays when the light changes. Here in parts of 2^14.
#[derive(Clone, Debug, PartialEq)]
pub struct Carpet {
    hue: [i16; 2],
    tolerance: i16,
    /// Least and largest hue of what may be white.
    white: [[i16; 2]; 2],
    /// Four times the luma above which something may be white.
    bright: u16,
}

const HUE_UNITS: f32 = 16384.0;

/// Hues beyond 2 are those of what is too dark to have one.
fn hue_units(hue: f32) -> i16 {
    // Saturates.
    (hue * HUE_UNITS) as i16
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    pub luma: f32,
    pub hue: [f32; 2],
}

/// What a pixel may show. The upper bit of the two is set for what is neither carpet nor a line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum Surface {
    #[default]
    Carpet = 0,
    /// Something white, as the lines are.
    White = 1,
    Other = 2,
    /// Too dark to tell.
    Dark = 3,
}

impl Surface {
    /// Neither carpet nor a line: robots, people, the robot's own body.
    #[inline(always)]
    pub fn is_occluder(self) -> bool {
        self as u8 & 2 != 0
    }

    /// From the two lowest bits.
    #[inline(always)]
    pub fn from_bits(bits: u8) -> Self {
        match bits & 3 {
            0 => Self::Carpet,
            1 => Self::White,
            2 => Self::Other,
            _ => Self::Dark,
        }
    }
}

/// Fewer green samples than this: no carpet is in view.
const FEWEST_SAMPLES: usize = 20;
/// Darker pixels have no colour worth reading.
const DARKEST: f32 = 8.0;
/// White is brighter than the carpet by this factor.
const BRIGHTER: f32 = 1.15;

impl Sample {
    /// `chroma` relative to neutral.
    pub fn new(luma: f32, chroma: [f32; 2]) -> Self {
        Self { luma, hue: chroma.map(|value| value / luma.max(1.0)) }
    }
}

/// Learns a carpet from samples; kept from frame to frame for its buffers.
#[derive(Clone, Debug, Default)]
pub struct Learning {
    green: Vec<Sample>,
    values: Vec<f32>,
}

impl Learning {
    /// The median colour of what is greener than gray; `None` if there is too little of it.
    pub fn learn(&mut self, samples: impl Iterator<Item = Sample>) -> Option<Carpet> {
        let is_green =
            |s: &Sample| s.luma >= DARKEST && s.hue[0] + s.hue[1] < -0.06 && s.hue[0] < 0.03 && s.hue[1] < 0.03;
        let Self { green, values } = self;
        green.clear();
        green.extend(samples.filter(is_green));
        if green.len() < FEWEST_SAMPLES {
            return None;
        }
        let mut median_of = |value: &dyn Fn(&Sample) -> f32| {
            values.clear();
            values.extend(green.iter().map(value));
            let middle = values.len() / 2;
            *values.select_nth_unstable_by(middle, f32::total_cmp).1
        };
        let hue = [median_of(&|s| s.hue[0]), median_of(&|s| s.hue[1])];
        let spread = median_of(&|s| (s.hue[0] - hue[0]).abs().max((s.hue[1] - hue[1]).abs()));
        let white = hue.map(|hue| {
            if hue.abs() < 0.02 {
                return [i16::MIN, i16::MAX];
            }
            let (a, b) = (-0.25 * hue, 1.1 * hue);
            [a.min(b), a.max(b)].map(hue_units)
        });
        Some(Carpet {
            hue: hue.map(hue_units),
            tolerance: hue_units((4.0 * spread).clamp(0.07, 0.3)),
            white,
            bright: (4.0 * BRIGHTER * median_of(&|s| s.luma)) as u16,
        })
    }
}

impl Carpet {
    /// Of four pixels with this sum of luma and this Cb and Cr (neutral: 128). In 16 bits, without branches or divisions:
    /// every pixel passes here.
    #[inline(always)]
    pub fn classify(&self, four: u16, chroma: [u8; 2]) -> Surface {
        // Luma and chroma in eighths of a level, after a hue of 2^14 parts has taken its 16 bits.
        let lit = 8 * four as i16;
        let of_luma = |hue: i16| ((i32::from(lit) * i32::from(hue)) >> 16) as i16;
        let chroma = chroma.map(|value| 8 * (i16::from(value) - 128));
        let tolerance = of_luma(self.tolerance);
        let near = |c: usize| (chroma[c] - of_luma(self.hue[c])).abs() < tolerance;
        let carpet = near(0) & near(1);
        // A thin line's colour lies between white's and the carpet's.
        let between = |c: usize| (chroma[c] >= of_luma(self.white[c][0])) & (chroma[c] <= of_luma(self.white[c][1]));
        let white = between(0) & between(1) & (four > self.bright);
        let plain = if white { Surface::White } else { Surface::Other };
        let surface = if carpet { Surface::Carpet } else { plain };
        if four < 4 * DARKEST as u16 { Surface::Dark } else { surface }
    }

    /// What each half-resolution pixel shows; `half` holds the sums of each four pixels' luma.
    pub fn surfaces(&self, half: &[u16], picture: &Picture, surfaces: &mut Vec<Surface>) {
        surfaces.resize(half.len(), Surface::Carpet);
        // A chroma plane of an odd width has one column more.
        let (width, stride) = ((picture.width / 2).max(1), picture.width.div_ceil(2));
        let Chroma { blue, red } = &picture.chroma;
        let carpet = self;
        for (v, (row, half)) in surfaces.chunks_exact_mut(width).zip(half.chunks_exact(width)).enumerate() {
            let (blue, red) = (&blue[v * stride..][..width], &red[v * stride..][..width]);
            vectorised!(|carpet: &Carpet, row: &mut [Surface], half: &[u16], blue: &[u8], red: &[u8]| {
                for (((surface, half), cb), cr) in row.iter_mut().zip(half).zip(blue).zip(red) {
                    *surface = carpet.classify(*half, [*cb, *cr]);
                }
            });
        }
    }
}

/// Without colours: whatever is lit may be carpet. Darker pixels show nothing: the black surround of a fisheye's
/// circle (a sensor's own black is 0 to 3).
pub fn lit_surfaces(half: &[u16], surfaces: &mut Vec<Surface>) {
    const BLACK: u16 = 6;
    surfaces.clear();
    surfaces.extend(half.iter().map(|sum| if *sum < 4 * BLACK { Surface::Dark } else { Surface::Carpet }));
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Luma, Cb and Cr.
    fn pixel(r: u8, g: u8, b: u8) -> (u8, [u8; 2]) {
        let p = Picture::from_rgb(1, 1, &[r, g, b]).expect("a pixel");
        (p.luma[0], [p.chroma.blue[0], p.chroma.red[0]])
    }

    fn sample(r: u8, g: u8, b: u8) -> Sample {
        let (luma, chroma) = pixel(r, g, b);
        Sample::new(f32::from(luma), chroma.map(|c| f32::from(c) - 128.0))
    }

    #[test]
    fn carpet_lines_and_obstacles_are_told_apart_in_any_light() {
        for light in [0.4, 1.0, 1.8] {
            let lit = |rgb: [f64; 3]| {
                let [r, g, b] = rgb.map(|c| (c * light) as u8);
                (r, g, b)
            };
            let classify = |carpet: &Carpet, (r, g, b)| {
                let (luma, chroma) = pixel(r, g, b);
                carpet.classify(4 * u16::from(luma), chroma)
            };
            let carpet = Learning::default()
                .learn((0..100).map(|i| {
                    let (r, g, b) = lit([30.0, 90.0 + f64::from(i % 10), 35.0]);
                    sample(r, g, b)
                }))
                .expect("green");
            assert_eq!(classify(&carpet, lit([32.0, 95.0, 36.0])), Surface::Carpet);
            assert_eq!(classify(&carpet, lit([20.0, 62.0, 23.0])), Surface::Carpet, "a shadow");
            assert_eq!(classify(&carpet, lit([140.0, 140.0, 135.0])), Surface::White);
            assert_eq!(classify(&carpet, lit([35.0, 35.0, 40.0])), Surface::Other, "a robot");
            assert_eq!(classify(&carpet, lit([130.0, 60.0, 40.0])), Surface::Other, "a ball");
        }
        assert_eq!(Learning::default().learn((0..100).map(|_| sample(90, 90, 90))), None);
    }
}
