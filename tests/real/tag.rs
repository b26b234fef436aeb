//! `realitysim tag` on real pixels: images of one camera centre must be found at one place, up to the mirror.

use std::path::Path;
use std::process::Command;

use realitysim::config::{LensWanted, parse_lens};
use realitysim::geometry::{Pose2, wrap_angle};

/// The field that fits these images best of those shipped (docs/explanation/paper.md).
const FIELD: &str = "kid-2014";

struct Found {
    place: Pose2,
    /// Found yaw less the file's own, which is the same for all images of one centre.
    yaw_offset: f64,
}

fn found(id: u32) -> Found {
    let folder = Path::new("tests/data/visualmesh");
    let lens = folder.join(format!("lens{id:07}.yaml"));
    let output = Command::new(env!("CARGO_BIN_EXE_realitysim"))
        // Their tilt is exact.
        .args(["--json", "tag", "--attitude-sigma", "0", "--field", FIELD, "--lens"])
        .arg(&lens)
        .arg(folder.join(format!("image{id:07}.jpg")))
        .output()
        .expect("the program runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).expect("one JSON object");
    let number = |key: &str| report["best"]["pose"][key].as_f64().expect("a number");
    let place = Pose2::new(number("x"), number("y"), number("yaw_deg").to_radians());
    let text = std::fs::read_to_string(&lens).expect("a lens file");
    let wanted = LensWanted { image_size: Some([1280, 1024]), ..LensWanted::default() };
    let file = parse_lens(&text, "lens", wanted).expect("a VisualMesh file");
    let stated = file.visual_mesh_pose.expect("its pose").world_from_camera_link;
    Found { place, yaw_offset: wrap_angle(place.yaw - stated.euler().yaw) }
}

/// Distance in metres and yaw in degrees, of the pose or its mirror, whichever is nearer.
fn apart(a: &Found, b: &Found) -> (f64, f64) {
    let half_turn = core::f64::consts::PI;
    [(b.place, 0.0), (b.place.mirrored(), half_turn)]
        .map(|(place, turn)| {
            let yaw = wrap_angle(a.yaw_offset - b.yaw_offset - turn).abs().to_degrees();
            (a.place.distance(&place), yaw)
        })
        .into_iter()
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .expect("two")
}

#[test]
fn images_of_one_centre_are_found_at_one_place() {
    for (a, b) in [(20, 29), (2, 11), (4, 23)] {
        let (metres, degrees) = apart(&found(a), &found(b));
        println!("images {a} and {b}: {:.1} cm and {degrees:.2} deg apart", 100.0 * metres);
        assert!(metres < 0.05 && degrees < 0.5, "images {a} and {b}: {metres:.3} m, {degrees:.2} deg");
    }
}
