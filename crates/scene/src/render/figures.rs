//! Drawing of the figures of a scene onto images that something else has made.

use glam::DMat3;

use super::super::Scene;
use super::crowd::CrowdView;
use super::posed_figure::View;
use super::rays::RayTable;
use realitysim_geometry::{Isometry, Lens};

/// The figures of a scene (robots, people, balls), prepared for drawing through any lens.
///
/// Preparation takes some tens of milliseconds and serves any number of images.
#[derive(Clone, Debug)]
pub struct Figures {
    scene: Scene,
    rays: RayTable,
    crowd: CrowdView,
}

impl Figures {
    /// Prepares the figures for `lens`. `None` if the scene has no figures.
    pub fn new(scene: &Scene, lens: &Lens) -> Option<Self> {
        let crowd = scene.crowd.as_ref()?;
        let rays = RayTable::new(lens);
        let crowd = CrowdView::new(crowd, &rays);
        Some(Self { scene: scene.clone(), rays, crowd })
    }

    /// Draws the figures of frame `frame` by daylight, each with a soft shadow, into RGB pixels of the size of the lens.
    ///
    /// `limit` gives for a pixel (column, row) the distance along its ray, metres, at which something hides what is behind
    /// it, or infinity. Returns for each pixel the distance along its ray, metres, of the figure that it shows, or
    /// infinity.
    pub fn draw(
        &self,
        frame: u64,
        map_from_camera_link: &Isometry,
        limit: impl Fn(usize, usize) -> f32,
        pixels: &mut [u8],
    ) -> Vec<f32> {
        let rotation = DMat3::from_quat(map_from_camera_link.rotation).to_cols_array().map(|value| value as f32);
        let camera = map_from_camera_link.translation.as_vec3().to_array();
        let view = View { rays: &self.rays, rotation: &rotation, camera: &camera, light: None };
        let rows = 0..self.rays.height();
        self.crowd.draw(self.scene.frame_time_s(frame), &view, &rows, limit, pixels)
    }
}
