//! Filling of pixels that are hidden in every source.

use super::compose::Composed;
use super::ground_warp::Warp;
use super::photometry::Gain;
use super::raster::{NOTHING, UNSURE};
use super::sample::read;
use super::synthesized_view::{Candidate, Request};
use super::target_rays::Target;

/// Fills pixels that the composition has left black with those that the nearest source has marked as moving. They are marked
/// unsure, which is better than black.
pub(super) fn fill(
    composed: &mut Composed,
    request: &Request,
    target: &Target,
    warps: &[Warp],
    sources: &[Candidate],
    gains: &[Gain],
) {
    let camera = target.camera();
    let Composed { image, pixels } = composed;
    let width = image.width;
    for (index, pixel) in image.pixels.iter_mut().enumerate() {
        if pixel[3] != NOTHING || !camera.shows()[index] {
            continue;
        }
        let (u, v) = (index % width, index / width);
        let found = warps.iter().zip(sources).zip(gains).enumerate().find_map(|(number, ((warp, source), gain))| {
            let (at, _) = warp.pixel(u, v)?;
            let [r, g, b, known] = read(source.image.full(), at.x as f32, at.y as f32);
            let there = source.vignetting.at(source.camera.lens(), at.x, at.y);
            let here = request.vignetting.at(camera.lens(), u as f64, v as f64);
            let lit = |value: u8, gain: f64| (f64::from(value) * gain * here / there + 0.5).min(255.0) as u8;
            let [red, green, blue] = gain.rgb;
            (known >= UNSURE).then(|| (number, [lit(r, red), lit(g, green), lit(b, blue), UNSURE]))
        });
        if let Some((number, shown)) = found {
            *pixel = shown;
            pixels[number] += 1.0;
        }
    }
}
