//! Colours from a Bayer mosaic, in which each pixel has one of red, green and blue.

/// The order of the colours in a Bayer mosaic: the names list the first two rows from left to right.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Mosaic {
    /// Column and row of the first red pixel.
    first_red: [usize; 2],
}

impl Mosaic {
    pub(super) const RGGB: Self = Self { first_red: [0, 0] };
    pub(super) const BGGR: Self = Self { first_red: [1, 1] };
    pub(super) const GBRG: Self = Self { first_red: [0, 1] };
    pub(super) const GRBG: Self = Self { first_red: [1, 0] };

    /// Returns the colour of the pixel in a column and row: 0 for red, 1 for green, 2 for blue.
    fn colour_at(self, u: usize, v: usize) -> usize {
        let [red_u, red_v] = self.first_red;
        match ((v + red_v) % 2, (u + red_u) % 2) {
            (0, 0) => 0,
            (1, 1) => 2,
            _ => 1,
        }
    }
}

/// Converts a Bayer mosaic into RGB bilinearly: a missing colour is the mean of the nearest neighbours of that colour.
pub(super) fn demosaic(width: usize, height: usize, rows: &[&[u8]], mosaic: Mosaic) -> Vec<u8> {
    let mut rgb = Vec::with_capacity(3 * width * height);
    for v in 0..height {
        for u in 0..width {
            for colour in 0..3 {
                if mosaic.colour_at(u, v) == colour {
                    rgb.push(rows[v][u]);
                    continue;
                }
                let (mut sum, mut count) = (0u32, 0u32);
                let columns = u.saturating_sub(1)..(u + 2).min(width);
                for (nv, row) in rows.iter().enumerate().take((v + 2).min(height)).skip(v.saturating_sub(1)) {
                    for nu in columns.clone() {
                        // Missing green is taken from the four direct neighbours, red and blue from all eight.
                        let beside = colour != 1 || nu == u || nv == v;
                        if beside && mosaic.colour_at(nu, nv) == colour {
                            sum += u32::from(row[nu]);
                            count += 1;
                        }
                    }
                }
                rgb.push(((sum + count / 2) / count.max(1)) as u8);
            }
        }
    }
    rgb
}
