//! A place of the ground that two neighbouring frames show must lie at one place.

use glam::{DVec2, DVec3};
use nalgebra::Vector6;

use super::chain::{Border, Chain};
use super::residuals::{Lenses, Model, ROBUST, SMALL};
use super::{Frame, Match};
use crate::geometry::{Isometry, Lens};
use crate::localization::refinement::moved_pose;

/// Adds the matches of the frames `i` and `i + 1`; returns their cost.
pub(super) fn add(
    chain: &mut Chain,
    i: usize,
    frames: [&Frame; 2],
    poses: [&Isometry; 2],
    lenses: &Lenses,
    model: &Model,
) -> f64 {
    let [before, here] = frames;
    let matches = here.overlap.as_ref().filter(|overlap| overlap.before_ns == before.stamp_ns);
    let mut cost = 0.0;
    for shared in matches.iter().flat_map(|overlap| &overlap.matches) {
        let Some(ray) = lenses.lens.unproject(shared.here) else { continue };
        let aside = ray.any_orthonormal_pair();
        let scale = lenses.lens.focal() / model.match_px;
        let off = |poses: [&Isometry; 2], lens: &Lens| off(shared, poses, lens, aside).map(|off| off * scale);
        let Some(now) = off(poses, &lenses.lens) else { continue };
        let mut by_pose = [[Vector6::zeros(); 2]; 2];
        for k in 0..6 {
            let mut small = Vector6::zeros();
            small[k] = SMALL;
            let moved = poses.map(|pose| moved_pose(pose, &small));
            for (which, poses) in [[&moved[0], poses[1]], [poses[0], &moved[1]]].into_iter().enumerate() {
                let slope = (off(poses, &lenses.lens).unwrap_or(now) - now) / SMALL;
                (by_pose[0][which][k], by_pose[1][which][k]) = (slope.x, slope.y);
            }
        }
        let mut by_lens = [Border::zeros(); 2];
        for (k, (step, lens)) in lenses.changed.iter().enumerate() {
            let slope = (off(poses, lens).unwrap_or(now) - now) / *step;
            (by_lens[0][k], by_lens[1][k]) = (slope.x, slope.y);
        }
        // Whoever walks through the picture is far off in both directions.
        let square = now.length_squared() / (ROBUST * ROBUST);
        let weight = 1.0 / (1.0 + square);
        cost += 0.5 * now.length_squared() / (1.0 + square);
        for (axis, off) in [now.x, now.y].into_iter().enumerate() {
            let [own, next] = by_pose[axis].map(|row| row * weight);
            chain.add_between(i, weight * off, &own, &next, &(by_lens[axis] * weight));
        }
    }
    cost
}

/// Between the ray on which the later image shows the place and the direction in which it must lie, radians along both axes.
fn off(shared: &Match, [before, here]: [&Isometry; 2], lens: &Lens, (x, y): (DVec3, DVec3)) -> Option<DVec2> {
    let ray = before.transform_vector(lens.unproject(shared.before)?);
    let distance = -before.translation.z / ray.z;
    if !(distance > 0.0 && distance.is_finite()) {
        return None;
    }
    let place = before.translation + ray * distance;
    let wanted = here.inverse().transform_point(place).normalize();
    let seen = lens.unproject(shared.here)?;
    Some(DVec2::new((wanted - seen).dot(x), (wanted - seen).dot(y)))
}
