//! Finds the hall in which a source's images were taken, and that of a whole database.

use std::path::Path;

use super::contents::Source;
use super::error::DatabaseError;
use super::image_database::shown_by;
use super::pixels::{colours, read_image};
use super::record::Record;
use realitysim_geometry::{Field, FieldDimensions, Lens};
use realitysim_views::{Camera, Hall, HallImage, Raster, Scenery, World, fit_hall, mark_moving};

/// Number of images that are looked at, spread evenly over the source.
const SAMPLED_IMAGES: usize = 36;
/// Distances of one plane that differ by no more than this share are of the same hall.
const SAME_PLANE_SHARE: f64 = 0.1;
/// Directions of walls that differ by no more than this, in radians, are of the same hall.
const SAME_YAW_RAD: f64 = 0.06;

/// The planes of the hall that a source's images determine.
pub(super) fn measure(
    folder: &Path,
    source: &Source,
    records: &[Record],
    field: &FieldDimensions,
) -> Result<Hall, DatabaseError> {
    let lens = Lens::new(source.lens.clone())
        .map_err(|error| DatabaseError::Lens { path: source.path.clone(), source: error })?;
    let field =
        Field::new(field.clone()).map_err(|error| DatabaseError::Field { path: source.path.clone(), source: error })?;
    let world = World::without_goals(&field);
    let camera = Camera::new(&lens);
    let shows = shown_by(folder, source, &camera)?;
    let image = |record: &Record| -> Option<HallImage> {
        let bytes = read_image(&source.file(record.file)?, record).ok()?;
        let colours = colours(&bytes, record.form).ok()?;
        let mut raster = Raster::from_rgb(colours.width, colours.height, &colours.rgb, &shows)?;
        let (map_from_link, tag) = (record.pose(), record.tag());
        mark_moving(
            &mut raster,
            &Scenery { camera: &camera, map_from_link, tag, field: &field, world: &world, moved: None },
        );
        Some(HallImage::new(&camera, &map_from_link, &raster))
    };
    let step = records.len().div_ceil(SAMPLED_IMAGES).max(1);
    let images: Vec<HallImage> = records.iter().step_by(step).filter_map(image).collect();
    Ok(fit_hall(&images, world.ground_half()).hall)
}

/// The hall of a database: that of the source with the most planes, with planes that only others know, and without those on which
/// they disagree. Sources of halls that are turned otherwise know none of each other's walls.
pub(super) fn common(sources: &[Source]) -> Hall {
    let known = |hall: &Hall| hall.walls_m.iter().flatten().count() + usize::from(hall.ceiling_m.is_some());
    let Some(mut common) = sources.iter().map(|source| source.hall).max_by_key(known) else { return Hall::default() };
    for hall in sources.iter().map(|source| source.hall).filter(|hall| !hall.is_unknown()) {
        if (hall.yaw_rad - common.yaw_rad).abs() > SAME_YAW_RAD {
            return Hall::default();
        }
        for (ours, theirs) in common.walls_m.iter_mut().zip(hall.walls_m) {
            *ours = merged(*ours, theirs);
        }
        common.ceiling_m = merged(common.ceiling_m, hall.ceiling_m);
    }
    common
}

/// One plane as two sources know it; `None` if they disagree.
fn merged(ours: Option<f64>, theirs: Option<f64>) -> Option<f64> {
    match (ours, theirs) {
        (Some(ours), Some(theirs)) => ((ours - theirs).abs() <= SAME_PLANE_SHARE * ours).then_some(ours),
        (ours, theirs) => ours.or(theirs),
    }
}
