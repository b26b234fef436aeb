//! Residuals of ground that two neighbouring frames show, which must lie at one place.

use glam::{DVec2, DVec3};

use super::chain::{Border, Chain, FRAME_UNKNOWNS, FrameVector};
use super::model::Model;
use super::moving_camera::MovingCamera;
use super::residuals::{Camera, Cameras, Changed, DIFFERENCE_STEP, ROBUST};
use super::{Frame, Match};

/// Adds the matches of the frames `i` and `i + 1` and returns their cost.
pub(super) fn add(
    chain: &mut Chain,
    i: usize,
    frames: [&Frame; 2],
    moving: [&MovingCamera; 2],
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
        let off = |moving: [&MovingCamera; 2], camera: &Camera| {
            ray_error(shared, moving, camera, aside).map(|off| off * scale)
        };
        let Some(now) = off(moving, &cameras.camera) else { continue };
        let mut by_frame = [[FrameVector::zeros(); 2]; 2];
        for k in 0..FRAME_UNKNOWNS {
            let mut small = FrameVector::zeros();
            small[k] = DIFFERENCE_STEP;
            let moved = moving.map(|moving| moving.moved(&small));
            for (which, moving) in [[&moved[0], moving[1]], [moving[0], &moved[1]]].into_iter().enumerate() {
                let slope = (off(moving, &cameras.camera).unwrap_or(now) - now) / DIFFERENCE_STEP;
                (by_frame[0][which][k], by_frame[1][which][k]) = (slope.x, slope.y);
            }
        }
        let mut by_camera = [Border::zeros(); 2];
        for Changed { constant, step, camera } in &cameras.changed {
            let slope = (off(moving, camera).unwrap_or(now) - now) / *step;
            (by_camera[0][*constant], by_camera[1][*constant]) = (slope.x, slope.y);
        }
        // Something that moves through the picture is far off in both directions: the robust loss takes both together.
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

/// Difference between the ray on which the later image shows the point and the direction in which it must lie, along both axes,
/// radians.
fn ray_error(
    shared: &Match,
    [before, here]: [&MovingCamera; 2],
    camera: &Camera,
    (x, y): (DVec3, DVec3),
) -> Option<DVec2> {
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
