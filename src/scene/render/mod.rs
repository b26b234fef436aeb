//! What the camera sees: textured carpet with painted lines, the hall's floor, walls and ceiling, whoever stands
//! there. No goals.
//!
//! One ray per pixel, known from the lens once and for all; per frame the rays are turned and met with the ground.
//! Everything is filtered by the pixel's footprint, so that nothing shimmers and lines stay exact below a pixel.

mod body;
mod crowd;
mod fixed;
mod footprint;
mod hall;
mod light;
mod lines;
mod placed;
mod rays;
mod shape;
mod sheet;
mod solid;
mod surface;
mod tile;
mod tiles;
mod wear;

use glam::DMat3;

use super::Scene;
use crate::geometry::Isometry;
use crowd::CrowdView;
use fixed::byte;
use footprint::{GroundRow, Turned};
use light::lit;
use placed::View;
use rays::RayTable;
use surface::World;
use wear::Wear;

/// Can be shared between threads: rendering changes nothing.
#[derive(Clone, Debug)]
pub struct Renderer {
    scene: Scene,
    rays: RayTable,
    world: World,
    crowd: Option<CrowdView>,
}

impl Renderer {
    /// Takes a moment: it prepares rays and textures.
    pub fn new(scene: &Scene) -> Self {
        let rays = RayTable::new(scene.lens());
        let seed = scene.file().scene.seed;
        let wear = scene.worn_lines.as_ref().map(|effect| Wear::new(effect, seed));
        let world = World::new(scene.field(), wear, seed);
        let crowd = scene.crowd.as_ref().map(|crowd| CrowdView::new(crowd, &rays));
        Self { scene: scene.clone(), rays, world, crowd }
    }

    pub fn width(&self) -> u32 {
        self.rays.width() as u32
    }

    pub fn height(&self) -> u32 {
        self.rays.height() as u32
    }

    /// The frame of this index as the camera delivers it: RGB, rows from the top, no padding.
    /// `pixels` is resized to fit. Black is where the lens sees nothing.
    pub fn render(&self, index: u64, pixels: &mut Vec<u8>) {
        let truth = self.scene.truth(self.scene.frame_time_s(index));
        self.render_from(&truth.map_from_camera_link, index, pixels);
    }

    /// As if the frame of this index had been taken from another pose.
    pub fn render_from(&self, map_from_camera_link: &Isometry, index: u64, pixels: &mut Vec<u8>) {
        self.render_clean(map_from_camera_link, index, pixels);
        if let Some(noise) = &self.scene.noise {
            noise.apply(index, pixels);
        }
    }

    /// What reaches the sensor, without the sensor's own effects.
    pub fn render_clean(&self, map_from_camera_link: &Isometry, index: u64, pixels: &mut Vec<u8>) {
        let width = self.rays.width();
        pixels.resize(width * self.rays.height() * 3, 0);
        let rotation = DMat3::from_quat(map_from_camera_link.rotation).to_cols_array().map(|value| value as f32);
        let camera = map_from_camera_link.translation.as_vec3();
        // From inside the ground nothing could be seen; a pose there is nonsense, but must not harm.
        let camera = [camera.x, camera.y, camera.z.max(1e-3)];
        let view = View { rays: &self.rays, rotation: &rotation, camera: &camera, light: self.scene.light.as_ref() };
        self.draw_hall(&view, pixels);
        if let Some(crowd) = &self.crowd {
            crowd.draw(self.scene.frame_time_s(index), &view, pixels);
        }
    }

    fn draw_hall(&self, view: &View, pixels: &mut [u8]) {
        let width = self.rays.width();
        // Copies: what stands elsewhere might change with every pixel written, for all that the compiler knows.
        let (rotation, camera) = (*view.rotation, *view.camera);
        let [mut above, mut here, mut below] = core::array::from_fn(|_| Turned::new(width));
        let mut ground = GroundRow::new(width);
        here.turn(&self.rays, 0, &rotation);
        below.turn(&self.rays, 1, &rotation);
        for (row, line) in pixels.chunks_exact_mut(width * 3).enumerate() {
            core::mem::swap(&mut above, &mut here);
            core::mem::swap(&mut here, &mut below);
            below.turn(&self.rays, row + 2, &rotation);
            ground.meet(&above, &here, &below, &camera);
            let seen = self.rays.seen(row);
            line[..seen.start * 3].fill(0);
            line[seen.end * 3..].fill(0);
            for (column, pixel) in seen.clone().zip(line[seen.start * 3..seen.end * 3].chunks_exact_mut(3)) {
                let ray = here.direction(column);
                let colour = self.world.colour(&camera, ray, &ground, column);
                let colour = lit(view.light, colour, || self.world.hall.end_of(&camera, ray));
                pixel[0] = byte(colour[0]);
                pixel[1] = byte(colour[1]);
                pixel[2] = byte(colour[2]);
            }
        }
    }
}
