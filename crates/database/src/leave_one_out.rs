//! Measures the quality of a database's views with its own images: an image is left out and made of the others.

use super::error::DatabaseError;
use super::image_database::{ImageDatabase, ViewQuery};
use realitysim_views::{Method, SURE, Surface, Target, World, similarity};

/// PSNR on the ground, dB, between images and their views made of the other images.
///
/// `wanted` images are taken, spread evenly over the database. Those that cannot be read, or whose ground no other image
/// shows, are left out. Exposure is not compensated beyond what the view does itself. `progress` gets the number of images so
/// far.
pub fn leave_one_out(
    database: &ImageDatabase,
    wanted: usize,
    progress: &mut dyn FnMut(u64),
) -> Result<Vec<f64>, DatabaseError> {
    let count = database.index().len();
    let wanted = wanted.min(count);
    let mut found = Vec::new();
    for which in 0..wanted {
        let number = (2 * which + 1) * count / (2 * wanted);
        progress(which as u64 + 1);
        let record = database.index().record(number);
        let (Some(camera), Ok(image)) = (database.camera(&record), database.image(number)) else { continue };
        let pose = record.pose();
        let asked = ViewQuery {
            map_from_link: pose,
            method: Method::Exact,
            camera: Some(camera.clone()),
            max_distance_m: f64::INFINITY,
            may_be_stored: true,
            without: vec![number],
        };
        let shown = match database.view(&asked) {
            Ok(shown) => shown.answer.image,
            Err(DatabaseError::View(_) | DatabaseError::Image { .. }) => continue,
            Err(error) => return Err(error),
        };
        let world = World::without_goals(database.field());
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
