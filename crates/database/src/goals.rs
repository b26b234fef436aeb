//! Whether goals stood where the field file has them when a source's images were taken.

use std::path::Path;

use super::catalogue::Source;
use super::error::DatabaseError;
use super::image_database::shown_by;
use super::pixels::{colours, read_bytes};
use super::record::Record;
use realitysim_geometry::{Field, FieldDimensions, Lens};
use realitysim_views::{Camera, GoalBars, Raster, World};

/// Images that are looked at, spread evenly over the source.
const MOST_IMAGES: usize = 80;
/// Fewer places along posts and crossbars say nothing.
const FEWEST_PLACES: u64 = 300;
/// Walls behind have edges too; before a bar somebody may stand, and a bar may be as bright as its wall.
const LEAST_STANDING: f64 = 0.4;

/// `None` if too little of them would be seen to tell.
pub(super) fn stand(
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
        let bytes = read_bytes(&source.file(record.file)?, record.offset, record.length).ok()?;
        let colours = colours(&bytes, record.form).ok()?;
        let raster = Raster::from_rgb(colours.width, colours.height, &colours.rgb, &shows)?;
        Some(GoalBars::seen(&camera, &record.pose(), &raster, &world))
    };
    let step = records.len().div_ceil(MOST_IMAGES).max(1);
    let seen = records.iter().step_by(step).filter_map(seen_in).fold(GoalBars::default(), |sum, seen| GoalBars {
        places: sum.places + seen.places,
        standing: sum.standing + seen.standing,
    });
    let stand = seen.standing as f64 >= LEAST_STANDING * seen.places as f64;
    Ok((seen.places >= FEWEST_PLACES).then_some(stand))
}
