//! `realitysim doctor --calibration` against walks whose mount is known.

use crate::replay::support::Room;

#[test]
fn a_mount_that_has_moved_is_told_with_its_angle_and_day() {
    let room = Room::new();
    let level =
        |text: String| text.replace("bias_deg = 0.5", "bias_deg = 0.0").replace("bias_deg = -0.5", "bias_deg = 0.0");
    room.write_scene("before.toml", level);
    room.write_scene("moved.toml", |text| {
        let text = level(text);
        format!("{text}\n[[effect]]\nkind = \"calibration_error\"\nrole = \"base\"\nmount_pitch_deg = 0.8\n")
    });
    room.run("scene render before.toml -o before.mcap").succeeds();
    room.run("scene render moved.toml -o moved.mcap").succeeds();

    let before = room.run("doctor --calibration before.mcap").succeeds().stdout;
    assert!(before.ends_with("the calibration is still valid\n"), "{before}");
    let moved = room.run("doctor --calibration moved.mcap --since before.mcap").fails(1, &[]).stdout;
    let words = "the mount has turned by 0.8 degrees since Thursday, 9 October 2025, 08:53 UTC";
    assert!(moved.contains(words), "{moved}");
    assert!(moved.contains("- tilt of the camera: looks 0.") && moved.contains(" higher"), "{moved}");
    assert!(moved.contains("turned in its own frame"), "what to do about it: {moved}");

    room.run("doctor --since before.mcap").fails(2, &["--calibration"]);
    room.run("doctor -o captures --calibration").fails(1, &["no capture in it"]);
}
