//! What a view costs: `cargo test --release --test integration views::speed -- --ignored --nocapture`

use std::time::Instant;

use realitysim::geometry::{Lens, LensModel, LensParameters};
use realitysim::views::{Camera, Candidate, Pyramid, Raster, World, view};

use super::{candidate, field, pose, request};

#[test]
#[ignore = "a benchmark: prints a table"]
fn the_cost_of_a_view() {
    let model = LensModel::KannalaBrandt { k: [0.0; 4] };
    let parameters = LensParameters {
        width: 640,
        height: 480,
        fx: 203.7,
        fy: 203.7,
        cx: 319.5,
        cy: 239.5,
        model,
        fov_deg: Some(180.0),
    };
    let camera = Camera::new(&Lens::new(parameters).expect("a lens"));
    let noise: Vec<u8> = (0..640 * 480 * 3u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    let image = Pyramid::new(Raster::from_rgb(640, 480, &noise, camera.shows()).expect("fits"));
    println!("| goals | sources | least ms | p50 ms | p99 ms |\n| --- | --- | --- | --- | --- |");
    for (goals, world) in [("no", World::without_goals(&field())), ("yes", World::new(&field()))] {
        for count in [1, 2, 4] {
            let sources: Vec<Candidate> = (0..count)
                .map(|i| {
                    let (sin, cos) = libm::sincos(0.3 + f64::from(i) * core::f64::consts::FRAC_PI_2);
                    let turn = if i % 2 == 0 { 10.0 } else { -10.0 };
                    candidate(&camera, pose(0.3 + 0.25 * cos, -0.5 + 0.25 * sin, 20.0 + turn), &image)
                })
                .collect();
            let wanted = request(&camera, pose(0.3, -0.5, 20.0), &world);
            let mut times: Vec<f64> = (0..200)
                .map(|_| {
                    let started = Instant::now();
                    let answer = view(&wanted, &sources).expect("a view");
                    assert!(answer.valid_share > 0.5);
                    1e3 * started.elapsed().as_secs_f64()
                })
                .collect();
            times.sort_by(f64::total_cmp);
            println!("| {goals} | {count} | {:.2} | {:.2} | {:.2} |", times[0], times[100], times[198]);
        }
    }
}
