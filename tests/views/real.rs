//! Real pixels: images of one place turned into each other as a view is made.

use std::path::Path;

use realitysim::evaluation::views::{Pair, pairs};

use super::field;

fn check(folder: &Path) -> Vec<Pair> {
    let pairs = pairs(folder, &field()).expect("images and lenses");
    for pair in &pairs {
        println!("{pair:?}");
        assert!(pair.gain_db >= 31.0 && pair.gain_ssim >= 0.93, "{pair:?}");
    }
    let mut gains: Vec<f64> = pairs.iter().map(|pair| pair.gain_db).collect();
    gains.sort_by(f64::total_cmp);
    assert!(gains[gains.len() / 2] >= 36.0, "median {}", gains[gains.len() / 2]);
    pairs
}

#[test]
fn shipped_images_are_seen_through_each_other() {
    assert_eq!(check(Path::new("tests/data/visualmesh")).len(), 8);
}

/// `REALITYSIM_VISUALMESH=folder` with all thirty images and the whole table.
#[test]
fn all_images_are_seen_through_each_other() {
    match std::env::var_os("REALITYSIM_VISUALMESH") {
        Some(folder) => assert_eq!(check(Path::new(&folder)).len(), 23),
        None => println!("skipped: REALITYSIM_VISUALMESH does not name a folder"),
    }
}
