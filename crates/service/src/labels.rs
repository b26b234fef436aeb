//! The class of each pixel of a view.

use realitysim_database::{ImageDatabase, ViewResult};
use realitysim_labels::{Labeller, PoseCovariance, PosedImage};
use realitysim_views::{NOTHING, Provenance};

/// Returns the classes as the numbers of [`Class`](realitysim_labels::Class), row by row.
///
/// A pixel is ignored if a figure is drawn there (`figures_m` is its distance, infinite where there is none), if the view does not know
/// what it shows, or if it is so near to an edge that the expected error of the view hides the side.
pub(super) fn labels(database: &ImageDatabase, shown: &ViewResult, figures_m: &[f32]) -> Vec<u8> {
    let mut mask = shown.answer.image.mask();
    let drawn = mask.iter_mut().zip(figures_m).filter(|(_, figure_m)| figure_m.is_finite());
    drawn.for_each(|(mask, _)| *mask = NOTHING);
    let error_rad = shown.answer.trusted_error_px().unwrap_or(0.0) / shown.camera.lens().parameters().fx;
    let image = PosedImage {
        camera: &shown.camera,
        map_from_link: shown.answer.map_from_link,
        covariance: PoseCovariance::isotropic(0.0, error_rad),
        shown: &mask,
        body: own_body(database, shown, mask.len()),
    };
    let labeller = Labeller::new(database.field(), database.world().has_goals());
    labeller.classes(&image).into_iter().map(|class| class as u8).collect()
}

/// Returns which pixels show the robot that took the image, if the view is that image; it is cut out of all others.
fn own_body<'a>(database: &'a ImageDatabase, shown: &ViewResult, pixels: usize) -> &'a [bool] {
    let is_unchanged = matches!(shown.answer.made, Provenance::Stored | Provenance::Nearest);
    let source = shown.answer.sources.first().filter(|_| is_unchanged);
    let body = source.map_or(&[][..], |used| database.body(database.index().record(used.id as usize).source));
    if body.len() == pixels { body } else { &[] }
}
