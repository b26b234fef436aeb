//! The Python client of the repository, installed and used as its users do.

use std::fs;
use std::process::Command;

use super::{PLACES, Served, add_images};
use crate::replay::support::Room;

/// A lens as renderers have it.
const PINHOLE: &str = "title = \"pinhole\"\nwidth = 320\nheight = 240\nfx = 200.0\nfy = 200.0\ncx = 159.5\ncy = 119.5\n\
    model = \"plumb_bob\"\nd = [0.0, 0.0, 0.0, 0.0, 0.0]\n";

/// Names a Python interpreter that has numpy and pip.
const INTERPRETER: &str = "REALITYSIM_PYTHON";

#[test]
fn the_python_client_gets_arrays_from_a_served_database() {
    let Some(python) = std::env::var_os(INTERPRETER) else {
        println!("skipped: {INTERPRETER} names no interpreter");
        return;
    };
    let room = Room::new();
    add_images(&room, "images", &PLACES);
    room.write("pinhole.toml", PINHOLE);
    let served = Served::of(room, "--lens pinhole=pinhole.toml");
    let target = served.room.path("site");
    let package = concat!(env!("CARGO_MANIFEST_DIR"), "/clients/python");
    let copy = served.room.path("package");
    // pip builds beside the sources.
    let copied = Command::new("cp").args(["-r", package]).arg(&copy).status().expect("cp");
    assert!(copied.success());
    let install = Command::new(&python)
        .args([
            "-m",
            "pip",
            "install",
            "--quiet",
            "--no-deps",
            "--no-index",
            "--no-build-isolation",
            "--disable-pip-version-check",
            "--target",
        ])
        .arg(&target)
        .arg(&copy)
        .output()
        .expect("pip");
    assert!(install.status.success(), "{install:?}");
    let run = |script: &str, arguments: &[&str]| {
        let script = format!("{}/{script}", env!("CARGO_MANIFEST_DIR"));
        let output = Command::new(&python)
            .arg(script)
            .args(arguments)
            .env("PYTHONPATH", &target)
            .current_dir(served.room.path(""))
            .output();
        let output = output.expect("python");
        assert!(
            output.status.success(),
            "{}{}",
            String::from_utf8_lossy(&output.stdout),
            String::from_utf8_lossy(&output.stderr)
        );
        String::from_utf8_lossy(&output.stdout).into_owned()
    };
    let url = format!("http://{}", served.address);
    let image = served.room.path("images/0.png").display().to_string();
    println!("{}", run("tests/service/check_client.py", &[&url, &image]));
    let said =
        run("clients/python/examples/follow_robot.py", &["--url", &url, "--steps", "20", "--radius", "0.1", "--plain"]);
    assert!(said.contains("20 views"), "{said}");
    // Half of a ball in the ground is hidden by the ground, half of it is in front; a ball that lies on the ground is seen whole.
    let counts = |ball: &str| {
        let mut arguments = vec!["--url", &url, "--camera", "0.2", "0.2", "0.5", "10", "30", "--ball"];
        arguments.extend(ball.split(' '));
        let said = run("clients/python/examples/compose_by_depth.py", &arguments);
        let number = |word: &str| word.parse::<f64>().ok();
        let numbers: Vec<f64> = said.split_whitespace().filter_map(number).collect();
        <[f64; 2]>::try_from(numbers).unwrap_or_else(|_| panic!("{said}"))
    };
    let [shown, hidden] = counts("1.2 0.4 0.1");
    assert!(shown > 400.0 && hidden == 0.0, "a ball on the ground: {shown} shown, {hidden} hidden");
    let [shown, hidden] = counts("1.2 0.4 0.0");
    // Seen from 26 degrees above, the part of a sphere's outline above its own middle plane is (1 + sin) / 2.
    let share = shown / (shown + hidden);
    assert!((share - 0.72).abs() < 0.03, "a ball half in the ground: {share}");
    let picture = fs::read(served.room.path("composed.ppm")).expect("written");
    assert!(picture.starts_with(b"P6 320 240 255\n"));
}
