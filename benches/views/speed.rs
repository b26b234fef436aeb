//! A view from images that are decoded, raw pixels out: one thread.

use std::fmt::Write;
use std::hint::black_box;
use std::time::Instant;

use realitysim::views::{Candidate, Target, Warp, World, view};

use super::opencv::OpenCv;
use super::{Times, setting};

pub fn run(rounds: usize, text: &mut String) {
    let (field, camera) = (setting::field(), setting::camera());
    let image = setting::noise(&camera);
    let mut cv = OpenCv::start(&map(&camera, &World::without_goals(&field), &image), image.full());
    let _ = writeln!(
        text,
        "Views of 640 x 480 from decoded images, one thread, {rounds} rounds. {}\n",
        match cv {
            Some(_) => "OpenCV's `remap` (bilinear, one source, the map given) takes turns with them.",
            None => "OpenCV was not there.",
        }
    );
    let _ = writeln!(text, "| goals | sources | least ms | p50 ms | p99 ms | `remap` least ms | least in `remap`s |");
    let _ = writeln!(text, "| --- | --- | --- | --- | --- | --- | --- |");
    for (goals, world) in [("no", World::without_goals(&field)), ("yes", World::new(&field))] {
        for count in [1, 2, 4] {
            let sources: Vec<Candidate> = (0..count).map(|i| setting::source(&camera, &image, i)).collect();
            let wanted = setting::request(&camera, &world);
            let (mut ours, mut theirs) = (Vec::new(), Vec::new());
            for _ in 0..rounds {
                let started = Instant::now();
                let answer = black_box(view(&wanted, &sources).expect("a view"));
                ours.push(1e3 * started.elapsed().as_secs_f64());
                assert!(answer.valid_share > 0.5);
                theirs.extend(cv.as_mut().map(OpenCv::remap));
            }
            let ours = Times::of(ours);
            let (remap, ratio) = match theirs.is_empty() {
                true => ("-".to_owned(), "-".to_owned()),
                false => {
                    let theirs = Times::of(theirs).at(0.0);
                    (format!("{theirs:.2}"), format!("{:.2}", ours.at(0.0) / theirs))
                }
            };
            let [least, p50, p99] = [0.0, 0.5, 0.99].map(|share| ours.at(share));
            let _ = writeln!(text, "| {goals} | {count} | {least:.2} | {p50:.2} | {p99:.2} | {remap} | {ratio} |");
        }
    }
}

/// Where each pixel of the view lies in the first source, as OpenCV wants it; -1 where it does not.
fn map(camera: &realitysim::views::Camera, world: &World, image: &realitysim::views::Pyramid) -> [Vec<f32>; 2] {
    let source = setting::source(camera, image, 0);
    let target = Target::new(camera, &setting::wanted(), world);
    let warp = Warp::new(&target, &source);
    let (mut us, mut vs) = (Vec::new(), Vec::new());
    for (u, v) in (0..480).flat_map(|v| (0..640).map(move |u| (u, v))) {
        let at = warp.interpolated(u, v).map(|(at, _)| at);
        us.push(at.map_or(-1.0, |at| at.x as f32));
        vs.push(at.map_or(-1.0, |at| at.y as f32));
    }
    [us, vs]
}
