//! Real images of the same place, turned into each other through the lens files: the proof that files, lenses and
//! rotations mean what they say, on pixels that this crate has not made.

mod tag;
mod warp;

use std::fs;
use std::path::Path;

use glam::DMat3;
use realitysim::config::{LensFile, LensWanted, parse_lens};
use realitysim::geometry::{Lens, LensParameters};

use warp::{Comparison, View};

/// One line of same_centre_pairs.csv: what NumPy and OpenCV measured.
struct Pair {
    source: u32,
    target: u32,
    overlap: usize,
    raw_db: f64,
    gain_db: f64,
    gain_bgr: [f64; 3],
}

#[test]
fn shipped_images_turn_into_each_other() {
    let pairs = pairs(Path::new("tests/data/visualmesh"));
    assert_eq!(pairs.len(), 8);
    compare(Path::new("tests/data/visualmesh"), &pairs);
}

/// `REALITYSIM_VISUALMESH=folder` with all thirty images and the whole table.
#[test]
fn all_images_turn_into_each_other() {
    let Some(folder) = std::env::var_os("REALITYSIM_VISUALMESH") else {
        println!("skipped: REALITYSIM_VISUALMESH does not name a folder");
        return;
    };
    let folder = Path::new(&folder);
    compare(folder, &pairs(folder));
}

fn compare(folder: &Path, pairs: &[Pair]) {
    println!("source target  overlap (table)    raw dB (table)  after gain dB (table)");
    for pair in pairs {
        let found = Comparison::new(&view(folder, pair.source), &view(folder, pair.target));
        println!(
            "{:6} {:6} {:8} ({:7}) {:6.2} ({:5.2}) {:12.2} ({:5.2})",
            pair.source,
            pair.target,
            found.overlap,
            pair.overlap,
            found.raw_db,
            pair.raw_db,
            found.gain_db,
            pair.gain_db
        );
        let name = format!("{} -> {}", pair.source, pair.target);
        assert!(found.overlap.abs_diff(pair.overlap) <= 20, "{name}: {} of {}", found.overlap, pair.overlap);
        assert!((found.raw_db - pair.raw_db).abs() < 0.05, "{name}: raw {} not {}", found.raw_db, pair.raw_db);
        assert!((found.gain_db - pair.gain_db).abs() < 0.1, "{name}: {} not {}", found.gain_db, pair.gain_db);
        for (rgb, bgr) in [(0, 2), (1, 1), (2, 0)] {
            assert!((found.gain_rgb[rgb] - pair.gain_bgr[bgr]).abs() < 0.002, "{name}: gains {:?}", found.gain_rgb);
        }
    }
}

fn pairs(folder: &Path) -> Vec<Pair> {
    let text = fs::read_to_string(folder.join("same_centre_pairs.csv")).expect("the table");
    let number = |text: &str| text.parse::<f64>().expect("a number");
    text.lines()
        .skip(1)
        .map(|line| {
            let cells: Vec<_> = line.split(',').collect();
            Pair {
                source: number(cells[0]) as u32,
                target: number(cells[1]) as u32,
                overlap: number(cells[2]) as usize,
                raw_db: number(cells[3]),
                gain_db: number(cells[4]),
                gain_bgr: [number(cells[7]), number(cells[8]), number(cells[9])],
            }
        })
        .collect()
}

fn view(folder: &Path, index: u32) -> View {
    let bytes = fs::read(folder.join(format!("image{index:07}.jpg"))).expect("an image");
    let image = image::load_from_memory(&bytes).expect("a JPEG").into_rgb8();
    let path = folder.join(format!("lens{index:07}.yaml"));
    let text = fs::read_to_string(&path).expect("a lens file");
    let wanted = LensWanted { camera: None, image_size: Some([image.width(), image.height()]) };
    let LensFile { lens, visual_mesh_pose, .. } =
        parse_lens(&text, &path.display().to_string(), wanted).expect("a good lens file");
    // The table keeps off the rim of the fisheye's circle.
    let stated = lens.parameters().fov_deg.expect("every file states it");
    let inner = LensParameters { fov_deg: Some(0.98 * stated), ..lens.parameters().clone() };
    let link = visual_mesh_pose.expect("every file has Hoc").world_from_camera_link;
    let optical = link * realitysim::geometry::Isometry::link_from_optical();
    let world_from_camera = DMat3::from_quat(optical.rotation);
    View { image, lens: Lens::new(inner).expect("a smaller view"), world_from_camera }
}
