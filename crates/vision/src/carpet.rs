//! The carpet's colour, learnt in each frame anew.

use super::picture::{Chroma, Picture};
use realitysim_geometry::multiversioned;

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
/// And where nothing of the carpet is mixed into it by at least this one.
const WHITE: f32 = 1.5;
const FEWEST_WHITE: usize = 6;
/// A white that is off by less is within what white may be, ...
const LEAST_CAST: f32 = 0.05;
/// ... and one by more is no white.
const MOST_CAST: f32 = 0.4;

impl Sample {
    /// `chroma` relative to neutral.
    pub fn new(luma: f32, chroma: [f32; 2]) -> Self {
        Self { luma, hue: chroma.map(|value| value / luma.max(1.0)) }
    }
}

/// Learns a carpet from samples; kept from frame to frame for its buffers.
#[derive(Clone, Debug, Default)]
pub struct Learning {
    samples: Vec<Sample>,
    /// Those that count at the moment.
    chosen: Vec<Sample>,
    values: Vec<f32>,
}

impl Learning {
    /// The median colour of what is greener than gray; `None` if there is too little of it. What is brighter beside it shows how
    /// the light or the camera's white balance colours white.
    pub fn learn(&mut self, samples: impl Iterator<Item = Sample>) -> Option<Carpet> {
        self.samples.clear();
        self.samples.extend(samples.filter(|s| s.luma >= DARKEST));
        let is_green = |s: &Sample| s.hue[0] + s.hue[1] < -0.06 && s.hue[0] < 0.03 && s.hue[1] < 0.03;
        self.choose(is_green, FEWEST_SAMPLES)?;
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
        Some(Carpet { hue, tolerance, white, bright: (4.0 * BRIGHTER * luma) as u16 })
    }

    /// The hue of white; that of a gray if it is nearly one, or if it does not show.
    fn cast(&mut self, carpet: [f32; 2], luma: f32, tolerance: f32) -> [f32; 2] {
        let beside = |s: &Sample| s.hue.iter().zip(carpet).any(|(own, carpet)| (own - carpet).abs() > tolerance);
        if self.choose(|s| s.luma > WHITE * luma && beside(s), FEWEST_WHITE).is_none() {
            return [0.0; 2];
        }
        let cast = [0, 1].map(|c| self.median_of(|s| s.hue[c]));
        let is_cast = cast.iter().any(|c| c.abs() > LEAST_CAST) && cast.iter().all(|c| c.abs() < MOST_CAST);
        if is_cast { cast } else { [0.0; 2] }
    }

    fn choose(&mut self, which: impl Fn(&Sample) -> bool, fewest: usize) -> Option<()> {
        self.chosen.clear();
        self.chosen.extend(self.samples.iter().filter(|sample| which(sample)));
        (self.chosen.len() >= fewest).then_some(())
    }

    fn median_of(&mut self, value: impl Fn(&Sample) -> f32) -> f32 {
        self.values.clear();
        self.values.extend(self.chosen.iter().map(value));
        let middle = self.values.len() / 2;
        *self.values.select_nth_unstable_by(middle, f32::total_cmp).1
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
            multiversioned!(|carpet: &Carpet, row: &mut [Surface], half: &[u16], blue: &[u8], red: &[u8]| {
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

    #[test]
    fn lines_are_white_in_coloured_light_where_they_are_seen_so() {
        // Too warm, too cold, as of a white balance that was set elsewhere.
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
            // A few of them may be a ball.
            let few = (0..100).map(|i| lit(if i < 5 { line } else { carpet }));
            assert_eq!(Learning::default().learn(few), Some(alone));
        }
    }
}
