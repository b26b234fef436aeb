//! Measures how a source's lens darkens its images towards the border, from the images themselves.

use std::path::Path;

use super::contents::Source;
use super::error::DatabaseError;
use super::image_database::shown_by;
use super::pixels::{colours, read_image};
use super::record::Record;
use realitysim_geometry::{Field, FieldDimensions, Lens};
use realitysim_views::{
    Camera, Candidate, Overlap, Pyramid, Raster, Scenery, Vignetting, World, angle_between, darkening, mark_moving,
    overlap,
};

/// Number of pairs of images that are compared.
const PAIRS: usize = 24;
/// Fewest images of a source. With fewer, the darkening of the lens cannot be told from the brightness of the ground.
const MIN_IMAGES: usize = 8;
/// Number of images considered as the partner of one image.
const PARTNERS: usize = 400;
/// Rotation between the images of a pair. The same ground must lie at another radius and still be in view.
const BETWEEN_RAD: core::ops::RangeInclusive<f64> = 0.2..=1.4;
/// Distance below which the images of a pair must lie.
const PAIR_DISTANCE_M: f64 = 1.0;
/// Distance above which the images of a pair need not differ in rotation.
const AHEAD_M: f64 = 0.35;

/// The coefficients k1 to k3 of the source's vignetting, or `None` if they cannot be measured.
///
/// `records` are those of the source, in the order of their files.
pub(super) fn measure(
    folder: &Path,
    source: &Source,
    records: &[Record],
    field: &FieldDimensions,
) -> Result<Option<[f64; 3]>, DatabaseError> {
    if records.len() < MIN_IMAGES {
        return Ok(None);
    }
    let lens = Lens::new(source.lens.clone())
        .map_err(|error| DatabaseError::Lens { path: source.path.clone(), source: error })?;
    let field =
        Field::new(field.clone()).map_err(|error| DatabaseError::Field { path: source.path.clone(), source: error })?;
    let camera = Camera::new(&lens);
    let shows = shown_by(folder, source, &camera)?;
    let world = World::without_goals(&field);
    let image = |record: &Record| -> Option<Pyramid> {
        let bytes = read_image(&source.file(record.file)?, record).ok()?;
        let colours = colours(&bytes, record.form).ok()?;
        let mut raster = Raster::from_rgb(colours.width, colours.height, &colours.rgb, &shows)?;
        let (map_from_link, tag) = (record.pose(), record.tag());
        mark_moving(
            &mut raster,
            &Scenery { camera: &camera, map_from_link, tag, field: &field, world: &world, moved: None },
        );
        Some(Pyramid::new(raster))
    };
    let pair = |(first, second): (&Record, &Record)| -> Option<Vec<Overlap>> {
        let images = [image(first)?, image(second)?];
        let candidate = |record: &Record, which: usize| Candidate {
            id: 0,
            camera: &camera,
            map_from_link: record.pose(),
            image: &images[which],
            tag: record.tag(),
            vignetting: Vignetting::default(),
        };
        Some(overlap(&candidate(first, 0), &candidate(second, 1), &world))
    };
    let pairs: Vec<Vec<Overlap>> = partners(records).into_iter().filter_map(pair).collect();
    Ok(darkening(&pairs).map(|vignetting| vignetting.k))
}

/// Pairs of images: one of several spread evenly over the source, and one that shows the same ground at other radii.
fn partners(records: &[Record]) -> Vec<(&Record, &Record)> {
    let count = records.len();
    let pair = |which: usize| {
        let first = &records[(2 * which + 1) * count / (2 * PAIRS)];
        let pose = first.pose();
        let others = (0..PARTNERS.min(count)).map(|step| &records[step * count / PARTNERS.min(count)]);
        let cost = |other: &Record| {
            let place = other.pose();
            let (apart_m, turned) = (place.translation.distance(pose.translation), angle_between(&place, &pose));
            let differs = BETWEEN_RAD.contains(&turned) || apart_m > AHEAD_M;
            // The best partner is turned by 0.6 rad and near.
            (differs && apart_m < PAIR_DISTANCE_M && turned < *BETWEEN_RAD.end())
                .then(|| apart_m + (turned - 0.6).abs())
        };
        let best = others.filter_map(|other| Some((cost(other)?, other))).min_by(|a, b| a.0.total_cmp(&b.0));
        best.map(|(_, second)| (first, second))
    };
    (0..PAIRS.min(count)).filter_map(pair).collect()
}
