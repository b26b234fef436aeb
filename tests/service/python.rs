//! The Python client of the repository, used as its users do. `./dev package` installs it as a wheel.

use std::fs;
use std::path::Path;
use std::process::Command;

use super::{PLACES, Served, add_images, with_captures};
use crate::replay::support::Room;

/// A lens as renderers have it.
const PINHOLE: &str = "title = \"pinhole\"\nwidth = 320\nheight = 240\nfx = 200.0\nfy = 200.0\ncx = 159.5\ncy = 119.5\n\
    model = \"plumb_bob\"\nd = [0.0, 0.0, 0.0, 0.0, 0.0]\n";

/// Names a Python interpreter that has numpy.
const INTERPRETER: &str = "REALITYSIM_PYTHON";

/// Runs a script of the repository with the client and the program at hand; returns what it prints. `None` without an interpreter.
fn run(script: &str, arguments: &[&str], folder: &Path) -> Option<String> {
    let Some(python) = std::env::var_os(INTERPRETER) else {
        println!("skipped: {INTERPRETER} names no interpreter");
        return None;
    };
    let repository = Path::new(env!("CARGO_MANIFEST_DIR"));
    let programs = Path::new(env!("CARGO_BIN_EXE_realitysim")).parent().expect("a folder").to_owned();
    let path = std::env::var_os("PATH").unwrap_or_default();
    let paths = std::env::join_paths([programs].into_iter().chain(std::env::split_paths(&path))).expect("paths");
    let output = Command::new(&python)
        .arg("-B")
        .arg(repository.join(script))
        .args(arguments)
        .env("PYTHONPATH", repository.join("clients/python"))
        .env("PATH", paths)
        .current_dir(folder)
        .output()
        .expect("python");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    assert!(output.status.success(), "{}{}", text(&output.stdout), text(&output.stderr));
    Some(text(&output.stdout))
}

#[test]
fn a_capture_a_camera_and_coroutines_give_arrays_in_python() {
    let (served, name) = with_captures();
    let capture = format!("captures/{name}");
    let folder = served.room.path("");
    if let Some(said) = run("tests/service/check_captures.py", &[&capture, "db"], &folder) {
        assert!(said.contains("captures agree"), "{said}");
    }
    let values = [format!("capture_folder={capture}"), "database_folder=db".to_owned()];
    let notebook = format!("{}/clients/python/examples/captures_and_views.ipynb", env!("CARGO_MANIFEST_DIR"));
    if let Some(said) = run("tests/service/run_notebook.py", &[&notebook, &values[0], &values[1]], &folder) {
        assert_eq!(said.matches("a picture of").count(), 2, "{said}");
    }
}

#[test]
fn the_python_client_gets_arrays_from_a_served_database() {
    let room = Room::new();
    add_images(&room, "images", &PLACES);
    room.write("pinhole.toml", PINHOLE);
    let served = Served::of(room, "--lens pinhole=pinhole.toml");
    let folder = served.room.path("");
    let run = |script: &str, arguments: &[&str]| run(script, arguments, &folder);
    let url = format!("http://{}", served.address);
    let image = served.room.path("images/0.png").display().to_string();
    let Some(said) = run("tests/service/check_client.py", &[&url, &image]) else { return };
    assert!(said.contains("the client agrees"), "{said}");
    let walked =
        run("clients/python/examples/follow_robot.py", &["--url", &url, "--steps", "20", "--radius", "0.1", "--plain"]);
    assert!(walked.as_ref().is_some_and(|said| said.contains("20 views")), "{walked:?}");
    // Half of a ball in the ground is hidden by the ground, half of it is in front; a ball that lies on the ground is seen whole.
    let counts = |ball: &str| {
        let mut arguments = vec!["--url", &url, "--camera", "0.2", "0.2", "0.5", "10", "30", "--ball"];
        arguments.extend(ball.split(' '));
        let said = run("clients/python/examples/compose_by_depth.py", &arguments).unwrap_or_default();
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
