//! Effects on stored images: which ones, and that they do what they do in a frame.

use std::collections::BTreeSet;
use std::fs;

use realitysim::scene::{Effect, Renderer, Scene};

use super::common::{image, shelf, straight_with as build};

const LIGHT: &str = "kind = \"light\"\ngain = 0.6\ncolour = [1.0, 0.88, 0.7]\ncamera_gain = 1.5";
const NOISE: &str =
    "kind = \"sensor_noise\"\nread_noise_dn = { uniform = [1, 5], per = \"frame\" }\nshot_noise_factor = 0.1";
const FRAME: u64 = 17;

fn clean(scene: &Scene) -> Vec<u8> {
    let pose = scene.truth(scene.frame_time_s(FRAME)).map_from_camera_link;
    let mut pixels = Vec::new();
    Renderer::new(scene).render_clean(&pose, FRAME, &mut pixels);
    pixels
}

/// Everything else needs to know where the camera stood, how it moved, or acts on something else than pixels.
#[test]
fn of_all_effects_these_are_for_stored_images() {
    let (mut applied, mut left_out) = (BTreeSet::new(), BTreeSet::new());
    for (name, scene) in shelf() {
        let (on_any, others) = scene.effects_on_images();
        for effect in &scene.file().effects {
            let means_the_same = match effect {
                Effect::Light(light) => light.gradient_per_m == [0.0; 2],
                Effect::SensorNoise(_) => true,
                _ => false,
            };
            let lists = [on_any.contains(&effect.name()), others.contains(&effect.name())];
            assert_eq!(lists, [means_the_same, !means_the_same], "{name}: {}", effect.name());
        }
        applied.extend(on_any);
        left_out.extend(others);
    }
    let (even, _) = build(&[LIGHT, NOISE]).effects_on_images();
    applied.extend(even);
    assert_eq!(applied, BTreeSet::from(["light", "sensor_noise"]), "each is gated below");
    assert!(left_out.contains("light"), "with a gradient");
    let text = fs::read_to_string("docs/reference/scenes.md").expect("readable");
    let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(text.contains("`light` without a gradient and `sensor_noise`, which mean the same on any image"));
}

#[test]
fn noise_on_a_stored_image_is_that_of_the_frame_to_the_bit() {
    let scene = build(&[NOISE]);
    let before = clean(&scene);
    let mut stored = before.clone();
    scene.apply_to_image(FRAME, &mut stored);
    assert!(stored == image(&scene, FRAME) && stored != before);
}

#[test]
fn light_on_a_stored_image_is_that_of_the_frame_up_to_rounding() {
    let (dark, day) = (build(&[LIGHT]), build(&[]));
    let mut stored = clean(&day);
    dark.apply_to_image(FRAME, &mut stored);
    let rendered = image(&dark, FRAME);
    let worst = stored.iter().zip(&rendered).map(|(a, b)| a.abs_diff(*b)).max();
    // The stored image has been rounded before.
    assert!(worst.is_some_and(|worst| worst <= 1), "{worst:?}");
    assert!(stored.iter().zip(clean(&day)).any(|(a, b)| a.abs_diff(b) > 20));
}

/// The camera amplifies its noise with the picture, whichever of the two is applied to what.
#[test]
fn light_and_noise_on_a_stored_image_equal_those_of_a_rendered_one() {
    let (both, day) = (build(&[LIGHT, NOISE]), build(&[]));
    let mut stored = clean(&day);
    both.apply_to_image(FRAME, &mut stored);
    let rendered = image(&both, FRAME);
    let worst = stored.iter().zip(&rendered).map(|(a, b)| a.abs_diff(*b)).max();
    assert!(worst.is_some_and(|worst| worst <= 2), "{worst:?}");
}
