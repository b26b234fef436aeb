//! The paper's method: the forward map moves every pixel of the nearest image into the view, and pixels that none reaches
//! are read through the reverse map.

use glam::{DVec2, DVec3};

use super::quadratic::Quadratic;
use super::raster::{NOTHING, Raster, SURE, UNSURE};
use super::sample::read;
use super::synthesized_view::{Candidate, Request, SynthesizedView, ViewError};
use super::target_rays::Target;
use super::world::{Surface, World};
use super::{Camera, optical};
use realitysim_geometry::Isometry;

/// Choice of the common points of the ground for the fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Correspondences {
    /// A square grid on the field. The ground near the camera gets few points.
    OnGround {
        /// Distance between neighbouring points, metres.
        spacing_m: f64,
    },
    /// Points under a square grid of the source's pixels. Every part of the image counts the same.
    InImage {
        /// Distance between neighbouring points, pixels.
        spacing_px: usize,
    },
}

/// The choice of points in the paper.
pub const PAPER: Correspondences = Correspondences::OnGround { spacing_m: 0.25 };
/// Ground farther away than this many camera heights is left out: it is a streak below the horizon.
const RANGE_LIMIT_HEIGHTS: f64 = 30.0;

/// A camera at a pose.
#[derive(Clone, Copy, Debug)]
pub struct Posed<'a> {
    /// The lens.
    pub camera: &'a Camera,
    /// Pose of `camera_link` in `map`.
    pub map_from_link: Isometry,
}

/// Makes the view that `request` asks for from `source` by two quadratic maps.
pub(super) fn view(request: &Request, source: &Candidate) -> Result<SynthesizedView, ViewError> {
    let from = Posed { camera: source.camera, map_from_link: source.map_from_link };
    let to = Posed { camera: request.camera, map_from_link: request.map_from_link };
    let pairs = correspondences(&from, &to, request.world, PAPER);
    let forward = Quadratic::fit(&pairs)?;
    let reverse = Quadratic::fit(&pairs.iter().map(|(from, to)| (*to, *from)).collect::<Vec<_>>())?;
    let mut image = Raster::black(to.camera.width(), to.camera.height());
    splat(&mut image, source, &forward);
    fill(&mut image, source, &reverse);
    let target = Target::new(to.camera, &to.map_from_link, request.world);
    for (index, pixel) in image.pixels.iter_mut().enumerate() {
        // The map is fitted to the ground: everything else is a guess.
        match target.surface(index % to.camera.width(), index / to.camera.width()) {
            None => *pixel = [0, 0, 0, NOTHING],
            Some(Surface::Ground) => {}
            Some(_) => pixel[3] = pixel[3].min(UNSURE),
        }
    }
    Ok(SynthesizedView::warped(request, source, image, forward.residual().rms_px))
}

/// Pairs of pixels, of the source and of the wanted view, that show the same point of the ground.
pub fn correspondences(from: &Posed, to: &Posed, world: &World, how: Correspondences) -> Vec<(DVec2, DVec2)> {
    let (from_pose, to_pose) = (optical(&from.map_from_link), optical(&to.map_from_link));
    let drawn = |posed: &Posed, pose: &Isometry, place: DVec3| {
        posed.camera.projector().project_inside(pose.inverse().transform_point(place))
    };
    let pair = |place: DVec3| Some((drawn(from, &from_pose, place)?, drawn(to, &to_pose, place)?));
    match how {
        Correspondences::OnGround { spacing_m } => {
            let half = world.ground_half();
            let count = (2.0 * half / spacing_m).floor();
            let place = |x: usize, y: usize| {
                let place = DVec2::new(x as f64 - count.x / 2.0, y as f64 - count.y / 2.0) * spacing_m;
                place.extend(0.0)
            };
            let places = (0..=count.x as usize).flat_map(|x| (0..=count.y as usize).map(move |y| (x, y)));
            places.filter_map(|(x, y)| pair(place(x, y))).collect()
        }
        Correspondences::InImage { spacing_px } => {
            let camera = from.camera;
            let background = world.background_from(from_pose.translation);
            let rows = (0..camera.height()).step_by(spacing_px);
            let pixels = rows.flat_map(|v| (0..camera.width()).step_by(spacing_px).map(move |u| (u, v)));
            let place = |(u, v): (usize, usize)| {
                let ray = from_pose.transform_vector(camera.ray(u, v)?);
                let hit = background.hit(ray);
                let near = hit.inverse_distance * from_pose.translation.z * RANGE_LIMIT_HEIGHTS > 1.0;
                let on_ground = near && hit.surface == Surface::Ground;
                on_ground.then(|| (from_pose.translation + ray / hit.inverse_distance).with_z(0.0))
            };
            pixels.filter_map(place).filter_map(pair).collect()
        }
    }
}

/// Copies each sure pixel of the source to the nearest pixel of the view.
fn splat(image: &mut Raster, source: &Candidate, forward: &Quadratic) {
    let full = source.image.full();
    for (index, pixel) in full.pixels.iter().enumerate().filter(|(_, pixel)| pixel[3] == SURE) {
        let to = forward.apply(DVec2::new((index % full.width) as f64, (index / full.width) as f64)).round();
        if to.x >= 0.0 && to.y >= 0.0 && to.x < image.width as f64 && to.y < image.height as f64 {
            image.pixels[to.y as usize * image.width + to.x as usize] = *pixel;
        }
    }
}

/// Reads pixels that are still empty through the reverse map.
fn fill(image: &mut Raster, source: &Candidate, reverse: &Quadratic) {
    let width = image.width;
    for (index, pixel) in image.pixels.iter_mut().enumerate().filter(|(_, pixel)| pixel[3] == NOTHING) {
        let from = reverse.apply(DVec2::new((index % width) as f64, (index / width) as f64));
        let read = read(source.image.full(), from.x as f32, from.y as f32);
        if read[3] == SURE {
            *pixel = read;
        }
    }
}
