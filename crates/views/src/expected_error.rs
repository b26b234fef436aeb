//! The displacement that is to be expected in a view: what a program needs to know before it trusts one.

use glam::{DVec2, DVec3};

use super::camera::CELL;
use super::ground_warp::Warp;
use super::synthesized_view::TagError;
use super::target_rays::Target;

/// Standard deviation of the ground's height, metres: carpets have waves, and blades stand up.
const GROUND_SIGMA_M: f64 = 0.003;
/// Error of a map that is interpolated on a grid, root mean square, pixels.
const GRID_ERROR_PX: f64 = 0.04;

/// Error of the inverse distance of what is beyond the ground, 1/m: in a known hall, of what stands before its walls, and in an unknown one,
/// whose walls are 5 to 15 m away and taken to be infinitely far.
const HALL_SIGMA_PER_M: [f64; 2] = [0.02, 0.12];

/// Every so many corners of cells are looked at: hundreds suffice.
const EVERY: usize = 7;

/// Expected displacement of what `target`'s view shows as this warp draws it, root mean square in pixels.
///
/// Beyond the ground, the error of the distance moves everything with the distance between both cameras. On the ground an error of the source's tag moves the ground in the source by its angle, and in the view by that times the magnification of the map:
/// more from above, where the source has seen it at a grazing angle. An error of the ground's height moves it by the difference of
/// both slopes of sight.
pub(super) fn expected_error_px(target: &Target, warp: &Warp, tag: &TagError) -> f64 {
    let focal = [warp.source().camera, target.camera].map(|camera| camera.lens().focal());
    let (mut sum, mut count) = (0.0, 0usize);
    let hall_sigma_per_m = HALL_SIGMA_PER_M[usize::from(target.world.hall().is_unknown())];
    for node in (0..target.node_count()).step_by(EVERY) {
        let Some((ray, hit)) = target.nodes[node] else { continue };
        let Some(magnification) = magnification(target, warp, node) else { continue };
        let square = match hit.on_ground() {
            None => {
                let turned = magnification * focal[0] * tag.rotation_rad;
                let apart = focal[1] * warp.baseline_m() * hall_sigma_per_m;
                turned * turned + apart * apart
            }
            Some(inverse_distance) => {
                let at = target.place + ray / inverse_distance;
                let from_source = (at - warp.place()).length().max(1e-3);
                let by_tag = magnification * focal[0] * libm::hypot(tag.rotation_rad, tag.position_m / from_source);
                let slope = |place: DVec3| (at - place).truncate() / place.z.max(0.02);
                let apart = slope(warp.place()).distance(slope(target.place));
                let by_height = focal[1] * inverse_distance * GROUND_SIGMA_M * apart;
                by_tag * by_tag + by_height * by_height
            }
        };
        sum += square;
        count += 1;
    }
    libm::hypot(libm::sqrt(sum / count.max(1) as f64), GRID_ERROR_PX)
}

/// View pixels per source pixel at a corner of the cells, root mean square over all directions; `None` at the edge of what the source
/// shows.
fn magnification(target: &Target, warp: &Warp, node: usize) -> Option<f64> {
    let (columns, _) = target.camera.cells();
    let at = |node: usize| DVec2::from_array(warp.node(node).map(f64::from));
    if (node + 1).is_multiple_of(columns + 1) || node + columns + 1 >= target.node_count() {
        return None;
    }
    let (right, down) = (at(node + 1) - at(node), at(node + columns + 1) - at(node));
    let area = right.perp_dot(down).abs();
    // The Frobenius norm of the inverse Jacobian; the comparison is false for NaN.
    let norm = libm::sqrt(right.length_squared() + down.length_squared()) / area * CELL as f64;
    (area > 1e-6).then_some(norm * core::f64::consts::FRAC_1_SQRT_2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Camera, Candidate, Pyramid, Vignetting, World};
    use realitysim_geometry::{Euler, Field, Isometry, Lens, LensModel, LensParameters};

    fn camera() -> Camera {
        let model = LensModel::KannalaBrandt { k: [0.0; 4] };
        let (width, height, fx, fy) = (160, 120, 51.0, 51.0);
        let parameters = LensParameters { width, height, fx, fy, cx: 79.5, cy: 59.5, model, fov_deg: Some(180.0) };
        Camera::new(&Lens::new(parameters).expect("a lens"))
    }

    fn world() -> World {
        World::without_goals(&Field::new(realitysim_config::load_field("kid-2020").expect("shipped")).expect("a field"))
    }

    fn pose(x: f64, y: f64, z: f64, yaw: f64) -> Isometry {
        Isometry::from_euler(Euler { yaw, pitch: 0.4, roll: 0.0 }, DVec3::new(x, y, z))
    }

    fn expected(camera: &Camera, wanted: &Isometry, source: &Isometry, tag: TagError) -> f64 {
        let (world, image) = (world(), Pyramid::default());
        let target = Target::new(camera, wanted, &world);
        let vignetting = Vignetting::default();
        let candidate = Candidate { id: 0, camera, map_from_link: *source, image: &image, tag, vignetting };
        expected_error_px(&target, &Warp::new(&target, &candidate), &tag)
    }

    #[test]
    fn the_expected_error_grows_with_distance_and_height() {
        let (camera, source) = (camera(), pose(0.0, 0.0, 0.55, 0.1));
        let tag = TagError { position_m: 0.005, rotation_rad: 0.002 };
        let above = [0.55, 0.65, 0.8, 1.2, 1.5].map(|z| expected(&camera, &pose(0.0, 0.1, z, 0.1), &source, tag));
        assert!(above.is_sorted() && above[4] > 3.0 * above[0], "{above:?}");
        let beside = [0.0, 0.1, 0.3, 0.6, 1.0].map(|y| expected(&camera, &pose(0.0, y, 0.55, 0.1), &source, tag));
        assert!(beside.is_sorted() && beside[4] > 3.0 * beside[0], "{beside:?}");
    }

    /// The displacement in the view when the source was taken beside its tag, in a hall that is not known, root mean square over random errors.
    fn displacement(camera: &Camera, wanted: &Isometry, source: &Isometry, tag: TagError, draws: &mut Draws) -> f64 {
        let walls_m = [Some(9.7), Some(8.0), Some(11.0), Some(7.0)];
        let in_hall = world().with_hall(crate::Hall { walls_m, ceiling_m: Some(6.0), yaw_rad: 0.0 });
        let (world, image) = (world(), Pyramid::default());
        let target = Target::new(camera, wanted, &world);
        let true_target = Target::new(camera, wanted, &in_hall);
        let candidate = |map_from_link| Candidate {
            id: 0,
            camera,
            map_from_link,
            image: &image,
            tag,
            vignetting: Vignetting::default(),
        };
        let said = candidate(*source);
        let warp = Warp::new(&target, &said);
        let (mut sum, mut count) = (0.0, 0usize);
        for _ in 0..4 {
            let turn = glam::DQuat::from_scaled_axis(draws.vector() * tag.rotation_rad);
            let true_source = Isometry::new(
                (turn * source.rotation).normalize(),
                source.translation + draws.vector() * tag.position_m,
            );
            let there = candidate(true_source);
            let right = Warp::new(&true_target, &there);
            for node in (0..target.node_count()).step_by(3) {
                let Some(magnification) = magnification(&target, &warp, node) else { continue };
                let [a, b] = [warp.node(node), right.node(node)].map(|at| DVec2::from_array(at.map(f64::from)));
                let apart = magnification * a.distance(b);
                if apart.is_finite() {
                    sum += apart * apart;
                    count += 1;
                }
            }
        }
        libm::sqrt(sum / count.max(1) as f64)
    }

    /// A linear congruential generator.
    struct Draws(u64);

    impl Draws {
        fn uniform(&mut self) -> f64 {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (self.0 >> 11) as f64 / (1u64 << 53) as f64
        }

        /// About normal in each part: the sum of twelve uniform numbers.
        fn vector(&mut self) -> DVec3 {
            let mut part = || (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0;
            DVec3::new(part(), part(), part())
        }
    }

    fn ranks(values: &[f64]) -> Vec<f64> {
        let mut order: Vec<usize> = (0..values.len()).collect();
        order.sort_by(|a, b| values[*a].total_cmp(&values[*b]));
        let mut ranks = vec![0.0; values.len()];
        order.into_iter().enumerate().for_each(|(rank, index)| ranks[index] = rank as f64);
        ranks
    }

    /// Spearman's rank correlation over random tags, sources and views.
    #[test]
    fn the_expected_error_ranks_views_as_the_true_one_does() {
        let (camera, mut draws) = (camera(), Draws(7));
        let (mut told, mut truth) = (Vec::new(), Vec::new());
        for _ in 0..1000 {
            let mut between = |low: f64, high: f64| low + (high - low) * draws.uniform();
            let source = pose(between(-2.0, 2.0), between(-1.5, 1.5), 0.55, between(-3.0, 3.0));
            let yaw = source.euler().yaw + between(-0.4, 0.4);
            let place = source.translation;
            let wanted = pose(place.x + between(-0.5, 0.5), place.y + between(-0.5, 0.5), between(0.3, 1.5), yaw);
            let tag = TagError { position_m: between(0.001, 0.02), rotation_rad: between(0.0005, 0.01) };
            told.push(expected(&camera, &wanted, &source, tag));
            truth.push(displacement(&camera, &wanted, &source, tag, &mut draws));
        }
        let (told, truth) = (ranks(&told), ranks(&truth));
        let count = told.len() as f64;
        let squares: f64 = told.iter().zip(&truth).map(|(a, b)| (a - b) * (a - b)).sum();
        let correlation = 1.0 - 6.0 * squares / (count * (count * count - 1.0));
        println!("rank correlation {correlation:.3}");
        assert!(correlation >= 0.8, "{correlation}");
    }
}
