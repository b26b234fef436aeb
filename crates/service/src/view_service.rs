//! Makes views from the database, and from the lenses and scenes given at the start.
//!
//! No file is opened by a name that a client sends.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock};

use hyper::StatusCode;
use serde_json::{Value, json};

use super::HttpProblem;
use super::encode::{self, Form};
use super::labels::LabelledView;
use super::parameters::{MaskWanted, Parameters, ViewRequest, named};
use realitysim_config::ViewsSettings;
use realitysim_database::{DatabaseError, ImageDatabase, ViewQuery, ViewResult, coverage};
use realitysim_evaluation::drawing::coverage_map;
use realitysim_geometry::{Lens, LensParameters};
use realitysim_scene::{Scene, ViewOverlay};
use realitysim_views::{Camera, Provenance, ViewError};

/// Makes views, and keeps what is expensive to prepare for them.
pub(super) struct ViewService {
    /// The database as it is now.
    database: RwLock<Arc<ImageDatabase>>,
    /// Lenses that clients may name.
    lenses: BTreeMap<String, LensParameters>,
    /// Scenes that clients may name.
    scenes: BTreeMap<String, Scene>,
    /// Lenses with their rays, the least recently used first.
    cameras: Mutex<Vec<Arc<Camera>>>,
    /// Scenes prepared for a lens, the least recently used first.
    stages: Mutex<Vec<(StageKey, Arc<ViewOverlay>)>>,
    /// Largest distance of a view from the nearest image, metres, if the client does not state one.
    max_distance_m: f64,
}

/// Key of a prepared scene: its name, whether its figures are drawn, and the lens.
type StageKey = (String, bool, LensParameters);

/// An encoded view, and the headers that describe it.
pub(super) struct Picture {
    pub(super) bytes: Vec<u8>,
    pub(super) form: Form,
    /// How the view was made.
    pub(super) made: &'static str,
    pub(super) headers: Vec<(&'static str, String)>,
}

/// Largest number of lenses kept prepared, beside those of the database.
const MAX_CAMERAS: usize = 16;
/// Largest number of scenes kept prepared, each for one lens.
const MAX_STAGES: usize = 8;
/// Largest number of pixels of all prepared lenses, and of all prepared scenes, if there is more than one; each takes some 14 bytes.
const MAX_KEPT_PIXELS: u64 = 1 << 23;
/// Largest number of pixels of one view.
const MAX_PIXELS: u64 = 1 << 22;
/// Largest number of cells of a coverage: the paper's grid has 720,000 poses.
const MAX_CELLS: f64 = 1e6;

impl ViewService {
    /// Opens the database in a folder.
    pub(super) fn open(
        folder: &Path,
        settings: &ViewsSettings,
        lenses: BTreeMap<String, LensParameters>,
        scenes: BTreeMap<String, Scene>,
        max_distance_m: f64,
    ) -> Result<Self, DatabaseError> {
        let database = RwLock::new(Arc::new(ImageDatabase::open(folder, settings)?));
        Ok(Self { database, lenses, scenes, cameras: Mutex::default(), stages: Mutex::default(), max_distance_m })
    }

    /// Returns the database as it is now. Callers keep it while it is replaced.
    pub(super) fn database(&self) -> Arc<ImageDatabase> {
        Arc::clone(&self.database.read().unwrap_or_else(PoisonError::into_inner))
    }

    /// Reopens the database if it has changed. Returns whether it had.
    pub(super) fn refresh(&self) -> Result<bool, DatabaseError> {
        let Some(new) = self.database().reopened()? else { return Ok(false) };
        *self.database.write().unwrap_or_else(PoisonError::into_inner) = Arc::new(new);
        Ok(true)
    }

    /// Makes a view and encodes it in the best of the accepted forms.
    pub(super) fn picture(&self, asked: &ViewRequest, forms: &[Form]) -> Result<Picture, HttpProblem> {
        let database = self.database();
        let camera = self.camera(&database, asked)?;
        if let Some(name) = &asked.scene {
            named("scene", name, &self.scenes)?;
        }
        let max_distance_m = asked.max_distance_m.unwrap_or(self.max_distance_m);
        let wanted = ViewQuery {
            map_from_link: asked.map_from_link,
            method: asked.method,
            camera,
            max_distance_m: if asked.refuses { max_distance_m } else { f64::INFINITY },
            may_be_stored: asked.scene.is_none(),
            without: Vec::new(),
        };
        let mut shown = database.view(&wanted).map_err(|error| refusal(&error))?;
        let (effects, figures_m) = match &asked.scene {
            Some(name) => self.apply(&database, name, asked, &mut shown)?,
            None => (Vec::new(), Vec::new()),
        };
        let untouched = effects.is_empty() && asked.mask == MaskWanted::None && asked.layers.is_empty();
        let stored = shown.stored.take().filter(|bytes| untouched && forms.contains(&Form::of(bytes)));
        let image = &shown.answer.image;
        let (form, (bytes, channels)) = match stored {
            Some(bytes) => (Form::of(&bytes), (bytes, 3)),
            None if asked.layers.is_empty() => (forms[0], encode::encode(image, forms[0], asked.mask, asked.quality)?),
            None => {
                let depth_m = || shown.depth_m(database.world(), &figures_m);
                let labels = || LabelledView::new(&database, &shown, &figures_m).class_numbers();
                (Form::Arrays, (encode::encode_layers(image, &asked.layers, depth_m, labels)?, 3))
            }
        };
        let mut headers = provenance(&database, &shown, channels);
        if !effects.is_empty() {
            headers.push(("realitysim-effects", effects.join(", ")));
        }
        headers.extend(shown.answer.warning(max_distance_m).map(|words| ("realitysim-warning", words)));
        Ok(Picture { bytes, form, made: made(shown.answer.made), headers })
    }

    /// Returns the camera that is asked for; `None` for that of the nearest image.
    fn camera(&self, database: &ImageDatabase, asked: &ViewRequest) -> Result<Option<Arc<Camera>>, HttpProblem> {
        if asked.lens.is_none() && asked.size == [None; 2] {
            return Ok(None);
        }
        let own = || {
            let camera = database.nearest_camera(&asked.map_from_link);
            camera.map(|camera| camera.lens().parameters().clone()).ok_or_else(|| refusal(&DatabaseError::Empty))
        };
        let lens = match &asked.lens {
            Some(name) => named("lens", name, &self.lenses)?.clone(),
            None => own()?,
        };
        let lens = lens.resized(asked.size);
        if pixels_of(&lens) > MAX_PIXELS {
            let (width, height) = (lens.width, lens.height);
            let what = format!("width x height is {width} x {height}: at most {MAX_PIXELS} pixels are made");
            return Err(HttpProblem::wrong(what));
        }
        let known = |cameras: &[Arc<Camera>]| cameras.iter().position(|camera| *camera.lens().parameters() == lens);
        let mut cameras = self.cameras();
        if let Some(at) = known(&cameras) {
            let camera = cameras.remove(at);
            cameras.push(Arc::clone(&camera));
            return Ok(Some(camera));
        }
        // The camera is prepared without the lock.
        drop(cameras);
        let checked = Lens::new(lens.clone()).map_err(|error| HttpProblem::wrong(format!("lens: {error}")))?;
        let camera = Arc::new(Camera::new(&checked));
        let mut cameras = self.cameras();
        if known(&cameras).is_none() {
            cameras.push(Arc::clone(&camera));
        }
        let pixels = |camera: &Arc<Camera>| pixels_of(camera.lens().parameters());
        evict(&mut cameras, MAX_CAMERAS, pixels);
        Ok(Some(camera))
    }

    /// Applies a scene to a view. Returns the names of the effects that were applied, and how far each pixel's figure is.
    fn apply(
        &self,
        database: &ImageDatabase,
        name: &str,
        asked: &ViewRequest,
        shown: &mut ViewResult,
    ) -> Result<(Vec<&'static str>, Vec<f32>), HttpProblem> {
        let scene = named("scene", name, &self.scenes)?;
        let stage = self.stage(name, scene, asked.figures, shown.camera.lens());
        stage.check(database.field()).map_err(|error| HttpProblem::wrong(format!("scene is {name:?}: {error}")))?;
        let figures_m = stage.apply(asked.frame, &shown.camera, database.world(), &mut shown.answer);
        Ok((stage.effects(), figures_m))
    }

    /// Returns a scene prepared for a lens.
    fn stage(&self, name: &str, scene: &Scene, figures: bool, lens: &Lens) -> Arc<ViewOverlay> {
        let key = (name.to_owned(), figures, lens.parameters().clone());
        let mut stages = self.stages();
        if let Some(at) = stages.iter().position(|(known, _)| *known == key) {
            let stage = stages.remove(at);
            stages.push(stage.clone());
            return stage.1;
        }
        // The scene is prepared without the lock.
        drop(stages);
        let stage = Arc::new(ViewOverlay::new(scene, lens, figures));
        let mut stages = self.stages();
        if stages.iter().all(|(known, _)| *known != key) {
            stages.push((key, Arc::clone(&stage)));
        }
        evict(&mut stages, MAX_STAGES, |((_, _, lens), _)| pixels_of(lens));
        stage
    }

    fn stages(&self) -> MutexGuard<'_, Vec<(StageKey, Arc<ViewOverlay>)>> {
        self.stages.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn cameras(&self) -> MutexGuard<'_, Vec<Arc<Camera>>> {
        self.cameras.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns what the service has: sources, lenses, scenes, field.
    pub(super) fn info(&self) -> Value {
        let database = self.database();
        let names = |path: &Path| path.file_name().map(|name| name.to_string_lossy().into_owned());
        let sources = database.contents().sources.iter().enumerate().map(|(number, source)| {
            json!({ "number": number, "name": names(&source.path), "images": source.images, "lens": source.lens })
        });
        json!({
            "version": env!("CARGO_PKG_VERSION"),
            "images": database.index().len(),
            "index": database.contents().index,
            "field": database.field().dimensions(),
            "sources": sources.collect::<Vec<Value>>(),
            "lenses": self.lenses,
            "scenes": self.scenes.iter().map(|(name, scene)| (name.clone(), json!(scene.effects_on_views())))
                .collect::<serde_json::Map<String, Value>>(),
            "max_distance_m": self.max_distance_m,
        })
    }

    /// Counts images by cells of x, y and yaw. Returns JSON or a picture as PNG, and its media type.
    pub(super) fn coverage(
        &self,
        parameters: &Parameters,
        picture: bool,
    ) -> Result<(Vec<u8>, &'static str), HttpProblem> {
        parameters.only(&["cell_m", "headings"])?;
        let cell_m = parameters.number("cell_m", 0.02, 5.0)?.unwrap_or(0.25);
        let headings = parameters.whole("headings", 1, 360)?.unwrap_or(24);
        let database = self.database();
        let half = database.field().carpet_half_extent();
        let cells = (2.0 * half.x / cell_m).ceil() * (2.0 * half.y / cell_m).ceil() * f64::from(headings);
        if cells > MAX_CELLS {
            let what = format!("cell_m and headings make {cells:.0} cells: at most {MAX_CELLS:.0} are counted");
            return Err(HttpProblem::wrong(what));
        }
        let found = coverage(database.index(), database.field(), cell_m, headings as usize);
        if picture {
            let image = coverage_map(&found, database.field());
            let (width, height) = image.dimensions();
            let pixels = image.into_raw().as_chunks::<3>().0.iter().map(|[r, g, b]| [*r, *g, *b, 255]).collect();
            let raster = realitysim_views::Raster { width: width as usize, height: height as usize, pixels };
            return Ok((encode::encode(&raster, Form::Png, MaskWanted::None, 0)?.0, Form::Png.media_type()));
        }
        let mut value = serde_json::to_value(&found).unwrap_or_default();
        value["counts"] = json!(found.counts());
        Ok((value.to_string().into_bytes(), "application/json"))
    }
}

/// Returns the number of pixels of a lens's images.
fn pixels_of(lens: &LensParameters) -> u64 {
    u64::from(lens.width) * u64::from(lens.height)
}

/// Removes the least recently used until at most `max_count` are left, with at most [`MAX_KEPT_PIXELS`] unless it is one.
fn evict<T>(kept: &mut Vec<T>, max_count: usize, pixels: impl Fn(&T) -> u64) {
    while kept.len() > max_count || (kept.len() > 1 && kept.iter().map(&pixels).sum::<u64>() > MAX_KEPT_PIXELS) {
        kept.remove(0);
    }
}

/// Returns the word for how a view was made.
pub(super) fn made(made: Provenance) -> &'static str {
    match made {
        Provenance::Stored => "stored",
        Provenance::Nearest => "nearest",
        Provenance::Warped => "warped",
        Provenance::Composed => "composed",
    }
}

/// Returns the headers that describe a view.
fn provenance(database: &ImageDatabase, shown: &ViewResult, channels: usize) -> Vec<(&'static str, String)> {
    let answer = &shown.answer;
    let source = |used: &realitysim_views::UsedSource| {
        let record = database.index().record(used.id as usize);
        let pose = record.pose();
        let position = pose.translation;
        json!({
            "source": record.source,
            "stamp_ns": record.stamp_ns,
            "distance_m": rounded(used.distance_m),
            "angle_deg": rounded(used.angle_rad.to_degrees()),
            "share": rounded(used.share),
            "x": rounded(position.x),
            "y": rounded(position.y),
            "yaw_deg": rounded(pose.euler().yaw.to_degrees()),
        })
    };
    let sources: Vec<Value> = answer.sources.iter().map(source).collect();
    let mut headers = vec![
        ("realitysim-made", made(answer.made).to_owned()),
        ("realitysim-sources", Value::from(sources).to_string()),
        ("realitysim-valid-share", format!("{:.4}", answer.valid_share)),
        ("realitysim-sure-share", format!("{:.4}", answer.sure_share)),
        ("realitysim-width", answer.image.width.to_string()),
        ("realitysim-height", answer.image.height.to_string()),
        ("realitysim-channels", channels.to_string()),
        ("realitysim-index", database.contents().index.to_string()),
        ("realitysim-lens", json!(shown.camera.lens().parameters()).to_string()),
    ];
    if let Some(pixels) = answer.trusted_error_px() {
        headers.push(("realitysim-expected-error-px", format!("{pixels:.3}")));
    }
    if !shown.unreadable.is_empty() {
        headers.push(("realitysim-unreadable", shown.unreadable.len().to_string()));
    }
    headers
}

/// Rounds to four decimals: a tenth of a millimetre, of a millidegree, of a permille.
fn rounded(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}

/// Turns an error of the database into an answer that does not name folders of this machine.
fn refusal(error: &DatabaseError) -> HttpProblem {
    let none = |what: String| HttpProblem::new(StatusCode::NOT_FOUND, what);
    match error {
        DatabaseError::Empty => none("the database has no image: add some with `realitysim db add`".to_owned()),
        DatabaseError::View(wrong @ (ViewError::NotFinite | ViewError::Place { .. } | ViewError::Height { .. })) => {
            HttpProblem::wrong(wrong.to_string())
        }
        DatabaseError::View(error) => none(error.to_string()),
        _ => HttpProblem::new(
            StatusCode::INTERNAL_SERVER_ERROR,
            "none of the images near this pose can be read: they vanished or changed since they were indexed; `realitysim db \
             verify` names them, `realitysim db rebuild` mends the database",
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_least_recently_used_is_evicted_until_few_and_small_are_left() {
        let left = |mut kept: Vec<u64>, max_count: usize| {
            evict(&mut kept, max_count, |pixels| *pixels);
            kept
        };
        assert_eq!(left(vec![1, 2, 3], 3), [1, 2, 3]);
        assert_eq!(left(vec![1, 2, 3], 2), [2, 3]);
        assert_eq!(left(vec![MAX_PIXELS, MAX_PIXELS, MAX_PIXELS], 16), [MAX_PIXELS; 2]);
        assert_eq!(left(vec![7, MAX_KEPT_PIXELS + 1], 16), [MAX_KEPT_PIXELS + 1], "the one in use stays");
    }
}
