//! The effects of a scene applied to a view that was made of recorded images.

use glam::DVec3;
use thiserror::Error;

use super::{Figures, Scene};
use realitysim_geometry::{Field, Lens};
use realitysim_views::{Camera, SURE, SynthesizedView, World};

/// Applies a scene to views through one lens: it draws the figures of the scene, then light and noise over the image.
#[derive(Clone, Debug)]
pub struct ViewOverlay {
    scene: Scene,
    figures: Option<Figures>,
}

/// The figures of a scene stand on another field than the one in the images.
#[derive(Clone, Debug, Error, PartialEq)]
#[error(
    "the scene's figures stand on the field {scene:?}, and the images were taken on {images:?}: leave the figures out, or \
     name that field in the scene"
)]
pub struct StageError {
    scene: String,
    images: String,
}

impl ViewOverlay {
    /// Prepares the overlay for views through `lens`. If `figures` is false, the figures of the scene are left out.
    pub fn new(scene: &Scene, lens: &Lens, figures: bool) -> Self {
        let figures = if figures { Figures::new(scene, lens) } else { None };
        Self { scene: scene.clone(), figures }
    }

    /// Checks that the images show the field of the scene, because its figures have positions on that field.
    pub fn check(&self, images: &Field) -> Result<(), StageError> {
        let [scene, images] = [self.scene.field(), images].map(Field::dimensions);
        if self.figures.is_none() || scene.is_same_as(images) {
            return Ok(());
        }
        Err(StageError { scene: scene.title.clone(), images: images.title.clone() })
    }

    /// Names of the effects that the overlay applies.
    pub fn effects(&self) -> Vec<&'static str> {
        match self.figures {
            Some(_) => self.scene.effects_on_views(),
            None => self.scene.effects_on_images().0,
        }
    }

    /// Applies the effects to a view as if it were frame `frame` of the scene.
    ///
    /// `camera` has the lens that the overlay was made for. `world` is the one that the view was made with: its goals
    /// hide figures that stand behind them. Returns the distance of each pixel's figure along its ray, metres: infinity
    /// where there is none, and nothing at all if no figures are drawn.
    pub fn apply(&self, frame: u64, camera: &Camera, world: &World, answer: &mut SynthesizedView) -> Vec<f32> {
        if self.effects().is_empty() {
            return Vec::new();
        }
        let mut rgb = answer.image.to_rgb();
        let distances_m = self.figures.as_ref().map_or_else(Vec::new, |figures| {
            let pose = answer.map_from_link;
            let optical = pose * realitysim_geometry::Isometry::link_from_optical();
            let goals = world.goals_seen_from(pose.translation);
            let limit = |column: usize, row: usize| {
                let ray: Option<DVec3> = camera.ray(column, row).map(|ray| optical.transform_vector(ray));
                ray.and_then(&goals).map_or(f32::INFINITY, |distance| distance as f32)
            };
            figures.draw(frame, &pose, limit, &mut rgb)
        });
        self.scene.apply_to_image(frame, &mut rgb);
        for (pixel, rgb) in answer.image.pixels.iter_mut().zip(rgb.as_chunks::<3>().0) {
            pixel[..3].copy_from_slice(rgb);
        }
        for (pixel, distance_m) in answer.image.pixels.iter_mut().zip(&distances_m) {
            // A pixel that shows a figure is certain.
            if distance_m.is_finite() {
                pixel[3] = SURE;
            }
        }
        answer.recount(camera);
        distances_m
    }
}
