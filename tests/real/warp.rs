//! Turns one image into another taken from the same point, and says how alike they are; the recipe is in
//! tests/data/visualmesh/README.md.

use glam::{DMat3, DVec2};
use image::RgbImage;
use realitysim::geometry::Lens;

pub struct View {
    pub image: RgbImage,
    pub lens: Lens,
    /// From `camera_optical_frame`.
    pub world_from_camera: DMat3,
}

pub struct Comparison {
    pub overlap: usize,
    pub raw_db: f64,
    pub gain_db: f64,
    pub gain_rgb: [f64; 3],
}

/// Pixels kept from the edge of the overlap.
const MARGIN: i64 = 2;

impl Comparison {
    pub fn new(source: &View, target: &View) -> Self {
        let warped = erode(&warp(source, target), target.lens.width());
        let pairs: Vec<([f64; 3], [f64; 3])> = warped
            .iter()
            .zip(target.image.pixels())
            .filter_map(|(warped, wanted)| Some(((*warped)?, wanted.0.map(f64::from))))
            .collect();
        let gain_rgb = [0, 1, 2].map(|c| {
            let product: f64 = pairs.iter().map(|(a, b)| a[c] * b[c]).sum();
            let square: f64 = pairs.iter().map(|(a, _)| a[c] * a[c]).sum();
            product / square
        });
        Self {
            overlap: pairs.len(),
            raw_db: psnr(&pairs, |_, value| value),
            gain_db: psnr(&pairs, |c, value| (gain_rgb[c] * value).min(255.0).floor()),
            gain_rgb,
        }
    }
}

/// The source as the target's camera would have seen it, pixel by pixel of the target; `None` without overlap.
fn warp(source: &View, target: &View) -> Vec<Option<[f64; 3]>> {
    let source_from_target = source.world_from_camera.transpose() * target.world_from_camera;
    let (width, height) = target.image.dimensions();
    (0..height)
        .flat_map(|v| (0..width).map(move |u| DVec2::new(f64::from(u), f64::from(v))))
        .map(|pixel| {
            let ray = target.lens.unproject(pixel)?;
            let there = source.lens.project(source_from_target * ray)?;
            source.lens.contains(there).then(|| bilinear(&source.image, there))
        })
        .collect()
}

/// Rounded to 8 bit.
fn bilinear(image: &RgbImage, at: DVec2) -> [f64; 3] {
    let base = at.floor();
    let (u, v) = (base.x as u32, base.y as u32);
    let pixel = |du: u32, dv: u32| image.get_pixel((u + du).min(image.width() - 1), (v + dv).min(image.height() - 1));
    let (fx, fy) = (at.x - base.x, at.y - base.y);
    let [a, b, c, d] = [pixel(0, 0), pixel(1, 0), pixel(0, 1), pixel(1, 1)];
    [0, 1, 2].map(|i| {
        let [a, b, c, d] = [a, b, c, d].map(|p| f64::from(p.0[i]));
        ((a * (1.0 - fx) + b * fx) * (1.0 - fy) + (c * (1.0 - fx) + d * fx) * fy).round()
    })
}

/// Drops what is near a pixel without overlap; outside of the image is not such a pixel.
fn erode(pixels: &[Option<[f64; 3]>], width: u32) -> Vec<Option<[f64; 3]>> {
    let width = i64::from(width);
    let height = pixels.len() as i64 / width;
    let near = |at: i64, end: i64| (at - MARGIN).max(0)..=(at + MARGIN).min(end - 1);
    // Along the rows first, then along the columns: together the square.
    let all = |mask: &[bool], u: i64, v: i64, (du, dv): (bool, bool)| {
        let columns = if du { near(u, width) } else { u..=u };
        let rows = if dv { near(v, height) } else { v..=v };
        rows.into_iter().all(|v| columns.clone().all(|u| mask[(v * width + u) as usize]))
    };
    let places = || (0..height).flat_map(|v| (0..width).map(move |u| (u, v)));
    let full: Vec<_> = pixels.iter().map(Option::is_some).collect();
    let rows: Vec<_> = places().map(|(u, v)| all(&full, u, v, (true, false))).collect();
    let both = places().map(|(u, v)| all(&rows, u, v, (false, true)));
    pixels.iter().zip(both).map(|(pixel, keep)| pixel.filter(|_| keep)).collect()
}

fn psnr(pairs: &[([f64; 3], [f64; 3])], change: impl Fn(usize, f64) -> f64) -> f64 {
    let squares: f64 = pairs.iter().map(|(a, b)| (0..3).map(|c| (change(c, a[c]) - b[c]).powi(2)).sum::<f64>()).sum();
    10.0 * (255.0 * 255.0 * 3.0 * pairs.len() as f64 / squares).log10()
}
