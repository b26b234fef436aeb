//! The interface of view synthesis: requests, candidate images, results and errors.

use thiserror::Error;

use super::expected_error::expected_error_px;
use super::ground_warp::Warp;
use super::raster::{NOTHING, Pyramid, Raster, SURE};
use super::target_rays::Target;
use super::{Camera, Vignetting, World};
use realitysim_geometry::{Isometry, multiversioned};

/// A request for one view.
#[derive(Clone, Copy, Debug)]
pub struct Request<'a> {
    /// Lens of the wanted view.
    pub camera: &'a Camera,
    /// Pose of `camera_link` in `map`.
    pub map_from_link: Isometry,
    /// The method to use.
    pub method: Method,
    /// Known geometry.
    pub world: &'a World,
    /// Vignetting of the wanted lens.
    pub vignetting: Vignetting,
    /// Numbers of sources and distances that are allowed.
    pub settings: ViewSettings,
}

/// A method of making views.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Method {
    /// Maps through ground plane, goals and both lenses, taking the best source for each pixel.
    #[default]
    Exact,
    /// Warps the nearest image by a quadratic map, Eq. 3-4 of the paper.
    Paper,
    /// Returns the nearest image unchanged.
    Nearest,
}

/// Limits on the sources of a view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewSettings {
    /// Largest number of images that a view is made of.
    pub sources: usize,
    /// An image within this distance, in metres, and `stored_within_rad` is the answer itself.
    pub stored_within_m: f64,
    /// Largest angle, in radians, at which a stored image is the answer itself.
    pub stored_within_rad: f64,
    /// A request farther than this from the nearest image is refused, metres. If it is finite, exact views that show too
    /// little are refused as well; infinity accepts whatever there is.
    pub max_distance_m: f64,
}

impl Default for ViewSettings {
    fn default() -> Self {
        Self {
            sources: 4,
            stored_within_m: 0.005,
            stored_within_rad: 0.25f64.to_radians(),
            max_distance_m: f64::INFINITY,
        }
    }
}

/// A recorded image that a view may be made of.
#[derive(Clone, Copy, Debug)]
pub struct Candidate<'a> {
    /// Identifier of the caller's choice.
    pub id: u64,
    /// Lens that took the image.
    pub camera: &'a Camera,
    /// Pose of `camera_link` in `map`.
    pub map_from_link: Isometry,
    /// The image, of the camera's size.
    pub image: &'a Pyramid,
    /// Uncertainty of `map_from_link`.
    pub tag: TagError,
    /// Vignetting of the lens that took the image.
    pub vignetting: Vignetting,
}

/// Standard deviations of a tag.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TagError {
    /// Standard deviation of the position, metres.
    pub position_m: f64,
    /// Standard deviation of the orientation, radians.
    pub rotation_rad: f64,
}

/// The way in which a view came about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Provenance {
    /// A recorded image, unchanged, taken at the requested pose.
    Stored,
    /// A recorded image, unchanged, although it was taken elsewhere.
    Nearest,
    /// Made from one image.
    Warped,
    /// Made from several images.
    Composed,
}

/// A view and what is known about its quality.
#[derive(Clone, Debug, PartialEq)]
pub struct SynthesizedView {
    /// The pixels. The fourth channel is the mask: [`SURE`](super::SURE), [`UNSURE`](super::UNSURE) or [`NOTHING`](super::NOTHING).
    pub image: Raster,
    /// The way in which the view came about.
    pub made: Provenance,
    /// Pose of `camera_link` in `map`: as requested, or where an unchanged image was taken.
    pub map_from_link: Isometry,
    /// The images that appear in the view, nearest first.
    pub sources: Vec<UsedSource>,
    /// Share of the pixels drawn by the lens that show something.
    pub valid_share: f64,
    /// Share of the pixels drawn by the lens that show known geometry: ground or goal.
    pub sure_share: f64,
    /// Expected displacement of what is shown, root mean square in pixels, due to the errors of tags, of the ground's height and of the
    /// distance of what is beyond the ground, and to the map itself.
    pub expected_error_px: f64,
}

/// An image that appears in a view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UsedSource {
    /// Identifier of the [`Candidate`].
    pub id: u64,
    /// Distance from the requested position, metres.
    pub distance_m: f64,
    /// Angle between both orientations, radians.
    pub angle_rad: f64,
    /// Share of the view that the image contributes.
    pub share: f64,
}

/// The reason why there is no view.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ViewError {
    /// No candidate was given.
    #[error("there is no image to make a view from")]
    NoCandidates,
    /// The requested pose contains NaN or infinity.
    #[error("the pose asked for is not finite: give x, y, z in metres and yaw, pitch, roll in degrees")]
    NotFinite,
    /// The requested camera is too low or too high.
    #[error(
        "the camera asked for is {z:.3} m above the ground: views are made from {MIN_HEIGHT_M} to {MAX_HEIGHT_M} m"
    )]
    Height {
        /// Requested height, metres.
        z: f64,
    },
    /// The requested position is outside of the allowed range.
    #[error(
        "the camera asked for is at x = {x:.6}, y = {y:.6} m: views are made from -{MAX_PLACE_M} to {MAX_PLACE_M} m in both"
    )]
    Place {
        /// Requested x in `map`, metres.
        x: f64,
        /// Requested y in `map`, metres.
        y: f64,
    },
    /// The nearest image was taken too far away.
    #[error(
        "the nearest image was taken {distance_m:.2} m away, farther than the {max_m} m that are allowed: record \
         there, or allow more"
    )]
    TooFar {
        /// Distance to the nearest image, metres.
        distance_m: f64,
        /// Largest allowed distance, metres.
        max_m: f64,
    },
    /// The images show too little of the view.
    #[error(
        "images show {:.0} % of this view, less than the {:.0} % that an answer within a distance needs: record there, \
         looking that way, or take what there is (--outside warn; of the service, outside=warn)",
        100.0 * share,
        100.0 * MIN_SHOWN_SHARE
    )]
    TooLittle {
        /// Share of the view that they show.
        share: f64,
    },
    /// The images show nothing of the view.
    #[error("no image shows anything of this view")]
    NothingSeen,
    /// The quadratic map of [`Method::Paper`] cannot be fitted.
    #[error("the quadratic map cannot be fitted: {0}")]
    Fit(#[from] super::quadratic::FitError),
}

/// Smallest height of a requested camera, metres: below it, rays graze the ground.
pub const MIN_HEIGHT_M: f64 = 0.02;
/// Largest height of a requested camera, metres: no camera in a hall hangs higher.
pub const MAX_HEIGHT_M: f64 = 20.0;
/// Largest absolute x and y of a requested camera, metres: no hall is larger.
pub const MAX_PLACE_M: f64 = 100.0;
/// Largest absolute angle that a request may state, degrees: ten turns.
pub const MAX_TURN_DEG: f64 = 3600.0;
/// Default of the largest distance to the nearest image, metres. Beyond it a view is refused or carries a warning.
pub const FAR_M: f64 = 1.0;
/// Largest value that may be set for that distance, metres.
pub const MAX_FAR_M: f64 = 1000.0;
/// A view that shows a smaller share of what its lens draws carries a warning.
const MIN_TRUSTED_SHARE: f64 = 0.5;
/// A view that shows a smaller share is refused if a distance limit is set.
const MIN_SHOWN_SHARE: f64 = 0.25;
/// A view of which a smaller share is known geometry has no expected error: what little there is says nothing about the rest.
const MIN_SCORED_SHARE: f64 = 0.05;

/// Checks that a view can be requested from this pose of `camera_link`.
pub fn check_pose(map_from_link: &Isometry) -> Result<(), ViewError> {
    if !map_from_link.is_finite() {
        return Err(ViewError::NotFinite);
    }
    let glam::DVec3 { x, y, z } = map_from_link.translation;
    if x.abs().max(y.abs()) > MAX_PLACE_M {
        return Err(ViewError::Place { x, y });
    }
    if (MIN_HEIGHT_M..=MAX_HEIGHT_M).contains(&z) { Ok(()) } else { Err(ViewError::Height { z }) }
}

impl Request<'_> {
    pub(super) fn refuse_far(&self, nearest: &Candidate) -> Result<(), ViewError> {
        let distance_m = self.distance_m(&nearest.map_from_link);
        let max_m = self.settings.max_distance_m;
        if distance_m <= max_m { Ok(()) } else { Err(ViewError::TooFar { distance_m, max_m }) }
    }

    /// Refuses an exact view that shows too little: a near camera that looks elsewhere is no better than a far one.
    pub(super) fn refuse_sparse(&self, answer: SynthesizedView) -> Result<SynthesizedView, ViewError> {
        let share = answer.valid_share;
        let is_poor = self.settings.max_distance_m.is_finite() && share < MIN_SHOWN_SHARE;
        if is_poor { Err(ViewError::TooLittle { share }) } else { Ok(answer) }
    }

    fn distance_m(&self, map_from_link: &Isometry) -> f64 {
        self.map_from_link.translation.distance(map_from_link.translation)
    }

    /// Whether the candidate's image, taken with an equal lens at the same pose, is the answer.
    pub(super) fn is_stored_as(&self, candidate: &Candidate) -> bool {
        self.is_within(&candidate.map_from_link)
            && self.camera.lens().parameters().draws_as(candidate.camera.lens().parameters())
    }

    /// Whether an image taken at `map_from_link` is the answer itself, if its lens is the requested one.
    pub fn is_within(&self, map_from_link: &Isometry) -> bool {
        self.distance_m(map_from_link) <= self.settings.stored_within_m
            && angle_between(&self.map_from_link, map_from_link) <= self.settings.stored_within_rad
    }

    pub(super) fn used(&self, candidate: &Candidate, share: f64) -> UsedSource {
        UsedSource {
            id: candidate.id,
            distance_m: self.distance_m(&candidate.map_from_link),
            angle_rad: angle_between(&self.map_from_link, &candidate.map_from_link),
            share,
        }
    }
}

/// The angle of the rotation between two orientations, radians.
pub fn angle_between(a: &Isometry, b: &Isometry) -> f64 {
    let turn = a.rotation.conjugate() * b.rotation;
    2.0 * libm::atan2(turn.xyz().length(), turn.w.abs())
}

impl SynthesizedView {
    /// `expected_error_px`, or `None` if less than a twentieth of the view is known geometry.
    pub fn trusted_error_px(&self) -> Option<f64> {
        (self.sure_share >= MIN_SCORED_SHARE).then_some(self.expected_error_px)
    }

    /// The image of `source` as a view, unchanged.
    pub(super) fn unchanged(made: Provenance, request: &Request, source: &Candidate) -> Self {
        let image = source.image.full().clone();
        // A stored image is judged by the requested lens, even if its own picture ends earlier.
        let camera = if made == Provenance::Stored { request.camera } else { source.camera };
        let (valid_share, sure_share) = shares(camera, &image);
        let target = Target::new(request.camera, &request.map_from_link, request.world);
        let warp = Warp::new(&target, source);
        // Every point of the ground is shown where the source's camera saw it.
        let shift_px = if made == Provenance::Nearest { warp.rms_shift_px() } else { 0.0 };
        let expected_error_px = libm::hypot(shift_px, expected_error_px(&target, &warp, &source.tag));
        let (map_from_link, sources) = (source.map_from_link, vec![request.used(source, 1.0)]);
        Self { image, made, map_from_link, sources, valid_share, sure_share, expected_error_px }
    }

    /// A view warped from one source, whose map has this error in pixels (root mean square).
    pub(super) fn warped(request: &Request, source: &Candidate, image: Raster, map_error_px: f64) -> Self {
        let (valid_share, sure_share) = shares(request.camera, &image);
        let target = Target::new(request.camera, &request.map_from_link, request.world);
        let tag_error_px = expected_error_px(&target, &Warp::new(&target, source), &source.tag);
        let expected_error_px = libm::hypot(map_error_px, tag_error_px);
        let (map_from_link, sources) = (request.map_from_link, vec![request.used(source, 1.0)]);
        Self { image, made: Provenance::Warped, map_from_link, sources, valid_share, sure_share, expected_error_px }
    }

    /// A warning if all sources were taken farther away than `far_m` metres, or if they show little of the view.
    pub fn warning(&self, far_m: f64) -> Option<String> {
        let nearest_m = self.sources.iter().map(|source| source.distance_m).fold(f64::INFINITY, f64::min);
        match nearest_m > far_m {
            _ if self.sources.is_empty() => Some("no image shows anything of this view".to_owned()),
            true => Some(format!("the nearest image was taken {nearest_m:.2} m away, farther than {far_m} m")),
            false if self.valid_share < MIN_TRUSTED_SHARE => {
                Some(format!("images show {:.0} % of it only: they look elsewhere", 100.0 * self.valid_share))
            }
            false => None,
        }
    }

    /// Recomputes the shares after something was drawn over the image. `camera` is that of the image.
    pub fn recount(&mut self, camera: &Camera) {
        (self.valid_share, self.sure_share) = shares(camera, &self.image);
    }

    /// A view composed of several candidates.
    pub(super) fn composed(
        request: &Request,
        target: &Target,
        warps: &[Warp],
        candidates: &[Candidate],
        composed: super::compose::Composed,
    ) -> Result<Self, ViewError> {
        let super::compose::Composed { image, pixels } = composed;
        let all: f64 = pixels.iter().sum();
        let used: Vec<f64> = pixels.iter().map(|pixels| pixels / all.max(1e-9)).collect();
        let (valid_share, sure_share) = shares(request.camera, &image);
        if valid_share == 0.0 {
            return Err(ViewError::NothingSeen);
        }
        let squares = warps.iter().zip(&used).filter(|(_, share)| **share > 0.0).map(|(warp, share)| {
            let error = expected_error_px(target, warp, &warp.source().tag);
            share * error * error
        });
        let expected_error_px = libm::sqrt(squares.sum::<f64>());
        let sources: Vec<UsedSource> = candidates
            .iter()
            .zip(&used)
            .filter(|(_, share)| **share > 0.0)
            .map(|(candidate, share)| request.used(candidate, *share))
            .collect();
        let made = if sources.len() > 1 { Provenance::Composed } else { Provenance::Warped };
        let map_from_link = request.map_from_link;
        Ok(Self { image, made, map_from_link, sources, valid_share, sure_share, expected_error_px })
    }
}

/// Shares of the pixels drawn by the lens that show something and that are sure.
fn shares(camera: &Camera, image: &Raster) -> (f64, f64) {
    let shown = camera.shows();
    let [drawn, valid, sure] = multiversioned!(|shown: &[bool], image: &Raster| -> [f64; 3] {
        let (mut drawn, mut valid, mut sure) = (0u32, 0u32, 0u32);
        for (shows, pixel) in shown.iter().zip(&image.pixels) {
            let known = u32::from_le_bytes(*pixel) >> 24;
            drawn += u32::from(*shows);
            valid += u32::from(*shows & (known != u32::from(NOTHING)));
            sure += u32::from(*shows & (known == u32::from(SURE)));
        }
        [drawn, valid, sure].map(f64::from)
    });
    (valid / drawn.max(1.0), sure / drawn.max(1.0))
}
