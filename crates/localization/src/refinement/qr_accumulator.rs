//! Least squares by orthogonal (QR) factorisation, accumulated a block of rows at a time.

use nalgebra::{SMatrix, SVector};

/// Upper triangular R and right side d of the rows so far: minimise |R y - d|. A row holds N coefficients, the right side, and
/// zeros up to W numbers, for the sake of vector instructions.
#[derive(Clone, Debug)]
pub(super) struct Triangular<const N: usize, const W: usize> {
    r: [[f64; W]; N],
}

/// Rows that are factorised together.
const AT_ONCE: usize = 32;

/// A column with a smaller sum of squares is taken for zero: entries of 1e-140 beside the prior's 1.
const MIN_SQUARE_SUM: f64 = 1e-280;

/// Collects rows into blocks and reduces each to a triangle.
pub(super) struct Rows<const N: usize, const W: usize> {
    triangle: Triangular<N, W>,
    waiting: [[f64; W]; AT_ONCE],
    count: usize,
}

impl<const N: usize, const W: usize> Rows<N, W> {
    /// Starts without any row.
    pub(super) fn none() -> Self {
        Self::beside(Triangular { r: [[0.0; W]; N] })
    }

    /// Starts with N rows of weight 1 that say y = `y`.
    pub(super) fn identity(y: &SVector<f64, N>) -> Self {
        Self::beside(Triangular::identity(y))
    }

    fn beside(triangle: Triangular<N, W>) -> Self {
        Self { triangle, waiting: [[0.0; W]; AT_ONCE], count: 0 }
    }

    /// Adds one row.
    pub(super) fn push(&mut self, coefficients: &[f64; N], right: f64) {
        let row = &mut self.waiting[self.count];
        row[..N].copy_from_slice(coefficients);
        row[N] = right;
        row[N + 1..].fill(0.0);
        self.count += 1;
        if self.count == AT_ONCE {
            self.triangle.reflect(&mut self.waiting);
            self.count = 0;
        }
    }

    /// Reduces the rows that are left.
    pub(super) fn finish(mut self) -> Triangular<N, W> {
        self.triangle.reflect(&mut self.waiting[..self.count]);
        self.triangle
    }
}

impl<const N: usize, const W: usize> Triangular<N, W> {
    fn identity(y: &SVector<f64, N>) -> Self {
        const { assert!(W > N, "the right side needs a place") };
        let r = core::array::from_fn(|i| {
            let mut row = [0.0; W];
            (row[i], row[N]) = (1.0, y[i]);
            row
        });
        Self { r }
    }

    /// A copy with all rows scaled by `weight`, and N more of weight 1 that say y = `y`.
    pub(super) fn weighed(&self, weight: f64, y: &SVector<f64, N>) -> Self {
        let mut all = Self::identity(y);
        all.reflect(&mut self.r.map(|row| row.map(|value| weight * value)));
        all
    }

    /// A copy with N more rows of this weight that say y = 0.
    pub(super) fn damped(&self, weight: f64) -> Self {
        let mut rows = [[0.0; W]; N];
        for (i, row) in rows.iter_mut().enumerate() {
            row[i] = weight;
        }
        let mut damped = self.clone();
        damped.reflect(&mut rows);
        damped
    }

    /// Reduces `rows` into the triangle by Householder reflections, one for each column. What is left in `rows` is of no use.
    /// Rounding errors do not grow with the number of rows.
    fn reflect(&mut self, rows: &mut [[f64; W]]) {
        for column in 0..N {
            let mut products = [0.0; W];
            for row in rows.iter() {
                for (product, value) in products.iter_mut().zip(row) {
                    *product += row[column] * value;
                }
            }
            let (square, corner) = (products[column], self.r[column][column]);
            // Squares that underflow change no digit beside the prior's rows, whose entries are 1; divided by, they would give
            // infinities.
            if square < MIN_SQUARE_SUM {
                continue;
            }
            let length = libm::sqrt(corner * corner + square);
            // This is corner - length without cancellation, as corner is positive.
            let first = -square / (corner + length);
            let scale = 2.0 / (first * first + square);
            let mut shares = [0.0; W];
            for ((share, product), own) in shares.iter_mut().zip(&products).zip(&mut self.r[column]) {
                *share = scale * (first * *own + product);
                *own -= *share * first;
            }
            for row in rows.iter_mut() {
                let along = row[column];
                for (value, share) in row.iter_mut().zip(&shares) {
                    *value -= share * along;
                }
            }
        }
    }

    /// The solution y.
    pub(super) fn solve(&self) -> SVector<f64, N> {
        self.solve_from(0)
    }

    /// Solves as if the unknowns before `first` had been solved for already: their right sides are taken for zero, and they follow
    /// the others.
    pub(super) fn solve_from(&self, first: usize) -> SVector<f64, N> {
        let mut y = SVector::zeros();
        for i in (0..N).rev() {
            let rest: f64 = (i + 1..N).map(|j| self.r[i][j] * y[j]).sum();
            let right = if i < first { 0.0 } else { self.r[i][N] };
            y[i] = (right - rest) / self.r[i][i];
        }
        y
    }

    /// Inverse of R. The covariance is its product with its own transpose.
    pub(super) fn inverse(&self) -> SMatrix<f64, N, N> {
        let mut inverse = SMatrix::zeros();
        for column in 0..N {
            for i in (0..=column).rev() {
                let unit = if i == column { 1.0 } else { 0.0 };
                let rest: f64 = (i + 1..=column).map(|j| self.r[i][j] * inverse[(j, column)]).sum();
                inverse[(i, column)] = (unit - rest) / self.r[i][i];
            }
        }
        inverse
    }

    pub(super) fn r(&self) -> SMatrix<f64, N, N> {
        SMatrix::from_fn(|i, j| self.r[i][j])
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// The solution for three unknowns from these rows and an identity prior.
    fn solved(rows: &[([f64; 3], f64)]) -> [f64; 3] {
        let mut all = Rows::<3, 4>::identity(&SVector::zeros());
        rows.iter().for_each(|(coefficients, right)| all.push(coefficients, *right));
        all.finish().solve().into()
    }

    proptest! {
        #[test]
        fn a_column_whose_squares_underflow_tells_nothing(exponent in -330..-20i32, of in 0usize..3, signs in any::<u8>()) {
            let tiny = 10f64.powi(exponent);
            let rows: Vec<_> = (0..8u8)
                .map(|i| {
                    let mut coefficients = [1.0, f64::from(i), f64::from(i * i) - 9.0];
                    coefficients[of] = if signs >> i & 1 == 1 { tiny } else { -tiny };
                    (coefficients, 0.5 - f64::from(i))
                })
                .collect();
            let without: Vec<_> = rows.iter().cloned().map(|(mut row, right)| { row[of] = 0.0; (row, right) }).collect();
            for (value, expected) in solved(&rows).into_iter().zip(solved(&without)) {
                prop_assert!((value - expected).abs() <= 1e-12 * expected.abs().max(1e-7), "{value} for {expected}");
            }
        }
    }
}
