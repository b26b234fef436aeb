//! Nothing shimmers: a frame is what a four times finer camera sees, averaged over the pixels.

use glam::DVec3;
use realitysim::geometry::{Euler, Isometry, LensModel, LensParameters};
use realitysim::scene::{Renderer, Scene, SceneFile};

use super::common::{STRAIGHT, fisheye_640, kid_2009, plain};

const WIDTH: usize = 160;
const HEIGHT: usize = 120;
const FINE: usize = 4;

fn renderer(lens: LensParameters) -> Renderer {
    let file = SceneFile::from_toml(&plain(STRAIGHT)).expect("readable");
    Renderer::new(&Scene::build(file, kid_2009(), lens).expect("possible"))
}

/// The fisheye with 160 x 120 pixels times `finer`; pixel centres lie so that the fine ones tile the coarse ones.
fn lens(finer: usize) -> LensParameters {
    let scale = finer as f64 / 4.0;
    let centre = |c: f64| (c + 0.5) * scale - 0.5;
    LensParameters {
        width: (WIDTH * finer) as u32,
        height: (HEIGHT * finer) as u32,
        fx: 205.0 * scale,
        fy: 205.0 * scale,
        cx: centre(322.0),
        cy: centre(236.0),
        ..fisheye_640()
    }
}

fn averaged(fine: &[u8], row: usize, column: usize, channel: usize) -> f64 {
    let (mut sum, mut weights) = (0.0, 0.0);
    for dy in -2..6i32 {
        for dx in -2..6i32 {
            let offset = |d: i32| 1.0 - (f64::from(d) - 1.5).abs() / FINE as f64;
            let weight = offset(dx) * offset(dy);
            let place = |base: usize, d: i32| (base * FINE) as i32 + d;
            let at = (place(row, dy) * (WIDTH * FINE) as i32 + place(column, dx)) as usize * 3 + channel;
            sum += weight * f64::from(fine[at]);
            weights += weight;
        }
    }
    sum / weights
}

#[test]
fn a_frame_is_the_average_of_a_finer_one() {
    let [coarse, fine] = [renderer(lens(1)), renderer(lens(FINE))];
    let [mut coarse_pixels, mut fine_pixels] = [Vec::new(), Vec::new()];
    for (x, yaw, roll) in [(-2.5, 0.0, 0.0), (-0.5, 0.5, 0.05), (1.5, 2.5, -0.1)] {
        let pose = Isometry::from_euler(Euler { yaw, pitch: 0.3, roll }, DVec3::new(x, 0.2, 0.49));
        coarse.render_clean(&pose, 0, &mut coarse_pixels);
        fine.render_clean(&pose, 0, &mut fine_pixels);
        let (mut bias, mut squares, mut worst, mut count) = (0.0, 0.0, 0f64, 0.0);
        // Well inside the view.
        for row in 8..HEIGHT - 8 {
            for column in 20..WIDTH - 20 {
                for channel in 0..3 {
                    let expected = averaged(&fine_pixels, row, column, channel);
                    let error = f64::from(coarse_pixels[(row * WIDTH + column) * 3 + channel]) - expected;
                    bias += error;
                    squares += error * error;
                    worst = worst.max(error.abs());
                    count += 1.0;
                }
            }
        }
        let (bias, rms) = (bias / count, f64::sqrt(squares / count));
        assert!(bias.abs() < 0.3 && rms < 4.0 && worst < 60.0, "bias {bias} rms {rms} worst {worst}");
    }
}

#[test]
fn no_pose_and_no_lens_can_harm() {
    let tiny = LensParameters { width: 1, height: 1, cx: 0.0, cy: 0.0, ..fisheye_640() };
    let pinhole = LensParameters {
        fx: 80.0,
        fy: 80.0,
        model: LensModel::PlumbBob { d: [-0.2, 0.05, 0.001, 0.0, 0.0] },
        fov_deg: None,
        ..lens(1)
    };
    let mut pixels = Vec::new();
    for lens in [tiny, pinhole, lens(1)] {
        let renderer = renderer(lens);
        for place in [DVec3::ZERO, DVec3::new(0.0, 0.0, -3.0), DVec3::splat(1e9), DVec3::splat(-70.0), DVec3::NAN] {
            for angle in [0.0, 1.57, 3.0, -1.6, f64::NAN] {
                let pose = Isometry::from_euler(Euler { yaw: angle, pitch: angle, roll: -angle }, place);
                renderer.render_clean(&pose, 0, &mut pixels);
                assert_eq!(pixels.len(), (renderer.width() * renderer.height() * 3) as usize);
            }
        }
    }
}
