//! Rendered turf beside path-traced turf (tests/data/turf): the same statistics, within stated factors.

use std::path::Path;

use glam::DVec3;
use realitysim::geometry::{Euler, Isometry, Lens, LensModel, LensParameters};
use realitysim::log_input::decode::picture_of_size;
use realitysim::scene::Renderer;
use realitysim::vision::{Picture, TableQuantity, Vision, VisionSettings};

use crate::replay::support::read_log;

const WIDTH: usize = 640;
const HEIGHT: usize = 480;

/// Half the sides, in pixels, of the boxes whose means are compared: what is finer than one and coarser than the other.
const BANDS: [(usize, usize); 3] = [(0, 1), (1, 3), (3, 7)];

/// Of the carpet in a picture's lower middle, about a metre before the robot.
#[derive(Clone, Copy, Debug, Default)]
struct Statistics {
    /// Contrast of the clearest lines over the noise of plain carpet where a line is looked for.
    line_to_noise: f64,
    /// Spread of the brightness in each of the [`BANDS`], as a share of its mean: half of what lies between the 16th and the 84th of a hundred.
    bands: [f64; 3],
    /// Share of pixels that are brighter than the mean of their 15 x 15 by half of it and more.
    glints: f64,
}

fn statistics(picture: &Picture, lens: &Lens) -> Statistics {
    let settings =
        VisionSettings { reading: TableQuantity::Contrast, line_width_m: 0.05, tilt_sigma_rad: 0.01, reduction: 1 };
    // As all of these robots carry their camera, give or take their gait.
    let euler = Euler { yaw: 0.0, pitch: 22.0_f64.to_radians(), roll: 0.0 };
    let place = Isometry::from_euler(euler, DVec3::new(0.04, 0.0, 0.55)) * Isometry::link_from_optical();
    let seen = Vision::new(lens, settings).look(picture, &place, None);
    let mean = |u: usize, v: usize, half: usize| {
        let rows = v - half..=v + half;
        let sum: u32 = rows
            .flat_map(|row| &picture.luma[row * WIDTH + u - half..=row * WIDTH + u + half])
            .map(|l| u32::from(*l))
            .sum();
        f64::from(sum) / ((2 * half + 1) * (2 * half + 1)) as f64
    };
    let places = || (300..450).step_by(2).flat_map(|v| (160..480).step_by(2).map(move |u| (u, v)));
    let bands = BANDS.map(|(fine, coarse)| {
        let mut all: Vec<f64> =
            places().map(|(u, v)| (mean(u, v, fine) - mean(u, v, coarse)) / mean(u, v, 7).max(1.0)).collect();
        all.sort_by(f64::total_cmp);
        (all[all.len() * 84 / 100] - all[all.len() * 16 / 100]) / 2.0
    });
    let bright = places().filter(|(u, v)| mean(*u, *v, 0) > 1.5 * mean(*u, *v, 7)).count();
    Statistics {
        line_to_noise: f64::from(seen.image.full_contrast() / seen.image.noise()),
        bands,
        glints: bright as f64 / places().count() as f64,
    }
}

fn mean_of(all: &[Statistics]) -> Statistics {
    let mean = |of: &dyn Fn(&Statistics) -> f64| all.iter().map(of).sum::<f64>() / all.len() as f64;
    Statistics {
        line_to_noise: mean(&|s| s.line_to_noise),
        bands: [0, 1, 2].map(|band| mean(&move |s: &Statistics| s.bands[band])),
        glints: mean(&|s| s.glints),
    }
}

fn path_traced(name: &str, f: f64, [cx, cy]: [f64; 2], k: [f64; 4]) -> Statistics {
    let (width, height) = (WIDTH as u32, HEIGHT as u32);
    let model = LensModel::KannalaBrandt { k };
    let parameters = LensParameters { width, height, fx: f, fy: f, cx, cy, model, fov_deg: Some(200.0) };
    let lens = Lens::new(parameters).expect("a lens");
    let log = read_log(Path::new(&format!("tests/data/turf/{name}.mcap")));
    let pictures = log.iter().filter(|message| message.channel.topic == "/camera/image/compressed").step_by(3);
    let all: Vec<Statistics> = pictures
        .map(|message| statistics(&picture_of_size(message, [WIDTH, HEIGHT]).expect("a picture"), &lens))
        .collect();
    mean_of(&all)
}

fn rendered(name: &str) -> Statistics {
    let scene =
        realitysim::log_input::scene_source::load(format!("replay/scenes/{name}.toml")).expect("a possible scene");
    let renderer = Renderer::new(&scene);
    let mut pixels = Vec::new();
    let all: Vec<Statistics> = [5, 15, 25, 35]
        .map(|index| {
            renderer.render(index, &mut pixels);
            statistics(&Picture::from_rgb(WIDTH, HEIGHT, &pixels).expect("a picture"), scene.lens())
        })
        .to_vec();
    mean_of(&all)
}

fn all_path_traced() -> [(&'static str, Statistics); 4] {
    const SUN: [f64; 4] = [0.014, -0.0052, 0.0009, -0.0001];
    [
        ("worn", path_traced("worn", 201.5, [317.5, 243.0], SUN)),
        ("lamps", path_traced("lamps", 206.0, [322.0, 236.5], [-0.014, 0.0022, -0.0002, 0.0])),
        ("goal-in-sun", path_traced("goal-in-sun", 201.5, [317.5, 243.0], SUN)),
        ("goal-at-night", path_traced("goal-at-night", 201.5, [317.5, 243.0], SUN)),
    ]
}

const RENDERED: [&str; 4] = ["turf-grey", "turf-thin", "turf-worn", "turf-sun"];

/// Each figure of the rendered pictures lies among those of the path-traced ones, or not farther beyond them than this.
const BAND_FACTOR: f64 = 1.6;
const LINE_FACTOR: f64 = 1.5;
/// Share of pixels; glints are few and differ from hall to hall.
const GLINTS_APART: f64 = 0.01;

#[test]
fn rendered_turf_is_like_path_traced_turf() {
    let real = all_path_traced();
    let among = |what: &str, own: f64, of: &dyn Fn(&Statistics) -> f64, factor: f64| {
        let least = real.iter().map(|(_, s)| of(s)).fold(f64::INFINITY, f64::min);
        let most = real.iter().map(|(_, s)| of(s)).fold(0.0, f64::max);
        assert!(own > least / factor && own < most * factor, "{what}: {own}, path-traced {least} to {most}");
    };
    for name in RENDERED {
        let own = rendered(name);
        among(&format!("{name}, lines"), own.line_to_noise, &|s| s.line_to_noise, LINE_FACTOR);
        for band in 0..BANDS.len() {
            among(&format!("{name}, band {band}"), own.bands[band], &move |s| s.bands[band], BAND_FACTOR);
        }
        let most = real.iter().map(|(_, s)| s.glints).fold(0.0, f64::max);
        assert!(own.glints <= most + GLINTS_APART, "{name}: {} glints, path-traced at most {most}", own.glints);
    }
}

/// Prints the table of docs/reference/scenes.md.
#[test]
#[ignore = "prints a table"]
fn statistics_side_by_side() {
    let row = |name: String, s: Statistics| {
        let [fine, middle, coarse] = s.bands.map(|band| format!("{:.1} %", 100.0 * band));
        println!("| {name} | {:.1} | {fine} | {middle} | {coarse} | {:.2} % |", s.line_to_noise, 100.0 * s.glints);
    };
    all_path_traced().into_iter().for_each(|(name, s)| row(format!("path-traced `{name}`"), s));
    RENDERED.into_iter().for_each(|name| row(format!("`{name}`"), rendered(name)));
}
