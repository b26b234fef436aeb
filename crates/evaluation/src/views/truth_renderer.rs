//! Renderer of the truth that views are judged by: a lawn with lines and goals, every pixel the mean of 4 x 4 exact
//! rays.
//!
//! The renderer of scenes filters by the footprint of a pixel, as a camera with soft optics would, and so makes
//! pictures that are easier to warp. Here a pixel is as sharp as possible, and the grass has blades of 2.5 mm.

use glam::{DMat3, DVec2, DVec3};

use realitysim_geometry::{Field, Isometry, Lens};
use realitysim_views::{NOTHING, Raster, SURE};

/// A camera on a lawn with the lines of a field.
#[derive(Clone, Debug)]
pub struct TruthRenderer {
    width: usize,
    height: usize,
    /// Unit rays in `camera_optical_frame`, [`RAYS`] squared for each pixel; NaN where the lens shows nothing.
    rays: Vec<[f32; 3]>,
    texture: Texture,
    /// Ends of the axes of goal posts and crossbars in `map`, metres.
    posts: Vec<[DVec3; 2]>,
    /// Radius of posts and crossbars, metres.
    post_radius: f64,
}

/// Colours of the carpet, seen from above.
#[derive(Clone, Debug)]
struct Texture {
    /// Number of texels along x.
    columns: usize,
    /// Half extent of the carpet, metres.
    half: DVec2,
    texels: Vec<[u8; 3]>,
}

/// Number of rays along each side of a pixel.
const RAYS: usize = 4;
/// Side of a texel, metres.
const TEXEL_M: f64 = 0.0025;
/// Cell size in texels and strength in percent of each octave of the noise.
const OCTAVES: [(usize, f64); 4] = [(2, 18.0), (6, 21.0), (24, 15.0), (96, 10.0)];
const GRASS: [f64; 3] = [62.0, 118.0, 58.0];
const PAINT: [f64; 3] = [225.0, 228.0, 225.0];
const POST: [f64; 3] = [240.0, 240.0, 240.0];

impl TruthRenderer {
    /// Prepares pictures of a field through a lens, with or without goals.
    pub fn new(field: &Field, lens: &Lens, goals: bool) -> Self {
        let (width, height) = (lens.width() as usize, lens.height() as usize);
        let mut rays = Vec::with_capacity(width * height * RAYS * RAYS);
        for v in 0..height {
            for u in 0..width {
                for sub in 0..RAYS * RAYS {
                    let off = |i: usize| (i as f64 + 0.5) / RAYS as f64 - 0.5;
                    let pixel = DVec2::new(u as f64 + off(sub % RAYS), v as f64 + off(sub / RAYS));
                    rays.push(lens.unproject(pixel).unwrap_or(DVec3::NAN).as_vec3().to_array());
                }
            }
        }
        let dimensions = field.dimensions();
        let mut posts = Vec::new();
        if let Some(goal) = dimensions.goal.filter(|_| goals) {
            for x in [-dimensions.length_m / 2.0, dimensions.length_m / 2.0] {
                let [left, right] = [-goal.width_m / 2.0, goal.width_m / 2.0];
                let at = |y, z| DVec3::new(x, y, z);
                posts.push([at(left, 0.0), at(left, goal.height_m)]);
                posts.push([at(right, 0.0), at(right, goal.height_m)]);
                posts.push([at(left, goal.height_m), at(right, goal.height_m)]);
            }
        }
        let post_radius = dimensions.goal.map_or(0.0, |goal| goal.post_diameter_m / 2.0);
        Self { width, height, rays, texture: Texture::new(field), posts, post_radius }
    }

    /// Renders the view from a pose of `camera_link` in `map`, and tells which pixels show nothing but the lawn.
    pub fn render(&self, map_from_link: &Isometry) -> (Raster, Vec<bool>) {
        let pose = *map_from_link * Isometry::link_from_optical();
        let (camera, rotation) = (pose.translation, DMat3::from_quat(pose.rotation));
        let mut image = Raster::black(self.width, self.height);
        let mut ground = vec![false; self.width * self.height];
        for (index, rays) in self.rays.chunks_exact(RAYS * RAYS).enumerate() {
            let (mut sum, mut on_lawn, mut seen) = ([0.0; 3], 0, 0);
            for [x, y, z] in rays {
                if x.is_nan() {
                    continue;
                }
                let ray = rotation * DVec3::new(f64::from(*x), f64::from(*y), f64::from(*z));
                let (colour, lawn) = self.colour(camera, ray);
                (0..3).for_each(|c| sum[c] += colour[c]);
                on_lawn += usize::from(lawn);
                seen += 1;
            }
            if seen == RAYS * RAYS {
                let [r, g, b] = sum.map(|sum| (sum / seen as f64 + 0.5) as u8);
                image.pixels[index] = [r, g, b, SURE];
            } else {
                image.pixels[index][3] = NOTHING;
            }
            ground[index] = on_lawn == RAYS * RAYS;
        }
        (image, ground)
    }

    /// Returns the colour that a ray meets, and whether that is the lawn.
    fn colour(&self, camera: DVec3, ray: DVec3) -> ([f64; 3], bool) {
        let to_ground = -camera.z / ray.z;
        let ground = (to_ground > 0.0).then_some(to_ground);
        let post = self.posts.iter().filter_map(|post| intersect_bar(*post, self.post_radius, camera, ray));
        if let Some(post) = post.min_by(f64::total_cmp)
            && ground.is_none_or(|ground| post < ground)
        {
            return (POST, false);
        }
        let place = ground.map(|distance| (camera + ray * distance).truncate());
        match place.and_then(|place| self.texture.at(place)) {
            Some(colour) => (colour, true),
            // Beyond the carpet there is a hall with soft stripes.
            None => {
                let around = libm::atan2(ray.y, ray.x);
                let light = 120.0 + 40.0 * libm::sin(14.0 * around) + 50.0 * ray.z;
                ([light, light, light + 12.0], false)
            }
        }
    }
}

/// Returns the distance along a ray to a round bar with flat ends; `None` if the ray misses it.
fn intersect_bar([from, to]: [DVec3; 2], radius: f64, camera: DVec3, ray: DVec3) -> Option<f64> {
    let axis = (to - from).normalize();
    let across = |v: DVec3| v - axis * v.dot(axis);
    let (d, o) = (across(ray), across(camera - from));
    let (a, b, c) = (d.length_squared(), d.dot(o), o.length_squared() - radius * radius);
    let root = b * b - a * c;
    if root < 0.0 || a < 1e-12 {
        return None;
    }
    let distance = (-b - libm::sqrt(root)) / a;
    let along = (camera + ray * distance - from).dot(axis);
    (distance > 0.0 && (-radius..=from.distance(to) + radius).contains(&along)).then_some(distance)
}

impl Texture {
    fn new(field: &Field) -> Self {
        let half = field.carpet_half_extent();
        let columns = (2.0 * half.x / TEXEL_M) as usize;
        let rows = (2.0 * half.y / TEXEL_M) as usize;
        let mut noise = vec![0.0f32; columns * rows];
        for (octave, (cell, strength)) in OCTAVES.into_iter().enumerate() {
            add_octave(&mut noise, columns, octave as u32, cell, strength);
        }
        let strokes = field.painted_strokes();
        let half_width = field.line_width() / 2.0;
        let texels = noise.iter().enumerate().map(|(index, noise)| {
            let place = DVec2::new((index % columns) as f64 + 0.5, (index / columns) as f64 + 0.5) * TEXEL_M - half;
            let off = strokes.iter().map(|stroke| stroke.distance(place)).fold(f64::INFINITY, f64::min);
            let paint = ((half_width - off) / TEXEL_M + 0.5).clamp(0.0, 1.0);
            let noise = f64::from(*noise);
            core::array::from_fn(|c| {
                let grass = GRASS[c] * (1.0 + noise / 100.0);
                let paint_here = PAINT[c] + 0.25 * noise;
                (grass + (paint_here - grass) * paint + 0.5).clamp(0.0, 255.0) as u8
            })
        });
        Self { columns, half, texels: texels.collect() }
    }

    /// Returns the bilinearly interpolated colour at a point in `map`; `None` off the carpet.
    fn at(&self, place: DVec2) -> Option<[f64; 3]> {
        let at = (place + self.half) / TEXEL_M - DVec2::splat(0.5);
        let rows = self.texels.len() / self.columns;
        if !(at.x >= 0.0 && at.y >= 0.0 && at.x < (self.columns - 1) as f64 && at.y < (rows - 1) as f64) {
            return None;
        }
        let (column, row) = (at.x as usize, at.y as usize);
        let (fx, fy) = (at.x - column as f64, at.y - row as f64);
        let start = row * self.columns + column;
        let [a, b] = [self.texels[start], self.texels[start + 1]];
        let [c, d] = [self.texels[start + self.columns], self.texels[start + self.columns + 1]];
        Some(core::array::from_fn(|i| {
            let [a, b, c, d] = [a, b, c, d].map(|texel| f64::from(texel[i]));
            (a * (1.0 - fx) + b * fx) * (1.0 - fy) + (c * (1.0 - fx) + d * fx) * fy
        }))
    }
}

/// Adds bilinear noise between lattice points; `strength` is its largest value.
fn add_octave(noise: &mut [f32], columns: usize, octave: u32, cell: usize, strength: f64) {
    let lattice = |x: usize, y: usize| hash_noise(x as u32, y as u32, octave) * strength as f32;
    for (index, value) in noise.iter_mut().enumerate() {
        let (column, row) = (index % columns, index / columns);
        let (x, y) = (column / cell, row / cell);
        let (fx, fy) = ((column % cell) as f32 / cell as f32, (row % cell) as f32 / cell as f32);
        let upper = lattice(x, y) * (1.0 - fx) + lattice(x + 1, y) * fx;
        let lower = lattice(x, y + 1) * (1.0 - fx) + lattice(x + 1, y + 1) * fx;
        *value += upper * (1.0 - fy) + lower * fy;
    }
}

/// Returns a hash of a lattice point, -1 to 1.
fn hash_noise(x: u32, y: u32, octave: u32) -> f32 {
    let mut h = x.wrapping_mul(0x9e37_79b1) ^ y.wrapping_mul(0x85eb_ca77) ^ octave.wrapping_mul(0xc2b2_ae3d);
    for _ in 0..2 {
        h = (h ^ (h >> 15)).wrapping_mul(0x2c1b_3c6d);
        h = (h ^ (h >> 12)).wrapping_mul(0x297a_2d39);
    }
    (h >> 8) as f32 / (1 << 23) as f32 - 1.0
}
