//! Large-scale coloured textures that cover their surface once, without repetition.

use super::super::stream::Stream;
use super::fixed::{ONE, fixed};

/// Red, green and blue, 0 to 255.
pub(super) type Colour = [f32; 3];

/// A finished texture, packed for fast sampling.
#[derive(Clone, Debug)]
pub(super) struct Sheet {
    columns: usize,
    rows: usize,
    texels_per_metre: f32,
    /// Red, green and blue in lanes of [`LANE`] bits, so that one multiplication weights all three.
    texels: Vec<u64>,
}

/// A texture under construction, in full precision.
#[derive(Clone, Debug)]
pub(super) struct Canvas {
    pub(super) columns: usize,
    pub(super) rows: usize,
    texel_m: f64,
    colours: Vec<[f64; 3]>,
}

/// Bits per colour channel. 8 bits of colour and two weights of [`FRACTION_BITS`](super::fixed::FRACTION_BITS) fill 20.
const LANE: u32 = 21;

/// Maximum number of texels along a side. Textures of huge surfaces get coarser.
const MAX_TEXELS_PER_SIDE: f64 = 4096.0;

impl Sheet {
    /// Colour at (x, y), metres from the corner. Beyond the edges the colour is that of the edge.
    #[inline]
    pub(super) fn sample(&self, x: f32, y: f32) -> Colour {
        let place = |metres: f32, count: usize| {
            let (index, fraction) =
                fixed((metres * self.texels_per_metre - 0.5).max(0.0).min((count - 2) as f32 + 0.98));
            (index as usize, u64::from(fraction))
        };
        let (column, fx) = place(x, self.columns);
        let (row, fy) = place(y, self.rows);
        let at = row * self.columns + column;
        let upper = &self.texels[at..at + 2];
        let lower = &self.texels[at + self.columns..at + self.columns + 2];
        let one = u64::from(ONE);
        let sum = (one - fy) * ((one - fx) * upper[0] + fx * upper[1]) + fy * ((one - fx) * lower[0] + fx * lower[1]);
        let lane =
            |which: u32| ((sum >> (which * LANE)) as i32 & ((1 << LANE) - 1)) as f32 * (1.0 / (ONE * ONE) as f32);
        [lane(0), lane(1), lane(2)]
    }
}

impl Canvas {
    /// A canvas of one colour. Texels have a side of `texel_m`, or more on a huge surface.
    pub(super) fn new(width_m: f64, height_m: f64, texel_m: f64, colour: [f64; 3]) -> Self {
        let texel_m = texel_m.max(width_m.max(height_m) / MAX_TEXELS_PER_SIDE);
        let count = |metres: f64| (libm::ceil(metres / texel_m) as usize).max(2);
        let (columns, rows) = (count(width_m), count(height_m));
        Self { columns, rows, texel_m, colours: vec![colour; columns * rows] }
    }

    /// Calls `change` for every texel with its position in metres and its colour.
    pub(super) fn paint(&mut self, mut change: impl FnMut(f64, f64, &mut [f64; 3])) {
        for (at, colour) in self.colours.iter_mut().enumerate() {
            let (column, row) = (at % self.columns, at / self.columns);
            change((column as f64 + 0.5) * self.texel_m, (row as f64 + 0.5) * self.texel_m, colour);
        }
    }

    /// Fills a rectangle, metres, with one colour.
    pub(super) fn rectangle(&mut self, from: [f64; 2], to: [f64; 2], colour: [f64; 3]) {
        let texel = |metres: f64, count: usize| (libm::round(metres / self.texel_m).max(0.0) as usize).min(count);
        let (left, right) = (texel(from[0], self.columns), texel(to[0], self.columns));
        let (top, bottom) = (texel(from[1], self.rows), texel(to[1], self.rows));
        for row in top..bottom {
            self.colours[row * self.columns..][left..right.max(left)].fill(colour);
        }
    }

    /// Multiplies colours by smooth noise from 1 - `share` to 1 + `share` with features of `scale_m` metres.
    pub(super) fn mottle(&mut self, stream: &mut Stream, scale_m: f64, share: f64) {
        let side = (self.columns.max(self.rows) as f64 * self.texel_m / scale_m) as usize + 2;
        let lattice: Vec<f64> = (0..side * side).map(|_| stream.between(-share, share)).collect();
        self.paint(|x, y, colour| {
            let smooth = |metres: f64| {
                let (whole, t) = ((metres / scale_m) as usize, metres / scale_m % 1.0);
                (whole.min(side - 2), t * t * (3.0 - 2.0 * t))
            };
            let ((column, tx), (row, ty)) = (smooth(x), smooth(y));
            let mix = |row: usize| {
                let (a, b) = (lattice[row * side + column], lattice[row * side + column + 1]);
                a + (b - a) * tx
            };
            let gain = 1.0 + mix(row) + (mix(row + 1) - mix(row)) * ty;
            *colour = colour.map(|value| value * gain);
        });
    }

    /// Softens edges by a mean over three texels along both axes, repeated `times` times.
    pub(super) fn blur(&mut self, times: usize) {
        let (columns, rows) = (self.columns, self.rows);
        for _ in 0..times {
            for vertical in [false, true] {
                let from = self.colours.clone();
                for (at, colour) in self.colours.iter_mut().enumerate() {
                    let (column, row) = (at % columns, at / columns);
                    let (before, after) = if vertical {
                        (row.saturating_sub(1) * columns + column, (row + 1).min(rows - 1) * columns + column)
                    } else {
                        (row * columns + column.saturating_sub(1), row * columns + (column + 1).min(columns - 1))
                    };
                    *colour = core::array::from_fn(|i| (from[before][i] + from[at][i] + from[after][i]) / 3.0);
                }
            }
        }
    }

    /// Packs the canvas into a texture.
    pub(super) fn finish(self) -> Sheet {
        let byte = |value: f64| libm::round(value).clamp(0.0, 255.0) as u64;
        let texel = |c: &[f64; 3]| byte(c[0]) | byte(c[1]) << LANE | byte(c[2]) << (2 * LANE);
        let texels = self.colours.iter().map(texel).collect();
        Sheet { columns: self.columns, rows: self.rows, texels_per_metre: (1.0 / self.texel_m) as f32, texels }
    }
}
