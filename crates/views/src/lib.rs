//! Views: what the camera would have seen from a pose that was never recorded, made from images that were.
//!
//! Pure: poses, lenses and pixels in, pixels out. [`view`] is the method; which images are offered to it is for
//! [`realitysim_database`] to say. Every answer tells what it was made of and how far it can be trusted: [`SynthesizedView`].

mod camera;
mod compose;
mod coverage_mask;
mod dynamic_mask;
mod goal_check;
mod ground_warp;
mod occlusion_fill;
pub mod paper;
mod photometry;
pub mod quadratic;
mod raster;
mod sample;
mod similarity;
mod synthesized_view;
mod target_rays;
mod vignetting;
mod weights;
mod world;

pub use camera::Camera;
pub use coverage_mask::{CoverageMask, PlaceMask};
pub use dynamic_mask::{Scenery, mark_moving};
pub use goal_check::GoalBars;
pub use ground_warp::Warp;
pub use photometry::{Gain, Vignetting};
pub use raster::{NOTHING, Pyramid, Raster, SURE, UNSURE};
pub use similarity::{Similarity, similarity};
pub use synthesized_view::{
    Candidate, FAR_M, LEAST_HEIGHT_M, MAX_FAR_M, MAX_PLACE_M, MAX_TURN_DEG, MOST_HEIGHT_M, Method, Provenance, Request,
    SynthesizedView, TagError, UsedSource, ViewError, ViewSettings, angle_between, check_pose,
};
pub use target_rays::Target;
pub use vignetting::{Overlap, darkening, overlap};
pub use world::{Surface, World};

use realitysim_geometry::Isometry;

/// The view from `request.map_from_link`, made of the candidates, nearest first; images of another lens or size do.
///
/// ```text
/// stored   : the first candidate is near enough to be the answer itself
/// nearest  : the first candidate, unchanged
/// paper    : the first candidate through a quadratic map (Eq. 3-4), its holes filled by the reverse map
/// exact    : every candidate through ground, goals and both lenses; the best of them for each pixel
/// ```
pub fn view(request: &Request, candidates: &[Candidate]) -> Result<SynthesizedView, ViewError> {
    check_pose(&request.map_from_link)?;
    let nearest = candidates.first().ok_or(ViewError::NoCandidates)?;
    request.refuse_far(nearest)?;
    if request.is_stored_as(nearest) {
        return Ok(SynthesizedView::unchanged(Provenance::Stored, request, nearest));
    }
    match request.method {
        Method::Nearest => Ok(SynthesizedView::unchanged(Provenance::Nearest, request, nearest)),
        Method::Paper => paper::view(request, nearest),
        Method::Exact => {
            let chosen = &candidates[..candidates.len().min(request.settings.sources)];
            let target = Target::new(request.camera, &request.map_from_link, request.world);
            let warps: Vec<Warp> = chosen.iter().map(|source| Warp::new(&target, source)).collect();
            let gains = photometry::balance(&target, &warps, chosen);
            let mut composed = compose::compose(request, &target, &warps, chosen, &gains);
            if chosen.iter().any(|source| source.image.has_moving()) {
                occlusion_fill::fill(&mut composed, request, &target, &warps, chosen, &gains);
            }
            request.refuse_little(SynthesizedView::composed(request, &target, chosen, composed)?)
        }
    }
}

/// `map` from `camera_optical_frame` for a pose of `camera_link`.
fn optical(map_from_link: &Isometry) -> Isometry {
    *map_from_link * Isometry::link_from_optical()
}
