//! Rendering of camera images: textured carpet with painted lines, floor, walls and ceiling of the hall, and figures.
//! Goals are not drawn.
//!
//! The lens gives one ray per pixel, computed once. For each frame the rays are rotated and intersected with the ground.
//! Textures and lines are filtered by the footprint of the pixel. So nothing shimmers, and lines are exact below a pixel.

mod body;
mod crowd;
mod figures;
mod fixed;
mod footprint;
mod hall;
mod light;
mod lines;
mod macro_texture;
mod posed_figure;
mod rays;
mod shape;
mod solid;
mod surface;
mod tile;
mod tiles;
mod turf;
mod wear;
mod window;

use core::ops::Range;

use glam::DMat3;

use super::Scene;
use super::effects::{LightModel, Shutter};
use super::per_frame::Changing;
use crowd::CrowdView;
pub use figures::Figures;
use fixed::byte;
use footprint::{GroundRow, Turned};
use light::illuminate;
use posed_figure::View;
use rays::RayTable;
use realitysim_geometry::Isometry;
use surface::{GroundEffects, World};
use turf::{Sunlight, TurfLook};
use wear::Wear;
use window::Window;

/// The state of camera and light at one moment of a frame.
struct Shot<'a> {
    /// `map_from_camera_link`.
    pose: Isometry,
    /// Seconds since the scene's start.
    time: f64,
    light: Option<&'a LightModel>,
    window: Option<&'a Window>,
}

/// Step of the numerical derivative of the camera's rotation, seconds. It is shorter than any exposure that shows motion blur.
const DIFFERENCE_S: f64 = 1e-3;

/// Renders the camera images of a scene. It can be shared between threads, because rendering changes nothing in it.
#[derive(Clone, Debug)]
pub struct Renderer {
    scene: Scene,
    rays: RayTable,
    world: World,
    crowd: Option<CrowdView>,
}

impl Renderer {
    /// Prepares rays and textures, which takes a moment.
    pub fn new(scene: &Scene) -> Self {
        let rays = RayTable::new(scene.lens());
        let seed = scene.file().scene.seed;
        let wear = scene.worn_lines.as_ref().map(|effect| Wear::new(effect, seed));
        let turf = scene.turf.as_ref().map(|effect| TurfLook::new(effect, seed));
        let sun = scene.sun_patches.as_ref().map(|effect| Sunlight::new(effect, seed));
        let world = World::new(scene.field(), GroundEffects { turf, wear, sun }, seed);
        let crowd = scene.crowd.as_ref().map(|crowd| CrowdView::new(crowd, &rays));
        Self { scene: scene.clone(), rays, world, crowd }
    }

    /// Width of the images, pixels.
    pub fn width(&self) -> u32 {
        self.rays.width() as u32
    }

    /// Height of the images, pixels.
    pub fn height(&self) -> u32 {
        self.rays.height() as u32
    }

    /// Renders frame `index` as the camera delivers it: RGB, rows from the top, no padding.
    ///
    /// `pixels` is resized to fit. Pixels outside the view of the lens are black.
    pub fn render(&self, index: u64, pixels: &mut Vec<u8>) {
        let truth = self.scene.truth(self.scene.frame_time_s(index));
        self.render_from(&truth.map_from_camera_link, index, pixels);
    }

    /// Renders frame `index` as if it had been taken from another pose.
    pub fn render_from(&self, map_from_camera_link: &Isometry, index: u64, pixels: &mut Vec<u8>) {
        let now = self.scene.at_frame(index);
        self.expose(&now, map_from_camera_link, index, pixels);
        if let Some(noise) = &now.noise {
            noise.apply(index, pixels);
        }
        if let Some(processing) = &self.scene.image_processing {
            processing.apply(self.rays.width(), pixels);
        }
    }

    /// Renders frame `index` from a pose without the effects of the sensor: no noise and no image processing.
    pub fn render_clean(&self, map_from_camera_link: &Isometry, index: u64, pixels: &mut Vec<u8>) {
        self.expose(&self.scene.at_frame(index), map_from_camera_link, index, pixels);
    }

    /// Renders a frame with all effects up to the exposure.
    fn expose(&self, now: &Changing, map_from_camera_link: &Isometry, index: u64, pixels: &mut Vec<u8>) {
        let (width, height) = (self.rays.width(), self.rays.height());
        pixels.resize(width * height * 3, 0);
        let window = now.window.as_ref().map(|window| Window::new(window, self.world.hall.half));
        let time = self.scene.frame_time_s(index);
        let shot = Shot { pose: *map_from_camera_link, time, light: now.light.as_ref(), window: window.as_ref() };
        let veil = match &now.shutter {
            None => self.draw(&shot, 0..height, pixels),
            Some(shutter) => self.expose_bands(shutter, &shot, pixels),
        };
        window::add_veil(pixels, veil);
        if let Some(optics) = &self.scene.optics {
            let lens = self.scene.lens().parameters();
            optics.apply(width, [lens.cx, lens.cy], pixels);
        }
        if let Some(hunting) = &self.scene.exposure_hunting {
            hunting.apply(time, pixels);
        }
    }

    /// Renders the empty hall by daylight, as a baseline for the cost of effects.
    ///
    /// Only the effects on the ground (turf, worn lines, sun patches) are kept.
    pub fn render_bare(&self, map_from_camera_link: &Isometry, pixels: &mut Vec<u8>) {
        let (width, height) = (self.rays.width(), self.rays.height());
        pixels.resize(width * height * 3, 0);
        let rotation = DMat3::from_quat(map_from_camera_link.rotation).to_cols_array().map(|value| value as f32);
        let camera = map_from_camera_link.translation.as_vec3().to_array();
        let view = View { rays: &self.rays, rotation: &rotation, camera: &camera, light: None };
        self.draw_hall(&view, 0..height, pixels);
    }

    /// Draws some rows at one moment. Returns the image value that the lens scatters over the whole picture.
    fn draw(&self, shot: &Shot, rows: Range<usize>, pixels: &mut [u8]) -> f32 {
        let rotation = DMat3::from_quat(shot.pose.rotation).to_cols_array().map(|value| value as f32);
        let camera = shot.pose.translation.as_vec3();
        // A camera below the ground makes no sense, but must not break anything.
        let camera = [camera.x, camera.y, camera.z.max(1e-3)];
        let view = View { rays: &self.rays, rotation: &rotation, camera: &camera, light: shot.light };
        let stride = self.rays.width() * 3;
        let own = &mut pixels[rows.start * stride..rows.end * stride];
        self.draw_hall(&view, rows.clone(), own);
        let veil = shot.window.map_or(0.0, |window| window.draw(&view, rows.clone(), own));
        if let Some(crowd) = &self.crowd {
            crowd.draw(shot.time, &view, &rows, |_, _| f32::INFINITY, pixels);
        }
        veil
    }

    /// Draws every band of rows as the mean of several pictures during its exposure. Returns the mean scattered value.
    fn expose_bands(&self, shutter: &Shutter, shot: &Shot, pixels: &mut [u8]) -> f32 {
        let (height, stride) = (self.rays.height(), self.rays.width() * 3);
        let time = shot.time;
        let truth = self.scene.truth(time);
        let asked_from_true = shot.pose * truth.map_from_camera_link.inverse();
        let pixel_speed = self.angular_speed(time) * self.scene.lens().parameters().fx;
        let mut sums = vec![0u16; height * stride];
        let (mut veil, mut bands) = (0.0, 0);
        for band in shutter.bands(height) {
            let sums = &mut sums[..band.len() * stride];
            sums.fill(0);
            let mut count = 0u16;
            for offset in shutter.sample_times(&band, height, pixel_speed) {
                let at = time + offset;
                let pose = asked_from_true * self.scene.truth(at).map_from_camera_link;
                veil += self.draw(&Shot { pose, time: at, ..*shot }, band.clone(), pixels);
                let drawn = &pixels[band.start * stride..band.end * stride];
                sums.iter_mut().zip(drawn).for_each(|(sum, value)| *sum += u16::from(*value));
                count += 1;
                bands += 1;
            }
            let mean = &mut pixels[band.start * stride..band.end * stride];
            mean.iter_mut().zip(&*sums).for_each(|(value, sum)| *value = ((*sum + count / 2) / count) as u8);
        }
        veil / bands.max(1) as f32
    }

    /// Angular speed of the camera at `time`, rad/s.
    fn angular_speed(&self, time: f64) -> f64 {
        let [before, after] =
            [-DIFFERENCE_S, DIFFERENCE_S].map(|step| self.scene.truth(time + step).map_from_camera_link);
        let turned = before.rotation.conjugate() * after.rotation;
        // The length of the vector part is the sine of half the angle, which is exact for small angles.
        let half = libm::asin(turned.xyz().length().min(1.0));
        2.0 * half / (2.0 * DIFFERENCE_S)
    }

    /// Draws some rows of the hall with its ground. `pixels` holds these rows only.
    fn draw_hall(&self, view: &View, rows: Range<usize>, pixels: &mut [u8]) {
        let width = self.rays.width();
        // Local copies, because the compiler cannot know that writing a pixel does not change the originals.
        let (rotation, camera) = (*view.rotation, *view.camera);
        let [mut above, mut here, mut below] = core::array::from_fn(|_| Turned::new(width));
        let mut ground = GroundRow::new(width);
        here.turn(&self.rays, rows.start, &rotation);
        below.turn(&self.rays, rows.start + 1, &rotation);
        for (row, line) in rows.zip(pixels.chunks_exact_mut(width * 3)) {
            core::mem::swap(&mut above, &mut here);
            core::mem::swap(&mut here, &mut below);
            below.turn(&self.rays, row + 2, &rotation);
            ground.meet(&above, &here, &below, &camera);
            let seen = self.rays.visible_columns(row);
            line[..seen.start * 3].fill(0);
            line[seen.end * 3..].fill(0);
            for (column, pixel) in seen.clone().zip(line[seen.start * 3..seen.end * 3].chunks_exact_mut(3)) {
                let ray = here.direction(column);
                let colour = self.world.colour(&camera, ray, &ground, column);
                let colour = illuminate(view.light, colour, || self.world.hall.end_of(&camera, ray));
                pixel[0] = byte(colour[0]);
                pixel[1] = byte(colour[1]);
                pixel[2] = byte(colour[2]);
            }
        }
    }
}
