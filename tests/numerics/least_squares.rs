//! Refinement on rendered images. What it does with sights made up without an image stands beside it
//! (`src/localization/refinement/tests.rs`).

use std::sync::OnceLock;

use glam::DVec3;
use nalgebra::{Matrix2, Matrix6, Vector2, Vector6};
use realitysim::config::{load_field, load_lens};
use realitysim::geometry::{Euler, Field, Isometry};
use realitysim::localization::random::{Purpose, Stream};
use realitysim::localization::refinement::{Prior, Refined, Refiner, error_between, moved_pose};
use realitysim::scene::{Renderer, Scene, SceneFile};
use realitysim::vision::{Observations, Picture, TableQuantity, Vision, VisionSettings};

use realitysim_test_support::measured::largest_error;

struct Bench {
    renderer: Renderer,
    vision: Vision,
    refiner: Refiner,
}

/// The shipped walk with its sensor's noise, at full size.
fn bench() -> &'static Bench {
    static BENCH: OnceLock<Bench> = OnceLock::new();
    BENCH.get_or_init(|| {
        let file = SceneFile::from_toml(include_str!("../../replay/scenes/straight.toml")).expect("readable");
        let dimensions = load_field("kid-2009").expect("a shipped field");
        let lens = load_lens("fisheye-640").expect("a shipped lens").lens;
        let scene = Scene::build(file, dimensions.clone(), lens.parameters().clone()).expect("possible");
        let field = Field::new(dimensions).expect("possible");
        let settings = VisionSettings {
            reading: TableQuantity::Contrast,
            line_width_m: field.line_width(),
            tilt_sigma_rad: 0.012,
            reduction: 0,
        };
        Bench {
            renderer: Renderer::new(&scene),
            vision: Vision::new(&lens, settings),
            refiner: Refiner::new(&field, &lens),
        }
    })
}

impl Bench {
    fn seen(&self, map_from_optical: &Isometry, index: u64) -> Observations {
        let link = *map_from_optical * Isometry::link_from_optical().inverse();
        let mut pixels = Vec::new();
        self.renderer.render_from(&link, index, &mut pixels);
        let (width, height) = (self.renderer.width() as usize, self.renderer.height() as usize);
        let picture = Picture::from_rgb(width, height, &pixels).expect("a picture");
        // Vision needs height and tilt only.
        let at = DVec3::new(0.0, 0.0, link.translation.z);
        let footprint = Isometry::new(glam::DQuat::from_rotation_z(-link.euler().yaw) * link.rotation, at);
        self.vision.look(&picture, &(footprint * Isometry::link_from_optical()), None)
    }

    fn refined(&self, seen: &Observations, prior: &Prior, starts: &[Vector6<f64>]) -> Refined {
        let refined = self.refiner.clone().refine(&seen.image, prior, starts).expect("a covariance");
        let c = &refined.covariance;
        assert!(c.iter().chain(&refined.moved).all(|value| value.is_finite()) && refined.cost.is_finite());
        assert!(c.cholesky().is_some() && *c == c.transpose() && refined.condition >= 1.0 - 1e-12);
        refined
    }
}

fn camera(x: f64, y: f64, yaw: f64) -> Isometry {
    let tilt = Euler { yaw, pitch: 17f64.to_radians(), roll: 0.0 };
    Isometry::from_euler(tilt, DVec3::new(x, y, 0.49)) * Isometry::link_from_optical()
}

fn prior_about(map_from_optical: Isometry, sigmas: [f64; 6]) -> Prior {
    let sigmas = Vector6::from(sigmas);
    Prior::of_pose(map_from_optical, &Matrix6::from_diagonal(&sigmas.component_mul(&sigmas)))
}

/// As a walking robot's track knows its camera.
const WALKING: [f64; 6] = [0.04, 0.04, 0.008, 0.01, 0.01, 0.03];

fn normal_vector(seed: u64, sigmas: [f64; 6]) -> Vector6<f64> {
    Vector6::from_fn(|i, _| sigmas[i] * Stream::new(seed, Purpose::Start, 1, 0, i as u32).normal())
}

/// All over the field, the prior as wrong as it says, with the camera's noise: 95 % of the truth lies in the 95 %
/// ellipse; honest is 90 to 99 %.
#[test]
fn on_noisy_images_the_ellipse_holds_the_truth_as_often_as_it_says() {
    const IMAGES: u64 = 200;
    let bench = bench();
    let (mut within, mut errors) = (0, Vec::new());
    for index in 0..IMAGES {
        let mut draw = Stream::new(77, Purpose::Start, index, 0, 0);
        let mut between = |low: f64, high: f64| low + (high - low) * draw.uniform();
        let truth = camera(between(-2.6, 2.6), between(-1.7, 1.7), between(-3.1, 3.1));
        let prior = prior_about(moved_pose(&truth, &normal_vector(index, WALKING)), WALKING);
        let refined = bench.refined(&bench.seen(&truth, index), &prior, &[Vector6::zeros()]);
        let error = error_between(&refined.map_from_optical, &truth);
        let plane: Matrix2<f64> = refined.covariance.fixed_view::<2, 2>(0, 0).into();
        let xy = Vector2::new(error[0], error[1]);
        within += usize::from(xy.dot(&(plane.try_inverse().expect("regular") * xy)) < 5.991);
        errors.push(xy.norm());
    }
    errors.sort_by(f64::total_cmp);
    let share = within as f64 / IMAGES as f64;
    println!("{share:.3} within, median {:.4} m, p95 {:.4} m", errors[100], errors[190]);
    assert!((0.90..=0.99).contains(&share), "{share}");
    largest_error(errors[100], 4e-4, "m, the median of 200 noisy images");
}

/// The prior one line off: from there the next line fits, and fits badly; from elsewhere the right one is found.
#[test]
fn on_an_image_several_starts_leave_a_wrong_basin() {
    let bench = bench();
    let truth = camera(-1.6, 0.2, 3.0);
    let seen = bench.seen(&truth, 3);
    let off = Vector6::new(0.55, 0.05, 0.0, 0.0, 0.0, 0.0);
    let prior = prior_about(moved_pose(&truth, &off), [0.5, 0.5, 0.008, 0.01, 0.01, 0.1]);
    let one = bench.refined(&seen, &prior, &[Vector6::zeros()]);
    let good = error_between(&prior.map_from_optical, &truth) + Vector6::new(0.03, -0.03, 0.0, 0.0, 0.0, 0.01);
    let several = bench.refined(&seen, &prior, &[Vector6::zeros(), good]);
    let error = |refined: &Refined| (refined.map_from_optical.translation - truth.translation).truncate().length();
    assert!(error(&one) > 0.2, "not a wrong basin: {}", error(&one));
    assert!(error(&several) < 0.02 && several.cost < one.cost, "{} {} {}", error(&several), several.cost, one.cost);
}

/// A white stripe on plain carpet: the pose moves across it, not along it, and says so.
#[test]
fn on_an_image_of_one_line_the_covariance_is_long_along_the_line() {
    let bench = bench();
    let truth = camera(0.9, 0.0, 0.0);
    let lens = bench.vision.lens();
    let (width, height) = (lens.width() as usize, lens.height() as usize);
    // The goal line alone, from the pose that sees it at x = 3.
    let paint = |index: usize| {
        let (u, v) = (index % width, index / width);
        let shade = |du: f64, dv: f64| -> f64 {
            let Some(ray) = lens.unproject(glam::DVec2::new(u as f64 + du, v as f64 + dv)) else { return 0.0 };
            let ray = truth.transform_vector(ray);
            if ray.z > -0.02 {
                return 40.0;
            }
            let at = truth.translation - ray * (truth.translation.z / ray.z);
            if (at.x - 3.0).abs() < 0.025 && at.y.abs() < 1.9 { 220.0 } else { 90.0 }
        };
        let offsets = [-0.375, -0.125, 0.125, 0.375];
        let sum: f64 = offsets.iter().flat_map(|du| offsets.map(|dv| shade(*du, dv))).sum();
        (sum / 16.0) as u8
    };
    let picture = Picture::from_gray(width, height, (0..width * height).map(paint).collect()).expect("a picture");
    let place = Isometry::new(truth.rotation, DVec3::new(0.0, 0.0, truth.translation.z));
    let seen = bench.vision.look(&picture, &place, None);
    let moved = Vector6::new(0.05, 0.07, 0.003, 0.004, -0.004, 0.01);
    let prior = prior_about(moved_pose(&truth, &moved), [0.1, 0.1, 0.008, 0.008, 0.008, 0.03]);
    let refined = bench.refined(&seen, &prior, &[Vector6::zeros()]);
    let sigma = |i: usize| refined.covariance[(i, i)].sqrt();
    println!("sigmas {:.3} {:.3}, moved {}, condition {:.1}", sigma(0), sigma(1), refined.moved, refined.condition);
    assert!(sigma(1) > 0.08 && sigma(1) / sigma(0) > 1.5, "{} {}", sigma(0), sigma(1));
    assert!(refined.moved[1].abs() < 0.05, "no jump along the line: {}", refined.moved[1]);
}

#[test]
fn an_image_without_any_line_leaves_the_prior_as_it_was() {
    let bench = bench();
    let lens = bench.vision.lens();
    let (width, height) = (lens.width() as usize, lens.height() as usize);
    let truth = camera(0.0, 0.0, 0.0);
    let place = Isometry::new(truth.rotation, DVec3::new(0.0, 0.0, truth.translation.z));
    for level in [0, 90, 255] {
        let picture = Picture::from_gray(width, height, vec![level; width * height]).expect("a picture");
        let prior = prior_about(truth, WALKING);
        let refined = bench.refined(&bench.vision.look(&picture, &place, None), &prior, &[Vector6::zeros()]);
        assert_eq!((refined.pose_moved(), refined.lines.fitting), (Vector6::zeros(), 0), "{level}");
        assert!((refined.covariance - prior.covariance).amax() < 1e-12);
    }
}
