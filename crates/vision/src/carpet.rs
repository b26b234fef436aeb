//! The carpet's colour, which is learnt anew in each frame, and what each pixel shows by its colour.

use super::picture::{Chroma, Picture};
use realitysim_geometry::multiversioned;

/// The colour of the carpet in one frame, and the colours that are taken for white.
///
/// A hue is Cb and Cr (relative to neutral) over luma, which stays the same when the light gets brighter or darker. Here it is in
/// parts of 2^14.
#[derive(Clone, Debug, PartialEq)]
pub struct Carpet {
    /// Median hue of the carpet, (Cb, Cr).
    hue: [i16; 2],
    /// Largest deviation from `hue` that is still carpet.
    tolerance: i16,
    /// Smallest and largest hue of what may be white, for Cb and Cr.
    white: [[i16; 2]; 2],
    /// Four times the luma above which something may be white.
    bright: u16,
}

/// Units of a hue of 1.
const HUE_UNITS: f32 = 16384.0;

/// Turns a hue into integer units. It saturates: a pixel with a hue beyond 2 is too dark to have a meaningful one.
fn hue_units(hue: f32) -> i16 {
    (hue * HUE_UNITS) as i16
}

/// The colour of one pixel from which the carpet's colour is learnt.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Luma, 0 to 255.
    pub luma: f32,
    /// Cb and Cr (relative to neutral) over luma.
    pub hue: [f32; 2],
}

/// What a pixel shows. The upper of the two bits is set for what is neither carpet nor a line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum Surface {
    /// The carpet.
    #[default]
    Carpet = 0,
    /// Something white, as the lines are.
    White = 1,
    /// Something of another colour: robots, people, walls.
    Other = 2,
    /// Something too dark to tell its colour.
    Dark = 3,
}

impl Surface {
    /// Whether this is neither carpet nor a line: robots, people, the robot's own body, or too dark to tell.
    #[inline(always)]
    pub fn is_occluder(self) -> bool {
        self as u8 & 2 != 0
    }

    /// Decodes a surface from the two lowest bits; the others are ignored.
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

/// Number of green samples below which no carpet is in view.
const MIN_GREEN_SAMPLES: usize = 20;
/// Luma below which a pixel's colour means nothing.
const MIN_LUMA: f32 = 8.0;
/// Factor over the carpet's luma above which a pixel may be white, also where carpet is mixed into a line.
const MIXED_WHITE_FACTOR: f32 = 1.15;
/// Factor over the carpet's luma above which a pixel may be pure white, without carpet mixed into it.
const PURE_WHITE_FACTOR: f32 = 1.5;
/// Number of white samples below which no colour cast is learnt.
const MIN_WHITE_SAMPLES: usize = 6;
/// Hue of white below which there is no colour cast to correct.
const MIN_CAST: f32 = 0.05;
/// Hue above which bright samples are not taken for white in coloured light.
const CAST_LIMIT: f32 = 0.4;

impl Sample {
    /// Makes a sample of luma, 0 to 255, and Cb and Cr relative to neutral.
    pub fn new(luma: f32, chroma: [f32; 2]) -> Self {
        Self { luma, hue: chroma.map(|value| value / luma.max(1.0)) }
    }
}

/// Learns the carpet's colour from samples. It is kept from frame to frame for its buffers.
#[derive(Clone, Debug, Default)]
pub struct Learning {
    samples: Vec<Sample>,
    /// The samples that the current step uses.
    chosen: Vec<Sample>,
    values: Vec<f32>,
}

impl Learning {
    /// Learns the carpet's hue, the median of the samples that are greener than gray; `None` if there are too few of them.
    ///
    /// Bright samples of another hue show how the light or the camera's white balance colours white.
    pub fn learn(&mut self, samples: impl Iterator<Item = Sample>) -> Option<Carpet> {
        self.samples.clear();
        self.samples.extend(samples.filter(|s| s.luma >= MIN_LUMA));
        let is_green = |s: &Sample| s.hue[0] + s.hue[1] < -0.06 && s.hue[0] < 0.03 && s.hue[1] < 0.03;
        self.select(is_green, MIN_GREEN_SAMPLES)?;
        let hue = [0, 1].map(|c| self.median_of(|s| s.hue[c]));
        let spread = self.median_of(|s| (s.hue[0] - hue[0]).abs().max((s.hue[1] - hue[1]).abs()));
        let luma = self.median_of(|s| s.luma);
        let tolerance = (4.0 * spread).clamp(0.07, 0.3);
        let cast = self.cast(hue, luma, tolerance);
        let white = [0, 1].map(|c| {
            if hue[c].abs() < 0.02 {
                return [i16::MIN, i16::MAX];
            }
            let ends = [0.0, cast[c]].map(|white| [-0.25, 1.1].map(|share| white + share * (hue[c] - white)));
            let ends = ends.as_flattened();
            [f32::min, f32::max].map(|end| hue_units(ends[1..].iter().copied().fold(ends[0], end)))
        });
        let (hue, tolerance) = (hue.map(hue_units), hue_units(tolerance));
        Some(Carpet { hue, tolerance, white, bright: (4.0 * MIXED_WHITE_FACTOR * luma) as u16 })
    }

    /// Estimates the hue of white (the colour cast); 0 if it is nearly neutral, implausibly large or not in view.
    fn cast(&mut self, carpet: [f32; 2], luma: f32, tolerance: f32) -> [f32; 2] {
        let beside = |s: &Sample| s.hue.iter().zip(carpet).any(|(own, carpet)| (own - carpet).abs() > tolerance);
        if self.select(|s| s.luma > PURE_WHITE_FACTOR * luma && beside(s), MIN_WHITE_SAMPLES).is_none() {
            return [0.0; 2];
        }
        let cast = [0, 1].map(|c| self.median_of(|s| s.hue[c]));
        let is_cast = cast.iter().any(|c| c.abs() > MIN_CAST) && cast.iter().all(|c| c.abs() < CAST_LIMIT);
        if is_cast { cast } else { [0.0; 2] }
    }

    /// Selects the samples that fulfil a condition for the next [`Self::median_of`]; `None` if there are fewer than `fewest`.
    fn select(&mut self, which: impl Fn(&Sample) -> bool, fewest: usize) -> Option<()> {
        self.chosen.clear();
        self.chosen.extend(self.samples.iter().filter(|sample| which(sample)));
        (self.chosen.len() >= fewest).then_some(())
    }

    /// The median of a value over the selected samples.
    fn median_of(&mut self, value: impl Fn(&Sample) -> f32) -> f32 {
        self.values.clear();
        self.values.extend(self.chosen.iter().map(value));
        let middle = self.values.len() / 2;
        *self.values.select_nth_unstable_by(middle, f32::total_cmp).1
    }
}

impl Carpet {
    /// Classifies four pixels by the sum of their luma and their common Cb and Cr (neutral: 128).
    ///
    /// It computes in 16 bits, without branches or divisions, because every pixel passes here.
    #[inline(always)]
    pub fn classify(&self, four: u16, chroma: [u8; 2]) -> Surface {
        // The product of this luma and a hue in parts of 2^14, less 16 bits, is a chroma in eighths of a level.
        let lit = 8 * four as i16;
        let of_luma = |hue: i16| ((i32::from(lit) * i32::from(hue)) >> 16) as i16;
        let chroma = chroma.map(|value| 8 * (i16::from(value) - 128));
        let tolerance = of_luma(self.tolerance);
        let near = |c: usize| (chroma[c] - of_luma(self.hue[c])).abs() < tolerance;
        let carpet = near(0) & near(1);
        // The colour of a thin line lies between white and the carpet's.
        let between = |c: usize| (chroma[c] >= of_luma(self.white[c][0])) & (chroma[c] <= of_luma(self.white[c][1]));
        let white = between(0) & between(1) & (four > self.bright);
        let plain = if white { Surface::White } else { Surface::Other };
        let surface = if carpet { Surface::Carpet } else { plain };
        if four < 4 * MIN_LUMA as u16 { Surface::Dark } else { surface }
    }

    /// Classifies each half-resolution pixel; `half` holds the sum of the luma of its four pixels.
    pub fn surfaces(&self, half: &[u16], picture: &Picture, surfaces: &mut Vec<Surface>) {
        surfaces.resize(half.len(), Surface::Carpet);
        // For an odd width the chroma plane has one column more.
        let (width, stride) = ((picture.width / 2).max(1), picture.width.div_ceil(2));
        let Chroma { blue, red } = &picture.chroma;
        let carpet = self;
        for (v, (row, half)) in surfaces.chunks_exact_mut(width).zip(half.chunks_exact(width)).enumerate() {
            let (blue, red) = (&blue[v * stride..][..width], &red[v * stride..][..width]);
            multiversioned!(|carpet: &Carpet, row: &mut [Surface], half: &[u16], blue: &[u8], red: &[u8]| {
                for (((surface, half), cb), cr) in row.iter_mut().zip(half).zip(blue).zip(red) {
                    *surface = carpet.classify(*half, [*cb, *cr]);
                }
            });
        }
    }
}

/// Classifies each half-resolution pixel of a picture without usable colour: everything lit may be carpet.
///
/// Pixels with a luma below 6 are dark, such as the black surround of a fisheye's circle (a sensor's own black is 0 to 3).
pub fn lit_surfaces(half: &[u16], surfaces: &mut Vec<Surface>) {
    const BLACK: u16 = 6;
    surfaces.clear();
    surfaces.extend(half.iter().map(|sum| if *sum < 4 * BLACK { Surface::Dark } else { Surface::Carpet }));
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Converts R, G, B to luma and (Cb, Cr).
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

    #[test]
    fn lines_are_white_in_coloured_light_where_they_are_seen_so() {
        // Colour casts of a wrong white balance: too warm, and too cold.
        for cast in [[1.2, 0.9, 0.7], [0.65, 0.9, 1.2]] {
            let lit = |rgb: [f64; 3]| {
                let [r, g, b] = core::array::from_fn(|c| (rgb[c] * cast[c]) as u8);
                sample(r, g, b)
            };
            let surface = |carpet: &Carpet, rgb: [f64; 3]| {
                let Sample { luma, hue } = lit(rgb);
                carpet.classify(4 * luma as u16, hue.map(|hue| (hue * luma + 128.0) as u8))
            };
            let (carpet, line) = ([30.0, 90.0, 35.0], [170.0, 170.0, 165.0]);
            let alone = Learning::default().learn((0..100).map(|_| lit(carpet))).expect("green");
            assert_eq!(surface(&alone, line), Surface::Other, "nothing tells of the cast");
            let lines = (0..100).map(|i| lit(if i % 6 == 0 { line } else { carpet }));
            let learnt = Learning::default().learn(lines).expect("green");
            assert_eq!(surface(&learnt, line), Surface::White);
            assert_eq!(surface(&learnt, [100.0, 130.0, 100.0]), Surface::White, "mixed with carpet");
            assert_eq!(surface(&learnt, carpet), Surface::Carpet);
            assert_eq!(surface(&learnt, [40.0, 35.0, 40.0]), Surface::Other, "a robot");
            // A few white samples may be a ball.
            let few = (0..100).map(|i| lit(if i < 5 { line } else { carpet }));
            assert_eq!(Learning::default().learn(few), Some(alone));
        }
    }
}
