//! The Python client of the repository, installed and used as its users do.

use std::process::Command;

use super::Served;

/// Names a Python interpreter that has numpy and pip.
const INTERPRETER: &str = "REALITYSIM_PYTHON";

#[test]
fn the_python_client_gets_arrays_from_a_served_database() {
    let Some(python) = std::env::var_os(INTERPRETER) else {
        println!("skipped: {INTERPRETER} names no interpreter");
        return;
    };
    let served = Served::new("");
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
}
