//! The way of a request through a database: finding, reading, decoding, making, encoding.

use std::fmt::Write;
use std::hint::black_box;
use std::path::Path;
use std::time::Instant;

use realitysim::config::ViewsSettings;
use realitysim::database::{Contents, ImageDatabase, TagLimits, ViewQuery, add};
use realitysim::geometry::Isometry;
use realitysim::views::Method;

use super::{Times, setting};

/// Pictures, which the database's images share: what a view costs does not depend on what they show.
const PICTURES: usize = 64;
/// Places that are asked for again and again: their images stay decoded.
const PLACES: usize = 32;

pub fn run(rounds: usize, text: &mut String) {
    let folder = tempfile::tempdir().expect("a folder");
    let (images, db) = (folder.path().join("images"), folder.path().join("db"));
    let count = if rounds < 100 { 400 } else { 10_000 };
    let all = write(&images, count);
    let poses: Vec<Isometry> = all.iter().step_by(count / PLACES).copied().collect();
    add(&db, &[images], Some(setting::field().dimensions()), TagLimits::default(), &mut |_| ()).expect("a database");
    // Whatever its pictures show.
    let mut contents = Contents::read(&db).expect("a database");
    contents.sources.iter_mut().for_each(|source| source.goals = true);
    contents.write(&db).expect("a database");
    let settings = ViewsSettings::default();
    let open = || ImageDatabase::open(&db, &settings).expect("a database");
    let wanted = |map_from_link: Isometry| ViewQuery {
        map_from_link,
        method: Method::Exact,
        camera: None,
        max_distance_m: f64::INFINITY,
        may_be_stored: true,
        without: Vec::new(),
    };
    let between = |i: usize| Isometry {
        translation: poses[i % poses.len()].translation + glam::DVec3::new(0.02, 0.015, 0.0),
        ..poses[i % poses.len()]
    };
    // Nobody looked that way: the choice goes on until it knows.
    let away = |i: usize| {
        let pose = between(i);
        Isometry { rotation: glam::DQuat::from_rotation_z(2.1) * pose.rotation, ..pose }
    };
    let timed = |database: &ImageDatabase, pose: Isometry, jpeg: bool| {
        let started = Instant::now();
        let shown = database.view(&wanted(pose)).expect("a view");
        if jpeg {
            let mut bytes = Vec::new();
            let encoder = jpeg_encoder::Encoder::new(&mut bytes, 90);
            encoder.encode(&shown.answer.image.to_rgb(), 640, 480, jpeg_encoder::ColorType::Rgb).expect("encoded");
            black_box(bytes);
        }
        let took = 1e3 * started.elapsed().as_secs_f64();
        black_box(shown);
        took
    };
    let _ = writeln!(
        text,
        "From a database of {count} JPEGs of 640 x 480 (quality 90), choosing, file reading and checksums included, goals on the field:\n"
    );
    let _ = writeln!(text, "| | p50 ms | p99 ms |\n| --- | --- | --- |");
    let mut row = |what: &str, times: Vec<f64>| {
        let times = Times::of(times);
        let _ = writeln!(text, "| {what} | {:.2} | {:.2} |", times.at(0.5), times.at(0.99));
    };
    let warm = open();
    for (i, pose) in poses.iter().enumerate() {
        timed(&warm, between(i), false);
        timed(&warm, *pose, false);
        timed(&warm, away(i), false);
    }
    row("a stored image", (0..rounds).map(|i| timed(&warm, poses[i % poses.len()], false)).collect());
    row("an exact view of 4 sources, decoded before", (0..rounds).map(|i| timed(&warm, between(i), false)).collect());
    row("the same, encoded as JPEG", (0..rounds).map(|i| timed(&warm, between(i), true)).collect());
    row(
        "an exact view that looks 120 degrees away, decoded before",
        (0..rounds).map(|i| timed(&warm, away(i), false)).collect(),
    );
    let cold = (0..rounds.min(100)).map(|i| timed(&open(), between(i), false));
    row("an exact view of 4 sources, to be decoded", cold.collect());
    let started = Instant::now();
    std::thread::scope(|scope| {
        for thread in 0..2 {
            let (warm, timed, between) = (&warm, &timed, &between);
            scope.spawn(move || {
                (0..rounds / 2).for_each(|i| _ = black_box(timed(warm, between(2 * i + thread), false)))
            });
        }
    });
    let _ = writeln!(
        text,
        "\nTwo threads together: {:.0} exact views a second.",
        (rounds / 2 * 2) as f64 / started.elapsed().as_secs_f64()
    );
}

/// Smooth pictures: JPEGs of noise would be three times as large as any that a camera makes.
fn write(images: &Path, count: usize) -> Vec<Isometry> {
    std::fs::create_dir(images).expect("a folder");
    let lens = setting::lens();
    let camera = format!(
        "image_width: 640\nimage_height: 480\ncamera_name: bench\ncamera_matrix:\n  rows: 3\n  cols: 3\n  data: [{}, 0, {}, 0, {}, {}, 0, 0, 1]\n\
         distortion_model: equidistant\ndistortion_coefficients:\n  rows: 1\n  cols: 4\n  data: [0.0, 0.0, 0.0, 0.0]\n",
        lens.fx, lens.cx, lens.fy, lens.cy
    );
    std::fs::write(images.join("camera_info.yaml"), camera).expect("written");
    let mut table = "file,x,y,z,yaw_deg,pitch_deg,roll_deg\n".to_owned();
    for picture in 0..PICTURES {
        let wave = |t: f64| (127.0 + 100.0 * libm::sin(t)) as u8;
        let rgb: Vec<u8> = (0..640 * 480)
            .flat_map(|p| {
                let (u, v) = (f64::from(p % 640), f64::from(p / 640));
                [wave(u / 7.0 + picture as f64), wave(v / 5.0), wave((u + v) / 11.0)]
            })
            .collect();
        let mut bytes = Vec::new();
        jpeg_encoder::Encoder::new(&mut bytes, 90)
            .encode(&rgb, 640, 480, jpeg_encoder::ColorType::Rgb)
            .expect("encoded");
        std::fs::write(images.join(format!("{picture}.jpg")), bytes).expect("written");
    }
    // Over a field's middle, in five directions.
    let side = libm::sqrt(count as f64) as usize;
    let mut poses = Vec::new();
    for i in 0..count {
        let place = |along: usize| 4.0 * along as f64 / side as f64 - 2.0;
        let (x, y, yaw_deg) = (place(i % side), place(i / side), 20.0 * (i * 7 % 5) as f64);
        table.push_str(&format!("{}.jpg,{x},{y},0.55,{yaw_deg},28,1\n", i % PICTURES));
        let euler = realitysim::geometry::Euler {
            yaw: yaw_deg.to_radians(),
            pitch: 28f64.to_radians(),
            roll: 1f64.to_radians(),
        };
        poses.push(Isometry::from_euler(euler, glam::DVec3::new(x, y, 0.55)));
    }
    std::fs::write(images.join("poses.csv"), table).expect("written");
    poses
}
