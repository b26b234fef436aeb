//! What scenes cost, counted in instructions: `cargo bench --bench scenes`. Needs valgrind, and fails without; `-- --if-possible`
//! does not. `-- --write docs/reference/scenes.md` puts the table between that document's marks.
//!
//! Instructions do not depend on what else the machine does. Counted are a few frames, and everything that the robot's
//! other sensors send meanwhile; what acts once begins within that time. Setting up is counted apart and taken off. Fails if
//! a scene without effects costs over 2 % more than the bare renderer, which knows of no effect at all, or if a long
//! chain does not cost what its effects cost one by one.

use std::fmt::Write;
use std::process::{Command, ExitCode};

use realitysim::log_input::scene_source;
use realitysim::scene::{Renderer, START_STAMP_NS, Scene};

/// A shelf scene with all the effects that another one has cut off.
const BASE: &str = include_str!("../replay/scenes/straight.toml");

/// Frames of one run; each costs a second or two under valgrind.
const FRAMES: u64 = 3;
/// Of a scene without effects, in terms of the bare renderer.
const ALLOWED: f64 = 1.02;
/// Of a chain, off the sum of its effects: one stands before what another changes, or draws what another has lit.
const OFF_THE_SUM: f64 = 0.01;

const SWAY: &str =
    "kind = \"gait_sway\"\nroll_deg = 2\npitch_deg = 1.3\nlateral_m = 0.018\nvertical_m = 0.006\nstep_hz = 2.4";
const HEAD: &str =
    "kind = \"head_motion\"\npan_amplitude_deg = 30\npan_period_s = 4\ntilt_amplitude_deg = 5\ntilt_period_s = 3";
const KIDNAPPING: &str =
    "kind = \"kidnapping\"\nat_s = 0.05\nduration_s = 0.2\nlift_m = 0.1\nto_m = [-2.8, 0.2]\nto_yaw_deg = 5";
const FALL: &str = "kind = \"fall\"\nat_s = 0\nfall_s = 0.5\ndirection = \"left\"";
const WORN: &str = "kind = \"worn_lines\"\nshare = 0.5\npatch_m = 0.3";
const TURF: &str = "kind = \"turf\"\nblades = 0.2\nglint_share = 0.003\npaint = 0.4\nragged_mm = 5";
const SUN: &str = "kind = \"sun_patches\"\ngain = 2\nshare = 0.5\nlength_m = 1.5\nedge_m = 0.2";
const OPTICS: &str = "kind = \"optics\"\nstray_light = 0.1\nlateral_colour_px = 1";
const HUNTING: &str = "kind = \"exposure_hunting\"\namplitude = 0.4\nperiod_s = 2";
const PROCESSING: &str = "kind = \"image_processing\"\ncolour_filter = true\nsharpening = 1";
const LIGHT: &str = "kind = \"light\"\ngain = 0.4\ngradient_per_m = [0.1, 0.05]";
const WINDOW: &str = "kind = \"bright_window\"\nwall = \"+x\"\ncentre_m = 0\nwidth_m = 3\nsill_m = 1\nheight_m = 2.5\n\
                      brightness = 8\nglare = 0.4\nsun_elevation_deg = 20";
const ROBOT: &str = "kind = \"obstacles\"\nfigures = [{ shape = \"robot\", position_m = [-1.4, 0.3] }]";
const NOISE: &str = "kind = \"sensor_noise\"\nread_noise_dn = 1.5\nshot_noise_factor = 0.15";
const ODOMETRY: &str = "kind = \"odometry_error\"\nscale_percent = 5\nyaw_drift_deg_per_m = 1\nnoise_m_per_m = 0.1\n\
                        freeze = { from_s = 0.05, for_s = 0.05 }\nmissing = { from_s = 0.15, for_s = 0.05 }\n\
                        jump = { at_s = 0.1, x_m = 0.5, y_m = 0.1, yaw_deg = 20 }";
const IMU: &str =
    "kind = \"imu_error\"\nroll_bias_deg = 0.5\npitch_bias_deg = 0.3\nnoise_deg = 0.2\ngyro_noise_deg_s = 1";
const CALIBRATION: &str = "kind = \"calibration_error\"\nfocal_percent = 0.6";
const UNPLUGGED: &str = "kind = \"camera_fault\"\nunplugged = { from_s = 0.05, for_s = 0.1 }";
const SERIAL: &str = "kind = \"serial_noise\"\nlost_share = 0.2\ncorrupt_share = 0.1";

/// In a row of the table: what it is called, and its effects.
const ROWS: [(&str, &[&str]); 23] = [
    ("`gait_sway`", &[SWAY]),
    ("`head_motion`", &[HEAD]),
    ("`kidnapping`, under way", &[KIDNAPPING]),
    ("`fall`, under way, with `gait_sway`", &[SWAY, FALL]),
    ("`turf`", &[TURF]),
    ("`worn_lines`", &[WORN]),
    ("`sun_patches`", &[SUN]),
    ("`light`", &[LIGHT]),
    ("`light`, drawn per frame", &["kind = \"light\"\ngain = { uniform = [0.4, 0.9], per = \"frame\" }"]),
    ("`bright_window`", &[WINDOW]),
    ("`obstacles`, one robot", &[ROBOT]),
    ("`obstacles`, 8 drawn", &["kind = \"obstacles\"\nrandom = 8"]),
    ("`shutter`, rolling, with `gait_sway`", &[SWAY, "kind = \"shutter\"\nexposure_ms = 0.01\nreadout_ms = 16"]),
    ("`shutter`, open for 8 ms, with `gait_sway`", &[SWAY, "kind = \"shutter\"\nexposure_ms = 8\nreadout_ms = 0"]),
    ("`optics`", &[OPTICS]),
    ("`exposure_hunting`", &[HUNTING]),
    ("`sensor_noise`", &[NOISE]),
    ("`image_processing`", &[PROCESSING]),
    ("`odometry_error`: all of it", &[ODOMETRY]),
    ("`imu_error`", &[IMU]),
    ("`calibration_error`", &[CALIBRATION]),
    ("`camera_fault`, unplugged", &[UNPLUGGED]),
    ("`serial_noise`", &[SERIAL]),
];
/// One of each kind, but for `fall`, which excludes `kidnapping`, `shutter`, which draws all others several times, and those that
/// work on what the others have drawn: `turf`, `sun_patches`, `optics`, `exposure_hunting`, `image_processing`.
const CHAIN: [&str; 13] =
    [SWAY, HEAD, KIDNAPPING, WORN, LIGHT, WINDOW, ROBOT, NOISE, ODOMETRY, IMU, CALIBRATION, UNPLUGGED, SERIAL];

/// Of the child that is counted: what is rendered, how many frames, and then the effects' entries.
const CHILD: &str = "REALITYSIM_BENCH_SCENE";
const BARE: &str = "bare";
const SCENE: &str = "scene";

fn main() -> ExitCode {
    if let Ok(what) = std::env::var(CHILD) {
        render(&what);
        return ExitCode::SUCCESS;
    }
    let arguments: Vec<String> = std::env::args().collect();
    if Command::new("valgrind").arg("--version").output().is_err() {
        eprintln!("scenes: valgrind cannot be run, so nothing was counted: install it, or say -- --if-possible");
        return if arguments.iter().any(|argument| argument == "--if-possible") {
            ExitCode::SUCCESS
        } else {
            ExitCode::FAILURE
        };
    }
    let (bare, none) = (per_frame(BARE, &[]), per_frame(SCENE, &[]));
    let mut text =
        String::from("| scene | million instructions per frame | times that without effects |\n| --- | --- | --- |\n");
    let mut row = |name: &str, millions: String, cost: f64| {
        let line = format!("| {name} | {millions} | {:.4} |", cost / none);
        println!("{line}");
        let _ = writeln!(text, "{line}");
    };
    row("bare renderer", format!("{:.2}", bare / 1e6), bare);
    row("without effects", format!("{:.2}", none / 1e6), none);
    let mut single = Vec::new();
    for (name, effects) in ROWS {
        let cost = per_frame(SCENE, effects);
        row(name, more((cost - none) / 1e6), cost);
        if let [effect] = effects {
            single.push((*effect, cost - none));
        }
    }
    let chain = per_frame(SCENE, &CHAIN);
    let own = |effect: &&str| single.iter().find(|(known, _)| known == effect).map_or(f64::NAN, |(_, cost)| *cost);
    let sum = none + CHAIN.iter().map(own).sum::<f64>();
    row(&format!("{} of these in one scene", CHAIN.len()), more((chain - none) / 1e6), chain);
    row("the sum of their own costs", more((sum - none) / 1e6), sum);
    if let Some(path) = arguments.iter().skip_while(|argument| *argument != "--write").nth(1) {
        write_between_marks(path, &text);
    }
    let mut passed = true;
    if none > ALLOWED * bare {
        eprintln!("scenes: one without effects costs {:.4} times the bare renderer, {ALLOWED} is allowed", none / bare);
        passed = false;
    }
    let off = chain / sum;
    if !(1.0 - OFF_THE_SUM..=1.0 + OFF_THE_SUM).contains(&off) {
        eprintln!("scenes: a chain costs {off:.4} times the sum of its effects, {OFF_THE_SUM} off is allowed");
        passed = false;
    }
    if passed { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// Nothing has no sign of its own.
fn more(millions: f64) -> String {
    format!("{millions:+.2}").replace("-0.00", "+0.00")
}

fn write_between_marks(path: &str, text: &str) {
    let document = std::fs::read_to_string(path).expect("the document");
    let marks = ["<!-- begin: bench scenes -->", "<!-- end: bench scenes -->"];
    let [begin, end] = marks.map(|mark| document.find(mark).expect("a mark"));
    let whole = format!("{}\n\n{}\n\n{}", &document[..begin + marks[0].len()], text.trim(), &document[end..]);
    std::fs::write(path, whole).expect("written");
}

fn per_frame(what: &str, effects: &[&str]) -> f64 {
    let counted = |frames: u64| instructions(&format!("{what}/{frames}/{}", effects.join("\n[[effect]]\n")));
    (counted(FRAMES) - counted(0)) / FRAMES as f64
}

fn instructions(what: &str) -> f64 {
    let program = std::env::current_exe().expect("a path");
    let output = Command::new("valgrind")
        .args(["--tool=callgrind", "--callgrind-out-file=/dev/null"])
        .arg(program)
        .env(CHILD, what)
        .output()
        .expect("valgrind");
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    let count = told.lines().find_map(|line| line.split("Collected : ").nth(1)?.trim().parse().ok());
    count.filter(|_| output.status.success()).unwrap_or_else(|| panic!("{what}: nothing was counted: {told}"))
}

fn render(what: &str) {
    let mut parts = what.splitn(3, '/');
    let mut part = || parts.next().expect("what/frames/effects");
    let (what, frames, effects) = (part(), part().parse::<u64>().expect("a number"), part());
    let plain = BASE.split("[[effect]]").next().expect("a first part");
    let entries = if effects.is_empty() { String::new() } else { format!("\n[[effect]]\n{effects}\n") };
    let scene = scene_source::parse(&format!("{plain}{entries}"), "bench").expect("a scene");
    let renderer = Renderer::new(&scene);
    let mut pixels = Vec::new();
    if what == BARE {
        for frame in 0..frames {
            renderer.render_bare(&scene.truth(scene.frame_time_s(frame)).map_from_camera_link, &mut pixels);
        }
        return;
    }
    send(&scene, frames);
    for frame in 0..frames {
        // What is lost on the wire has been rendered.
        renderer.render(frame, &mut pixels);
    }
}

/// Everything that is sent until the frame after these is due.
fn send(scene: &Scene, frames: u64) {
    if frames == 0 {
        return;
    }
    let end_ns = START_STAMP_NS + (scene.frame_time_s(frames) * 1e9) as i64;
    let sent = scene.events().take_while(|event| event.stamp_ns < end_ns).count();
    assert!(sent > 0, "nothing was sent");
}
