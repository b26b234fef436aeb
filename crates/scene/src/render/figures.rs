//! A scene's figures alone, for pictures that something else has made.

use glam::DMat3;

use super::super::Scene;
use super::crowd::CrowdView;
use super::posed_figure::View;
use super::rays::RayTable;
use realitysim_geometry::{Isometry, Lens};

/// Robots, people and balls of a scene before a lens of any kind. Making it takes some tens of milliseconds; it serves
/// any number of pictures.
#[derive(Clone, Debug)]
pub struct Figures {
    scene: Scene,
    rays: RayTable,
    crowd: CrowdView,
}

impl Figures {
    /// `None` if the scene places nobody.
    pub fn new(scene: &Scene, lens: &Lens) -> Option<Self> {
        let crowd = scene.crowd.as_ref()?;
        let rays = RayTable::new(lens);
        let crowd = CrowdView::new(crowd, &rays);
        Some(Self { scene: scene.clone(), rays, crowd })
    }

    /// Into R, G, B of the lens's size, as they stand in this frame and look by daylight, each with a soft shadow. `limit`
    /// gives for a pixel (column, row) how far along its ray, in metres, something stands that hides what is behind it;
    /// infinity if nothing does. Returns which pixels show a figure.
    pub fn draw(
        &self,
        frame: u64,
        map_from_camera_link: &Isometry,
        limit: impl Fn(usize, usize) -> f32,
        pixels: &mut [u8],
    ) -> Vec<bool> {
        let rotation = DMat3::from_quat(map_from_camera_link.rotation).to_cols_array().map(|value| value as f32);
        let camera = map_from_camera_link.translation.as_vec3().to_array();
        let view = View { rays: &self.rays, rotation: &rotation, camera: &camera, light: None };
        let rows = 0..self.rays.height();
        self.crowd.draw(self.scene.frame_time_s(frame), &view, &rows, limit, pixels)
    }
}
