//! The forms of an image: as recorded, as views without it, and rendered.

use std::sync::Arc;

use anyhow::Context;

use crate::database::{DatabaseError, ImageDatabase, Metric, Neighbour, Record, ViewQuery};
use crate::geometry::Isometry;
use crate::scene::{Renderer, Scene, SceneFile};
use crate::views::{Camera, Method, Raster};

/// Names of the forms, in the order of the tables. The first is the recorded image itself, the last the rendered one.
pub const FORMS: [&str; 5] = ["recorded", "exact view", "paper's view", "nearest image", "rendered"];
/// The form that shows no goals: scenes are rendered without.
pub const WITHOUT_GOALS: usize = 4;

/// An image that is held out, and its forms.
pub struct HeldOut {
    /// Its number in the database.
    pub number: usize,
    /// Its record.
    pub record: Record,
    /// Its camera.
    pub camera: Arc<Camera>,
    /// Pose of `camera_link` in `map`.
    pub pose: Isometry,
    /// Its forms, in the order of [`FORMS`].
    pub images: Vec<Raster>,
}

/// Makes all forms of one image. `None` if no view can be made, since no other image is near.
pub fn forms(database: &ImageDatabase, number: usize, apart: f64) -> anyhow::Result<Option<HeldOut>> {
    let record = database.index().record(number);
    let (pose, camera) = (record.pose(), database.camera(&record).context("an image of an unknown source")?);
    let recorded = database.image(number).map_err(anyhow::Error::msg)?;
    let without = held_out(database, number, apart);
    let mut images = vec![recorded.full().clone()];
    for method in [Method::Exact, Method::Paper, Method::Nearest] {
        let camera = Some(Arc::clone(camera));
        let wanted = ViewQuery {
            map_from_link: pose,
            method,
            camera,
            max_distance_m: f64::INFINITY,
            may_be_stored: true,
            without: without.clone(),
        };
        match database.view(&wanted) {
            Ok(shown) => images.push(shown.answer.image),
            Err(DatabaseError::View(_) | DatabaseError::Image { .. }) => return Ok(None),
            Err(error) => return Err(error.into()),
        }
    }
    images.push(rendered(database, camera, &pose)?);
    Ok(Some(HeldOut { number, record, camera: Arc::clone(camera), pose, images }))
}

/// The image itself and all that were taken near it.
fn held_out(database: &ImageDatabase, number: usize, apart: f64) -> Vec<usize> {
    let pose = database.index().record(number).pose();
    // 512 neighbours are far more than a walk has within that distance.
    let near = database.index().nearest(&pose, 512, &Metric::default());
    let is_near =
        |at: &&Neighbour| database.index().record(at.number).pose().translation.distance(pose.translation) < apart;
    near.iter().filter(is_near).map(|at| at.number).chain([number]).collect()
}

/// Scene for the rendered form. Its route does not matter: only field, lens and texture count.
const SCENE: &str = r#"
[scene]
title = "Rendered in place of a recorded image"
task = "The rendered side of the reality gap."
seed = 9
field = "the database's"

[camera]
lens = "the database's"
rate_hz = 10.0
torso_height_m = 0.4
mount_xyz_m = [0.0, 0.0, 0.1]
mount_pitch_deg = 0.0

[route]
kind = "still"
poses = [[0.0, 0.0, 0.0]]
hold_s = 1.0
"#;

fn rendered(database: &ImageDatabase, camera: &Camera, pose: &Isometry) -> anyhow::Result<Raster> {
    let lens = camera.lens().parameters().clone();
    let scene = Scene::build(SceneFile::from_toml(SCENE)?, database.field().dimensions().clone(), lens)?;
    let mut rgb = Vec::new();
    Renderer::new(&scene).render_clean(pose, 0, &mut rgb);
    Raster::from_rgb(camera.width(), camera.height(), &rgb, camera.shows())
        .context("a rendered image of the camera's size")
}
