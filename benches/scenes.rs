//! What rendering costs, counted in instructions: `cargo bench --bench scenes`. Needs valgrind.
//!
//! Instructions do not depend on what else the machine does. Setting up is counted apart and taken off. Fails if a scene
//! without effects costs over 2 % more than the bare renderer, which knows of no effect at all.

use std::process::{Command, ExitCode};

use realitysim::scene::Renderer;
use realitysim::sensors::scene;

/// A shelf scene with all the effects that another one has cut off.
const BASE: &str = include_str!("../replay/scenes/straight.toml");

/// Frames of one run; each costs a second or two under valgrind.
const FRAMES: u64 = 3;
const ALLOWED: f64 = 1.02;

const EFFECTS: [(&str, &str); 18] = [
    ("gait_sway", SWAY),
    (
        "head_motion",
        "kind = \"head_motion\"\npan_amplitude_deg = 30\npan_period_s = 4\ntilt_amplitude_deg = 5\ntilt_period_s = 3",
    ),
    ("kidnapping", "kind = \"kidnapping\"\nat_s = 9\nto_m = [1.0, 0.5]\nto_yaw_deg = 30"),
    ("fall", "kind = \"fall\"\nat_s = 9\ndirection = \"left\""),
    ("light", "kind = \"light\"\ngain = 0.4\ngradient_per_m = [0.1, 0.05]"),
    ("light, drawn per frame", "kind = \"light\"\ngain = { uniform = [0.4, 0.9], per = \"frame\" }"),
    (
        "bright_window",
        "kind = \"bright_window\"\nwall = \"+x\"\ncentre_m = 0\nwidth_m = 3\nsill_m = 1\nheight_m = 2.5\nbrightness = 8\n\
         glare = 0.4\nsun_elevation_deg = 20",
    ),
    ("obstacles, one robot", "kind = \"obstacles\"\nfigures = [{ shape = \"robot\", position_m = [-1.4, 0.3] }]"),
    ("obstacles, 8 drawn", "kind = \"obstacles\"\nrandom = 8"),
    ("worn_lines", "kind = \"worn_lines\"\nshare = 0.5\npatch_m = 0.3"),
    ("shutter, rolling", "kind = \"shutter\"\nexposure_ms = 0.01\nreadout_ms = 16"),
    ("shutter, open for 8 ms", "kind = \"shutter\"\nexposure_ms = 8\nreadout_ms = 0"),
    ("odometry_error", "kind = \"odometry_error\"\nscale_percent = 5\nyaw_drift_deg_per_m = 1\nnoise_m_per_m = 0.1"),
    (
        "imu_error",
        "kind = \"imu_error\"\nroll_bias_deg = 0.5\npitch_bias_deg = 0.3\nnoise_deg = 0.2\ngyro_noise_deg_s = 1",
    ),
    ("sensor_noise", "kind = \"sensor_noise\"\nread_noise_dn = 1.5\nshot_noise_factor = 0.15"),
    ("calibration_error", "kind = \"calibration_error\"\nfocal_percent = 0.6"),
    ("camera_fault", "kind = \"camera_fault\"\nunplugged = { from_s = 1, for_s = 1 }"),
    ("serial_noise", "kind = \"serial_noise\"\nlost_share = 0.2"),
];
const SWAY: &str =
    "kind = \"gait_sway\"\nroll_deg = 2\npitch_deg = 1.3\nlateral_m = 0.018\nvertical_m = 0.006\nstep_hz = 2.4";

/// Of the child that is counted: which scene, and how many frames.
const CHILD: &str = "REALITYSIM_BENCH_SCENE";

fn main() -> ExitCode {
    if let Ok(what) = std::env::var(CHILD) {
        render(&what);
        return ExitCode::SUCCESS;
    }
    let (Some(bare), Some(none)) = (per_frame("bare"), per_frame("none")) else {
        eprintln!("valgrind cannot be run: nothing was counted");
        return ExitCode::SUCCESS;
    };
    let millions = |instructions: f64| instructions / 1e6;
    println!("instructions per frame of {FRAMES}, in millions\n\n  bare renderer            {:8.2}", millions(bare));
    println!("  scene without effects    {:8.2}  x {:.4}", millions(none), none / bare);
    for (index, (name, _)) in EFFECTS.iter().enumerate() {
        if let Some(cost) = per_frame(&index.to_string()) {
            println!("  {name:<24} {:+8.2}  x {:.4}", millions(cost - none), cost / none);
        }
    }
    if none > ALLOWED * bare {
        eprintln!("a scene without effects costs {:.4} times the bare renderer, {ALLOWED} is allowed", none / bare);
        return ExitCode::FAILURE;
    }
    ExitCode::SUCCESS
}

/// None without valgrind.
fn per_frame(what: &str) -> Option<f64> {
    let [without, with] = [0, FRAMES].map(|frames| instructions(&format!("{what}/{frames}")));
    Some((with? - without?) / FRAMES as f64)
}

fn instructions(what: &str) -> Option<f64> {
    let program = std::env::current_exe().ok()?;
    let output = Command::new("valgrind")
        .args(["--tool=callgrind", "--callgrind-out-file=/dev/null"])
        .arg(program)
        .env(CHILD, what)
        .output()
        .ok()?;
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    told.lines().find_map(|line| line.split("Collected : ").nth(1)?.trim().parse().ok())
}

fn render(what: &str) {
    let (which, frames) = what.split_once('/').expect("which/frames");
    let plain = BASE.split("[[effect]]").next().expect("a first part");
    let text = match which.parse::<usize>() {
        // The shutter needs something that moves, and who falls has walked.
        Ok(index) if EFFECTS[index].0.starts_with("shutter") || EFFECTS[index].0 == "fall" => {
            format!("{plain}\n[[effect]]\n{SWAY}\n[[effect]]\n{}\n", EFFECTS[index].1)
        }
        Ok(index) => format!("{plain}\n[[effect]]\n{}\n", EFFECTS[index].1),
        Err(_) => plain.to_owned(),
    };
    let scene = scene::parse(&text, "bench").expect("a scene");
    let renderer = Renderer::new(&scene);
    let mut pixels = Vec::new();
    for frame in 0..frames.parse().expect("a number") {
        if which == "bare" {
            let pose = scene.truth(scene.frame_time_s(frame)).map_from_camera_link;
            renderer.render_bare(&pose, &mut pixels);
        } else {
            renderer.render(frame, &mut pixels);
        }
    }
}
