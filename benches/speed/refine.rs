//! Least squares over six unknowns.

use std::cell::RefCell;

use nalgebra::{Matrix6, Vector6};
use realitysim::localization::refinement::{Prior, Refiner, moved_pose};

use super::measure::Bench;
use super::view::View;

pub fn run(bench: &mut Bench, view: &View) {
    let refiner = RefCell::new(Refiner::new(&view.field, &view.lens));
    let truth = view.pose.to_isometry() * view.footprint_from_optical;
    let sigmas = Vector6::new(0.03, 0.03, 0.01, 0.012, 0.012, 0.02);
    let covariance = Matrix6::from_diagonal(&sigmas.component_mul(&sigmas));
    let off = |by: f64| Prior::of_pose(moved_pose(&truth, &(sigmas * by)), &covariance);
    let (near, far) = (off(0.2), off(1.0));
    let start = [Vector6::zeros()];
    let from = |prior: &Prior| {
        let refined = refiner.borrow_mut().refine(&view.seen.image, prior, &start);
        refined.map(|refined| refined.moved)
    };
    bench.compare("refinement from a fifth of a sigma; from one sigma", None, || from(&far), || from(&near));
}
