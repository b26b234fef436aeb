//! Labels of a view.

use realitysim_database::{ImageDatabase, ViewResult};
use realitysim_labels::{Labeller, PoseCovariance, PosedImage};
use realitysim_views::{NOTHING, Provenance};

/// A view, and what its labels are made of.
///
/// A pixel is ignored if a figure is drawn there, if the view does not know what it shows, or if it is so near to an edge that the
/// expected error of the view hides the side.
#[derive(Clone, Debug)]
pub struct LabelledView<'a> {
    shown: &'a ViewResult,
    labeller: Labeller,
    covariance: PoseCovariance,
    mask: Vec<u8>,
    body: &'a [bool],
}

impl<'a> LabelledView<'a> {
    /// A view of a database. `figures_m` is the distance of the figure that is drawn at each pixel, infinite where there is none; it may
    /// be empty.
    pub fn new(database: &'a ImageDatabase, shown: &'a ViewResult, figures_m: &[f32]) -> Self {
        let mut mask = shown.answer.image.mask();
        let drawn = mask.iter_mut().zip(figures_m).filter(|(_, figure_m)| figure_m.is_finite());
        drawn.for_each(|(mask, _)| *mask = NOTHING);
        let error_rad = shown.answer.trusted_error_px().unwrap_or(0.0) / shown.camera.lens().parameters().fx;
        Self {
            shown,
            labeller: Labeller::new(database.field(), database.world().has_goals()),
            covariance: PoseCovariance::isotropic(0.0, error_rad),
            body: own_body(database, shown, mask.len()),
            mask,
        }
    }

    /// What labels its landmarks and pixels.
    pub fn labeller(&self) -> &Labeller {
        &self.labeller
    }

    /// The view with its pose, as [`Self::labeller`] needs it.
    pub fn posed_image(&self) -> PosedImage<'_> {
        PosedImage {
            camera: &self.shown.camera,
            map_from_link: self.shown.answer.map_from_link,
            covariance: self.covariance,
            shown: &self.mask,
            body: self.body,
        }
    }

    /// The classes of its pixels as the numbers of [`Class`](realitysim_labels::Class), row by row.
    pub fn class_numbers(&self) -> Vec<u8> {
        self.labeller.classes(&self.posed_image()).into_iter().map(|class| class as u8).collect()
    }
}

/// Returns which pixels show the robot that took the image, if the view is that image; it is cut out of all others.
fn own_body<'a>(database: &'a ImageDatabase, shown: &ViewResult, pixels: usize) -> &'a [bool] {
    let is_unchanged = matches!(shown.answer.made, Provenance::Stored | Provenance::Nearest);
    let source = shown.answer.sources.first().filter(|_| is_unchanged);
    let body = source.map_or(&[][..], |used| database.body(database.index().record(used.id as usize).source));
    if body.len() == pixels { body } else { &[] }
}
