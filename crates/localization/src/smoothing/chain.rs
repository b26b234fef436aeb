//! Least squares along a chain: each frame knows its neighbours, and all know a few common unknowns.
//!
//! The normal equations are block tridiagonal with a border. Frames are eliminated one after the other, what is left is the
//! border's own system, and the way back gives every frame its step and its covariance: the forward and backward pass of
//! a smoother (Rauch, Tung, Striebel 1965), with constants.

use nalgebra::{Cholesky, SMatrix, SVector};

use super::CONSTANTS;

/// Unknowns of a frame, of which the first six are its pose's error.
pub const OWN: usize = 12;

pub type Own = SVector<f64, OWN>;
pub type Border = SVector<f64, CONSTANTS>;
type Square = SMatrix<f64, OWN, OWN>;
type Aside = SMatrix<f64, OWN, CONSTANTS>;
type Common = SMatrix<f64, CONSTANTS, CONSTANTS>;

/// Normal equations: sums of J^T J and of -J^T r.
#[derive(Clone, Debug, PartialEq)]
pub struct Chain {
    own: Vec<Square>,
    /// Rows of a frame, columns of the next.
    next: Vec<Square>,
    aside: Vec<Aside>,
    right: Vec<Own>,
    common: Common,
    common_right: Border,
}

/// The step that the equations ask for.
#[derive(Clone, Debug, PartialEq)]
pub struct Solution {
    pub steps: Vec<Own>,
    pub border: Border,
    pub covariances: Vec<Square>,
    pub border_covariance: Common,
}

impl Chain {
    pub fn new(frames: usize) -> Self {
        Self {
            own: vec![Square::zeros(); frames],
            next: vec![Square::zeros(); frames.saturating_sub(1)],
            aside: vec![Aside::zeros(); frames],
            right: vec![Own::zeros(); frames],
            common: Common::zeros(),
            common_right: Border::zeros(),
        }
    }

    /// One residual of a frame, already divided by its standard deviation, and its derivatives.
    pub fn add(&mut self, frame: usize, residual: f64, own: &Own, common: &Border) {
        self.own[frame] += own * own.transpose();
        self.aside[frame] += own * common.transpose();
        self.right[frame] -= own * residual;
        self.common += common * common.transpose();
        self.common_right -= common * residual;
    }

    /// One residual between a frame and the next.
    pub fn add_between(&mut self, frame: usize, residual: f64, own: &Own, next: &Own, common: &Border) {
        self.aside[frame] += own * common.transpose();
        self.aside[frame + 1] += next * common.transpose();
        self.add_common(residual, common);
        self.own[frame] += own * own.transpose();
        self.own[frame + 1] += next * next.transpose();
        self.next[frame] += own * next.transpose();
        self.right[frame] -= own * residual;
        self.right[frame + 1] -= next * residual;
    }

    /// One residual of the common unknowns alone.
    pub fn add_common(&mut self, residual: f64, common: &Border) {
        self.common += common * common.transpose();
        self.common_right -= common * residual;
    }

    /// `None` if some unknown is not determined at all.
    pub fn solve(&self) -> Option<Solution> {
        let count = self.own.len();
        let (mut inverses, mut asides, mut rights) =
            (Vec::with_capacity(count), self.aside.clone(), self.right.clone());
        let (mut common, mut common_right) = (self.common, self.common_right);
        for i in 0..count {
            let mut own = self.own[i];
            if i > 0 {
                let before: &Square = &inverses[i - 1];
                let link = self.next[i - 1].transpose() * before;
                own -= link * self.next[i - 1];
                let (aside, right) = (link * asides[i - 1], link * rights[i - 1]);
                asides[i] -= aside;
                rights[i] -= right;
            }
            let inverse = symmetric(&Cholesky::new(symmetric(&own))?.inverse());
            common -= asides[i].transpose() * inverse * asides[i];
            common_right -= asides[i].transpose() * (inverse * rights[i]);
            inverses.push(inverse);
        }
        let border_covariance = Cholesky::new((common + common.transpose()) / 2.0)?.inverse();
        let border = border_covariance * common_right;
        let mut steps = vec![Own::zeros(); count];
        let mut covariances = vec![Square::zeros(); count];
        // How a frame's step depends on the border, and its covariance if the border were known.
        let (mut leans, mut alone) = (Aside::zeros(), Square::zeros());
        for i in (0..count).rev() {
            let inverse = inverses[i];
            let mut right = rights[i] - asides[i] * border;
            let mut lean = asides[i];
            let mut own = inverse;
            if i + 1 < count {
                let link = inverse * self.next[i];
                right -= self.next[i] * steps[i + 1];
                lean += self.next[i] * leans;
                own += link * alone * link.transpose();
            }
            steps[i] = inverse * right;
            leans = -(inverse * lean);
            alone = symmetric(&own);
            covariances[i] = symmetric(&(alone + leans * border_covariance * leans.transpose()));
        }
        Some(Solution { steps, border, covariances, border_covariance })
    }
}

impl Solution {
    pub fn border_sigmas(&self) -> [f64; CONSTANTS] {
        core::array::from_fn(|i| libm::sqrt(self.border_covariance[(i, i)].max(0.0)))
    }
}

fn symmetric(matrix: &Square) -> Square {
    (matrix + matrix.transpose()) / 2.0
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector};
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn the_chain_solves_what_dense_normal_equations_solve(
            count in 1..6usize,
            numbers in proptest::collection::vec(-1.0..1.0f64, 4000),
        ) {
            let mut numbers = numbers.into_iter().cycle();
            let mut take = || numbers.next().expect("endless");
            let size = OWN * count + CONSTANTS;
            let mut chain = Chain::new(count);
            let mut rows: Vec<(DVector<f64>, f64)> = Vec::new();
            for frame in 0..count {
                for _ in 0..18 {
                    let (own, common) = (Own::from_fn(|_, _| take()), Border::from_fn(|_, _| take()));
                    let residual = take();
                    chain.add(frame, residual, &own, &common);
                    let mut row = DVector::zeros(size);
                    row.rows_mut(OWN * frame, OWN).copy_from(&own);
                    row.rows_mut(OWN * count, CONSTANTS).copy_from(&common);
                    rows.push((row, residual));
                }
                if frame + 1 < count {
                    let (own, next) = (Own::from_fn(|_, _| take()), Own::from_fn(|_, _| take()));
                    let common = Border::from_fn(|_, _| 0.3 * take());
                    let residual = take();
                    chain.add_between(frame, residual, &own, &next, &common);
                    let mut row = DVector::zeros(size);
                    row.rows_mut(OWN * frame, OWN).copy_from(&own);
                    row.rows_mut(OWN * frame + OWN, OWN).copy_from(&next);
                    row.rows_mut(OWN * count, CONSTANTS).copy_from(&common);
                    rows.push((row, residual));
                }
            }
            for i in 0..CONSTANTS {
                let common = Border::from_fn(|j, _| f64::from(u8::from(i == j)) * 2.0);
                chain.add_common(0.3, &common);
                let mut row = DVector::zeros(size);
                row[OWN * count + i] = 2.0;
                rows.push((row, 0.3));
            }
            let mut normal = DMatrix::zeros(size, size);
            let mut right = DVector::zeros(size);
            for (row, residual) in &rows {
                normal += row * row.transpose();
                right -= row * *residual;
            }
            let inverse = normal.try_inverse().expect("determined");
            let dense = &inverse * right;
            let found = chain.solve().expect("determined");
            for frame in 0..count {
                for i in 0..OWN {
                    prop_assert!((found.steps[frame][i] - dense[OWN * frame + i]).abs() < 1e-6);
                    for j in 0..OWN {
                        let wanted = inverse[(OWN * frame + i, OWN * frame + j)];
                        prop_assert!((found.covariances[frame][(i, j)] - wanted).abs() < 1e-6 * (1.0 + wanted.abs()));
                    }
                }
            }
            for i in 0..CONSTANTS {
                prop_assert!((found.border[i] - dense[OWN * count + i]).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn what_nothing_determines_is_no_solution() {
        assert_eq!(Chain::new(2).solve(), None);
    }
}
