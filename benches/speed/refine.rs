//! Least squares over six unknowns.

use nalgebra::{Matrix6, Vector6};
use realitysim::geometry::Projector;
use realitysim::localization::refinement::{LinePoints, Prior, moved_pose, refine};

use super::measure::Bench;
use super::view::View;

pub fn run(bench: &mut Bench, view: &View) {
    let (points, projector) = (LinePoints::new(&view.field), Projector::new(&view.lens));
    let truth = view.pose.to_isometry() * view.footprint_from_optical;
    let sigmas = Vector6::new(0.03, 0.03, 0.01, 0.012, 0.012, 0.02);
    let covariance = Matrix6::from_diagonal(&sigmas.component_mul(&sigmas));
    let off = |by: f64| Prior { map_from_optical: moved_pose(&truth, &(sigmas * by)), covariance };
    let (near, far) = (off(0.2), off(1.0));
    let start = [Vector6::zeros()];
    let from =
        |prior: &Prior| refine(&points, &view.seen.image, &projector, prior, &start).map(|refined| refined.moved);
    bench.compare("refinement from a fifth of a sigma; from one sigma", None, || from(&far), || from(&near));
}
