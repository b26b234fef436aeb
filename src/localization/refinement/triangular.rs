//! Least squares by orthogonal factorisation, a row at a time.

use nalgebra::{Matrix6, Vector6};

/// Upper triangular R and right side d of the rows so far: minimise |R y - d|.
#[derive(Clone, Debug)]
pub(super) struct Triangular {
    r: [[f64; 6]; 6],
    d: [f64; 6],
}

impl Triangular {
    /// Six rows that say y = `y`, each with weight 1.
    pub(super) fn identity(y: &Vector6<f64>) -> Self {
        let mut r = [[0.0; 6]; 6];
        for (i, row) in r.iter_mut().enumerate() {
            row[i] = 1.0;
        }
        Self { r, d: [y[0], y[1], y[2], y[3], y[4], y[5]] }
    }

    /// Rotates the row into the triangle (Givens); rounding errors do not grow with the number of rows.
    pub(super) fn push(&mut self, mut row: [f64; 6], mut value: f64) {
        for i in 0..6 {
            if row[i] == 0.0 {
                continue;
            }
            let (a, b) = (self.r[i][i], row[i]);
            let length = libm::sqrt(a * a + b * b);
            let (c, s) = (a / length, b / length);
            for (old, new) in self.r[i][i..].iter_mut().zip(&mut row[i..]) {
                (*old, *new) = (c * *old + s * *new, c * *new - s * *old);
            }
            let (old, new) = (self.d[i], value);
            self.d[i] = c * old + s * new;
            value = c * new - s * old;
        }
    }

    pub(super) fn solve(&self) -> Vector6<f64> {
        let mut y = [0.0; 6];
        for i in (0..6).rev() {
            let rest: f64 = (i + 1..6).map(|j| self.r[i][j] * y[j]).sum();
            y[i] = (self.d[i] - rest) / self.r[i][i];
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
