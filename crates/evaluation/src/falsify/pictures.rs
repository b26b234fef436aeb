//! Distorted pictures: shifted, scaled, turned, or replaced by noise.

use glam::DVec2;

use realitysim_localization::random::{Purpose, Stream};
use realitysim_vision::{Chroma, Picture};

/// Change that is made to each picture of a walk. Pixels from beyond the edge are black.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Distortion {
    /// Shifts the picture.
    Shift {
        /// Pixels to the right and down.
        by_px: [i32; 2],
    },
    /// Scales the picture about its middle.
    Scale {
        /// Factor; more than 1 enlarges.
        by: f64,
    },
    /// Turns the picture about its middle.
    Turn {
        /// Angle clockwise, radians.
        by_rad: f64,
    },
    /// Replaces the picture by noise.
    Noise(Noise),
}

/// Kind of noise.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Noise {
    /// Independent pixels, uniform from black to white.
    Uniform,
    /// Neutral gray with the brightness of carpet and the contrast of turf, in grains a few pixels wide.
    Blurred,
    /// Blocks of the picture in random order: brightness, colours and texture are those of the field.
    Scrambled,
}

/// Side of the blocks of [`Noise::Scrambled`], pixels. It is even, since two pixels share their colour.
const BLOCK: usize = 8;
/// Side of the square window that noise is averaged over, pixels.
const GRAIN_PX: usize = 3;
const SEED: u64 = 0x6661_6c73_6966_7921;

impl Distortion {
    /// Describes the distortion in a few words, for people.
    pub fn name(&self) -> String {
        match self {
            Self::Shift { by_px: [right, 0] } => format!("pictures {right} px to the right"),
            Self::Shift { by_px: [0, down] } if *down > 0 => format!("pictures {down} px down"),
            Self::Shift { by_px: [0, down] } => format!("pictures {} px up", -down),
            Self::Shift { by_px: [right, down] } => format!("pictures {right} px to the right and {down} px down"),
            Self::Scale { by } => format!("pictures {:+.0} % in size", 100.0 * (by - 1.0)),
            Self::Turn { by_rad } => format!("pictures turned by {:.0} degrees", by_rad.to_degrees()),
            Self::Noise(Noise::Uniform) => "uniform noise".to_owned(),
            Self::Noise(Noise::Blurred) => "noise like turf".to_owned(),
            Self::Noise(Noise::Scrambled) => "pictures in scrambled blocks".to_owned(),
        }
    }

    /// Returns the distorted picture. `index` is that of the frame: noise differs from frame to frame.
    pub fn apply(&self, index: usize, picture: &Picture) -> Picture {
        let middle = DVec2::new(picture.width as f64 - 1.0, picture.height as f64 - 1.0) / 2.0;
        match *self {
            Self::Shift { by_px } => {
                let by = DVec2::from(by_px.map(f64::from));
                resampled(picture, |pixel| pixel - by)
            }
            Self::Scale { by } => resampled(picture, |pixel| middle + (pixel - middle) / by),
            Self::Turn { by_rad } => {
                let back = DVec2::new(libm::cos(by_rad), -libm::sin(by_rad));
                resampled(picture, |pixel| middle + back.rotate(pixel - middle))
            }
            Self::Noise(noise) => noise.picture(index, picture),
        }
    }
}

impl Noise {
    fn picture(self, index: usize, picture: &Picture) -> Picture {
        let mut stream = Stream::new(SEED, Purpose::Start, index as u64, 0, 0);
        let Picture { width, height, .. } = *picture;
        match self {
            Self::Uniform => {
                let mut drawn = |count: usize| (0..count).map(|_| stream.below(256) as u8).collect::<Vec<u8>>();
                let (luma, blue) = (drawn(width * height), drawn(picture.chroma.blue.len()));
                let red = drawn(blue.len());
                Picture { width, height, luma, chroma: Chroma { blue, red } }
            }
            Self::Blurred => {
                let drawn: Vec<f64> = (0..width * height).map(|_| stream.normal()).collect();
                let grain = blurred(&blurred(&drawn, width, GRAIN_PX, 1), width, GRAIN_PX, width);
                // A mean of n independent values has the standard deviation of one divided by the root of n.
                let spread = 25.0 * GRAIN_PX as f64;
                let luma = grain.iter().map(|value| (100.0 + spread * value).clamp(0.0, 255.0) as u8).collect();
                let neutral = vec![128; picture.chroma.blue.len()];
                Picture { width, height, luma, chroma: Chroma { blue: neutral.clone(), red: neutral } }
            }
            Self::Scrambled => scrambled(picture, &mut stream),
        }
    }
}

/// Averages `size` neighbours that are `stride` apart in memory.
fn blurred(values: &[f64], width: usize, size: usize, stride: usize) -> Vec<f64> {
    let reach = size / 2;
    let mean = |at: usize| {
        let near = (0..size).filter_map(|step| (at + step * stride).checked_sub(reach * stride));
        let (sum, count) = near
            .filter(|other| *other < values.len() && (stride != 1 || other / width == at / width))
            .fold((0.0, 0.0), |(sum, count), other| (sum + values[other], count + 1.0));
        if count > 0.0 { sum / count } else { 0.0 }
    };
    (0..values.len()).map(mean).collect()
}

/// Resamples a picture; `from` maps each pixel of the result to its source. Colour has half the resolution.
fn resampled(picture: &Picture, from: impl Fn(DVec2) -> DVec2) -> Picture {
    let Picture { width, height, .. } = *picture;
    let half = [width.div_ceil(2), height.div_ceil(2)];
    let of_half = |pixel: DVec2| (from(pixel * 2.0 + 0.5) - 0.5) / 2.0;
    let chroma = |plane: &[u8]| if plane.is_empty() { Vec::new() } else { sampled(plane, half, 128, of_half) };
    let (blue, red) = (chroma(&picture.chroma.blue), chroma(&picture.chroma.red));
    Picture { width, height, luma: sampled(&picture.luma, [width, height], 0, &from), chroma: Chroma { blue, red } }
}

/// Resamples a plane by bilinear interpolation; beyond its edges it is `outside`.
fn sampled(plane: &[u8], [width, height]: [usize; 2], outside: u8, from: impl Fn(DVec2) -> DVec2) -> Vec<u8> {
    let at = |x: f64, y: f64| {
        let inside = x >= 0.0 && y >= 0.0 && x < width as f64 && y < height as f64;
        f64::from(if inside { plane[y as usize * width + x as usize] } else { outside })
    };
    let pixel = |index: usize| {
        let place = from(DVec2::new((index % width) as f64, (index / width) as f64));
        let corner = DVec2::new(libm::floor(place.x), libm::floor(place.y));
        let (DVec2 { x, y }, DVec2 { x: u, y: v }) = (corner, place - corner);
        let upper = at(x, y) * (1.0 - u) + at(x + 1.0, y) * u;
        let lower = at(x, y + 1.0) * (1.0 - u) + at(x + 1.0, y + 1.0) * u;
        libm::round(upper * (1.0 - v) + lower * v) as u8
    };
    (0..width * height).map(pixel).collect()
}

/// Moves the blocks of a picture at random. Incomplete blocks at the right and lower edge stay where they are.
fn scrambled(picture: &Picture, stream: &mut Stream) -> Picture {
    let [columns, rows] = [picture.width / BLOCK, picture.height / BLOCK];
    let mut order: Vec<usize> = (0..columns * rows).collect();
    for last in (1..order.len()).rev() {
        order.swap(last, stream.below(last as u64 + 1) as usize);
    }
    let moved = |plane: &[u8], width: usize, block: usize| {
        let mut moved = plane.to_vec();
        for (to, from) in order.iter().enumerate() {
            let corner = |place: usize| place / columns * block * width + place % columns * block;
            for row in 0..block {
                let (to, from) = (corner(to) + row * width, corner(*from) + row * width);
                moved[to..to + block].copy_from_slice(&plane[from..from + block]);
            }
        }
        moved
    };
    let chroma = |plane: &[u8]| match plane {
        [] => Vec::new(),
        plane => moved(plane, picture.width.div_ceil(2), BLOCK / 2),
    };
    let (blue, red) = (chroma(&picture.chroma.blue), chroma(&picture.chroma.red));
    let luma = moved(&picture.luma, picture.width, BLOCK);
    Picture { luma, chroma: Chroma { blue, red }, ..*picture }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture() -> Picture {
        let luma = (0..40 * 30).map(|i| (i * 7 % 251) as u8).collect();
        let plane = |from: usize| (0..20 * 15).map(|i| ((i + from) * 5 % 200) as u8).collect();
        Picture { width: 40, height: 30, luma, chroma: Chroma { blue: plane(0), red: plane(9) } }
    }

    #[test]
    fn a_shift_moves_every_pixel_and_leaves_black_behind() {
        let own = picture();
        let moved = Distortion::Shift { by_px: [2, 4] }.apply(0, &own);
        for (index, value) in moved.luma.iter().enumerate() {
            let (x, y) = (index % 40, index / 40);
            let expected = if x < 2 || y < 4 { 0 } else { own.luma[(y - 4) * 40 + x - 2] };
            assert_eq!(*value, expected, "{x}, {y}");
        }
        assert_eq!(moved.chroma.blue[2 * 20 + 1], own.chroma.blue[0]);
        assert_eq!(moved.chroma.red[0], 128);
    }

    #[test]
    fn scales_and_turns_and_their_inverses_keep_the_middle() {
        let smooth = Picture { luma: (0..1200).map(|i| (60 + i % 40 + 2 * (i / 40)) as u8).collect(), ..picture() };
        for (there, back) in [
            (Distortion::Scale { by: 0.9 }, Distortion::Scale { by: 1.0 / 0.9 }),
            (Distortion::Turn { by_rad: 0.1 }, Distortion::Turn { by_rad: -0.1 }),
        ] {
            let again = back.apply(0, &there.apply(0, &smooth));
            for y in 8..22 {
                for x in 8..32 {
                    let at = y * 40 + x;
                    assert!(again.luma[at].abs_diff(smooth.luma[at]) <= 1, "{there:?} at {x}, {y}");
                }
            }
        }
        // Clockwise: what was to the right of the middle is below it.
        let mut dot = Picture { luma: vec![0; 1200], ..picture() };
        dot.luma[15 * 40 + 30] = 255;
        let turned = Distortion::Turn { by_rad: core::f64::consts::FRAC_PI_2 }.apply(0, &dot);
        let brightest = (0..1200).max_by_key(|at| turned.luma[*at]).expect("pixels");
        assert_eq!((brightest % 40, brightest / 40), (19, 25));
    }

    #[test]
    fn noise_differs_between_frames_and_scrambling_loses_nothing() {
        let own = picture();
        for noise in [Noise::Uniform, Noise::Blurred, Noise::Scrambled] {
            let [one, same, other] = [0, 0, 1].map(|index| noise.picture(index, &own));
            assert_eq!(one, same);
            assert_ne!(one.luma, other.luma);
            assert_ne!(one.luma, own.luma);
            assert_eq!((one.luma.len(), one.chroma.red.len()), (own.luma.len(), own.chroma.red.len()));
        }
        let sorted = |mut plane: Vec<u8>| {
            plane.sort();
            plane
        };
        let scrambled = Noise::Scrambled.picture(3, &own);
        assert_eq!(sorted(scrambled.luma), sorted(own.luma.clone()));
        assert_eq!(sorted(scrambled.chroma.blue), sorted(own.chroma.blue.clone()));
    }
}
