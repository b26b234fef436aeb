//! Creates and changes databases.
//!
//! A change writes a new index beside the old one, and then the `database.json` that names it. A concurrent reader therefore has
//! either all of the old content or all of the new.

use std::fs;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::contents::{Contents, Source, SourceKind, TagLimits};
use super::error::{DatabaseError, io};
use super::image_circle::circle_deg;
use super::image_database::without_rim;
use super::index::{Index, path_of, write_index};
use super::input_files::sources_of;
use super::masks::{self, Masks};
use super::pixels::read_image;
use super::record::Record;
use super::remote_files;
use super::sources::{self, Read, ScaledLens};
use super::{goals, hall, moved, vignetting};
use realitysim_geometry::{Field, FieldDimensions, LensParameters};
use realitysim_recording::Loss;

/// The result of [`add`] and [`rebuild`].
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Added {
    /// Number of images in the database that came from these sources.
    pub images: u64,
    /// Number of images that were left out.
    pub left_out: u64,
    /// Number of images left out because their valid tag does not know which half of the field it is in.
    pub ambiguous: u64,
    /// Number of images left out because the standard deviation of their pose exceeds the limit.
    pub imprecise: u64,
    /// Number of images whose pose has no standard deviations: 1 cm and 0.25 degrees are assumed.
    pub assumed: u64,
    /// Lenses that were scaled to the size of their images.
    pub scaled: Vec<ScaledLens>,
    /// Parts of the sources that could not be read.
    pub losses: Vec<Loss>,
    /// Sources without a usable image, with the reason.
    pub empty: Vec<Loss>,
}

/// Callback that gets the number of images read so far; of each source once more while its images are compared.
pub type Progress<'a> = &'a mut dyn FnMut(u64);

/// Adds captures and folders of images to a database, which is created if there is none.
///
/// `field` is for folders of images, which do not name theirs. A database has one field, and sources from another are an
/// error. If no source has a usable image, nothing is changed, and the error says why.
pub fn add(
    folder: &Path,
    paths: &[PathBuf],
    field: Option<&FieldDimensions>,
    limits: TagLimits,
    progress: Progress,
) -> Result<Added, DatabaseError> {
    fs::create_dir_all(folder).map_err(io(folder))?;
    let _lock = lock(folder)?;
    let known = match Contents::read(folder) {
        Ok(contents) => Some(contents),
        Err(DatabaseError::None { .. }) => None,
        Err(error) => return Err(error),
    };
    let mut records = match &known {
        Some(contents) => Index::open(&path_of(folder, contents.index))?.records().collect(),
        None => Vec::new(),
    };
    let mut contents = known;
    let mut added = Added::default();
    for path in sources_of(paths, contents.as_ref())? {
        let read = sources::read(&path, limits, progress)?;
        add_source(folder, &mut contents, &mut records, read, field, &mut added, progress)?;
    }
    if added.images == 0 {
        return Err(DatabaseError::Nothing([added.losses, added.empty].concat()));
    }
    if let Some(contents) = contents {
        publish(folder, contents, records)?;
    }
    Ok(added)
}

/// Reads every source again, as if the database were created anew. A source that cannot be read stays listed,
/// without images.
pub fn rebuild(folder: &Path, progress: Progress) -> Result<Added, DatabaseError> {
    require_database(folder)?;
    let _lock = lock(folder)?;
    let old = Contents::read(folder)?;
    let mut contents = Some(Contents { sources: Vec::new(), ..old.clone() });
    let (mut records, mut added) = (Vec::new(), Added::default());
    for source in &old.sources {
        match sources::read(&source.path, source.limits, progress) {
            Ok(read) => add_source(folder, &mut contents, &mut records, read, Some(&old.field), &mut added, progress)?,
            Err(error) => {
                added.losses.push(Loss::new(&source.path, error.to_string()));
                // The source may be unreachable for now: a later rebuild looks for it again.
                let empty = Source { images: 0, left_out: 0, ..source.clone() };
                contents.get_or_insert_with(|| Contents::new(old.field.clone())).sources.push(empty);
            }
        }
    }
    publish(folder, contents.unwrap_or(old), records)?;
    Ok(added)
}

/// Removes a source from a database and returns the number of its images. The source's files are not touched.
pub fn remove(folder: &Path, path: &Path) -> Result<u64, DatabaseError> {
    require_database(folder)?;
    let _lock = lock(folder)?;
    let mut contents = Contents::read(folder)?;
    let absolute = remote_files::absolute(path).or_else(|_| std::path::absolute(path)).map_err(io(path))?;
    let unknown = || {
        let known: Vec<String> = contents.sources.iter().map(|source| source.path.display().to_string()).collect();
        DatabaseError::Unknown { path: path.to_owned(), known: known.join(", ") }
    };
    let gone = contents.position(&absolute).ok_or_else(unknown)?;
    let index = Index::open(&path_of(folder, contents.index))?;
    let keep = |mut record: Record| {
        let source = record.source as usize;
        record.source -= u32::from(source > gone);
        (source != gone).then_some(record)
    };
    let records: Vec<Record> = index.records().filter_map(keep).collect();
    let removed = (index.len() - records.len()) as u64;
    contents.sources.remove(gone);
    publish(folder, contents, records)?;
    Ok(removed)
}

/// Fails if the folder holds no database, so that not even a lock file is put into a wrong folder.
fn require_database(folder: &Path) -> Result<(), DatabaseError> {
    Contents::read(folder).map(drop)
}

/// Lock of a database for a change, because of two concurrent changes one would be lost. Readers need none.
struct DatabaseLock(fs::File);

/// Unlocks explicitly: closing the file is not enough while a process that is just being started has a copy of it.
impl Drop for DatabaseLock {
    fn drop(&mut self) {
        let _ = self.0.unlock();
    }
}

/// Locks a database until what is returned is dropped, or the process ends.
fn lock(folder: &Path) -> Result<DatabaseLock, DatabaseError> {
    let path = folder.join(LOCK);
    match fs::metadata(folder) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            return Err(DatabaseError::None { path: folder.to_owned() });
        }
        _ => {}
    }
    let file = fs::File::options().write(true).create(true).truncate(false).open(&path).map_err(io(&path))?;
    match file.try_lock() {
        Ok(()) => Ok(DatabaseLock(file)),
        Err(fs::TryLockError::WouldBlock) => Err(DatabaseError::Busy { path: folder.to_owned() }),
        Err(fs::TryLockError::Error(error)) => Err(io(&path)(error)),
    }
}

const LOCK: &str = "database.lock";

/// Adds a source that was read to the contents and the records: checks its field, measures its lens, and writes its masks.
fn add_source(
    folder: &Path,
    contents: &mut Option<Contents>,
    records: &mut Vec<Record>,
    read: Read,
    field: Option<&FieldDimensions>,
    added: &mut Added,
    progress: Progress,
) -> Result<(), DatabaseError> {
    let Read {
        mut source,
        records: found,
        field: own,
        ambiguous,
        imprecise,
        assumed,
        losses,
        empty,
        scaled,
        lit,
        bodies,
    } = read;
    let at = source.path.clone();
    let path = || at.clone();
    // A capture knows its field. That of a folder of images may be stated anew.
    let wanted = match source.kind {
        SourceKind::Capture => own.as_ref().or(field),
        SourceKind::Folder => field.or(own.as_ref()),
    };
    let contents = match (contents, wanted) {
        (Some(known), Some(wanted)) if !known.sources.is_empty() && !wanted.is_same_as(&known.field) => {
            let (found, known) = (wanted.title.clone(), known.field.title.clone());
            return Err(DatabaseError::OtherField { path: path(), found, known });
        }
        (Some(known), Some(wanted)) if known.sources.is_empty() => {
            known.field = checked(wanted, &at)?;
            known
        }
        (Some(known), _) => known,
        (none, Some(wanted)) => none.insert(Contents::new(checked(wanted, &at)?)),
        (None, None) => {
            let what = "a folder of images does not say on which field it was taken: name it with --field".to_owned();
            return Err(DatabaseError::Source { path: path(), what });
        }
    };
    let number = contents.sources.len() as u32;
    added.images += source.images;
    added.left_out += source.left_out;
    added.ambiguous += ambiguous;
    added.imprecise += imprecise;
    added.assumed += assumed;
    added.scaled.extend(scaled);
    added.losses.extend(losses);
    added.empty.extend(empty);
    if let Some(mask) = lit.mask(source.lens.width as usize) {
        let shows: Vec<bool> = mask.iter().map(|pixel| *pixel > 0).collect();
        let circle_deg = circle_deg(&source.lens, &without_rim(&shows, source.lens.width as usize));
        source.lens.fov_deg =
            circle_deg.map(|found| fov_with_circle(found, &source.lens, &contents.sources)).or(source.lens.fov_deg);
        source.dark = Some(masks::write_dark(folder, &source, mask)?);
    }
    if !bodies.is_empty() {
        let masks = bodies.iter().map(|body| masks::write_body(folder, &source, body));
        source.body_masks = masks.collect::<Result<_, _>>()?;
    }
    source.darkening = vignetting::measure(folder, &source, &found, &contents.field)?;
    source.hall = hall::measure(folder, &source, &found, &contents.field)?;
    source.moved = moved::measure(folder, &source, &found, &contents.field, progress)?;
    if source.goals && contents.field.goal.is_some() {
        source.goals = goals::are_present(folder, &source, &found, &contents.field)?.unwrap_or(true);
    }
    records.extend(found.into_iter().map(|record| Record { source: number, ..record }));
    contents.sources.push(source);
    Ok(())
}

/// The full angle of view of a lens, degrees: the circle found in its images, or a narrower one that the lens states.
///
/// If another source with the same lens has nearly the same angle, that is used, so that both share one lens in memory.
fn fov_with_circle(found_deg: f64, lens: &LensParameters, others: &[Source]) -> f64 {
    let fov_deg = found_deg.min(lens.fov_deg.unwrap_or(f64::INFINITY));
    let of_others = others.iter().filter(|other| other.lens.maps_as(lens)).filter_map(|other| other.lens.fov_deg);
    of_others.into_iter().find(|other| (other - fov_deg).abs() <= SAME_CIRCLE_DEG).unwrap_or(fov_deg)
}

/// Difference up to which the circles found in two captures are of the same lens, degrees of the full angle.
const SAME_CIRCLE_DEG: f64 = 2.0;

/// The field's dimensions, if they are possible.
fn checked(field: &FieldDimensions, path: &Path) -> Result<FieldDimensions, DatabaseError> {
    let failed = |source| DatabaseError::Field { path: path.to_owned(), source };
    Field::new(field.clone()).map(|field| field.dimensions().clone()).map_err(failed)
}

/// Makes a change visible: writes the new index, then the `database.json` that names it, and removes what is no longer used.
fn publish(folder: &Path, mut contents: Contents, records: Vec<Record>) -> Result<(), DatabaseError> {
    let old = path_of(folder, contents.index);
    contents.index += 1;
    write_index(&path_of(folder, contents.index), records)?;
    contents.write(folder)?;
    // Readers hold the old index in memory, and a file that stays behind does no harm.
    let _ = fs::remove_file(old);
    masks::remove_all_but(folder, &contents);
    Ok(())
}

/// Statistics of a database.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Stats {
    /// Number of images.
    pub images: usize,
    /// Title of the field.
    pub field: String,
    /// The captures and folders that the images are in.
    pub sources: Vec<Source>,
    /// Size of the index, bytes.
    pub index_bytes: usize,
    /// Least and greatest x, y, z of `camera_link` in `map`, metres; `null` without images.
    pub box_m: Option<[[f32; 3]; 2]>,
    /// Median standard deviation of the position, metres, over the images whose tags state one.
    pub sigma_m: Option<f32>,
    /// Median standard deviation of the rotation, degrees, over the images whose tags state one.
    pub sigma_deg: Option<f32>,
    /// Number of images whose pose has no stated accuracy.
    pub without_sigma: usize,
}

/// Computes the statistics of a database from its index.
pub fn stats(folder: &Path) -> Result<Stats, DatabaseError> {
    let (contents, index) = Contents::with_index(folder)?;
    let mut extent: Option<[[f32; 3]; 2]> = None;
    let (mut metres, mut radians) = (Vec::with_capacity(index.len()), Vec::with_capacity(index.len()));
    for record in index.records() {
        let [low, high] = extent.unwrap_or([record.place; 2]);
        let side = |of: fn(f32, f32) -> f32, known: [f32; 3]| core::array::from_fn(|i| of(known[i], record.place[i]));
        extent = Some([side(f32::min, low), side(f32::max, high)]);
        if record.says_how_good_it_is() {
            metres.push(record.sigma_m);
            radians.push(record.sigma_rad);
        }
    }
    let without_sigma = index.len() - metres.len();
    let median = |mut values: Vec<f32>| {
        values.sort_by(f32::total_cmp);
        values.get(values.len() / 2).copied()
    };
    Ok(Stats {
        images: index.len(),
        field: contents.field.title.clone(),
        sources: contents.sources,
        index_bytes: index.bytes(),
        box_m: extent,
        sigma_m: median(metres),
        sigma_deg: median(radians).map(f32::to_degrees),
        without_sigma,
    })
}

/// The result of [`verify`].
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Checked {
    /// Number of images in the index.
    pub images: usize,
    /// Number of images whose bytes are as they were indexed.
    pub sound: usize,
    /// Files that are missing or changed, and masks that cannot be read.
    pub losses: Vec<Loss>,
}

/// Reads the bytes of every image and compares their checksum with the index. A damaged index is an error.
pub fn verify(folder: &Path, progress: Progress) -> Result<Checked, DatabaseError> {
    let (contents, index) = Contents::with_index(folder)?;
    let mut checked = Checked { images: index.len(), sound: 0, losses: Vec::new() };
    for error in contents.sources.iter().filter_map(|source| Masks::read(folder, source).err()) {
        checked.losses.push(Loss::new(folder, error.to_string()));
    }
    for (path, what) in contents.sources.iter().filter_map(|source| moved::verify(folder, source).err()) {
        checked.losses.push(Loss::new(&path, what));
    }
    let mut wrong: std::collections::BTreeMap<PathBuf, (u64, String)> = Default::default();
    for (number, record) in index.records().enumerate() {
        match bytes_of(&contents, &record) {
            Ok(_) => checked.sound += 1,
            Err((path, what)) => wrong.entry(path).or_insert((0, what)).0 += 1,
        }
        progress(number as u64 + 1);
    }
    let told = |(path, (count, what)): (PathBuf, (u64, String))| Loss::new(&path, format!("{count} images: {what}"));
    checked.losses.extend(wrong.into_iter().map(told));
    Ok(checked)
}

/// The bytes of an image, if they are as they were indexed. The error holds the file and what is wrong.
pub(super) fn bytes_of(contents: &Contents, record: &Record) -> Result<Vec<u8>, (PathBuf, String)> {
    let file = contents.sources.get(record.source as usize).and_then(|source| source.file(record.file));
    let file =
        file.ok_or_else(|| (PathBuf::from("index"), "names a file that database.json does not know".to_owned()))?;
    let bytes = match read_image(&file, record) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            return Err((file, "gone since it was indexed".to_owned()));
        }
        Err(error) => return Err((file, format!("cannot be read: {error}"))),
    };
    if crc32fast::hash(&bytes) == record.crc {
        Ok(bytes)
    } else {
        Err((file, "changed since it was indexed".to_owned()))
    }
}
