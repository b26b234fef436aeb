//! The index from a thousand images to a million.

use std::fmt::Write;
use std::time::Instant;

use realitysim::database::{Index, Metric, Record, write_index};
use realitysim::geometry::{Euler, Isometry};

use super::Times;

/// Evenly spread poses, the same everywhere.
fn poses(count: usize, salt: f64) -> impl Iterator<Item = Isometry> {
    (0..count).map(move |i| {
        let part = |step: f64| ((i as f64 + 0.5) * step + salt).fract();
        let place = glam::DVec3::new(6.0 * part(0.618_034) - 3.0, 4.0 * part(0.754_878) - 2.0, 0.5 + 0.05 * part(0.33));
        let euler = Euler {
            yaw: core::f64::consts::TAU * part(0.569_84),
            pitch: 0.3 + 0.1 * part(0.27),
            roll: 0.1 * part(0.71) - 0.05,
        };
        Isometry::from_euler(euler, place)
    })
}

pub fn run(quick: bool, text: &mut String) {
    let folder = tempfile::tempdir().expect("a folder");
    let metric = Metric::default();
    let _ = writeln!(text, "| images | built s | opened ms | nearest 8: p50 us | p99 us | bytes an image |");
    let _ = writeln!(text, "| --- | --- | --- | --- | --- | --- |");
    let counts: &[usize] = if quick { &[1_000, 10_000] } else { &[1_000, 10_000, 100_000, 720_000, 1_000_000] };
    for count in counts.iter().copied() {
        let path = folder.path().join("index.bin");
        let records: Vec<Record> = poses(count, 0.0).map(|pose| Record::at(&pose)).collect();
        let started = Instant::now();
        write_index(&path, records).expect("written");
        let built = started.elapsed().as_secs_f64();
        let started = Instant::now();
        let index = Index::open(&path).expect("open");
        let opened = started.elapsed().as_secs_f64();
        let times: Vec<f64> = poses(2_000, 0.123)
            .map(|pose| {
                let started = Instant::now();
                assert_eq!(index.nearest(&pose, 8, &metric).len(), 8);
                1e6 * started.elapsed().as_secs_f64()
            })
            .collect();
        let times = Times::of(times);
        let bytes = index.bytes() as f64 / count as f64;
        let (p50, p99) = (times.at(0.5), times.at(0.99));
        let _ = writeln!(text, "| {count} | {built:.2} | {:.2} | {p50:.1} | {p99:.1} | {bytes:.1} |", 1e3 * opened);
    }
}
