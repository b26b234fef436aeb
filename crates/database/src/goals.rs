//! Finds out whether goals stood where the field file has them when a source's images were taken.

use std::path::Path;

use super::contents::Source;
use super::error::DatabaseError;
use super::image_database::shown_by;
use super::pixels::{colours, read_image};
use super::record::Record;
use realitysim_geometry::{Field, FieldDimensions, Lens};
use realitysim_views::{Camera, GoalBars, Raster, World};

/// Number of images that are looked at, spread evenly over the source.
const SAMPLED_IMAGES: usize = 80;
/// Fewest places along posts and crossbars for a decision.
const MIN_PLACES: u64 = 300;
/// Least share of these places that must show a bar. It is low because bars may be hidden or as bright as the wall behind,
/// and not 0 because walls have edges too.
const MIN_DETECTED_SHARE: f64 = 0.4;

/// Whether the images show goals; `None` if too few of the expected places are in view to tell.
pub(super) fn are_present(
    folder: &Path,
    source: &Source,
    records: &[Record],
    field: &FieldDimensions,
) -> Result<Option<bool>, DatabaseError> {
    let lens = Lens::new(source.lens.clone())
        .map_err(|error| DatabaseError::Lens { path: source.path.clone(), source: error })?;
    let field =
        Field::new(field.clone()).map_err(|error| DatabaseError::Field { path: source.path.clone(), source: error })?;
    let world = World::new(&field);
    let camera = Camera::new(&lens);
    let shows = shown_by(folder, source, &camera)?;
    let seen_in = |record: &Record| -> Option<GoalBars> {
        let bytes = read_image(&source.file(record.file)?, record).ok()?;
        let colours = colours(&bytes, record.form).ok()?;
        let raster = Raster::from_rgb(colours.width, colours.height, &colours.rgb, &shows)?;
        Some(GoalBars::seen(&camera, &record.pose(), &raster, &world))
    };
    let step = records.len().div_ceil(SAMPLED_IMAGES).max(1);
    let seen = records.iter().step_by(step).filter_map(seen_in).fold(GoalBars::default(), |sum, seen| GoalBars {
        places: sum.places + seen.places,
        detected: sum.detected + seen.detected,
    });
    let present = seen.detected as f64 >= MIN_DETECTED_SHARE * seen.places as f64;
    Ok((seen.places >= MIN_PLACES).then_some(present))
}
