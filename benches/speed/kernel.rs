//! The kernel against the lens itself, against f64 and against its own plain path; the search against trying everything.

use core::f64::consts::TAU;

use glam::{DVec2, DVec3};
use realitysim::geometry::Pose2;
use realitysim::localization::global_search::{Candidate, GlobalSearch, SearchRate, SearchRequest, SearchState};
use realitysim::localization::kernel::{Points, available, sum_levels};
use realitysim::localization::observation::default_alpha;
use realitysim::localization::{Effort, Formula, Observation, Particles, SimdPath, Spread};

use super::measure::Bench;
use super::view::View;

const PARTICLES: usize = 800;
const POINTS: usize = 350;

pub fn run(bench: &mut Bench, view: &View) {
    let particles = Particles::around(view.pose, Spread { xy_m: 0.05, yaw_rad: 0.03 }, PARTICLES, 1, 0).poses;
    let positions: Vec<DVec2> = view.field.points(POINTS).iter().map(|point| point.position).collect();
    let table = &view.seen.table;
    let units = Some(((PARTICLES * positions.len()) as f64, "points"));
    let all = |path: SimdPath| {
        let points = Points::new(positions.iter().copied());
        let particles = &particles;
        move || particles.iter().map(|pose| sum_levels(path, table, &points, pose)).sum::<f64>()
    };
    let fastest = available(SimdPath::Auto);
    let direct = || particles.iter().map(|pose| projected(view, &positions, pose)).sum::<f64>();
    bench.compare(
        &format!("kernel {fastest:?}, {PARTICLES} x {} points; each point through the lens", positions.len()),
        units,
        direct,
        all(fastest),
    );
    let exact = || particles.iter().map(|pose| in_f64(view, &positions, pose)).sum::<f64>();
    bench.compare("kernel, fastest path; the same sums in f64", units, exact, all(fastest));
    bench.compare("kernel, fastest path; the plain path", units, all(SimdPath::Scalar), all(fastest));
    search(bench, view);
}

/// What the table saves: each point into the image, for each pose anew.
fn projected(view: &View, positions: &[DVec2], pose: &Pose2) -> f64 {
    let optical_from_map = (pose.to_isometry() * view.footprint_from_optical).inverse();
    let (width, luma) = (view.picture.width, &view.picture.luma);
    let read = |position: &DVec2| {
        let pixel = view.lens.project(optical_from_map.transform_point(DVec3::new(position.x, position.y, 0.0)))?;
        let inside = pixel.x >= 0.0 && pixel.y >= 0.0;
        let (u, v) = (pixel.x as usize, pixel.y as usize);
        if !inside || u + 1 >= width || v + 1 >= view.picture.height {
            return None;
        }
        let (fu, fv) = (pixel.x - u as f64, pixel.y - v as f64);
        let at = |row: usize, column: usize| f64::from(luma[row * width + column]);
        let along = |row: usize| at(row, u) + (at(row, u + 1) - at(row, u)) * fu;
        Some(along(v) + (along(v + 1) - along(v)) * fv)
    };
    positions.iter().filter_map(read).sum()
}

fn in_f64(view: &View, positions: &[DVec2], pose: &Pose2) -> f64 {
    let table = &view.seen.table;
    let (scale, offset) = table.to_cells();
    let zero = f64::from(table.readings().zero);
    let last = realitysim::vision::ground::SIDE as f64 - 1.0;
    let level = |u: f64, v: f64| f64::from(table.level(u as usize, v as usize));
    let from_map = pose.inverse();
    let read = |position: &DVec2| {
        let at = from_map.compose(&Pose2::new(position.x, position.y, 0.0));
        let (u, v) = (at.x * scale + offset, at.y * scale + offset);
        if !(u >= 0.0 && v >= 0.0 && u < last && v < last) {
            return 0.0;
        }
        let (fu, fv) = (u.fract(), v.fract());
        let upper = level(u, v) * (1.0 - fu) + level(u + 1.0, v) * fu;
        let lower = level(u, v + 1.0) * (1.0 - fu) + level(u + 1.0, v + 1.0) * fu;
        upper * (1.0 - fv) + lower * fv - zero
    };
    positions.iter().map(read).sum()
}

fn search(bench: &mut Bench, view: &View) {
    let alpha = default_alpha(Formula::Corrected);
    let observation = Observation::new(&view.field, POINTS, Formula::Corrected, alpha, SimdPath::Auto);
    let table = &view.seen.table;
    let mut search = GlobalSearch::new(&view.field, 0.3, &observation);
    let half = view.field.carpet_half_extent();
    let everywhere = || {
        let steps = |half: f64| ((half + 0.3) / 0.1).ceil() as i32;
        let places = (0..=steps(half.x)).flat_map(|i| (-steps(half.y)..=steps(half.y)).map(move |j| (i, j)));
        let poses = places.flat_map(|(i, j)| {
            (0..120).map(move |turn| Pose2::new(f64::from(i) * 0.1, f64::from(j) * 0.1, TAU * f64::from(turn) / 120.0))
        });
        poses
            .map(|pose| Candidate { pose, log_likelihood: observation.log_likelihood(table, &pose) })
            .max_by(|a, b| a.log_likelihood.total_cmp(&b.log_likelihood))
    };
    bench.compare("search of the field, coarse to fine; every 10 cm and 3 deg", None, everywhere, || {
        let wanted = SearchRequest { candidates: 4, rate: SearchRate::Fast };
        search.run(&observation, table, wanted, &mut SearchState::default(), &mut Effort::default(), &mut |_| true)
    });
}
