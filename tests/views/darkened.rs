//! Exposure and the lens's darkening are taken out.

use realitysim::evaluation::views::TruthRenderer;
use realitysim::views::{Camera, Pyramid, Raster, SURE, Vignetting, World, similarity, view};

use super::{candidate, field, lens, pose, request};

/// As a lens and an exposure would have made it.
fn darkened(raster: &Raster, camera: &Camera, gain: [f64; 3], vignetting: &Vignetting) -> Raster {
    let mut raster = raster.clone();
    let width = raster.width;
    for (index, pixel) in raster.pixels.iter_mut().enumerate() {
        let light = vignetting.at(camera.lens(), (index % width) as f64, (index / width) as f64);
        (0..3).for_each(|c| pixel[c] = (f64::from(pixel[c]) * gain[c] * light).round().min(255.0) as u8);
    }
    raster
}

#[test]
fn other_exposures_and_dark_corners_are_balanced() {
    let (field, lens) = (field(), lens());
    let (camera, lawn, world) =
        (Camera::new(&lens), TruthRenderer::new(&field, &lens, false), World::without_goals(&field));
    let dark = Vignetting { k: [-0.5, 0.1, 0.0] };
    let wanted = pose(0.2, 0.1, 15.0);
    let (truth, ground) = lawn.render(&wanted);
    let truth = darkened(&truth, &camera, [1.0; 3], &dark);
    let places = [pose(0.3, 0.1, 22.0), pose(0.0, 0.1, 5.0), pose(0.2, -0.2, 12.0)];
    let gains = [[1.0; 3], [0.6, 0.65, 0.7], [1.1, 1.0, 0.9]];
    let images: Vec<Pyramid> = (places.iter().zip(gains))
        .map(|(place, gain)| Pyramid::new(darkened(&lawn.render(place).0, &camera, gain, &dark)))
        .collect();
    let score = |vignetting: Vignetting, used: usize| {
        let mut sources: Vec<_> =
            places.iter().zip(&images).take(used).map(|(place, image)| candidate(&camera, *place, image)).collect();
        sources.iter_mut().for_each(|source| source.vignetting = vignetting);
        let mut request = request(&camera, wanted, &world);
        request.vignetting = vignetting;
        let answer = view(&request, &sources).expect("a view");
        let shown: Vec<bool> = answer.image.pixels.iter().map(|pixel| pixel[3] == SURE).collect();
        similarity(&truth.pixels, &answer.image.pixels, 320, &ground, &shown)
    };
    let (known, ignored) = (score(dark, 3), score(Vignetting::default(), 3));
    println!("lens known {known:?}, ignored {ignored:?}");
    // Sources as bright as they are would give less than 20 dB.
    assert!(known.psnr_db > 35.0 && known.psnr_db > ignored.psnr_db + 1.0, "{known:?} {ignored:?}");
    assert!(known.compared > 0.97, "{known:?}");
}
