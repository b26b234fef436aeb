//! For eyes: `cargo test --release scene::look -- --ignored --nocapture` leaves images of every scene on the shelf
//! under target/scene-look and says how long one took.

use std::path::Path;
use std::time::Instant;

use realitysim::scene::{Renderer, Scene};

use super::common::{DEMO, plain, scene, shelf, with_effects};

/// The best of many: whatever else the machine does only adds.
fn best_ms(mut once: impl FnMut(u64)) -> f64 {
    let time = |frame: u64| {
        let start = Instant::now();
        once(frame);
        start.elapsed().as_secs_f64() * 1e3
    };
    (0..100).map(time).fold(f64::INFINITY, f64::min)
}

#[test]
#[ignore = "for eyes, not for machines"]
fn frames_of_the_shelf() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("target/scene-look");
    std::fs::create_dir_all(&folder).expect("a writable target folder");
    for (name, scene) in shelf() {
        let start = Instant::now();
        let renderer = Renderer::new(&scene);
        let (frames, ready) = (scene.frame_count(), start.elapsed());
        let mut pixels = Vec::new();
        for part in [1, 3, 5, 7] {
            let frame = frames * part / 8;
            renderer.render(frame, &mut pixels);
            let path = folder.join(format!("{name}-{frame:03}.png"));
            image::save_buffer(&path, &pixels, renderer.width(), renderer.height(), image::ColorType::Rgb8)
                .expect("written");
        }
        println!("{name}: {:.1} s, {frames} frames, renderer in {ready:.0?}", scene.duration_s());
    }
}

#[test]
#[ignore = "times, not verdicts"]
fn cost_of_each_effect() {
    let cost = |scene: &Scene| {
        let (renderer, mut pixels) = (Renderer::new(scene), Vec::new());
        best_ms(|frame| renderer.render(frame, &mut pixels))
    };
    let base = plain(DEMO);
    for (name, effects) in [
        ("no effect", vec![]),
        (
            "gait_sway",
            vec![
                "kind = \"gait_sway\"\nroll_deg = 2\npitch_deg = 1.3\nlateral_m = 0.018\nvertical_m = 0.006\nstep_hz = 2.4",
            ],
        ),
        (
            "head_motion",
            vec![
                "kind = \"head_motion\"\npan_amplitude_deg = 60\npan_period_s = 4\ntilt_amplitude_deg = 10\n\
             tilt_period_s = 3",
            ],
        ),
        ("kidnapping", vec!["kind = \"kidnapping\"\nat_s = 2\nduration_s = 2\nto_m = [0, 1]\nto_yaw_deg = 0"]),
        ("light", vec!["kind = \"light\"\ngain = 0.12\ngradient_per_m = [0.1, 0.05]"]),
        ("obstacles, 6 far and near", vec!["kind = \"obstacles\"\nrandom = 6"]),
        ("obstacles, 24", vec!["kind = \"obstacles\"\nrandom = 24"]),
        ("worn_lines", vec!["kind = \"worn_lines\"\nshare = 0.4\npatch_m = 0.3"]),
        (
            "obstacles, a person 0.5 m ahead",
            vec!["kind = \"obstacles\"\nfigures = [{ shape = \"person\", position_m = [-0.4, -0.9] }]"],
        ),
        ("sensor_noise", vec!["kind = \"sensor_noise\"\nread_noise_dn = 1.5\nshot_noise_factor = 0.15"]),
    ] {
        println!("{name}: {:.2} ms", cost(&scene(&with_effects(&base, &effects))));
    }
}
