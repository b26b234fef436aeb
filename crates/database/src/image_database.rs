//! Answers requests for views: selects images, decodes them, keeps them in memory, and makes a view of them.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use glam::DVec2;

use super::build::bytes_of;
use super::contents::{Contents, MAX_TRIES, Source};
use super::error::DatabaseError;
use super::hall;
use super::index::{Index, Neighbour};
use super::kd_tree::Metric;
use super::masks::Masks;
use super::moved::MovedBlocks;
use super::pixels::{colours, ending, png_of};
use super::record::{Form, Record};
use super::remote_files::exists;
use super::source_selection::{Exclusions, choose};
use realitysim_config::ViewsSettings;
use realitysim_geometry::{Field, Isometry, Lens, LensParameters};
use realitysim_views::{
    Camera, Candidate, CoverageMask, Method, Provenance, Pyramid, Raster, Request, Scenery, SynthesizedView,
    ViewSettings, Vignetting, World, check_pose, depth_m, mark_moving, view,
};
use realitysim_vision::BodyMask;

/// An open database. It can be shared between threads.
#[derive(Debug)]
pub struct ImageDatabase {
    folder: PathBuf,
    contents: Contents,
    index: Index,
    settings: ViewsSettings,
    field: Field,
    world: World,
    /// The camera of each source; sources with the same lens share one.
    cameras: Vec<Arc<Camera>>,
    /// For each source, whether each pixel shows the world.
    shows: Vec<Vec<bool>>,
    /// For each source, what stands before the hall in its images, if that is known.
    moved: Vec<Option<MovedBlocks>>,
    /// For each source, whether each pixel may show the robot's own body.
    bodies: Vec<Vec<bool>>,
    decoded: Mutex<Decoded>,
}

/// A request for a view.
#[derive(Clone, Debug)]
pub struct ViewQuery {
    /// Pose of `camera_link` in `map`.
    pub map_from_link: Isometry,
    /// How the view is made.
    pub method: Method,
    /// The camera of the view; without it, that of the nearest image.
    pub camera: Option<Arc<Camera>>,
    /// Largest distance of the nearest image from the pose, metres.
    pub max_distance_m: f64,
    /// Whether an image taken at this pose may be the answer unchanged. It may not if a scene is drawn over the view.
    pub may_be_stored: bool,
    /// Numbers of records that are not used, for leaving an image out.
    pub without: Vec<usize>,
}

/// A view, and how it was made.
#[derive(Clone, Debug)]
pub struct ViewResult {
    /// The view.
    pub answer: SynthesizedView,
    /// The camera of the view's picture.
    pub camera: Arc<Camera>,
    /// The bytes of the stored image, if that is the answer and it is a JPEG or PNG.
    pub stored: Option<Vec<u8>>,
    /// Files of images that were selected but could not be read, with the reason. Other images took their place.
    pub unreadable: Vec<String>,
}

impl ViewResult {
    /// Depth of the view in `world`, metres along the ray of each pixel as [`depth_m`] describes it.
    ///
    /// `figures_m` are distances of figures that were drawn into the view, infinite where there is none; it may be empty.
    pub fn depth_m(&self, world: &World, figures_m: &[f32]) -> Vec<f32> {
        let mut depths = depth_m(&self.camera, &self.answer.map_from_link, world);
        for (depth, figure) in depths.iter_mut().zip(figures_m).filter(|(depth, _)| !depth.is_nan()) {
            *depth = depth.min(*figure);
        }
        depths
    }
}

/// Width of the band at the edge of the lens's circle that lens and codec have mixed with black, pixels.
const RIM_PX: usize = 3;
/// Most unreadable images that are passed over for one view.
const MAX_UNREADABLE: usize = 32;

impl ImageDatabase {
    /// Opens the database in a folder.
    ///
    /// A concurrent change removes files that the new contents do not name; then the contents are read again.
    pub fn open(folder: &Path, settings: &ViewsSettings) -> Result<Self, DatabaseError> {
        for _ in 0..MAX_TRIES {
            let (contents, index) = Contents::with_index(folder)?;
            let number = contents.index;
            match Self::of(folder, settings, contents, index) {
                Err(_) if Contents::read(folder)?.index != number => {}
                opened => return opened,
            }
        }
        Err(DatabaseError::Busy { path: folder.to_owned() })
    }

    fn of(folder: &Path, settings: &ViewsSettings, contents: Contents, index: Index) -> Result<Self, DatabaseError> {
        let field = Field::new(contents.field.clone())
            .map_err(|source| DatabaseError::Field { path: folder.to_owned(), source })?;
        let mut by_lens: Vec<(&LensParameters, Arc<Camera>)> = Vec::new();
        let (mut cameras, mut shows, mut bodies, mut moved) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for source in &contents.sources {
            let known = by_lens.iter().find(|(lens, _)| **lens == source.lens).map(|(_, camera)| Arc::clone(camera));
            let camera = match known {
                Some(camera) => camera,
                None => {
                    let lens = Lens::new(source.lens.clone())
                        .map_err(|error| DatabaseError::Lens { path: source.path.clone(), source: error })?;
                    let camera = Arc::new(Camera::new(&lens));
                    by_lens.push((&source.lens, Arc::clone(&camera)));
                    camera
                }
            };
            shows.push(shown_by(folder, source, &camera)?);
            bodies.push(body_of(folder, source)?);
            cameras.push(camera);
            moved.push(MovedBlocks::open(folder, source)?);
        }
        let any_goals = contents.sources.iter().any(|source| source.goals);
        let world = if settings.goals && any_goals { World::new(&field) } else { World::without_goals(&field) };
        let world = world.with_hall(hall::common(&contents.sources));
        let decoded = Mutex::new(Decoded::new(settings.cache_mb << 20));
        let settings = settings.clone();
        Ok(Self {
            folder: folder.to_owned(),
            contents,
            index,
            settings,
            field,
            world,
            cameras,
            shows,
            bodies,
            moved,
            decoded,
        })
    }

    /// Opens the database again if it has been changed since this one was opened.
    pub fn reopened(&self) -> Result<Option<Self>, DatabaseError> {
        let now = Contents::read(&self.folder)?;
        if now.index == self.contents.index {
            return Ok(None);
        }
        Self::open(&self.folder, &self.settings).map(Some)
    }

    /// The index.
    pub fn index(&self) -> &Index {
        &self.index
    }

    /// The field.
    pub fn field(&self) -> &Field {
        &self.field
    }

    /// The surfaces that views are made of: ground and, if images show them, goals.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// The contents.
    pub fn contents(&self) -> &Contents {
        &self.contents
    }

    /// The camera that an image was taken with.
    pub fn camera(&self, record: &Record) -> Option<&Arc<Camera>> {
        self.camera_of(record.source)
    }

    pub(super) fn camera_of(&self, source: u32) -> Option<&Arc<Camera>> {
        self.cameras.get(source as usize)
    }

    /// For each pixel of a source's images, row by row: whether it may show the robot's own body. Empty if none does.
    pub fn body(&self, source: u32) -> &[bool] {
        self.bodies.get(source as usize).map_or(&[], Vec::as_slice)
    }

    /// Bytes of the decoded images in memory.
    pub fn decoded_bytes(&self) -> usize {
        self.decoded().bytes
    }

    /// The camera of the nearest image.
    pub fn nearest_camera(&self, map_from_link: &Isometry) -> Option<&Arc<Camera>> {
        let nearest = self.index.nearest(map_from_link, 1, &Metric::default());
        self.camera(&self.index.record(nearest.first()?.number))
    }

    /// Selects the images for a view, the nearest and best first.
    fn choose(&self, wanted: &ViewQuery, without: &Exclusions) -> Vec<Neighbour> {
        let pose = &wanted.map_from_link;
        let Some(camera) = wanted.camera.as_ref().or_else(|| self.nearest_camera(pose)) else { return Vec::new() };
        let footprint = CoverageMask::new(camera, pose, &self.world);
        choose(self, pose, &footprint, self.settings.sources, without)
    }

    /// Answers a request. Images that cannot be read are replaced by others, up to a limit.
    ///
    /// Fails if the database is empty, the pose is impossible, or no view can be made of the images.
    pub fn view(&self, wanted: &ViewQuery) -> Result<ViewResult, DatabaseError> {
        if self.index.is_empty() {
            return Err(DatabaseError::Empty);
        }
        check_pose(&wanted.map_from_link)?;
        let mut without = Exclusions { records: wanted.without.clone(), sources: Vec::new(), files: Vec::new() };
        let mut unreadable = Vec::new();
        loop {
            let chosen = self.choose(wanted, &without);
            if let Some(shown) = self.stored(wanted, &chosen)? {
                return Ok(shown);
            }
            let images: Vec<(usize, Result<Arc<Pyramid>, String>)> =
                chosen.iter().map(|neighbour| (neighbour.number, self.image(neighbour.number))).collect();
            let failed: Vec<(usize, &String)> =
                images.iter().filter_map(|(number, image)| Some((*number, image.as_ref().err()?))).collect();
            if failed.is_empty() || unreadable.len() >= MAX_UNREADABLE {
                return self.make(wanted, images, unreadable);
            }
            for (number, what) in failed {
                let Record { source, file, .. } = self.index.record(number);
                if without.sources.contains(&source) || without.files.contains(&(source, file)) {
                    continue;
                }
                let gone = |path: &Path| format!("{}: gone since it was indexed", path.display());
                let known = self.contents.sources.get(source as usize);
                let path = known.and_then(|source| source.file(file));
                // If a whole source or file is gone, all of its images are excluded at once.
                match (known.map(|source| &source.path).filter(|path| !exists(path)), path) {
                    (Some(away), _) => {
                        without.sources.push(source);
                        unreadable.push(gone(away));
                    }
                    (None, Some(away)) if !exists(&away) => {
                        without.files.push((source, file));
                        unreadable.push(gone(&away));
                    }
                    _ => {
                        without.records.push(number);
                        unreadable.push(what.clone());
                    }
                }
            }
        }
    }

    /// The stored image itself as the answer, if one of the selected images was taken at the requested pose with the
    /// requested camera. Only that image is decoded.
    fn stored(&self, wanted: &ViewQuery, chosen: &[Neighbour]) -> Result<Option<ViewResult>, DatabaseError> {
        for neighbour in chosen {
            let record = self.index.record(neighbour.number);
            let Some(own) = self.camera(&record) else { continue };
            let camera = wanted.camera.as_ref().unwrap_or(own);
            let request = self.request(wanted, camera);
            let same = camera.lens().parameters().draws_as(own.lens().parameters());
            if !same || !request.is_within(&record.pose()) || wanted.method == Method::Nearest {
                continue;
            }
            let (Ok(bytes), Ok(image)) = (bytes_of(&self.contents, &record), self.image(neighbour.number)) else {
                continue;
            };
            let candidate = self.candidate(neighbour.number, &record, own, &image);
            let answer = view(&request, &[candidate])?;
            let stored = (answer.made == Provenance::Stored && record.form == Form::File).then_some(bytes);
            return Ok(Some(ViewResult { answer, camera: Arc::clone(camera), stored, unreadable: Vec::new() }));
        }
        Ok(None)
    }

    /// Makes a view of the images that could be read.
    fn make(
        &self,
        wanted: &ViewQuery,
        images: Vec<(usize, Result<Arc<Pyramid>, String>)>,
        unreadable: Vec<String>,
    ) -> Result<ViewResult, DatabaseError> {
        let readable: Vec<(usize, Record, Arc<Pyramid>)> = images
            .into_iter()
            .filter_map(|(number, image)| Some((number, self.index.record(number), image.ok()?)))
            .collect();
        let candidates: Vec<Candidate> = readable
            .iter()
            .filter_map(|(number, record, image)| Some(self.candidate(*number, record, self.camera(record)?, image)))
            .collect();
        let nearest = readable.first().and_then(|(_, record, _)| self.camera(record));
        let camera = match (&wanted.camera, nearest) {
            (Some(camera), _) | (None, Some(camera)) => Arc::clone(camera),
            (None, None) => {
                let what = unreadable.first().cloned().unwrap_or_else(|| "no image can be read".to_owned());
                return Err(DatabaseError::Image { path: self.folder.clone(), what });
            }
        };
        let answer = view(&self.request(wanted, &camera), &candidates)?;
        let camera = match (answer.made, nearest) {
            // The nearest image is returned unchanged, so it keeps its own camera.
            (Provenance::Nearest, Some(own)) => Arc::clone(own),
            _ => camera,
        };
        Ok(ViewResult { answer, camera, stored: None, unreadable })
    }

    fn request<'a>(&'a self, wanted: &ViewQuery, camera: &'a Camera) -> Request<'a> {
        Request {
            camera,
            map_from_link: wanted.map_from_link,
            method: wanted.method,
            world: &self.world,
            vignetting: self.darkening_of(camera.lens().parameters()),
            settings: ViewSettings {
                sources: self.settings.sources,
                // No image is as near as a negative distance.
                stored_within_m: if wanted.may_be_stored { self.settings.stored_within_m } else { -1.0 },
                stored_within_rad: ViewSettings::default().stored_within_rad,
                max_distance_m: wanted.max_distance_m,
            },
        }
    }

    fn candidate<'a>(&self, number: usize, record: &Record, camera: &'a Camera, image: &'a Pyramid) -> Candidate<'a> {
        Candidate {
            id: number as u64,
            camera,
            map_from_link: record.pose(),
            image,
            tag: record.tag(),
            vignetting: self.darkening(record.source as usize),
        }
    }

    /// The vignetting of a source, as it was measured when the source was added.
    fn darkening(&self, source: usize) -> Vignetting {
        let measured = self.contents.sources.get(source).and_then(|source| source.darkening);
        measured.map_or_else(Vignetting::default, |k| Vignetting { k })
    }

    /// The vignetting of a lens: that of the first source with the same lens at any image size, or none.
    fn darkening_of(&self, lens: &LensParameters) -> Vignetting {
        let size = [Some(lens.width), Some(lens.height)];
        let is_same = |source: &Source| source.lens.maps_as(lens) || source.lens.resized(size).maps_as(lens);
        let source = self.contents.sources.iter().position(|source| source.darkening.is_some() && is_same(source));
        source.map_or_else(Vignetting::default, |source| self.darkening(source))
    }

    /// The decoded image with this record number. The error names its file.
    pub fn image(&self, number: usize) -> Result<Arc<Pyramid>, String> {
        if let Some(image) = self.decoded().get(number) {
            return Ok(image);
        }
        let record = self.index.record(number);
        let image = Arc::new(self.decode(&record, &self.bytes(&record)?)?);
        self.decoded().put(number, &image);
        Ok(image)
    }

    /// The ending of an image's file ([`Self::file_of`]): `jpg` or `png`. The error names the file that cannot be read.
    pub fn ending_of(&self, record: &Record) -> Result<&'static str, String> {
        match record.form {
            Form::RosImage => Ok("png"),
            Form::File => Ok(ending(&self.bytes(record)?)),
        }
    }

    /// An image as a file: its bytes as they are stored, or a PNG of a raw image. The error names the file that cannot be read.
    pub fn file_of(&self, record: &Record) -> Result<Vec<u8>, String> {
        let bytes = self.bytes(record)?;
        match record.form {
            Form::File => Ok(bytes),
            Form::RosImage => png_of(&colours(&bytes, record.form)?),
        }
    }

    fn bytes(&self, record: &Record) -> Result<Vec<u8>, String> {
        bytes_of(&self.contents, record).map_err(|(path, what)| format!("{}: {what}", path.display()))
    }

    fn decode(&self, record: &Record, bytes: &[u8]) -> Result<Pyramid, String> {
        let shows = self.shows.get(record.source as usize);
        let shows = shows.ok_or("the index names a source that database.json does not know")?;
        let colours = colours(bytes, record.form)?;
        let raster = Raster::from_rgb(colours.width, colours.height, &colours.rgb, shows);
        let mut raster = raster.ok_or("its pixels do not fit its lens")?;
        if let Some(camera) = self.camera(record).filter(|_| self.settings.mask_moving) {
            let (map_from_link, tag) = (record.pose(), record.tag());
            let (field, world) = (&self.field, &self.world);
            let moved = self.moved.get(record.source as usize).and_then(Option::as_ref);
            let moved = moved.map(|moved| moved.read(record)).transpose().map_err(|error| error.to_string())?.flatten();
            let moved = moved.as_deref();
            let figures = mark_moving(&mut raster, &Scenery { camera, map_from_link, tag, field, world, moved });
            return Ok(Pyramid::with_figures(raster, figures));
        }
        Ok(Pyramid::new(raster))
    }

    /// Locks the decoded images. They are consistent even if a thread has panicked while it held the lock.
    fn decoded(&self) -> MutexGuard<'_, Decoded> {
        self.decoded.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Whether each pixel of a source's images shows the world: the lens draws it, an image has ever lit it, and it is neither the
/// robot's own body nor in the soft rim of the lens's circle.
pub(super) fn shown_by(folder: &Path, source: &Source, camera: &Camera) -> Result<Vec<bool>, DatabaseError> {
    let width = source.lens.width as usize;
    let shown = |masks: &[BodyMask]| -> Vec<bool> {
        let pixel = |index: usize| DVec2::new((index % width) as f64, (index / width) as f64);
        let drawn = camera.shows().iter().enumerate();
        drawn.map(|(index, drawn)| *drawn && !masks.iter().any(|mask| mask.hides(pixel(index)))).collect()
    };
    let Masks { dark, bodies } = Masks::read(folder, source)?;
    let lit = without_rim(&shown(dark.as_slice()), width);
    Ok(lit.iter().zip(shown(&bodies)).map(|(lit, body)| *lit && body).collect())
}

/// Whether each pixel of a source's images may show the robot's own body; empty if it has no mask of it.
fn body_of(folder: &Path, source: &Source) -> Result<Vec<bool>, DatabaseError> {
    let Masks { bodies, .. } = Masks::read(folder, source)?;
    let (width, height) = (source.lens.width as usize, source.lens.height as usize);
    let pixel = |index: usize| DVec2::new((index % width) as f64, (index / width) as f64);
    let all = (0..if bodies.is_empty() { 0 } else { width * height }).map(pixel);
    Ok(all.map(|pixel| bodies.iter().any(|body| body.hides(pixel))).collect())
}

/// Excludes the pixels within [`RIM_PX`] of a pixel that shows nothing. The border of the image is not a rim.
pub(super) fn without_rim(shows: &[bool], width: usize) -> Vec<bool> {
    let height = shows.len() / width;
    let near = |at: usize, end: usize| at.saturating_sub(RIM_PX)..(at + RIM_PX + 1).min(end);
    let rows: Vec<bool> =
        (0..shows.len()).map(|i| near(i % width, width).all(|u| shows[i / width * width + u])).collect();
    (0..shows.len()).map(|i| near(i / width, height).all(|v| rows[v * width + i % width])).collect()
}

/// A cache of decoded images, from which the least recently used ones are removed first.
#[derive(Debug)]
struct Decoded {
    /// Time of the last use (a count of uses) and image, by record number.
    images: HashMap<usize, (u64, Arc<Pyramid>)>,
    /// Record numbers by time of the last use.
    by_use: BTreeMap<u64, usize>,
    uses: u64,
    bytes: usize,
    max_bytes: u64,
}

impl Decoded {
    fn new(max_bytes: u64) -> Self {
        Self { images: HashMap::new(), by_use: BTreeMap::new(), uses: 0, bytes: 0, max_bytes }
    }

    fn get(&mut self, number: usize) -> Option<Arc<Pyramid>> {
        let (used, image) = self.images.get_mut(&number)?;
        self.by_use.remove(used);
        self.uses += 1;
        *used = self.uses;
        self.by_use.insert(self.uses, number);
        Some(Arc::clone(image))
    }

    fn put(&mut self, number: usize, image: &Arc<Pyramid>) {
        self.uses += 1;
        self.bytes += image.bytes();
        if let Some((used, old)) = self.images.insert(number, (self.uses, Arc::clone(image))) {
            self.by_use.remove(&used);
            self.bytes -= old.bytes();
        }
        self.by_use.insert(self.uses, number);
        while self.bytes as u64 > self.max_bytes
            && let Some((_, oldest)) = self.by_use.pop_first()
        {
            if let Some((_, image)) = self.images.remove(&oldest) {
                self.bytes -= image.bytes();
            }
        }
    }
}
