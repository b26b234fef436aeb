//! Least squares by orthogonal factorisation, some rows at a time.

use nalgebra::{Matrix6, Vector6};

/// Upper triangular R and right side d of the rows so far: minimise |R y - d|.
#[derive(Clone, Debug)]
pub(super) struct Triangular {
    r: [Row; 6],
}

/// Six coefficients, the right side, and a zero: what vectors are made of.
type Row = [f64; 8];
const RIGHT: usize = 6;
const AT_ONCE: usize = 32;

/// Rows on their way into a triangle.
pub(super) struct Rows {
    triangle: Triangular,
    waiting: [Row; AT_ONCE],
    count: usize,
}

impl Rows {
    /// Six rows that say y = `y`, each with weight 1.
    pub(super) fn identity(y: &Vector6<f64>) -> Self {
        let r = core::array::from_fn(|i| {
            let mut row = Row::default();
            (row[i], row[RIGHT]) = (1.0, y[i]);
            row
        });
        Self { triangle: Triangular { r }, waiting: [Row::default(); AT_ONCE], count: 0 }
    }

    pub(super) fn push(&mut self, [a, b, c, d, e, f]: [f64; 6], right: f64) {
        self.waiting[self.count] = [a, b, c, d, e, f, right, 0.0];
        self.count += 1;
        if self.count == AT_ONCE {
            self.triangle.reflect(&mut self.waiting);
            self.count = 0;
        }
    }

    pub(super) fn finish(mut self) -> Triangular {
        self.triangle.reflect(&mut self.waiting[..self.count]);
        self.triangle
    }
}

impl Triangular {
    /// Six more rows that say y = 0, each with this weight.
    pub(super) fn damped(&self, weight: f64) -> Self {
        let mut rows = [Row::default(); 6];
        for (i, row) in rows.iter_mut().enumerate() {
            row[i] = weight;
        }
        let mut damped = self.clone();
        damped.reflect(&mut rows);
        damped
    }

    /// Householder reflections, one a column, that turn the rows into the triangle; what is left of them is of no use. Rounding
    /// errors do not grow with the number of rows.
    fn reflect(&mut self, rows: &mut [Row]) {
        for column in 0..6 {
            let mut products = Row::default();
            for row in rows.iter() {
                for (product, value) in products.iter_mut().zip(row) {
                    *product += row[column] * value;
                }
            }
            let (square, corner) = (products[column], self.r[column][column]);
            if square == 0.0 {
                continue;
            }
            let length = libm::sqrt(corner * corner + square);
            // corner - length without cancellation, as corner is positive.
            let first = -square / (corner + length);
            let scale = 2.0 / (first * first + square);
            let mut shares = Row::default();
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

    pub(super) fn solve(&self) -> Vector6<f64> {
        let mut y = [0.0; 6];
        for i in (0..6).rev() {
            let rest: f64 = (i + 1..6).map(|j| self.r[i][j] * y[j]).sum();
            y[i] = (self.r[i][RIGHT] - rest) / self.r[i][i];
        }
        Vector6::from(y)
    }

    /// Largest over smallest singular value of R: how many digits the solution can lose. At least 1.
    pub(super) fn condition(&self) -> f64 {
        let r = Matrix6::from_fn(|i, j| self.r[i][j]);
        let values = r.singular_values();
        values.max() / values.min()
    }

    /// Inverse of R: the covariance is its product with its own transpose.
    pub(super) fn inverse(&self) -> Matrix6<f64> {
        let mut inverse = Matrix6::zeros();
        for column in 0..6 {
            for i in (0..=column).rev() {
                let unit = if i == column { 1.0 } else { 0.0 };
                let rest: f64 = (i + 1..=column).map(|j| self.r[i][j] * inverse[(j, column)]).sum();
                inverse[(i, column)] = (unit - rest) / self.r[i][i];
            }
        }
        inverse
    }
}
