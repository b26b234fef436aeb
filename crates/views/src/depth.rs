//! The depth of a view: how far along its ray each pixel meets the ground, a goal or the hall.

use super::camera::{CELL, Camera};
use super::target_rays::{Target, cells};
use super::world::World;
use realitysim_geometry::Isometry;

/// Depth of the view of `camera` from `map_from_link`, its pose of `camera_link` in `map`: metres along the unit ray, row by row.
///
/// It is measured along the ray, since a fisheye also sees what lies beside the optical axis and behind the image plane. The
/// ray of a bar of a goal ends in the plane through the bar's axis. Depth is infinite for what is far or unknown, and NaN
/// where the lens draws nothing: an object is in front of what the image shows if it is nearer than this. Robots and people
/// that recorded images show have the depth of what is behind them.
pub fn depth_m(camera: &Camera, map_from_link: &Isometry, world: &World) -> Vec<f32> {
    let target = Target::new(camera, map_from_link, world);
    let (columns, rows) = camera.cells();
    let mut depths = vec![f32::NAN; camera.width() * camera.height()];
    for (cell, mixed) in cells(columns, rows).zip(&target.mixed) {
        match mixed {
            Some(hits) => write_cell(&mut depths, camera, cell, &hits.inverse_distances),
            None => write_cell(&mut depths, camera, cell, &target.ray_hits(cell, false).inverse_distances),
        }
    }
    depths
}

/// Writes the depths of one cell, where the lens draws them.
fn write_cell(depths: &mut [f32], camera: &Camera, (column, row): (usize, usize), inverse_distances: &[f32]) {
    let (width, left, top) = (camera.width(), column * CELL, row * CELL);
    for (line, nearness) in inverse_distances.chunks_exact(CELL).enumerate().take(camera.height() - top) {
        for (u, per_m) in (left..width).zip(nearness) {
            let at = (top + line) * width + u;
            if camera.shows()[at] {
                // What lies behind the camera is met by no ray.
                depths[at] = if *per_m > 0.0 { 1.0 / per_m } else { f32::INFINITY };
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Hall, optical};
    use glam::DVec3;
    use proptest::prelude::*;
    use realitysim_geometry::field::Goal;
    use realitysim_geometry::{Euler, Field, FieldDimensions, Lens};

    const GOAL: Goal = Goal { width_m: 1.5, height_m: 0.9, depth_m: 0.5, post_diameter_m: 0.1 };
    const HALL: Hall = Hall { yaw_rad: 0.1, walls_m: [Some(7.0), Some(5.0), None, Some(6.0)], ceiling_m: Some(4.0) };

    fn field() -> Field {
        let field = realitysim_config::load_field("kid-2009").expect("a shipped field");
        Field::new(FieldDimensions { goal: Some(GOAL), ..field }).expect("a field")
    }

    fn camera() -> Camera {
        let lens = realitysim_config::load_lens("fisheye-640").expect("a shipped lens").lens;
        Camera::new(&Lens::new(lens.parameters().resized([Some(160), None])).expect("a lens"))
    }

    /// Distance of a point from the nearest plane of floor, ceiling and walls, metres.
    fn off_the_planes(at: DVec3) -> f64 {
        let walls = HALL.walls_m.iter().enumerate();
        let walls = walls.filter_map(|(wall, metres)| Some(HALL.normal(wall).dot(at.truncate()) - (*metres)?));
        walls.chain([at.z, HALL.ceiling_m.expect("known") - at.z]).map(f64::abs).fold(f64::INFINITY, f64::min)
    }

    /// Distance of a point from the axis of the nearest bar, metres.
    fn off_the_bars(field: &Field, at: DVec3) -> f64 {
        let distance = |[from, to]: [DVec3; 2]| {
            let axis = to - from;
            at.distance(from + axis * ((at - from).dot(axis) / axis.length_squared()).clamp(0.0, 1.0))
        };
        field.goal_bars().into_iter().map(distance).fold(f64::INFINITY, f64::min)
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 12, ..ProptestConfig::default() })]

        #[test]
        fn the_depth_of_a_pixel_is_where_its_ray_meets_the_world(
            x in -2.5..2.5f64, y in -1.8..1.8f64, z in 0.2..1.5f64, yaw in -3.1..3.1f64, pitch in -0.3..1.0f64,
        ) {
            let (camera, field) = (camera(), field());
            let world = World::new(&field).with_hall(HALL);
            let pose = Isometry::from_euler(Euler { yaw, pitch, roll: 0.05 }, DVec3::new(x, y, z));
            let depths = depth_m(&camera, &pose, &world);
            let optical = optical(&pose);
            for (at, depth) in depths.iter().enumerate() {
                let Some(ray) = camera.ray(at % camera.width(), at / camera.width()) else {
                    prop_assert!(depth.is_nan());
                    continue;
                };
                let point = optical.transform_point(ray * f64::from(*depth));
                if depth.is_infinite() {
                    // The one wall that is not known lies in this direction.
                    let toward = optical.transform_vector(ray);
                    prop_assert!(toward.truncate().dot(HALL.normal(2)) > 0.0, "{at}: {toward}");
                    continue;
                }
                // A bar is widened by its soft edge, which grows with distance; f32 carries seven digits.
                let edge = 1.3 / camera.lens().focal() * f64::from(*depth);
                let bar = off_the_bars(&field, point) - GOAL.post_diameter_m / 2.0 - edge;
                let off = off_the_planes(point).min(bar.max(0.0));
                prop_assert!(off < 1e-4 * f64::from(*depth).max(1.0), "{at}: {off} m off at {depth} m, {point}");
                prop_assert!(point.z > -1e-3 && point.z < 4.001, "{at}: {point} is in the hall");
            }
        }
    }

    #[test]
    fn without_a_hall_all_above_the_horizon_is_infinitely_deep() {
        let camera = camera();
        let pose = Isometry::from_euler(Euler { yaw: 0.3, pitch: 0.2, roll: 0.0 }, DVec3::new(0.2, 0.1, 0.5));
        let depths = depth_m(&camera, &pose, &World::without_goals(&field()));
        let (mut floor, mut far) = (0, 0);
        for (at, depth) in depths.iter().enumerate() {
            let Some(ray) = camera.ray(at % camera.width(), at / camera.width()) else { continue };
            let down = -optical(&pose).transform_vector(ray).z;
            match down > 1e-6 {
                true => {
                    floor += 1;
                    assert!((f64::from(*depth) * down / 0.5 - 1.0).abs() < 1e-3, "{at}: {depth} m");
                }
                false => {
                    far += 1;
                    assert!(depth.is_infinite() || *depth > 1e4, "{at}: {depth} m");
                }
            }
        }
        assert!(floor > 1000 && far > 1000, "{floor} {far}");
    }
}
