//! What stands before the hall in a source's images: found when the source is added, and kept in a file of the database.
//!
//! The file has one entry of equal size for each image, in ascending order of file number and offset: these two (u32, u64,
//! little-endian), and one bit for each block of [`realitysim_views::moved_blocks`], the first in the lowest bit. It is read
//! entry by entry, so that it takes no memory.

use core::cmp::Ordering;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::{fs, io};

use super::build::Progress;
use super::contents::Source;
use super::error::DatabaseError;
use super::image_database::shown_by;
use super::parallel::in_parallel;
use super::pixels::{colours, read_bytes, read_image};
use super::record::Record;
use realitysim_config::plain_file;
use realitysim_geometry::{Field, FieldDimensions, Isometry, Lens};
use realitysim_recording::write_atomically;
use realitysim_views::{BlockImage, Camera, Raster, World, angle_between, block_grid, moved_blocks};

/// Start of the names of these files.
pub(super) const MOVED: &str = "moved-";

/// Bytes of an entry before its bits: file number and offset.
const KEY_BYTES: usize = 12;
/// Bytes that are read at once when the file is checked.
const READ_BYTES: u64 = 1 << 20;
/// Images are compared within groups of this many that follow each other; their blocks take 77 KB each.
const MAX_GROUP: usize = 600;
/// Number of images that one image is compared with.
const OTHERS: usize = 12;
/// Distances from which images are compared, metres: a person has moved before the hall, and the hall still looks alike.
const APART_M: core::ops::RangeInclusive<f64> = 0.2..=1.6;
/// Angle up to which images are compared, radians.
const TURNED_BY_RAD: f64 = 0.9;

/// Finds what stands before the hall in each of a source's images, and writes it. Returns the file's name, or `None` if the
/// hall is unknown, no image shows anything of that kind, or none has enough others to compare it with.
pub(super) fn measure(
    folder: &Path,
    source: &Source,
    records: &[Record],
    field: &FieldDimensions,
    progress: Progress,
) -> Result<Option<String>, DatabaseError> {
    if source.hall.is_unknown() {
        return Ok(None);
    }
    let lens = Lens::new(source.lens.clone())
        .map_err(|error| DatabaseError::Lens { path: source.path.clone(), source: error })?;
    let field =
        Field::new(field.clone()).map_err(|error| DatabaseError::Field { path: source.path.clone(), source: error })?;
    let world = World::without_goals(&field).with_hall(source.hall);
    let camera = Camera::new(&lens);
    let shows = shown_by(folder, source, &camera)?;
    let mut sorted: Vec<&Record> = records.iter().collect();
    sorted.sort_unstable_by_key(|record| (record.file, record.offset));
    let image = |record: &Record| -> Option<BlockImage> {
        let bytes = read_image(&source.file(record.file)?, record).ok()?;
        let colours = colours(&bytes, record.form).ok()?;
        let raster = Raster::from_rgb(colours.width, colours.height, &colours.rgb, &shows)?;
        Some(BlockImage::new(&camera, &record.pose(), &raster))
    };
    let mut bytes = Vec::new();
    let (mut any, mut done) = (false, 0);
    for group in sorted.chunks(MAX_GROUP) {
        let images: Vec<Option<BlockImage>> = in_parallel(group.len(), |number| image(group[number]));
        let poses: Vec<Isometry> = group.iter().map(|record| record.pose()).collect();
        let compared = |number: usize| {
            let others: Vec<&BlockImage> =
                partners(&poses, number).into_iter().filter_map(|other| images[other].as_ref()).collect();
            images[number].as_ref().and_then(|own| moved_blocks(own, &others, &world))
        };
        let nothing = || vec![false; blocks_of(source)];
        let found = in_parallel(group.len(), |number| compared(number).unwrap_or_else(nothing));
        for (record, blocks) in group.iter().zip(found) {
            any |= blocks.contains(&true);
            bytes.extend(record.file.to_le_bytes());
            bytes.extend(record.offset.to_le_bytes());
            bytes.extend(packed(&blocks));
        }
        done += group.len() as u64;
        progress(done);
    }
    if !any {
        return Ok(None);
    }
    let name = name_of(crc32fast::hash(&bytes));
    let path = folder.join(&name);
    write_atomically(&path, &bytes)?;
    Ok(Some(name))
}

/// One bit for each block, the first in the lowest bit.
fn packed(blocks: &[bool]) -> Vec<u8> {
    let byte = |eight: &[bool]| eight.iter().zip(0..).map(|(moved, bit)| u8::from(*moved) << bit).sum();
    blocks.chunks(8).map(byte).collect()
}

/// Numbers of the images that image `number` is compared with: spread over those at a suitable distance.
fn partners(poses: &[Isometry], number: usize) -> Vec<usize> {
    let own = &poses[number];
    let distance = |other: usize| poses[other].translation.distance(own.translation);
    let suits =
        |other: &usize| APART_M.contains(&distance(*other)) && angle_between(&poses[*other], own) <= TURNED_BY_RAD;
    let mut suitable: Vec<usize> = (0..poses.len()).filter(suits).collect();
    suitable.sort_by(|a, b| distance(*a).total_cmp(&distance(*b)));
    let count = suitable.len();
    (0..OTHERS.min(count)).map(|which| suitable[which * count / OTHERS.min(count)]).collect()
}

/// Number of blocks of a source's images.
fn blocks_of(source: &Source) -> usize {
    let (columns, rows) = block_grid(source.lens.width as usize, source.lens.height as usize);
    columns * rows
}

/// The file of one source, held open: a change of the database does not take it away from those who use it.
#[derive(Debug)]
pub(super) struct MovedBlocks {
    file: fs::File,
    /// Number of blocks of an image.
    blocks: usize,
    entries: u64,
}

impl MovedBlocks {
    /// Opens the file of a source of the database in `folder`; `None` if there is none.
    pub(super) fn open(folder: &Path, source: &Source) -> Result<Option<Self>, DatabaseError> {
        let Some(name) = &source.moved else { return Ok(None) };
        let path = folder.join(name);
        let damaged = |what: String| DatabaseError::Damaged { path: path.clone(), what };
        let file = plain_file::open(&path).map_err(|error| damaged(error.to_string()))?;
        let length = file.metadata().map_err(|error| damaged(error.to_string()))?.len();
        let blocks = blocks_of(source);
        let size = entry_bytes(blocks) as u64;
        if !length.is_multiple_of(size) {
            return Err(damaged(format!("has {length} bytes, no multiple of {size}")));
        }
        Ok(Some(Self { file, blocks, entries: length / size }))
    }

    /// The blocks of an image that show something before the hall; `None` if the file says nothing of the image.
    pub(super) fn read(&self, record: &Record) -> io::Result<Option<Vec<bool>>> {
        let size = entry_bytes(self.blocks);
        let mut entry = vec![0; size];
        let (mut low, mut high) = (0, self.entries);
        while low < high {
            let middle = (low + high) / 2;
            self.file.read_exact_at(&mut entry, middle * size as u64)?;
            match key(&entry).cmp(&(record.file, record.offset)) {
                Ordering::Less => low = middle + 1,
                Ordering::Greater => high = middle,
                Ordering::Equal => {
                    let bit = |index: usize| entry[KEY_BYTES + index / 8] >> (index % 8) & 1 == 1;
                    return Ok(Some((0..self.blocks).map(bit).collect()));
                }
            }
        }
        Ok(None)
    }
}

/// Size of an entry for an image of this many blocks.
fn entry_bytes(blocks: usize) -> usize {
    KEY_BYTES + blocks.div_ceil(8)
}

/// Checks that the file is as it was written: its name is made of its checksum.
pub(super) fn verify(folder: &Path, source: &Source) -> Result<(), (PathBuf, String)> {
    let Some(name) = &source.moved else { return Ok(()) };
    let path = folder.join(name);
    let failed = |error: io::Error| (path.clone(), error.to_string());
    let mut left = fs::metadata(&path).map_err(failed)?.len();
    let (mut hash, mut offset) = (crc32fast::Hasher::new(), 0);
    while left > 0 {
        let length = left.min(READ_BYTES);
        hash.update(&read_bytes(&path, offset, length as u32).map_err(failed)?);
        (left, offset) = (left - length, offset + length);
    }
    match *name == name_of(hash.finalize()) {
        true => Ok(()),
        false => Err((path, "changed since it was written: `realitysim db rebuild` makes it anew".to_owned())),
    }
}

/// The name of a file with this checksum.
fn name_of(hash: u32) -> String {
    format!("{MOVED}{hash:08x}.bin")
}

/// File number and offset of an entry.
fn key(entry: &[u8]) -> (u32, u64) {
    let part =
        |from: usize, to: usize| entry[from..to].iter().rev().fold(0, |value, byte| value << 8 | u64::from(*byte));
    (part(0, 4) as u32, part(4, KEY_BYTES))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use realitysim_geometry::Euler;

    #[test]
    fn images_are_compared_with_others_that_look_the_same_way_from_elsewhere() {
        let pose =
            |x: f64, yaw: f64| Isometry::from_euler(Euler { yaw, pitch: 0.3, roll: 0.0 }, DVec3::new(x, 0.0, 0.5));
        let poses: Vec<Isometry> =
            (0..60).map(|step| pose(0.1 * f64::from(step), 0.0)).chain([pose(0.5, 2.0)]).collect();
        let found = partners(&poses, 0);
        assert_eq!(found.len(), OTHERS);
        assert!(found.iter().all(|other| (2..=16).contains(other)), "{found:?}");
        assert!(partners(&poses[..2], 0).is_empty());
    }

    fn source(moved: Option<String>) -> Source {
        let lens = realitysim_config::load_lens("fisheye-640").expect("a shipped lens").lens.parameters().clone();
        let source = serde_json::json!({
            "kind": "folder", "path": "nowhere", "lens": lens, "files": [], "body_masks": [], "dark": null,
            "moved": moved, "images": 0, "left_out": 0,
        });
        serde_json::from_value(source).expect("a source")
    }

    fn record(file: u32, offset: u64) -> Record {
        Record { file, offset, ..Record::at(&Isometry::IDENTITY) }
    }

    #[test]
    fn each_image_finds_its_own_entry_and_damage_is_told() {
        let folder = tempfile::tempdir().expect("a folder");
        let count = blocks_of(&source(None));
        let entry = |(file, offset, marked): (u32, u64, usize)| {
            let blocks: Vec<bool> = (0..count).map(|block| block == marked).collect();
            [&file.to_le_bytes()[..], &offset.to_le_bytes(), &packed(&blocks)].concat()
        };
        let entries = [(0, 5, 3), (0, 1 << 40, 17), (2, 0, count - 1)];
        let bytes: Vec<u8> = entries.into_iter().flat_map(entry).collect();
        let name = name_of(crc32fast::hash(&bytes));
        let path = folder.path().join(&name);
        fs::write(&path, &bytes).expect("written");
        let source = source(Some(name));
        let file = MovedBlocks::open(folder.path(), &source).expect("sound").expect("there");
        for (number, offset, marked) in entries {
            let blocks = file.read(&record(number, offset)).expect("read").expect("an entry");
            assert_eq!(blocks.iter().position(|moved| *moved), Some(marked));
            assert_eq!(blocks.iter().filter(|moved| **moved).count(), 1);
        }
        assert_eq!(file.read(&record(1, 0)).expect("read"), None);
        assert_eq!(verify(folder.path(), &source), Ok(()));
        fs::write(&path, [&bytes[..40], &[9], &bytes[41..]].concat()).expect("written");
        assert!(verify(folder.path(), &source).expect_err("changed").1.contains("realitysim db rebuild"));
        fs::write(&path, &bytes[1..]).expect("written");
        assert!(matches!(MovedBlocks::open(folder.path(), &source), Err(DatabaseError::Damaged { .. })));
        fs::remove_file(&path).expect("removed");
        assert!(matches!(MovedBlocks::open(folder.path(), &source), Err(DatabaseError::Damaged { .. })));
    }
}
