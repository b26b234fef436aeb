//! View synthesis: the image that a camera would have taken from a pose at which no image was recorded.
//!
//! [`view`] makes a [`SynthesizedView`] for a [`Request`] out of recorded images, the [`Candidate`]s. A caller, such as
//! `realitysim_database`, chooses the candidates. Each result says which images it was made of and how far it can be
//! trusted. A [`Camera`] is a lens with the rays of its pixels, a [`World`] the known geometry (ground and goals), a
//! [`Target`] what the rays of the wanted view meet, and a [`Warp`] the map from the wanted view into one source image.
//! [`depth_m`] says how far each pixel of a view lies,
//! [`mark_moving`] masks robots and people in a recorded image, and [`darkening`] measures a lens's vignetting.
//!
//! The crate is pure: poses, lenses and pixels go in, pixels come out. The methods are described in `docs/explanation/views.md`.
//!
//! ```rust
//! use realitysim_geometry::{Euler, Field, Isometry};
//! use realitysim_views::*;
//!
//! let camera = Camera::new(&realitysim_config::load_lens("fisheye-640")?.lens);
//! let world = World::new(&Field::new(realitysim_config::load_field("kid-2020")?)?);
//! let at = |x| Isometry::from_euler(Euler { yaw: 0.0, pitch: 0.5, roll: 0.0 }, glam::DVec3::new(x, 0.0, 0.5));
//! // One recorded image, all gray, taken at x = 0 m; the view is wanted at x = 0.2 m.
//! let (width, height) = (camera.width(), camera.height());
//! let gray = vec![90; 3 * width * height];
//! let image = Pyramid::new(Raster::from_rgb(width, height, &gray, camera.shows()).expect("sizes agree"));
//! let (tag, vignetting, settings) = (TagError::default(), Vignetting::default(), ViewSettings::default());
//! let source = Candidate { id: 7, camera: &camera, map_from_link: at(0.0), image: &image, tag, vignetting };
//! let request =
//!     Request { camera: &camera, map_from_link: at(0.2), method: Method::Exact, world: &world, vignetting, settings };
//! let answer = view(&request, &[source])?;
//! assert_eq!((answer.made, answer.sources[0].id), (Provenance::Warped, 7));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod camera;
mod compose;
mod coverage_mask;
mod depth;
mod dynamic_mask;
mod expected_error;
mod figure_board;
mod figures;
mod goal_check;
mod ground_warp;
mod hall;
mod hall_fit;
mod moved_blocks;
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
pub use depth::depth_m;
pub use dynamic_mask::{Scenery, mark_moving};
pub use figures::Figures;
pub use goal_check::GoalBars;
pub use ground_warp::Warp;
pub use hall::Hall;
pub use hall_fit::{HallFit, HallImage, fit_hall};
pub use moved_blocks::{BlockImage, block_grid, moved_blocks};
pub use photometry::{Gain, Vignetting};
pub use raster::{NOTHING, Pyramid, Raster, SURE, UNSURE, luma};
pub use similarity::{Similarity, similarity};
pub use synthesized_view::{
    Candidate, FAR_M, MAX_FAR_M, MAX_HEIGHT_M, MAX_PLACE_M, MAX_TURN_DEG, MIN_HEIGHT_M, Method, Provenance, Request,
    SynthesizedView, TagError, UsedSource, ViewError, ViewSettings, angle_between, check_pose,
};
pub use target_rays::Target;
pub use vignetting::{Overlap, darkening, overlap};
pub use world::{Surface, World};

use realitysim_geometry::Isometry;

/// Makes the view that `request` asks for out of the candidates, which are ordered from the nearest to the farthest.
///
/// Candidates may differ from the request in lens and image size. The result depends on the method:
///
/// ```text
/// stored   : the first candidate is near enough to be the answer itself
/// nearest  : the first candidate, unchanged
/// paper    : the first candidate through a quadratic map (Eq. 3-4), its holes filled by the reverse map
/// exact    : every candidate through ground, goals and both lenses; the best of them for each pixel
/// ```
///
/// # Errors
///
/// A [`ViewError`] if the pose is out of range, there is no candidate, the nearest one is too far away, too little or
/// nothing of the view is shown, or the quadratic map cannot be fitted.
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
            request.refuse_sparse(SynthesizedView::composed(request, &target, &warps, chosen, composed)?)
        }
    }
}

/// `map_from_camera_optical_frame` for a pose of `camera_link` in `map`.
fn optical(map_from_link: &Isometry) -> Isometry {
    *map_from_link * Isometry::link_from_optical()
}
