//! What is asked for, what it is made from, and what the answer says of itself.

use thiserror::Error;

use super::ground_warp::Warp;
use super::raster::{NOTHING, Pyramid, Raster, SURE};
use super::target_rays::Target;
use super::{Camera, Vignetting, World};
use realitysim_geometry::{Isometry, multiversioned};

/// The camera asked for.
#[derive(Clone, Copy, Debug)]
pub struct Request<'a> {
    pub camera: &'a Camera,
    /// `camera_link` in `map`.
    pub map_from_link: Isometry,
    pub method: Method,
    pub world: &'a World,
    /// How the wanted lens darkens its image towards the border.
    pub vignetting: Vignetting,
    pub settings: ViewSettings,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Method {
    /// Ground plane and goals through both lenses, the best source for each pixel.
    #[default]
    Exact,
    /// A quadratic map from the nearest image, Eq. 3-4 of the paper.
    Paper,
    /// The nearest image as it is.
    Nearest,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewSettings {
    /// At most so many images make a view.
    pub sources: usize,
    /// An image this near is the answer itself.
    pub stored_within_m: f64,
    pub stored_within_rad: f64,
    /// Farther from the nearest image the request is refused.
    /// Exact views that show little are refused with it, too; infinite: whatever there is.
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

/// A recorded image that may serve.
#[derive(Clone, Copy, Debug)]
pub struct Candidate<'a> {
    /// The caller's own.
    pub id: u64,
    pub camera: &'a Camera,
    /// `camera_link` in `map`.
    pub map_from_link: Isometry,
    /// Of the camera's size.
    pub image: &'a Pyramid,
    pub tag: TagError,
    pub vignetting: Vignetting,
}

/// Standard deviation of a tag.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TagError {
    pub position_m: f64,
    pub rotation_rad: f64,
}

/// How an answer came about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Provenance {
    /// A recorded image, unchanged: it was taken where the request is.
    Stored,
    /// A recorded image, unchanged, though it was taken elsewhere.
    Nearest,
    /// From one image.
    Warped,
    /// From several.
    Composed,
}

#[derive(Clone, Debug, PartialEq)]
pub struct SynthesizedView {
    /// Its fourth channel is the mask of what is sure.
    pub image: Raster,
    pub made: Provenance,
    /// Where its camera stands: as asked, or where the image was taken if it is unchanged.
    pub map_from_link: Isometry,
    /// Those that show in it, nearest first.
    pub sources: Vec<UsedSource>,
    /// Share of the pixels which the lens draws that show something.
    pub valid_share: f64,
    /// Share of them that show known geometry: ground or goal.
    pub sure_share: f64,
    /// How far from its right place, in pixels (root mean square), known geometry is expected to be shown; by the tags'
    /// errors and the map's own.
    pub expected_error_px: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UsedSource {
    pub id: u64,
    /// From the pose asked for.
    pub distance_m: f64,
    /// Between both orientations.
    pub angle_rad: f64,
    /// Of the view.
    pub share: f64,
}

#[derive(Clone, Debug, Error, PartialEq)]
pub enum ViewError {
    #[error("there is no image to make a view from")]
    NoCandidates,
    #[error("the pose asked for is not finite: give x, y, z in metres and yaw, pitch, roll in degrees")]
    NotFinite,
    #[error(
        "the camera asked for is {z:.3} m above the ground: views are made from {LEAST_HEIGHT_M} to {MOST_HEIGHT_M} m"
    )]
    Height { z: f64 },
    #[error(
        "the camera asked for is at x = {x:.6}, y = {y:.6} m: views are made from -{MAX_PLACE_M} to {MAX_PLACE_M} m in both"
    )]
    Place { x: f64, y: f64 },
    #[error(
        "the nearest image was taken {distance_m:.2} m away, farther than the {max_m} m that are allowed: record \
         there, or allow more"
    )]
    TooFar { distance_m: f64, max_m: f64 },
    #[error(
        "images show {:.0} % of this view, less than the {:.0} % that an answer within a distance needs: record there, \
         looking that way, or take what there is (--outside warn; of the service, outside=warn)",
        100.0 * share,
        100.0 * LEAST
    )]
    TooLittle { share: f64 },
    #[error("no image shows anything of this view")]
    NothingSeen,
    #[error("the quadratic map cannot be fitted: {0}")]
    Fit(#[from] super::quadratic::FitError),
}

/// Lower, rays graze the ground.
pub const LEAST_HEIGHT_M: f64 = 0.02;
/// No camera in a hall hangs higher.
pub const MOST_HEIGHT_M: f64 = 20.0;
/// The largest x and y, whoever asks: no hall is larger.
pub const MAX_PLACE_M: f64 = 100.0;
/// The largest angle, whoever asks: ten turns.
pub const MAX_TURN_DEG: f64 = 3600.0;
/// All images farther away than this: there is no view, or a doubtful one, unless somebody says otherwise.
pub const FAR_M: f64 = 1.0;
/// The largest distance to the nearest image that somebody may allow.
pub const MAX_FAR_M: f64 = 1000.0;
/// An answer that shows less of what its lens draws is to be doubted.
const LITTLE: f64 = 0.5;
/// One that shows less than this is none, where a distance is allowed for.
const LEAST: f64 = 0.25;
/// Of a map that is interpolated on a grid, root mean square.
const GRID_ERROR_PX: f64 = 0.04;

/// Whether a view can be asked for from this pose of `camera_link` at all.
pub fn check_pose(map_from_link: &Isometry) -> Result<(), ViewError> {
    if !map_from_link.is_finite() {
        return Err(ViewError::NotFinite);
    }
    let glam::DVec3 { x, y, z } = map_from_link.translation;
    if x.abs().max(y.abs()) > MAX_PLACE_M {
        return Err(ViewError::Place { x, y });
    }
    if (LEAST_HEIGHT_M..=MOST_HEIGHT_M).contains(&z) { Ok(()) } else { Err(ViewError::Height { z }) }
}

impl Request<'_> {
    pub(super) fn refuse_far(&self, nearest: &Candidate) -> Result<(), ViewError> {
        let distance_m = self.distance_m(&nearest.map_from_link);
        let max_m = self.settings.max_distance_m;
        if distance_m <= max_m { Ok(()) } else { Err(ViewError::TooFar { distance_m, max_m }) }
    }

    /// Near by, and looking elsewhere, is no better than far away.
    pub(super) fn refuse_little(&self, answer: SynthesizedView) -> Result<SynthesizedView, ViewError> {
        let share = answer.valid_share;
        let is_poor = self.settings.max_distance_m.is_finite() && share < LEAST;
        if is_poor { Err(ViewError::TooLittle { share }) } else { Ok(answer) }
    }

    fn distance_m(&self, map_from_link: &Isometry) -> f64 {
        self.map_from_link.translation.distance(map_from_link.translation)
    }

    pub(super) fn is_stored_as(&self, candidate: &Candidate) -> bool {
        self.is_within(&candidate.map_from_link)
            && self.camera.lens().parameters().draws_as(candidate.camera.lens().parameters())
    }

    /// Whether an image taken there is the answer, if its lens is the one asked for.
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

/// The angle of the rotation from one orientation to the other, radians.
pub fn angle_between(a: &Isometry, b: &Isometry) -> f64 {
    let turn = a.rotation.conjugate() * b.rotation;
    2.0 * libm::atan2(turn.xyz().length(), turn.w.abs())
}

impl SynthesizedView {
    /// `expected_error_px`, where there is known geometry that it can be said of.
    pub fn expected_error_of_known_px(&self) -> Option<f64> {
        (self.sure_share > 0.0).then_some(self.expected_error_px)
    }

    pub(super) fn unchanged(made: Provenance, request: &Request, source: &Candidate) -> Self {
        let image = source.image.full().clone();
        // Of what was asked for, also where the source's own picture ends before it.
        let camera = if made == Provenance::Stored { request.camera } else { source.camera };
        let (valid_share, sure_share) = shares(camera, &image);
        let error = match made {
            // Each place is shown where the source's camera had it.
            Provenance::Nearest => {
                let target = Target::new(request.camera, &request.map_from_link, request.world);
                Warp::new(&target, source).rms_shift_px()
            }
            _ => 0.0,
        };
        let expected_error_px = libm::hypot(error, Nearness::of(request).tag_error_px(&source.tag));
        let (map_from_link, sources) = (source.map_from_link, vec![request.used(source, 1.0)]);
        Self { image, made, map_from_link, sources, valid_share, sure_share, expected_error_px }
    }

    pub(super) fn warped(request: &Request, source: &Candidate, image: Raster, map_error_px: f64) -> Self {
        let (valid_share, sure_share) = shares(request.camera, &image);
        let expected_error_px = libm::hypot(map_error_px, Nearness::of(request).tag_error_px(&source.tag));
        let (map_from_link, sources) = (request.map_from_link, vec![request.used(source, 1.0)]);
        Self { image, made: Provenance::Warped, map_from_link, sources, valid_share, sure_share, expected_error_px }
    }

    /// Why it is to be doubted: all of its images were taken farther away than `far_m`, or they show little of it.
    pub fn warning(&self, far_m: f64) -> Option<String> {
        let nearest_m = self.sources.iter().map(|source| source.distance_m).fold(f64::INFINITY, f64::min);
        match nearest_m > far_m {
            _ if self.sources.is_empty() => Some("no image shows anything of this view".to_owned()),
            true => Some(format!("the nearest image was taken {nearest_m:.2} m away, farther than {far_m} m")),
            false if self.valid_share < LITTLE => {
                Some(format!("images show {:.0} % of it only: they look elsewhere", 100.0 * self.valid_share))
            }
            false => None,
        }
    }

    /// Counts anew what is shown, after something was drawn over it. `camera` is the picture's.
    pub fn recount(&mut self, camera: &Camera) {
        (self.valid_share, self.sure_share) = shares(camera, &self.image);
    }

    pub(super) fn composed(
        request: &Request,
        target: &Target,
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
        let nearness = Nearness::new(request.camera, target.ground_corners());
        let squares = candidates.iter().zip(&used).map(|(source, share)| {
            let error = nearness.tag_error_px(&source.tag);
            share * error * error
        });
        let expected_error_px = libm::sqrt(squares.sum::<f64>() + GRID_ERROR_PX * GRID_ERROR_PX);
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

/// Of the pixels that the lens draws: those that show something, and those that are sure.
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

/// How near the ground in view is: what a tag's error means in pixels.
struct Nearness {
    focal: f64,
    /// 1/m^2, over the ground in view.
    mean_square: f64,
}

impl Nearness {
    fn of(request: &Request) -> Self {
        let map_from_optical = super::optical(&request.map_from_link);
        let place = map_from_optical.translation;
        let turn = glam::DMat3::from_quat(map_from_optical.rotation);
        let rays = request.camera.node_rays().iter().filter(|ray| !ray.x.is_nan());
        let hits = rays.map(|ray| request.world.behind_goals(place, turn * *ray));
        Self::new(request.camera, hits.filter_map(|hit| hit.on_ground()))
    }

    /// By inverse distances along rays that meet the ground, 1/m.
    fn new(camera: &Camera, inverse_distances: impl Iterator<Item = f64>) -> Self {
        let (mut sum, mut count) = (0.0, 0usize);
        inverse_distances.for_each(|inverse| {
            sum += inverse * inverse;
            count += 1;
        });
        Self { focal: camera.lens().focal(), mean_square: sum / count.max(1) as f64 }
    }

    /// How far a tag that is wrong by its standard deviation moves the ground, root mean square.
    fn tag_error_px(&self, tag: &TagError) -> f64 {
        let square = tag.rotation_rad * tag.rotation_rad + tag.position_m * tag.position_m * self.mean_square;
        self.focal * libm::sqrt(square)
    }
}
