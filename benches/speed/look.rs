//! From the picture to the ground table.

use glam::{DVec2, DVec3};
use realitysim::vision::Observations;
use realitysim::vision::ground::SIDE;

use super::measure::Bench;
use super::view::View;

pub fn run(bench: &mut Bench, view: &View) {
    let mut seen = Observations::default();
    bench.compare(
        "gray, contrast, border, table; only the table, lens at each cell",
        None,
        || through_the_lens(view),
        || view.vision.look_again(&view.picture, &view.footprint_from_optical, None, &mut seen),
    );
}

/// The pixel of every cell by the exact lens, and the nearest luma there: no contrast, no border, no levels.
fn through_the_lens(view: &View) -> u64 {
    let optical_from_footprint = view.footprint_from_optical.inverse();
    let cell = view.seen.table.cell_m();
    let place = |index: usize| (index as f64 + 0.5 - SIDE as f64 / 2.0) * cell;
    let mut sum = 0;
    for row in 0..SIDE {
        for column in 0..SIDE {
            let ground = DVec3::new(place(column), place(row), 0.0);
            let Some(pixel) = view.lens.project(optical_from_footprint.transform_point(ground)) else { continue };
            let DVec2 { x, y } = pixel.round();
            let inside =
                x >= 0.0 && y >= 0.0 && (x as usize) < view.picture.width && (y as usize) < view.picture.height;
            sum += if inside { u64::from(view.picture.luma[y as usize * view.picture.width + x as usize]) } else { 0 };
        }
    }
    sum
}
