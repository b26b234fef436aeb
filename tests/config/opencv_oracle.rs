//! What OpenCV writes is read, and drawn where OpenCV draws it.

use std::process::Command;

use glam::{DVec2, DVec3};
use realitysim::config::{LensFormat, load_lens};
use serde::Deserialize;

/// Names a Python interpreter that has OpenCV.
const INTERPRETER: &str = "REALITYSIM_PYTHON";

/// Rays of one lens: x, y, z and the pixel u, v where OpenCV draws them.
#[derive(Deserialize)]
struct Drawn {
    name: String,
    rays: Vec<[f64; 5]>,
}

#[test]
fn opencv_s_lenses_are_read_and_draw_as_in_opencv() {
    let Some(python) = std::env::var_os(INTERPRETER) else {
        println!("skipped: {INTERPRETER} names no interpreter");
        return;
    };
    let folder = tempfile::tempdir().expect("a folder");
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/config/write_lenses.py");
    let output = Command::new(python).arg(script).arg(folder.path()).output().expect("it starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let (mut worst, mut count, mut lenses) = (0.0f64, 0, 0);
    for line in std::fs::read_to_string(folder.path().join("rays.jsonl")).expect("rays").lines() {
        let Drawn { name, rays } = serde_json::from_str(line).expect("a line of rays");
        let path = |ending: &str| folder.path().join(format!("{name}.{ending}")).display().to_string();
        let file = load_lens(&path("yml")).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(file.format, LensFormat::OpenCv);
        assert_eq!(load_lens(&path("xml")).unwrap_or_else(|error| panic!("{error}")).lens, file.lens, "{name}");
        for [x, y, z, u, v] in rays {
            // Beyond the corner of the image this lens draws nothing.
            let Some(pixel) = file.lens.project(DVec3::new(x, y, z)) else { continue };
            worst = worst.max(pixel.distance(DVec2::new(u, v)));
            count += 1;
        }
        lenses += 1;
    }
    println!("{count} rays of {lenses} lenses: at most {worst:.1e} px apart");
    assert!(lenses == 40 && count > 6000, "{count} rays of {lenses} lenses");
    assert!(worst < 1e-9, "{worst} px");
}
