//! Laws that hold whatever the numbers are. Those of least squares stand in `src/localization/refinement/tests.rs`.

use std::sync::OnceLock;

use glam::{DVec2, DVec3};
use proptest::prelude::*;
use realitysim::config::{load_field, load_lens};
use realitysim::geometry::{Euler, Field, Isometry, Pose2};
use realitysim::localization::kernel::{Points, available, sum_levels};
use realitysim::localization::observation::{Formula, Observation, SimdPath};
use realitysim::localization::random::{Purpose, Stream};
use realitysim::localization::resampling::{Copies, residual};
use realitysim::localization::weights::normalise;
use realitysim::scene::{Renderer, Scene, SceneFile};
use realitysim::vision::{GroundTable, Picture, TableQuantity, Vision, VisionSettings};

use realitysim_test_support::measured::largest_error;

fn field() -> Field {
    Field::new(load_field("kid-2009").expect("a shipped field")).expect("possible")
}

/// What a robot at (-1, 0.3) sees around it.
fn table() -> &'static GroundTable {
    static TABLE: OnceLock<GroundTable> = OnceLock::new();
    TABLE.get_or_init(|| {
        let file = SceneFile::from_toml(include_str!("../../replay/scenes/straight.toml")).expect("readable");
        let lens = load_lens("fisheye-640").expect("a shipped lens").lens;
        let dimensions = load_field("kid-2009").expect("a shipped field");
        let scene = Scene::build(file, dimensions, lens.parameters().clone()).expect("possible");
        let tilt = Euler { pitch: 0.3, ..Euler::default() };
        let link = Isometry::from_euler(tilt, DVec3::new(0.04, 0.0, 0.49));
        let renderer = Renderer::new(&scene);
        let mut pixels = Vec::new();
        renderer.render_from(&(STANDS.to_isometry() * link), 0, &mut pixels);
        let picture = Picture::from_rgb(640, 480, &pixels).expect("a picture");
        let settings = VisionSettings {
            reading: TableQuantity::Contrast,
            line_width_m: field().line_width(),
            tilt_sigma_rad: 0.012,
            reduction: 0,
        };
        Vision::new(&lens, settings).look(&picture, &(link * Isometry::link_from_optical()), None).table
    })
}

const STANDS: Pose2 = Pose2 { x: -1.0, y: 0.3, yaw: 0.4 };

/// Poses near the true one and all over the field.
fn poses() -> impl Iterator<Item = Pose2> {
    (0..3000).map(|i| {
        let mut draw = Stream::new(6, Purpose::Start, 0, 0, i);
        let mut within = |half: f64| (2.0 * draw.uniform() - 1.0) * half;
        let (x, y, yaw) = (within(1.0), within(1.0), within(1.0));
        if i % 2 == 0 {
            STANDS.compose(&Pose2::new(0.2 * x, 0.2 * y, 0.2 * yaw))
        } else {
            Pose2::new(3.5 * x, 2.5 * y, 3.1 * yaw)
        }
    })
}

#[test]
fn the_mirror_pose_is_as_likely() {
    let observation = Observation::new(&field(), 350, Formula::Corrected, 3.0, SimdPath::Auto);
    let likely = |pose: &Pose2| observation.log_likelihood(table(), pose);
    let best = likely(&STANDS);
    assert!(best > 15.0, "a table that says something: {best}");
    let off = poses().map(|pose| (likely(&pose) - likely(&pose.mirrored())).abs());
    assert_eq!(off.fold(0.0, f64::max), 0.0, "to the bit");
}

/// Points and pose moved together lie on the table where they lay.
#[test]
fn moving_all_lines_and_the_robot_together_changes_no_likelihood() {
    let positions: Vec<DVec2> = field().points(350).iter().map(|point| point.position).collect();
    let path = available(SimdPath::Auto);
    let here = Points::new(positions.iter().copied());
    let mut largest = 0.0f64;
    for (index, pose) in poses().step_by(10).enumerate() {
        let mut draw = Stream::new(8, Purpose::Start, 0, 0, index as u32);
        let mut within = |half: f64| (2.0 * draw.uniform() - 1.0) * half;
        let elsewhere = Pose2::new(within(5.0), within(5.0), within(3.1));
        let moved = positions.iter().map(|point| {
            let at = elsewhere.compose(&Pose2::new(point.x, point.y, 0.0));
            DVec2::new(at.x, at.y)
        });
        let scale = table().readings().scale / 3.0;
        let before = sum_levels(path, table(), &here, &pose) * scale;
        let after = sum_levels(path, table(), &Points::new(moved), &elsewhere.compose(&pose)) * scale;
        largest = largest.max((before - after).abs());
    }
    largest_error(largest, 0.02, "of a log likelihood, moved by up to 7 m");
}

/// A cloud's common look-up leaves out lines that nobody can see; alone, each particle counts all.
#[test]
fn a_particle_s_likelihood_does_not_depend_on_the_others() {
    let observation = Observation::new(&field(), 350, Formula::Corrected, 3.0, SimdPath::Auto);
    let mut largest = 0.0f64;
    for yaw in [0.4, core::f64::consts::PI, -core::f64::consts::PI] {
        let cloud: Vec<Pose2> = poses()
            .step_by(2)
            .map(|pose| Pose2 { yaw: realitysim::geometry::wrap_angle(pose.yaw - 0.4 + yaw), ..pose })
            .collect();
        let mut near = Points::default();
        observation.look_near(table(), &cloud, &mut near);
        for pose in &cloud {
            let found = observation.log_likelihood_near(table(), pose, &near);
            largest = largest.max((observation.log_likelihood(table(), pose) - found).abs());
        }
    }
    largest_error(largest, 4e-15, "of a log likelihood");
}

/// Whatever the order of the particles: the same shares, and copies that average to them.
fn counts(log_weights: &[f64], draws: usize, stream: &mut Stream) -> Vec<u32> {
    let mut copies = Copies::default();
    residual(&normalise(log_weights), draws, stream, &mut copies);
    copies.counts
}

#[test]
fn the_order_of_particles_does_not_matter_to_the_distribution() {
    const SEEDS: u64 = 3000;
    let logs: Vec<f64> = (0..40).map(|i| -f64::from(i * 17 % 40) / 7.0).collect();
    let order: Vec<usize> = (0..40).map(|i| i * 27 % 40).collect();
    let shuffled: Vec<f64> = order.iter().map(|i| logs[*i]).collect();
    let (plain, other) = (normalise(&logs), normalise(&shuffled));
    for (place, index) in order.iter().enumerate() {
        assert!((plain.shares[*index] - other.shares[place]).abs() < 1e-16);
    }
    assert!((plain.evidence - other.evidence).abs() < 1e-14);
    assert!((plain.effective_sample_size / other.effective_sample_size - 1.0).abs() < 1e-14);
    let mut totals = [[0i64; 40]; 2];
    for seed in 0..SEEDS {
        let draw = |logs: &[f64]| counts(logs, 20, &mut Stream::new(seed, Purpose::Resampling, 0, 0, 0));
        let (plain, other) = (draw(&logs), draw(&shuffled));
        for (place, index) in order.iter().enumerate() {
            totals[0][*index] += i64::from(plain[*index]);
            totals[1][*index] += i64::from(other[place]);
        }
    }
    // Of two sums of coins, each of variance at most a quarter.
    let sigma = (SEEDS as f64 / 2.0).sqrt();
    let apart = (0..40).map(|i| (totals[0][i] - totals[1][i]).abs() as f64 / sigma);
    largest_error(apart.fold(0.0, f64::max), 1e0, "standard deviations, the largest of 40");
}

proptest! {
    #[test]
    fn resampling_keeps_the_number_and_scaling_changes_no_count(
        logs in proptest::collection::vec(-40.0..0.0f64, 1..200), draws in 0usize..500, seed in any::<u64>(), power in -60i32..60,
    ) {
        // Shifts that f64 holds exactly: a factor of all weights.
        let logs: Vec<f64> = logs.iter().map(|log| (log * 1024.0).round() / 1024.0).collect();
        let shift = f64::from(power) * 1024.0;
        let draw = |logs: &[f64]| counts(logs, draws, &mut Stream::new(seed, Purpose::Resampling, 1, 2, 0));
        let counts = draw(&logs);
        prop_assert_eq!(counts.iter().sum::<u32>() as usize, draws);
        prop_assert_eq!(draw(&logs.iter().map(|log| log + shift).collect::<Vec<_>>()), counts);
    }

    #[test]
    fn the_order_of_weights_changes_no_share(
        (logs, order) in proptest::collection::vec(-60.0..0.0f64, 1..200)
            .prop_flat_map(|logs| (Just(logs.clone()), Just((0..logs.len()).collect::<Vec<_>>()).prop_shuffle())),
    ) {
        let shuffled: Vec<f64> = order.iter().map(|index| logs[*index]).collect();
        let (plain, other) = (normalise(&logs), normalise(&shuffled));
        for (place, index) in order.iter().enumerate() {
            prop_assert!((plain.shares[*index] - other.shares[place]).abs() < 1e-15);
        }
        prop_assert!((plain.evidence - other.evidence).abs() < 1e-13);
        prop_assert!((plain.effective_sample_size / other.effective_sample_size - 1.0).abs() < 1e-13);
    }

    #[test]
    fn a_pose_and_its_mirror_image_are_alike_wherever_they_are(x in -6.0..6.0f64, y in -5.0..5.0f64, yaw in -3.2..3.2f64) {
        let observation = Observation::new(&field(), 350, Formula::Corrected, 3.0, SimdPath::Auto);
        let pose = Pose2::new(x, y, yaw);
        let off = observation.log_likelihood(table(), &pose) - observation.log_likelihood(table(), &pose.mirrored());
        prop_assert_eq!(off, 0.0);
    }
}
