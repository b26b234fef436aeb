//! For eyes: `cargo test --release scene::look -- --ignored --nocapture` leaves images under target/scene-look
//! and says how long one took.

use std::path::Path;
use std::time::Instant;

use realitysim::scene::Renderer;

use super::common::{DEMO, LOOP, STRAIGHT, scene};

#[test]
#[ignore = "for eyes, not for machines"]
fn frames_of_the_shelf() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("target/scene-look");
    std::fs::create_dir_all(&folder).expect("a writable target folder");
    for (name, toml, frames) in
        [("demo", DEMO, [0, 40, 100]), ("straight", STRAIGHT, [0, 60, 200]), ("loop", LOOP, [30, 130, 300])]
    {
        let scene = scene(toml);
        let start = Instant::now();
        let renderer = Renderer::new(&scene);
        println!("{name}: {} s, {} frames, renderer in {:?}", scene.duration_s(), scene.frame_count(), start.elapsed());
        let mut pixels = Vec::new();
        for frame in frames {
            renderer.render(frame, &mut pixels);
            let path = folder.join(format!("{name}-{frame:03}.png"));
            image::save_buffer(&path, &pixels, renderer.width(), renderer.height(), image::ColorType::Rgb8)
                .expect("written");
            let whole = image::RgbImage::from_raw(renderer.width(), renderer.height(), pixels.clone()).expect("fits");
            for (part, left, top) in [("far", 240, 180), ("near", 240, 270)] {
                let crop = image::imageops::crop_imm(&whole, left, top, 160, 120).to_image();
                image::imageops::resize(&crop, 960, 720, image::imageops::FilterType::Nearest)
                    .save(folder.join(format!("{name}-{frame:03}-{part}.png")))
                    .expect("written");
            }
        }
        for clean in [true, false] {
            let mut times: Vec<f64> = (0..117)
                .map(|frame| {
                    let pose = scene.truth(scene.frame_time_s(frame)).map_from_camera_link;
                    let start = Instant::now();
                    if clean {
                        renderer.render_clean(&pose, &mut pixels);
                    } else {
                        renderer.render_from(&pose, frame, &mut pixels);
                    }
                    start.elapsed().as_secs_f64() * 1e3
                })
                .collect();
            times.sort_by(f64::total_cmp);
            println!("  clean {clean}: median {:.2} ms, best {:.2} ms", times[58], times[0]);
        }
    }
}
