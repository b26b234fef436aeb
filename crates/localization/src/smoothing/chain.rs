//! Least squares along a chain, in which each frame is linked to its neighbours and all frames share a few unknowns.
//!
//! The normal equations are block tridiagonal with a border. Frames are eliminated one after the other, which leaves the
//! border's own system. The way back gives the step and the covariance of every frame: the forward and backward passes of a
//! smoother (Rauch, Tung, Striebel 1965), with constants.

use nalgebra::{Cholesky, SMatrix, SVector};

use super::CONSTANTS;

/// Number of unknowns of a frame. The first six are its pose's error.
pub const FRAME_UNKNOWNS: usize = 12;

/// A vector over the unknowns of one frame.
pub type FrameVector = SVector<f64, FRAME_UNKNOWNS>;
/// A vector over the common unknowns.
pub type Border = SVector<f64, CONSTANTS>;
type FrameBlock = SMatrix<f64, FRAME_UNKNOWNS, FRAME_UNKNOWNS>;
type CommonBlock = SMatrix<f64, FRAME_UNKNOWNS, CONSTANTS>;
type Common = SMatrix<f64, CONSTANTS, CONSTANTS>;

/// Normal equations: sums of J^T J and of -J^T r.
#[derive(Clone, Debug, PartialEq)]
pub struct Chain {
    /// Diagonal blocks.
    own: Vec<FrameBlock>,
    /// Off-diagonal blocks: rows of a frame, columns of the next.
    next: Vec<FrameBlock>,
    /// Blocks of each frame with the common unknowns.
    aside: Vec<CommonBlock>,
    /// Right sides of the frames.
    right: Vec<FrameVector>,
    /// Block of the common unknowns.
    common: Common,
    common_right: Border,
}

/// The solution of the normal equations.
#[derive(Clone, Debug, PartialEq)]
pub struct Solution {
    /// Step of each frame.
    pub steps: Vec<FrameVector>,
    /// Step of the common unknowns.
    pub border: Border,
    /// Covariance of each frame's unknowns.
    pub covariances: Vec<FrameBlock>,
    /// Covariance of the common unknowns.
    pub border_covariance: Common,
}

impl Chain {
    /// Equations without any residual.
    pub fn new(frames: usize) -> Self {
        Self {
            own: vec![FrameBlock::zeros(); frames],
            next: vec![FrameBlock::zeros(); frames.saturating_sub(1)],
            aside: vec![CommonBlock::zeros(); frames],
            right: vec![FrameVector::zeros(); frames],
            common: Common::zeros(),
            common_right: Border::zeros(),
        }
    }

    /// Adds one residual of a frame, divided by its standard deviation, with its derivatives.
    pub fn add(&mut self, frame: usize, residual: f64, own: &FrameVector, common: &Border) {
        self.own[frame] += own * own.transpose();
        self.aside[frame] += own * common.transpose();
        self.right[frame] -= own * residual;
        self.common += common * common.transpose();
        self.common_right -= common * residual;
    }

    /// Adds one residual between a frame and the next.
    pub fn add_between(&mut self, frame: usize, residual: f64, own: &FrameVector, next: &FrameVector, common: &Border) {
        self.aside[frame] += own * common.transpose();
        self.aside[frame + 1] += next * common.transpose();
        self.add_common(residual, common);
        self.own[frame] += own * own.transpose();
        self.own[frame + 1] += next * next.transpose();
        self.next[frame] += own * next.transpose();
        self.right[frame] -= own * residual;
        self.right[frame + 1] -= next * residual;
    }

    /// Adds one residual of the common unknowns alone.
    pub fn add_common(&mut self, residual: f64, common: &Border) {
        self.common += common * common.transpose();
        self.common_right -= common * residual;
    }

    /// Solves the equations; `None` if some unknown is not determined.
    pub fn solve(&self) -> Option<Solution> {
        let count = self.own.len();
        let (mut inverses, mut asides, mut rights) =
            (Vec::with_capacity(count), self.aside.clone(), self.right.clone());
        let (mut common, mut common_right) = (self.common, self.common_right);
        for i in 0..count {
            let mut own = self.own[i];
            if i > 0 {
                let before: &FrameBlock = &inverses[i - 1];
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
        let mut steps = vec![FrameVector::zeros(); count];
        let mut covariances = vec![FrameBlock::zeros(); count];
        // The derivative of a frame's step by the border, and the frame's covariance for a known border.
        let (mut leans, mut alone) = (CommonBlock::zeros(), FrameBlock::zeros());
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
    /// Standard deviations of the common unknowns.
    pub fn border_sigmas(&self) -> [f64; CONSTANTS] {
        core::array::from_fn(|i| libm::sqrt(self.border_covariance[(i, i)].max(0.0)))
    }
}

fn symmetric(matrix: &FrameBlock) -> FrameBlock {
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
            let size = FRAME_UNKNOWNS * count + CONSTANTS;
            let mut chain = Chain::new(count);
            let mut rows: Vec<(DVector<f64>, f64)> = Vec::new();
            for frame in 0..count {
                for _ in 0..18 {
                    let (own, common) = (FrameVector::from_fn(|_, _| take()), Border::from_fn(|_, _| take()));
                    let residual = take();
                    chain.add(frame, residual, &own, &common);
                    let mut row = DVector::zeros(size);
                    row.rows_mut(FRAME_UNKNOWNS * frame, FRAME_UNKNOWNS).copy_from(&own);
                    row.rows_mut(FRAME_UNKNOWNS * count, CONSTANTS).copy_from(&common);
                    rows.push((row, residual));
                }
                if frame + 1 < count {
                    let (own, next) = (FrameVector::from_fn(|_, _| take()), FrameVector::from_fn(|_, _| take()));
                    let common = Border::from_fn(|_, _| 0.3 * take());
                    let residual = take();
                    chain.add_between(frame, residual, &own, &next, &common);
                    let mut row = DVector::zeros(size);
                    row.rows_mut(FRAME_UNKNOWNS * frame, FRAME_UNKNOWNS).copy_from(&own);
                    row.rows_mut(FRAME_UNKNOWNS * frame + FRAME_UNKNOWNS, FRAME_UNKNOWNS).copy_from(&next);
                    row.rows_mut(FRAME_UNKNOWNS * count, CONSTANTS).copy_from(&common);
                    rows.push((row, residual));
                }
            }
            for i in 0..CONSTANTS {
                let common = Border::from_fn(|j, _| f64::from(u8::from(i == j)) * 2.0);
                chain.add_common(0.3, &common);
                let mut row = DVector::zeros(size);
                row[FRAME_UNKNOWNS * count + i] = 2.0;
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
                for i in 0..FRAME_UNKNOWNS {
                    prop_assert!((found.steps[frame][i] - dense[FRAME_UNKNOWNS * frame + i]).abs() < 1e-6);
                    for j in 0..FRAME_UNKNOWNS {
                        let wanted = inverse[(FRAME_UNKNOWNS * frame + i, FRAME_UNKNOWNS * frame + j)];
                        prop_assert!((found.covariances[frame][(i, j)] - wanted).abs() < 1e-6 * (1.0 + wanted.abs()));
                    }
                }
            }
            for i in 0..CONSTANTS {
                prop_assert!((found.border[i] - dense[FRAME_UNKNOWNS * count + i]).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn what_nothing_determines_is_no_solution() {
        assert_eq!(Chain::new(2).solve(), None);
    }
}
