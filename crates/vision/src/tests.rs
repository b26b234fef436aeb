//! Compares the ground table with a direct evaluation, which projects each point through the exact lens, all in f64.
//!
//! The table interpolates the lens between every fourth cell and stores bytes. These tests measure what that costs.

use std::sync::OnceLock;

use glam::DVec3;

use super::ground::{NEUTRAL, SIDE};
use super::ground_map::BLOCK;
use super::*;
use realitysim_geometry::{Euler, Field, FieldDimensions, LensModel, LensParameters, Pose2};
use realitysim_test_support::measured::largest_error;

const LINE_WIDTH_M: f64 = 0.05;
const TILT_SIGMA_RAD: f64 = 0.012;
const CARPET: [f64; 3] = [45.0, 120.0, 50.0];
const PAINT: [f64; 3] = [225.0, 230.0, 222.0];

fn field() -> Field {
    Field::new(FieldDimensions {
        title: "kid size".into(),
        length_m: 6.0,
        width_m: 4.0,
        line_width_m: LINE_WIDTH_M,
        border_strip_m: 0.7,
        centre_circle_diameter_m: 1.2,
        corner_arc_radius_m: None,
        goal_area: Some(realitysim_geometry::field::Area { depth_m: 0.6, width_m: 2.2 }),
        penalty_area: None,
        penalty_mark_from_goal_line_m: Some(1.8),
        mark_size_m: 0.1,
        centre_mark: false,
        goal: None,
    })
    .expect("a possible field")
}

fn lens(model: LensModel, focal: f64, fov_deg: Option<f64>) -> Lens {
    let parameters =
        LensParameters { width: 640, height: 480, fx: focal, fy: focal, cx: 321.0, cy: 237.0, model, fov_deg };
    Lens::new(parameters).expect("a good lens")
}

fn lenses() -> [(&'static str, Lens); 3] {
    [
        ("fisheye", lens(LensModel::KannalaBrandt { k: [-0.012, 0.003, -0.0008, 0.0] }, 205.0, Some(200.0))),
        ("equisolid", lens(LensModel::Equisolid, 214.0, Some(190.0))),
        ("wide", lens(LensModel::PlumbBob { d: [-0.28, 0.07, 0.0, 0.0, 0.0] }, 353.0, None)),
    ]
}

/// One lens of each other kind of projection.
fn more_lenses() -> [(&'static str, Lens); 3] {
    let rational = LensModel::RationalPolynomial { d: [4.1, -2.3, 0.0011, -0.0007, 0.31, 4.3, -0.7, -0.2] };
    let scaramuzza = LensModel::Scaramuzza { c: [-0.31, 0.05, -0.06, 0.01, 0.0], skew: 0.003 };
    [
        ("rational", lens(rational, 353.0, None)),
        ("double sphere", lens(LensModel::DoubleSphere { xi: -0.2, alpha: 0.6 }, 160.0, Some(200.0))),
        ("scaramuzza", lens(scaramuzza, 205.0, Some(200.0))),
    ]
}

/// Pose of the camera in `base_footprint`: half a metre above the ground, looking down by 17 degrees, a little rolled.
fn place() -> Isometry {
    Isometry::from_euler(Euler { yaw: 0.0, pitch: 0.3, roll: 0.03 }, DVec3::new(0.04, 0.01, 0.49))
        * Isometry::link_from_optical()
}

/// Renders the field through the lens, 16 rays a pixel, with a little noise.
fn rendered_field(lens: &Lens, robot: &Pose2) -> Picture {
    let (field, map_from_optical) = (field(), robot.to_isometry() * place());
    let camera = map_from_optical.translation;
    let colour = |pixel: DVec2| {
        let Some(ray) = lens.unproject(pixel) else { return [0.0; 3] };
        let ray = map_from_optical.transform_vector(ray);
        if ray.z > -0.05 {
            return [70.0, 72.0, 80.0];
        }
        let at = (camera - ray * (camera.z / ray.z)).truncate();
        let half = field.carpet_half_extent();
        if at.x.abs() > half.x || at.y.abs() > half.y {
            return [90.0, 85.0, 80.0];
        }
        if field.strokes().iter().any(|stroke| stroke.distance(at) < LINE_WIDTH_M / 2.0) { PAINT } else { CARPET }
    };
    let mut pixels = Vec::with_capacity(640 * 480 * 3);
    let mut state = 12345u32;
    for v in 0..480 {
        for u in 0..640 {
            let mut sum = [0.0; 3];
            for sub in 0..16 {
                let off = DVec2::new(f64::from(sub % 4), f64::from(sub / 4)) / 4.0 - 0.375;
                let part = colour(DVec2::new(f64::from(u), f64::from(v)) + off);
                sum.iter_mut().zip(part).for_each(|(sum, part)| *sum += part / 16.0);
            }
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let noise = f64::from(state >> 24) / 64.0 - 2.0;
            pixels.extend(sum.map(|value| (value + noise).clamp(0.0, 255.0) as u8));
        }
    }
    Picture::from_rgb(640, 480, &pixels).expect("a picture")
}

/// The observations of one frame, and the means to evaluate them again in f64.
struct Direct {
    lens: Lens,
    seen: Observations,
    /// Line contrast at half resolution, row by row.
    contrast: Vec<f64>,
}

impl Direct {
    fn new(lens: &Lens, robot: &Pose2) -> Self {
        let settings = VisionSettings {
            reading: TableQuantity::Contrast,
            line_width_m: LINE_WIDTH_M,
            tilt_sigma_rad: TILT_SIGMA_RAD,
            reduction: 1,
        };
        let seen = Vision::new(lens, settings).look(&rendered_field(lens, robot), &place(), None);
        assert!(seen.image.full_contrast() > 0.2 && seen.image.full_contrast() < 2.0);
        let contrast = contrast_in_f64(&seen);
        Self { lens: lens.clone(), seen, contrast }
    }

    fn pixel(&self, ground: DVec2) -> Option<DVec2> {
        let pixel = self.lens.project(place().inverse().transform_point(ground.extend(0.0)))?;
        self.lens.contains(pixel).then_some(pixel)
    }

    /// Interpolates the half-resolution contrast bilinearly at a full-size pixel.
    fn contrast_at(&self, pixel: DVec2) -> f64 {
        let (width, height) = (self.seen.contrast.width, self.seen.contrast.height);
        let at = (pixel * 0.5 - 0.25).clamp(DVec2::ZERO, DVec2::new((width - 1) as f64, (height - 1) as f64));
        let (u, v) = ((at.x as usize).min(width - 2), (at.y as usize).min(height - 2));
        let (fu, fv) = (at.x - u as f64, at.y - v as f64);
        let row = |v: usize| {
            let [a, b] = [self.contrast[v * width + u], self.contrast[v * width + u + 1]];
            a + (b - a) * fu
        };
        row(v) + (row(v + 1) - row(v)) * fv
    }

    /// The level of a point on the ground, by the formulas of strength and weight at its exact distance.
    fn level(&self, ground: DVec2) -> Option<f64> {
        let pixel = self.pixel(ground)?;
        let camera = place().translation;
        let square = camera.z * camera.z + ground.distance_squared(camera.truncate());
        let slant = square.sqrt();
        let width_px = self.lens.focal() * LINE_WIDTH_M * (camera.z / slant.powi(3)).sqrt();
        let strength = contrast::line_response(width_px);
        let shift = square / camera.z * TILT_SIGMA_RAD / LINE_WIDTH_M;
        let weight = strength / (1.0 + shift * shift).sqrt();
        let full = f64::from(self.seen.image.full_contrast());
        let share = (255.0 * self.contrast_at(pixel) / (full * strength)).clamp(0.0, 255.0);
        let neutral = f64::from(NEUTRAL);
        Some(neutral + (share - neutral) * weight)
    }

    /// Iterates over the cells that the table counts as seen: ground point, column and row.
    fn cells(&self) -> impl Iterator<Item = (DVec2, usize, usize)> {
        let cell_m = self.seen.table.cell_m();
        (0..SIDE * SIDE).filter_map(move |index| {
            let (column, row) = (index % SIDE, index / SIDE);
            let place = |index: usize| (index as f64 + 0.5 - SIDE as f64 / 2.0) * cell_m;
            let ground = DVec2::new(place(column), place(row));
            let inside = (1..SIDE - 1).contains(&column) && (1..SIDE - 1).contains(&row);
            (inside && self.seen.table.seen(ground) > 0.0).then_some((ground, column, row))
        })
    }
}

/// Computes [`LineContrast`] in f64: the same blurs, on the same surfaces and carpet.
fn contrast_in_f64(seen: &Observations) -> Vec<f64> {
    let LineContrast { width, height, half, contrast, .. } = &seen.contrast;
    let (width, height) = (*width, *height);
    let half: Vec<f64> = half.iter().map(|sum| f64::from(*sum) / 4.0).collect();
    let narrow = blurred(&half, width);
    let (columns, rows) = (width / 4, height / 4);
    let (mut sums, mut counts) = (vec![0.0; columns * rows], vec![0.0; columns * rows]);
    for v in 0..rows * 4 {
        for u in 0..columns * 4 {
            let (cell, pixel) = (v / 4 * columns + u / 4, v * width + u);
            if seen.on_carpet[cell] && !contrast::surface(contrast[pixel]).is_occluder() {
                sums[cell] += half[pixel];
                counts[cell] += 1.0;
            }
        }
    }
    for _ in 0..2 {
        (sums, counts) = (blurred(&sums, columns), blurred(&counts, columns));
    }
    let wide: Vec<f64> = (0..columns * rows)
        .map(|cell| {
            let middle = (cell / columns * 4 + 2) * width + cell % columns * 4 + 2;
            if counts[cell] > 0.05 { sums[cell] / counts[cell] } else { half[middle] }
        })
        .collect();
    let wide_at = |u: usize, v: usize| {
        let axis = |pixel: usize, count: usize| {
            let at = (pixel as f64 - 1.5) / 4.0;
            let clamped = |cell: f64| cell.clamp(0.0, count as f64 - 1.0) as usize;
            (clamped(at.floor()), clamped(at.floor() + 1.0), at - at.floor())
        };
        let ((u0, u1, fu), (v0, v1, fv)) = (axis(u, columns), axis(v, rows));
        let row = |v: usize| wide[v * columns + u0] * (1.0 - fu) + wide[v * columns + u1] * fu;
        row(v0) * (1.0 - fv) + row(v1) * fv
    };
    let relative = |above: f64, wide: f64| above / (wide + f64::from(contrast::STRAY_LEVELS));
    let wide = |i: usize| wide_at(i % width, i / width);
    (0..width * height).map(|i| relative(narrow[i] - wide(i), wide(i))).collect()
}

/// Blurs by the binomial filter 1 4 6 4 1 in both directions; edges repeat the last pixel.
fn blurred(image: &[f64], width: usize) -> Vec<f64> {
    let height = image.len() / width;
    let taps = [1.0, 4.0, 6.0, 4.0, 1.0];
    let pass = |image: &[f64], along_u: bool| -> Vec<f64> {
        (0..image.len())
            .map(|index| {
                let (u, v) = (index % width, index / width);
                let at = |k: usize| {
                    let moved = |x: usize, count: usize| (x + k).saturating_sub(2).min(count - 1);
                    if along_u { image[v * width + moved(u, width)] } else { image[moved(v, height) * width + u] }
                };
                (0..5).map(|k| taps[k] * at(k)).sum::<f64>() / 16.0
            })
            .collect()
    };
    pass(&pass(image, true), false)
}

const ROBOT: Pose2 = Pose2 { x: -1.1, y: 0.4, yaw: 0.3 };

/// A frame for each lens, rendered once for all tests.
fn frames() -> &'static [(&'static str, Direct)] {
    static FRAMES: OnceLock<Vec<(&'static str, Direct)>> = OnceLock::new();
    FRAMES.get_or_init(|| lenses().iter().map(|(name, lens)| (*name, Direct::new(lens, &ROBOT))).collect())
}

/// The map interpolates the lens between its nodes; this compares the pixel of each cell with that of the exact lens.
#[test]
fn the_ground_map_draws_places_where_the_lens_does() {
    let ranges = [0.5, 1.0, 2.0];
    let (mut worst_px, mut worst_m) = ([0.0f64; 3], 0.0f64);
    for (name, lens) in lenses() {
        let mut map = GroundMap::default();
        map.fill(&Projector::new(&lens), &place(), 3.6, &CarpetBorder::default());
        let mut count = 0;
        for row in 0..SIDE {
            for column in 0..SIDE {
                let Some([a, b, c, d]) = map.corners(row / BLOCK, column / BLOCK) else { continue };
                let (down, right) = ((row % BLOCK) as f64 / BLOCK as f64, (column % BLOCK) as f64 / BLOCK as f64);
                let mix = |i: usize| {
                    let [a, b, c, d] = [a, b, c, d].map(|corner| f64::from(corner[i]));
                    (a + (c - a) * down) * (1.0 - right) + (b + (d - b) * down) * right
                };
                let (ground, drawn) = (DVec2::new(map.place(column), map.place(row)), DVec2::new(mix(0), mix(1)));
                let range = ground.distance(place().translation.truncate());
                let exact = lens.project(place().inverse().transform_point(ground.extend(0.0))).expect("within");
                // A pixel of a longer lens is a smaller angle; for it only the error on the ground is measured.
                for (worst, least) in worst_px.iter_mut().zip(ranges).filter(|_| name != "wide") {
                    *worst = if range >= least { worst.max(exact.distance(drawn)) } else { *worst };
                }
                let ray = place().transform_vector(lens.unproject(drawn).expect("within"));
                let shown = place().translation - ray * (place().translation.z / ray.z);
                worst_m = worst_m.max(shown.truncate().distance(ground));
                count += 1;
            }
        }
        assert!(count > 20_000, "{name}: {count} cells");
    }
    largest_error(worst_px[0], 1.0, "px beyond 0.5 m, fisheyes");
    largest_error(worst_px[1], 0.3, "px beyond 1 m, fisheyes");
    largest_error(worst_px[2], 0.07, "px beyond 2 m, fisheyes");
    largest_error(worst_m * 1e3, 7.5, "mm on the ground");
}

/// The integer computation works in sixteenths of gray levels and loses two bits to the surface.
#[test]
fn line_contrast_in_16_bits_is_line_contrast() {
    let (mut largest, mut sum, mut count) = (0.0f64, 0.0, 0.0);
    for (_, direct) in frames() {
        for (found, exact) in direct.seen.contrast.contrast.iter().zip(&direct.contrast) {
            let off = f64::from(*found & !3) / f64::from(contrast::PARTS) - exact;
            largest = largest.max(off.abs());
            sum += off;
            count += 1.0;
        }
    }
    println!("mean {:.5}", sum / count);
    assert!((sum / count).abs() < 0.0015);
    largest_error(1e3 * largest, 10.0, "thousandths of the carpet's brightness");
}

/// The levels of single cells. At the steep edge of a line a third of a pixel is many levels, so the root mean square is held as well.
#[test]
fn the_table_s_levels_are_those_of_the_direct_way() {
    let (mut beyond, mut squares, mut bias, mut count) = (0.0f64, 0.0, 0.0, 0.0);
    for (name, direct) in frames() {
        let mut cells = 0;
        for (ground, column, row) in direct.cells() {
            let Some(exact) = direct.level(ground) else { continue };
            let off = f64::from(direct.seen.table.level(column, row)) - exact;
            if ground.distance(place().translation.truncate()) >= 1.0 {
                beyond = beyond.max(off.abs());
            }
            squares += off * off;
            bias += off;
            count += 1.0;
            cells += 1;
        }
        assert!(cells > 10_000, "{name}: {cells}");
    }
    let rms: f64 = f64::sqrt(squares / count);
    println!("rms {rms:.2}, bias {:.3} levels", bias / count);
    largest_error(beyond, 23.0, "levels of 255 in one cell beyond 1 m");
    largest_error(rms, 2.5, "levels of 255, rms of all cells");
}

/// The log likelihood of a particle, with alpha 3 and points every 10 cm. A difference of 1 is a factor of e between weights.
#[test]
fn the_log_likelihood_of_a_pose_is_that_of_the_direct_way() {
    let points = field().points(440);
    let per_point = points.iter().map(|point| point.length).sum::<f64>() / points.len() as f64 / 0.1;
    let mut largest = 0.0f64;
    for (name, direct) in frames() {
        let table = &direct.seen.table;
        let (scale, offset) = table.to_cells();
        let neutral = f64::from(NEUTRAL);
        let both = |pose: &Pose2| {
            let robot_from_map = pose.inverse();
            let (mut stored, mut exact) = (0.0, 0.0);
            for point in &points {
                let at = robot_from_map.compose(&Pose2::new(point.position.x, point.position.y, 0.0));
                let ground = DVec2::new(at.x, at.y);
                let (u, v) = (at.x * scale + offset, at.y * scale + offset);
                if !(u >= 0.0 && v >= 0.0 && u < SIDE as f64 - 1.0 && v < SIDE as f64 - 1.0) {
                    continue;
                }
                let level = |u: usize, v: usize| f64::from(table.level(u, v));
                let (iu, iv, fu, fv) = (u as usize, v as usize, u.fract(), v.fract());
                let row = |v: usize| level(iu, v) * (1.0 - fu) + level(iu + 1, v) * fu;
                stored += row(iv) * (1.0 - fv) + row(iv + 1) * fv - neutral;
                if table.seen(ground) > 0.0 {
                    exact += direct.level(ground).map_or(0.0, |level| level - neutral);
                }
            }
            [stored, exact].map(|sum| sum * table.readings().scale * per_point / 3.0)
        };
        let [stored, exact] = both(&ROBOT);
        assert!(stored > 10.0, "{name}: a pose that explains the picture: {stored}");
        println!("{name}: {stored:.2} stored, {exact:.2} direct");
        for i in 0..400 {
            let part = |k: i32, step: f64| f64::from((i * k) % 21 - 10) / 10.0 * step;
            let pose = ROBOT.compose(&Pose2::new(part(1, 0.2), part(8, 0.2), part(13, 0.15)));
            let [stored, exact] = both(&pose);
            largest = largest.max((stored - exact).abs());
        }
    }
    largest_error(largest, 0.6, "of the log likelihood, 20 cm and 9 deg around the pose");
}

#[test]
fn ridges_lie_on_painted_lines_as_far_as_four_metres_with_every_lens() {
    // Rendering takes seconds for each.
    std::thread::scope(|scope| {
        scope.spawn(|| frames().iter().for_each(|(name, direct)| assert_ridges_lie_on_lines(name, direct)));
        scope.spawn(|| {
            more_lenses().iter().for_each(|(name, lens)| assert_ridges_lie_on_lines(name, &Direct::new(lens, &ROBOT)));
        });
    });
}

fn assert_ridges_lie_on_lines(name: &str, direct: &Direct) {
    let ridges = direct.seen.ridges(&place(), direct.lens.focal(), LINE_WIDTH_M);
    // Counts painted points in view, one for each 5 cm of line, and those of them that are near a ridge.
    let points = field().points((field().strokes().iter().map(|stroke| stroke.length()).sum::<f64>() / 0.05) as usize);
    let (mut in_view, mut found) = (0, 0);
    for point in points {
        let inverse = ROBOT.inverse().to_affine();
        let ground = inverse.transform_point2(point.position);
        let Some(pixel) = direct.pixel(ground) else { continue };
        if ground.length() > 4.0 || pixel.x < 20.0 || pixel.y < 20.0 || pixel.x > 620.0 || pixel.y > 460.0 {
            continue;
        }
        in_view += 1;
        found += usize::from(ridges.iter().any(|ridge| ridge.pixel.distance(pixel) < 6.0));
    }
    assert!(in_view > 100 && found * 10 > in_view * 6, "{name}: {found} of {in_view}");
}
