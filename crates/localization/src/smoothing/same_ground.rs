//! A place of the ground that two neighbouring frames show must lie at one place.

use glam::{DVec2, DVec3};

use super::chain::{Border, Chain, OWN, Own};
use super::moving::Moving;
use super::residuals::{Camera, Cameras, Changed, Model, ROBUST, SMALL};
use super::{Frame, Match};

/// Adds the matches of the frames `i` and `i + 1`; returns their cost.
pub(super) fn add(
    chain: &mut Chain,
    i: usize,
    frames: [&Frame; 2],
    moving: [&Moving; 2],
    cameras: &Cameras,
    model: &Model,
) -> f64 {
    let [before, here] = frames;
    let matches = here.overlap.as_ref().filter(|overlap| overlap.before_ns == before.stamp_ns);
    let mut cost = 0.0;
    for shared in matches.iter().flat_map(|overlap| &overlap.matches) {
        let Some(ray) = cameras.camera.lens.unproject(shared.here) else { continue };
        let aside = ray.any_orthonormal_pair();
        let scale = cameras.camera.lens.focal() / model.match_px;
        let off = |moving: [&Moving; 2], camera: &Camera| off(shared, moving, camera, aside).map(|off| off * scale);
        let Some(now) = off(moving, &cameras.camera) else { continue };
        let mut by_frame = [[Own::zeros(); 2]; 2];
        for k in 0..OWN {
            let mut small = Own::zeros();
            small[k] = SMALL;
            let moved = moving.map(|moving| moving.moved(&small));
            for (which, moving) in [[&moved[0], moving[1]], [moving[0], &moved[1]]].into_iter().enumerate() {
                let slope = (off(moving, &cameras.camera).unwrap_or(now) - now) / SMALL;
                (by_frame[0][which][k], by_frame[1][which][k]) = (slope.x, slope.y);
            }
        }
        let mut by_camera = [Border::zeros(); 2];
        for Changed { constant, step, camera } in &cameras.changed {
            let slope = (off(moving, camera).unwrap_or(now) - now) / *step;
            (by_camera[0][*constant], by_camera[1][*constant]) = (slope.x, slope.y);
        }
        // Whoever walks through the picture is far off in both directions.
        let square = now.length_squared() / (ROBUST * ROBUST);
        let weight = 1.0 / (1.0 + square);
        cost += 0.5 * now.length_squared() / (1.0 + square);
        for (axis, off) in [now.x, now.y].into_iter().enumerate() {
            let [own, next] = by_frame[axis].map(|row| row * weight);
            chain.add_between(i, weight * off, &own, &next, &(by_camera[axis] * weight));
        }
    }
    cost
}

/// Between the ray on which the later image shows the place and the direction in which it must lie, radians along both axes.
fn off(shared: &Match, [before, here]: [&Moving; 2], camera: &Camera, (x, y): (DVec3, DVec3)) -> Option<DVec2> {
    let ray = camera.ray(shared.before, before)?;
    let distance = -ray.from.z / ray.along.z;
    if !(distance > 0.0 && distance.is_finite()) {
        return None;
    }
    let place = ray.from + ray.along * distance;
    let wanted = camera.pose_at(shared.here, here).inverse().transform_point(place).normalize();
    let seen = camera.lens.unproject(shared.here)?;
    Some(DVec2::new((wanted - seen).dot(x), (wanted - seen).dot(y)))
}
