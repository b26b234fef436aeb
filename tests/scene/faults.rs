//! What breaks: a robot that falls, a cable that comes loose, a line that is noisy; a window, a shutter.

use realitysim::geometry::Isometry;
use realitysim::scene::{Renderer, START_STAMP_NS, Scene, SceneEvent, SceneEventKind};

use super::common::{fisheye_640, image, straight_with as build};

const SWAY: &str = "kind = \"gait_sway\"\nroll_deg = 2.0\npitch_deg = 1.3\nlateral_m = 0.018\nvertical_m = 0.006\n\
                    step_hz = 2.4";
const ODOMETRY: &str = "kind = \"odometry_error\"\nscale_percent = 6.0\nyaw_drift_deg_per_m = 1.0\nnoise_m_per_m = 0.1";
const NOISE: &str = "kind = \"sensor_noise\"\nread_noise_dn = 1.5\nshot_noise_factor = 0.15";
const FALL: &str = "kind = \"fall\"\nat_s = 8.0\ndirection = \"forwards\"\nmoved_m = [0.2, -0.1]\nturned_deg = 30.0";
const UNPLUGGED: &str = "kind = \"camera_fault\"\nunplugged = { from_s = 5.0, for_s = 2.0 }";
const SERIAL: &str = "kind = \"serial_noise\"\nlost_share = 0.2\ncorrupt_share = 0.1";
const WINDOW: &str = "kind = \"bright_window\"\nwall = \"+x\"\ncentre_m = 0.5\nwidth_m = 3\nsill_m = 1\nheight_m = 2.5\n\
                      brightness = 8\nglare = 0.1\nsun_elevation_deg = 20\nsun_gain = 1.7";

fn seconds(event: &SceneEvent) -> f64 {
    (event.stamp_ns - START_STAMP_NS) as f64 / 1e9
}

fn is_frame(event: &SceneEvent) -> bool {
    matches!(event.kind, SceneEventKind::Frame { .. })
}

#[test]
fn who_falls_lies_and_gets_up_beside_where_it_fell() {
    let [walking, falling] = [build(&[SWAY, ODOMETRY]), build(&[SWAY, FALL, ODOMETRY])];
    assert!((falling.duration_s() - walking.duration_s() - 5.2).abs() < 1e-9);
    let before = |scene: &Scene| scene.events().take_while(|event| seconds(event) < 8.0).collect::<Vec<_>>();
    assert_eq!(before(&walking), before(&falling), "until then nothing is different");
    let tilt = |time: f64| falling.truth(time).map_from_base_link.euler().pitch.to_degrees();
    assert!(tilt(7.9).abs() < 3.0 && (tilt(9.0) - 85.0).abs() < 3.0 && tilt(13.3).abs() < 3.0);
    // Above the ground all the time, and where the feet are.
    for step in 0..60 {
        let camera = falling.truth(8.0 + 0.1 * f64::from(step)).map_from_camera_link.translation;
        assert!((0.03..0.7).contains(&camera.z), "{camera}");
    }
    let [fell, stands] = [8.0, 13.2].map(|time| falling.truth(time).map_from_base_footprint);
    let moved = fell.inverse().compose(&stands);
    assert!((moved.x - 0.2).abs() < 1e-9 && (moved.y + 0.1).abs() < 1e-9);
    assert!((moved.yaw.to_degrees() - 30.0).abs() < 1e-9);
}

/// The gyro's rates add up to the turn, and at rest the accelerometer feels gravity alone.
#[test]
fn the_imu_feels_the_fall() {
    let scene = build(&[SWAY, FALL]);
    let step = 1e-3;
    let mut rotation = scene.truth(8.0).map_from_base_link.rotation;
    for index in 0..1000 {
        let rate = scene.truth(8.0 + (f64::from(index) + 0.5) * step).angular_velocity;
        rotation *= glam::DQuat::from_scaled_axis(rate * step);
    }
    let off = rotation.angle_between(scene.truth(9.0).map_from_base_link.rotation).to_degrees();
    assert!(off < 0.1, "{off} degrees");
    let lying = scene.truth(9.3);
    assert!((lying.linear_acceleration.length() - 9.80665).abs() < 0.05, "{}", lying.linear_acceleration);
    assert!(lying.linear_acceleration.x < -9.0, "on its face gravity pulls ahead: {}", lying.linear_acceleration);
}

#[test]
fn a_camera_without_its_cable_sends_nothing_and_all_else_goes_on() {
    let [whole, faulty] = [build(&[SWAY, ODOMETRY]), build(&[SWAY, ODOMETRY, UNPLUGGED])];
    let heard = |event: &SceneEvent| !(is_frame(event) && (5.0..7.0).contains(&seconds(event)));
    assert!(whole.events().filter(heard).eq(faulty.events()));
    let torn: Vec<u64> = (0..faulty.frame_count()).filter(|frame| faulty.torn(*frame).is_some()).collect();
    assert_eq!(torn, [49], "the last one before");
    assert!((0.2..0.9).contains(&faulty.torn(49).unwrap()) && whole.torn(49).is_none());
    assert_eq!(image(&whole, 30), image(&faulty, 30));
}

#[test]
fn what_a_noisy_line_lets_through_is_what_was_sent() {
    let [quiet, noisy] = [build(&[SWAY, ODOMETRY]), build(&[SWAY, ODOMETRY, SERIAL])];
    let sent: Vec<SceneEvent> = quiet.events().collect();
    let heard: Vec<SceneEvent> = noisy.events().collect();
    let mut sent_again = sent.iter();
    for event in &heard {
        let same = |other: &&SceneEvent| other.stamp_ns == event.stamp_ns && other.kind == event.kind;
        assert!(sent_again.any(|other| same(&other)), "{event:?} was never sent");
    }
    let numbers = |events: &[SceneEvent]| events.iter().filter(|event| !is_frame(event)).count() as f64;
    let left = numbers(&heard) / numbers(&sent);
    assert!((left - 0.8).abs() < 0.02, "{left}");
    let corrupt = heard.iter().filter(|event| event.corrupt.is_some()).count() as f64 / numbers(&heard);
    assert!((corrupt - 0.1).abs() < 0.015, "{corrupt}");
    assert!(heard.iter().filter(|event| is_frame(event)).all(|event| event.corrupt.is_none()));
    assert_eq!(heard.iter().filter(|event| is_frame(event)).count() as u64, quiet.frame_count());
}

#[test]
fn a_window_clips_veils_and_lights_the_floor_behind_it_only() {
    let [dull, bright] = [build(&[]), build(&[WINDOW])];
    assert!(dull.events().eq(bright.events()));
    let (without, with) = (image(&dull, 30), image(&bright, 30));
    let white = |pixels: &[u8]| pixels.chunks_exact(3).filter(|pixel| **pixel == [255; 3]).count();
    assert!(white(&with) > 500 + 10 * white(&without), "{} {}", white(&with), white(&without));
    assert!(without.iter().zip(&with).all(|(without, with)| with >= without), "light only adds");
    let mean = |pixels: &[u8]| pixels.iter().map(|value| f64::from(*value)).sum::<f64>() / pixels.len() as f64;
    assert!(mean(&with) > mean(&without) + 0.5);
    // With the window behind the camera no veil is left: where the sun does not shine not a bit changes.
    let back = WINDOW.replace("\"+x\"", "\"-x\"").replace("sun_elevation_deg = 20\n", "");
    assert_eq!(image(&build(&[&back]), 30), without);
}

/// A still camera would show nothing: so its motion is compared with frames of a global, instant shutter.
#[test]
fn a_rolling_shutter_shows_each_row_as_it_was_at_its_time() {
    // The head alone moves, fast.
    let head = "kind = \"head_motion\"\npan_amplitude_deg = 60\npan_period_s = 1.5\ntilt_amplitude_deg = 0\n\
                tilt_period_s = 3";
    let shutter = |exposure_ms: f64, readout_ms: f64| {
        format!("kind = \"shutter\"\nexposure_ms = {exposure_ms}\nreadout_ms = {readout_ms}")
    };
    let frame = 4;
    let sharp = build(&[head]);
    let instant = image(&build(&[head, &shutter(0.01, 0.0)]), frame);
    assert_eq!(instant, image(&sharp, frame), "open for no time, all rows at once");
    let rolling = image(&build(&[head, &shutter(0.01, 40.0)]), frame);
    let stride = 3 * fisheye_640().width as usize;
    let at = |row: usize| {
        // Of the band of eight rows that it belongs to.
        let middle = (row / 8 * 8 + 4) as f64 / 480.0 - 0.5;
        let pose: Isometry = sharp.truth(sharp.frame_time_s(frame) + 0.04 * middle).map_from_camera_link;
        let mut pixels = Vec::new();
        Renderer::new(&sharp).render_from(&pose, frame, &mut pixels);
        pixels[row * stride..(row + 1) * stride].to_vec()
    };
    for row in [60, 243, 400] {
        let (found, wanted) = (&rolling[row * stride..(row + 1) * stride], at(row));
        let differ = found.iter().zip(&wanted).filter(|(a, b)| a.abs_diff(**b) > 2).count();
        assert!(differ < stride / 100, "row {row}: {differ}");
    }
    assert_ne!(rolling[60 * stride..61 * stride], instant[60 * stride..61 * stride]);
    // Open for long it smears: neighbours differ less.
    let edges = |pixels: &[u8]| pixels.windows(4).map(|pair| u64::from(pair[0].abs_diff(pair[3]))).sum::<u64>();
    let blurred = image(&build(&[head, &shutter(30.0, 0.0)]), frame);
    assert!(edges(&blurred) * 10 < edges(&instant) * 9, "{} {}", edges(&blurred), edges(&instant));
}

#[test]
fn these_effects_leave_what_others_do_alone() {
    let noise = |effects: &[&str]| {
        let scene = build(effects);
        let mut clean = Vec::new();
        let pose = scene.truth(scene.frame_time_s(12)).map_from_camera_link;
        Renderer::new(&scene).render_clean(&pose, 12, &mut clean);
        (clean, image(&scene, 12))
    };
    let (clean, noisy) = noise(&[SWAY, NOISE]);
    assert_eq!((clean.clone(), noisy), noise(&[SWAY, NOISE, UNPLUGGED, SERIAL]));
    assert_eq!(clean, noise(&[SWAY, FALL]).1);
}
