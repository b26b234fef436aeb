//! Laws of the files, and their size and speed.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use proptest::prelude::*;

use super::file::MAX_GROUP_ROWS;
use super::*;
use realitysim_config::plain_file;

/// Seconds of a frame, and rows of a session: eleven minutes at 30 Hz.
const FRAME_S: f64 = 1.0 / 30.0;
const SESSION_ROWS: usize = 20_000;

/// Random numbers from 0 to 1: the same at every run.
struct Random(blake3::OutputReader);

impl Random {
    fn new(seed: usize) -> Self {
        Self(blake3::Hasher::new().update(&seed.to_le_bytes()).finalize_xof())
    }

    fn bytes<const N: usize>(&mut self) -> [u8; N] {
        let mut bytes = [0; N];
        self.0.fill(&mut bytes);
        bytes
    }

    fn unit(&mut self) -> f64 {
        f64::from(u32::from_le_bytes(self.bytes())) / f64::from(u32::MAX)
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }
}

/// A walk from place to place on a field of 9 m x 6 m at 0.2 m/s, with a head that pans: the rows as a capture would give them.
fn walk(session: usize, count: usize) -> Vec<CatalogueRow> {
    let mut random = Random::new(session);
    let (mut x, mut y, mut offset) = (random.between(-4.5, 4.5), random.between(-3.0, 3.0), 4096);
    let mut goal = (x, y);
    let row = |number: usize| {
        let distance = (goal.0 - x).hypot(goal.1 - y);
        if distance < 0.05 {
            goal = (random.between(-4.5, 4.5), random.between(-3.0, 3.0));
        } else {
            let step = 0.2 * FRAME_S / distance;
            (x, y) = (x + step * (goal.0 - x), y + step * (goal.1 - y));
        }
        let heading = (goal.1 - y).atan2(goal.0 - x).to_degrees();
        let pan = 60.0 * (number as f64 * FRAME_S).sin() + random.between(-1.0, 1.0);
        let length = random.between(30e3, 50e3) as i32;
        offset += i64::from(length) + 60;
        let is_valid = random.unit() < 0.9;
        let mut row = CatalogueRow {
            session: format!("2026-11-28T10-00-{session:02}Z-robot"),
            session_id: format!("{session:032x}"),
            sequence: number as i64,
            stamp_ns: 1_795_860_000_000_000_000
                + (number as f64 * FRAME_S * 1e9) as i64
                + random.between(0.0, 1e6) as i64,
            segment: Some(format!("{:04}.mcap", number / 1800)),
            offset: Some(offset),
            length: Some(length),
            blake3: Some(random.bytes()),
            valid: is_valid,
            reason: if is_valid { "" } else { "few_lines" }.to_owned(),
            residual: super::row::short(random.between(0.6, 1.0) as f32),
            lines_expected: random.between(20.0, 90.0) as i32,
            lines_fitting: random.between(15.0, 60.0) as i32,
            brightness: Some((110.0 + 20.0 * (heading + pan).to_radians().cos() + random.between(-1.0, 1.0)) as i32),
            sharpness: Some(super::row::short(random.between(0.05, 0.12) as f32)),
            software: "realitysim 0.1.0".to_owned(),
            config_hash: "0123456789abcdef".to_owned(),
            ..CatalogueRow::default()
        };
        if is_valid {
            let sway = random.between(-0.02, 0.02);
            let yaw = (heading + pan + 540.0).rem_euclid(360.0) - 180.0;
            row.set_pose([x + sway, y + sway, 0.5 + sway], [yaw, 20.0 + 50.0 * sway, 50.0 * sway]);
            let sigma = random.between(0.003, 0.03);
            row.set_sigmas([
                sigma,
                sigma * random.between(0.5, 1.0),
                0.3 * sigma,
                10.0 * sigma,
                11.0 * sigma,
                20.0 * sigma,
            ]);
        }
        row
    };
    (0..count).map(row).collect()
}

fn written(folder: &Path, name: &str, rows: &[CatalogueRow]) -> PathBuf {
    let path = folder.join(name);
    fs::write(&path, parquet_of_rows(&FileHead::default(), rows).unwrap()).unwrap();
    path
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn rows_come_back_as_they_were_written(seed in 0usize..1000, count in 0usize..5000) {
        let folder = tempfile::tempdir().unwrap();
        let rows = walk(seed, count);
        let mut found = read_rows(&written(folder.path(), "a.parquet", &rows)).unwrap();
        found.sort_by_key(|row| row.sequence);
        prop_assert_eq!(found, rows);
    }

    #[test]
    fn a_damaged_file_is_an_error_or_read(place in 0.0..1.0, value: u8, cut: bool) {
        let folder = tempfile::tempdir().unwrap();
        let path = written(folder.path(), "a.parquet", &walk(1, 300));
        let mut bytes = plain_file::read(&path, u64::MAX).unwrap();
        let at = (place * bytes.len() as f64) as usize;
        if cut { bytes.truncate(at) } else { bytes[at] ^= value }
        fs::write(&path, bytes).unwrap();
        let (head, rows) = (read_head(&path), read_rows(&path));
        let is_named = matches!(head, Err(CatalogueError::Damaged { .. })) && rows.is_err();
        prop_assert!(!cut || is_named);
    }

    #[test]
    fn pruning_passes_over_no_row(seed in 0usize..1000, x in -5.0f32..5.0, y in -3.0f32..3.0, yaw in -180.0f32..150.0) {
        let folder = tempfile::tempdir().unwrap();
        let path = written(folder.path(), "a.parquet", &walk(seed, 3 * MAX_GROUP_ROWS));
        let range = PoseRange { x_m: [x, x + 0.5], y_m: [y, y + 0.5], yaw_deg: [yaw, yaw + 30.0] };
        let within = |ends: [f32; 2], value: Option<f32>| value.is_some_and(|value| ends[0] <= value && value <= ends[1]);
        let rows = read_rows(&path).unwrap();
        let matches = |row: &CatalogueRow| within(range.x_m, row.x_m) && within(range.y_m, row.y_m) && within(range.yaw_deg, row.yaw_deg);
        let holding = rows.chunks(MAX_GROUP_ROWS).filter(|group| group.iter().any(matches)).count();
        let [read, all] = pruned_groups(&path, &range).unwrap();
        prop_assert_eq!(all, 3);
        prop_assert!(holding <= read);
    }
}

#[test]
fn the_same_rows_give_the_same_bytes() {
    let head = FileHead::default();
    let mut rows = walk(1, 5000);
    let bytes = parquet_of_rows(&head, &rows).unwrap();
    rows.reverse();
    assert!(parquet_of_rows(&head, &rows).unwrap() == bytes);
}

#[test]
fn a_file_of_a_newer_version_and_a_foreign_one_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.parquet");
    let head = FileHead { format: FORMAT + 1, ..FileHead::default() };
    fs::write(&path, parquet_of_rows(&head, &walk(1, 10)).unwrap()).unwrap();
    let said = read_head(&path).unwrap_err().to_string();
    assert!(said.contains(&format!("of catalogue format {}, and this program knows {FORMAT}", FORMAT + 1)), "{said}");
    let bytes = plain_file::read(&path, u64::MAX).unwrap();
    let key = b"realitysim.catalogue";
    let at = bytes.windows(key.len()).rposition(|part| part == key).unwrap();
    let foreign = [&bytes[..at], b"another.. .catalogue", &bytes[at + key.len()..]].concat();
    fs::write(&path, foreign).unwrap();
    assert!(matches!(read_head(&path), Err(CatalogueError::Foreign { .. })));
}

#[test]
fn a_small_range_of_poses_reads_few_row_groups() {
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path(), "a.parquet", &walk(3, SESSION_ROWS));
    let share = mean_share(&[path], 0.5, 30.0);
    assert!(share < 0.06, "{:.1} %", 100.0 * share);
}

/// Figures of docs/howto/catalogue.md, of a million rows: in one file, and as fifty sessions.
#[test]
#[ignore = "prints the figures of docs/howto/catalogue.md, whose command stands there"]
fn a_million_rows() {
    let folder = tempfile::tempdir().unwrap();
    for (sessions, count) in [(1, 1_000_000), (50, SESSION_ROWS)] {
        let walks: Vec<_> = (0..sessions).map(|session| walk(session, count)).collect();
        let began = Instant::now();
        let write =
            |(number, rows): (usize, &Vec<_>)| written(folder.path(), &format!("{sessions}-{number}.parquet"), rows);
        let files: Vec<PathBuf> = walks.iter().enumerate().map(write).collect();
        let seconds = began.elapsed().as_secs_f64();
        let bytes: u64 = files.iter().map(|file| fs::metadata(file).unwrap().len()).sum();
        println!("{sessions} files: written in {seconds:.2} s, {:.1} bytes a row", bytes as f64 / 1e6);
        for (side, turn) in [(0.5, 30.0), (1.0, 60.0)] {
            println!(
                "  {side} m x {side} m x {turn} deg: {:.1} % of row groups",
                100.0 * mean_share(&files, side, turn)
            );
        }
    }
}

/// A catalogue of made-up sessions of eleven minutes by twenty robots on a hundred days, for `tests/replay/time_queries.py`.
#[test]
#[ignore = "writes the catalogue of docs/howto/catalogue.md, whose command stands there"]
fn a_league() {
    let variable = |name: &str| std::env::var(name).unwrap_or_else(|_| panic!("{name} is not set"));
    let folder = PathBuf::from(variable("REALITYSIM_LEAGUE"));
    let sessions = variable("REALITYSIM_LEAGUE_ROWS").parse::<usize>().unwrap() / SESSION_ROWS;
    let began = Instant::now();
    for session in 0..sessions {
        let day = session / 20 % 100;
        let date = format!("date=2026-{:02}-{:02}", 3 + day / 25, 1 + day % 25);
        let inner = folder.join("field=kid-2020").join(date).join(format!("robot=robot-{}", session % 20));
        fs::create_dir_all(&inner).unwrap();
        written(&inner, &format!("{session}.parquet"), &walk(session, SESSION_ROWS));
    }
    println!("{sessions} sessions made up and written in {:.0} s", began.elapsed().as_secs_f64());
}

/// Share of row groups that queries for ranges of poses read, on average over places all over the field.
fn mean_share(files: &[PathBuf], side: f64, turn: f64) -> f64 {
    let mut random = Random::new(7);
    let mut sum = [0; 2];
    for _ in 0..100 {
        let low =
            [random.between(-4.5, 4.5 - side), random.between(-3.0, 3.0 - side), random.between(-180.0, 180.0 - turn)];
        let [x_m, y_m, yaw_deg] = [0, 1, 2].map(|i| [low[i] as f32, (low[i] + [side, side, turn][i]) as f32]);
        for file in files {
            let [read, all] = pruned_groups(file, &PoseRange { x_m, y_m, yaw_deg }).unwrap();
            sum = [sum[0] + read, sum[1] + all];
        }
    }
    sum[0] as f64 / sum[1] as f64
}
