//! The carpet's colour, learnt in each frame anew.

use super::picture::Picture;

/// Hue is Cb and Cr over luma: what stays when the light changes.
#[derive(Clone, Debug, PartialEq)]
pub struct Carpet {
    hue: [f32; 2],
    tolerance: f32,
    luma: f32,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    pub luma: f32,
    pub hue: [f32; 2],
}

/// What a pixel may show.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Surface {
    Carpet,
    /// Something white, as the lines are.
    White,
    /// Too dark to tell.
    Dark,
    Other,
}

impl Surface {
    /// Neither carpet nor a line: robots, people, the robot's own body.
    pub fn is_occluder(self) -> bool {
        matches!(self, Self::Dark | Self::Other)
    }
}

/// Fewer green samples than this: no carpet is in view.
const FEWEST_SAMPLES: usize = 40;
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

impl Carpet {
    /// The median colour of what is greener than gray; `None` if there is too little of it.
    pub fn learn(samples: impl Iterator<Item = Sample>) -> Option<Self> {
        let is_green =
            |s: &Sample| s.luma >= DARKEST && s.hue[0] + s.hue[1] < -0.06 && s.hue[0] < 0.03 && s.hue[1] < 0.03;
        let green: Vec<Sample> = samples.filter(is_green).collect();
        if green.len() < FEWEST_SAMPLES {
            return None;
        }
        let median_of = |value: &dyn Fn(&Sample) -> f32| {
            let mut values: Vec<f32> = green.iter().map(value).collect();
            let middle = values.len() / 2;
            *values.select_nth_unstable_by(middle, f32::total_cmp).1
        };
        let hue = [median_of(&|s| s.hue[0]), median_of(&|s| s.hue[1])];
        let spread = median_of(&|s| (s.hue[0] - hue[0]).abs().max((s.hue[1] - hue[1]).abs()));
        Some(Self { hue, tolerance: (4.0 * spread).clamp(0.07, 0.3), luma: median_of(&|s| s.luma) })
    }

    pub fn classify(&self, sample: Sample) -> Surface {
        if sample.luma < DARKEST {
            return Surface::Dark;
        }
        let off = (sample.hue[0] - self.hue[0]).abs().max((sample.hue[1] - self.hue[1]).abs());
        if off < self.tolerance {
            return Surface::Carpet;
        }
        // A thin line's colour lies between white's and the carpet's.
        let between = [0, 1].iter().all(|c| {
            let share = sample.hue[*c] / self.hue[*c];
            self.hue[*c].abs() < 0.02 || (-0.25..=1.1).contains(&share)
        });
        if between && sample.luma > BRIGHTER * self.luma { Surface::White } else { Surface::Other }
    }

    /// What each half-resolution pixel shows.
    pub fn surfaces(&self, picture: &Picture) -> Vec<Surface> {
        let (width, height) = (picture.width / 2, picture.height / 2);
        let mut surfaces = Vec::with_capacity(width * height);
        for v in 0..height {
            let (upper, lower) = (2 * v * picture.width, (2 * v + 1) * picture.width);
            for u in 0..width {
                let (mut luma, mut cb, mut cr) = (0u16, 0u16, 0u16);
                for index in [upper + 2 * u, upper + 2 * u + 1, lower + 2 * u, lower + 2 * u + 1] {
                    luma += u16::from(picture.luma[index]);
                    cb += u16::from(picture.chroma[index][0]);
                    cr += u16::from(picture.chroma[index][1]);
                }
                let chroma = [cb, cr].map(|sum| f32::from(sum) * 0.25 - 128.0);
                surfaces.push(self.classify(Sample::new(f32::from(luma) * 0.25, chroma)));
            }
        }
        surfaces
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(r: u8, g: u8, b: u8) -> Sample {
        let p = Picture::from_rgb(1, 1, &[r, g, b]).expect("a pixel");
        Sample::new(f32::from(p.luma[0]), p.chroma[0].map(|c| f32::from(c) - 128.0))
    }

    #[test]
    fn carpet_lines_and_obstacles_are_told_apart_in_any_light() {
        for light in [0.4, 1.0, 1.8] {
            let lit = |rgb: [f64; 3]| {
                let [r, g, b] = rgb.map(|c| (c * light) as u8);
                sample(r, g, b)
            };
            let carpet = Carpet::learn((0..100).map(|i| lit([30.0, 90.0 + f64::from(i % 10), 35.0]))).expect("green");
            assert_eq!(carpet.classify(lit([32.0, 95.0, 36.0])), Surface::Carpet);
            assert_eq!(carpet.classify(lit([20.0, 62.0, 23.0])), Surface::Carpet, "a shadow");
            assert_eq!(carpet.classify(lit([140.0, 140.0, 135.0])), Surface::White);
            assert_eq!(carpet.classify(lit([35.0, 35.0, 40.0])), Surface::Other, "a robot");
            assert_eq!(carpet.classify(lit([130.0, 60.0, 40.0])), Surface::Other, "a ball");
        }
        assert_eq!(Carpet::learn((0..100).map(|_| sample(90, 90, 90))), None);
    }
}
