//! The same seed gives the same tags, however they are computed.

use super::support::{Room, assert_same, walk};

#[test]
fn the_same_seed_gives_the_same_tags_on_any_number_of_threads() {
    let room = Room::with_walk();
    for threads in [1, 2, 4, 7] {
        let again = room.replay(&format!("log.mcap --threads {threads}"));
        assert_eq!(again.count("threads"), threads);
        assert_same(&again.tags, &walk().tags, &format!("{threads} threads"));
    }
}

#[test]
fn the_same_seed_gives_the_same_tags_on_every_kernel() {
    let room = Room::with_walk();
    let mut kernels = vec!["scalar"];
    #[cfg(target_arch = "x86_64")]
    {
        kernels.push("sse2");
        if std::is_x86_feature_detected!("avx2") {
            kernels.push("avx2");
        }
    }
    for kernel in kernels {
        assert_same(&room.replay(&format!("log.mcap --simd {kernel}")).tags, &walk().tags, kernel);
    }
}

/// A scene's lens file says how wide it sees, which a log's camera_info cannot: the scene does without as well.
#[test]
fn a_scene_gives_the_same_tags_as_its_log() {
    let room = Room::with_walk();
    room.write_scene("scene.toml", |text| text);
    assert_same(&room.replay("scene.toml").tags, &walk().tags, "without a log in between");
    // Both can be told.
    let from_log = room.replay("log.mcap --set camera.fov_deg=120").tags;
    assert_same(&room.replay("scene.toml --set camera.fov_deg=120").tags, &from_log, "told how wide it sees");
    assert!(from_log.iter().zip(&walk().tags).any(|(a, b)| a.best_particle != b.best_particle), "it matters");
}

#[test]
fn a_scene_of_another_lens_and_raw_images_gives_the_same_tags_as_its_log() {
    let room = Room::new();
    for (name, lens) in [("wide", "wide-640"), ("equisolid", "fisheye-1280")] {
        let scene = |text: String| {
            text.replace("\"lens.toml\"", &format!("\"{lens}\""))
                .replace("jpeg_quality = 90\n", "")
                .replace("rate_hz = 10.0", "rate_hz = 2.0")
        };
        room.write_scene("scene.toml", scene);
        room.run("scene render scene.toml -o log.mcap").succeeds();
        assert_same(&room.replay("scene.toml").tags, &room.replay("log.mcap").tags, name);
    }
}

#[test]
fn another_seed_gives_other_particles() {
    let room = Room::with_walk();
    let other = room.replay("log.mcap --seed 2").tags;
    let same = other.iter().zip(&walk().tags).filter(|(a, b)| a.best_particle == b.best_particle).count();
    assert_eq!(same, 0);
    let valid = other.iter().filter(|tag| tag.valid).count();
    assert!(10 * valid >= 9 * walk().frames(), "{valid} of {} valid", walk().frames());
}
