//! How good a database's views are by its own images: each in turn is left out and made of the others.

use super::error::DatabaseError;
use super::image_database::{ImageDatabase, ViewQuery};
use realitysim_views::{Method, SURE, Surface, Target, World, similarity};

/// PSNR on the ground, dB, of `wanted` images spread evenly over the database; those that no other image shows are left out. Exposure is not
/// evened out beyond what a view does by itself.
pub fn leave_one_out(
    gallery: &ImageDatabase,
    wanted: usize,
    progress: &mut dyn FnMut(u64),
) -> Result<Vec<f64>, DatabaseError> {
    let count = gallery.index().len();
    let wanted = wanted.min(count);
    let mut found = Vec::new();
    for which in 0..wanted {
        let number = (2 * which + 1) * count / (2 * wanted);
        progress(which as u64 + 1);
        let record = gallery.index().record(number);
        let (Some(camera), Ok(image)) = (gallery.camera(&record), gallery.image(number)) else { continue };
        let pose = record.pose();
        let asked = ViewQuery {
            map_from_link: pose,
            method: Method::Exact,
            camera: Some(camera.clone()),
            max_distance_m: f64::INFINITY,
            may_be_stored: true,
            without: vec![number],
        };
        let shown = match gallery.view(&asked) {
            Ok(shown) => shown.answer.image,
            Err(DatabaseError::View(_) | DatabaseError::Image { .. }) => continue,
            Err(error) => return Err(error),
        };
        let world = World::without_goals(gallery.field());
        let target = Target::new(camera, &pose, &world);
        let (width, real) = (camera.width(), image.full());
        let ground: Vec<bool> = (0..width * camera.height())
            .map(|i| target.surface(i % width, i / width) == Some(Surface::Ground))
            .collect();
        let both: Vec<bool> =
            shown.pixels.iter().zip(&real.pixels).map(|(a, b)| a[3] == SURE && b[3] == SURE).collect();
        let similarity = similarity(&real.pixels, &shown.pixels, width, &ground, &both);
        if similarity.compared > 0.0 {
            found.push(similarity.psnr_db);
        }
    }
    Ok(found)
}
