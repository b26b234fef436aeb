//! The index file: a header, the splits of a k-d tree, and the records in the tree's order.
//!
//! The file is read whole and checked when it is opened. An image takes only 80 bytes, and later changes of the file by
//! another program or a failing disk do not affect a reader.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use super::error::{DatabaseError, io};
use super::kd_tree::{self, Metric, Search, Split};
use super::record::{RECORD_BYTES, Record};
use realitysim_config::plain_file;
use realitysim_geometry::{Isometry, Physical};

/// An index in memory. Index files are never changed, only replaced by new ones.
#[derive(Debug)]
pub struct Index {
    bytes: Vec<u8>,
    count: usize,
    records_at: usize,
}

/// An image near a pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Neighbour {
    /// Distance from the pose by the [`Metric`].
    pub distance: f64,
    /// Number of the image's record.
    pub number: usize,
}

const MAGIC: &[u8; 8] = b"RSIMVIEW";
const VERSION: u32 = 1;
/// Bytes of the header: magic number, version, CRC-32 of everything behind the header, number of records.
const HEADER_BYTES: usize = 24;
/// Bytes of a split: dimension and value.
const SPLIT_BYTES: usize = 8;
/// Most images of an index, 1.4 GB. A larger count is taken for damage.
const MAX_IMAGES: usize = 1 << 24;

/// Brings the records into the tree's order, writes the index, and forces it to disk.
pub fn write_index(path: &Path, mut records: Vec<Record>) -> Result<(), DatabaseError> {
    let splits = kd_tree::build(&mut records);
    let mut crc = crc32fast::Hasher::new();
    let parts = || {
        let splits = splits.iter().map(|split| {
            let mut bytes = [0; RECORD_BYTES];
            bytes[..4].copy_from_slice(&split.dimension.to_le_bytes());
            bytes[4..SPLIT_BYTES].copy_from_slice(&split.value.to_le_bytes());
            (bytes, SPLIT_BYTES)
        });
        splits.chain(records.iter().map(|record| (record.to_bytes(), RECORD_BYTES)))
    };
    parts().for_each(|(bytes, length)| crc.update(&bytes[..length]));
    let file = File::create(path).map_err(io(path))?;
    let mut writer = BufWriter::with_capacity(1 << 20, file);
    let write = || -> std::io::Result<()> {
        writer.write_all(MAGIC)?;
        writer.write_all(&VERSION.to_le_bytes())?;
        writer.write_all(&crc.finalize().to_le_bytes())?;
        writer.write_all(&(records.len() as u64).to_le_bytes())?;
        for (bytes, length) in parts() {
            writer.write_all(&bytes[..length])?;
        }
        writer.flush()?;
        writer.get_ref().sync_all()
    };
    write().map_err(io(path))
}

impl Index {
    /// Reads an index file. Its version, length and checksum must be right, and all poses possible.
    pub fn open(path: &Path) -> Result<Self, DatabaseError> {
        let damaged = |what: &str| DatabaseError::Damaged { path: path.to_owned(), what: what.to_owned() };
        let bytes = plain_file::read(path, bytes_of(MAX_IMAGES) as u64).map_err(io(path))?;
        let header = bytes.get(..HEADER_BYTES).ok_or_else(|| damaged("cut in its header"))?;
        if &header[..8] != MAGIC {
            return Err(damaged("no index of images"));
        }
        let version = u32::from_le_bytes([header[8], header[9], header[10], header[11]]);
        if version != VERSION {
            return Err(damaged(&format!("of version {version}, and this program reads version {VERSION}")));
        }
        let stated = u32::from_le_bytes(core::array::from_fn(|i| header[12 + i]));
        let count = usize::try_from(u64::from_le_bytes(core::array::from_fn(|i| header[16 + i])));
        let count = count.ok().filter(|count| *count <= MAX_IMAGES);
        let count = count.ok_or_else(|| damaged("its number of images makes no sense"))?;
        if bytes.len() != bytes_of(count) {
            return Err(damaged(&format!("{} bytes long, which does not fit its {count} images", bytes.len())));
        }
        if crc32fast::hash(&bytes[HEADER_BYTES..]) != stated {
            return Err(damaged("not as it was written: its checksum is another"));
        }
        let index = Self { bytes, count, records_at: records_at(count) };
        let wild = index.records().position(|record| !record.is_possible());
        match wild {
            Some(number) => Err(damaged(&format!("image {number} has a pose that no camera can have"))),
            None => Ok(index),
        }
    }

    /// Number of images.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Whether there is no image.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Size of the index file, bytes.
    pub fn bytes(&self) -> usize {
        self.bytes.len()
    }

    /// The record with this number. Panics if there is none.
    pub fn record(&self, number: usize) -> Record {
        Record::from_bytes(self.raw(number))
    }

    /// All records, in the order of their numbers.
    pub fn records(&self) -> impl Iterator<Item = Record> + '_ {
        (0..self.count).map(|number| self.record(number))
    }

    fn raw(&self, number: usize) -> &[u8; RECORD_BYTES] {
        assert!(number < self.count, "record {number} of {}", self.count);
        let (records, _) = self.bytes[self.records_at..].as_chunks::<RECORD_BYTES>();
        &records[number]
    }

    /// The `wanted` images nearest to a pose of `camera_link` in `map`, nearest first.
    pub fn nearest(&self, pose: &Isometry, wanted: usize, metric: &Metric) -> Vec<Neighbour> {
        let (splits, _) = self.bytes[HEADER_BYTES..self.records_at].as_chunks::<SPLIT_BYTES>();
        let search = Search {
            count: self.count,
            split: |node: usize| {
                let [a, b, c, d, e, f, g, h] = splits[node];
                Split { dimension: u32::from_le_bytes([a, b, c, d]), value: f32::from_le_bytes([e, f, g, h]) }
            },
            pose: |number: usize| {
                let raw = self.raw(number);
                let float = |i: usize| f32::from_le_bytes([raw[4 * i], raw[4 * i + 1], raw[4 * i + 2], raw[4 * i + 3]]);
                (core::array::from_fn(float), core::array::from_fn(|i| float(3 + i)))
            },
            metric,
            wanted,
        };
        let found = search.nearest(pose).into_iter();
        found.map(|(square, number)| Neighbour { distance: libm::sqrt(square), number }).collect()
    }
}

/// Where the records begin in an index of this many images, bytes.
fn records_at(count: usize) -> usize {
    HEADER_BYTES + SPLIT_BYTES * kd_tree::leaves(count).max(1)
}

/// Size of an index of this many images, bytes.
fn bytes_of(count: usize) -> usize {
    records_at(count) + RECORD_BYTES * count
}

/// The path of the index file with this number.
pub(super) fn path_of(folder: &Path, number: u64) -> PathBuf {
    folder.join(format!("index-{number:06}.bin"))
}

#[cfg(test)]
mod tests {
    use super::super::record::tests::record_at;
    use super::*;

    fn records(count: usize) -> Vec<Record> {
        (0..count).map(|i| record_at(i as f64 * 0.01, 0.3, 0.5, (i % 7) as f64)).collect()
    }

    #[test]
    fn what_was_written_is_found_again() {
        let folder = tempfile::tempdir().expect("a folder");
        for count in [0, 1, 24, 25, 1000] {
            let path = path_of(folder.path(), count as u64);
            write_index(&path, records(count)).expect("written");
            let index = Index::open(&path).expect("open");
            assert!(index.len() == count && index.bytes() == bytes_of(count));
            let metric = Metric::default();
            for record in records(count).iter().step_by(97) {
                let found = index.nearest(&record.pose(), 1, &metric);
                assert_eq!(index.record(found[0].number), *record);
            }
            assert_eq!(index.nearest(&record_at(0.0, 0.0, 0.0, 0.0).pose(), 8, &metric).len(), count.min(8));
        }
    }

    #[test]
    fn damage_is_noticed_and_never_a_panic() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = path_of(folder.path(), 1);
        write_index(&path, records(100)).expect("written");
        let whole = std::fs::read(&path).expect("readable");
        for length in [0, 7, 23, 24, 100, whole.len() - 1] {
            std::fs::write(&path, &whole[..length]).expect("written");
            let said = Index::open(&path).expect_err("cut").to_string();
            assert!(said.contains("index-000001.bin") && (length == 0 || said.contains("db rebuild")), "{said}");
        }
        for byte in (0..whole.len()).step_by(11) {
            let mut bytes = whole.clone();
            bytes[byte] ^= 0xff;
            std::fs::write(&path, &bytes).expect("written");
            Index::open(&path).expect_err("damaged");
        }
    }

    #[test]
    fn a_pose_that_no_camera_can_have_is_damage_even_with_the_right_checksum() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = path_of(folder.path(), 1);
        for wild in [
            Record { place: [f32::NAN, 0.0, 0.5], ..record_at(0.0, 0.0, 0.5, 0.0) },
            Record { place: [0.0, f32::INFINITY, 0.5], ..record_at(0.0, 0.0, 0.5, 0.0) },
            Record { rotation: [0.0; 4], ..record_at(0.0, 0.0, 0.5, 0.0) },
            Record { sigma_m: f32::INFINITY, ..record_at(0.0, 0.0, 0.5, 0.0) },
            Record { sigma_rad: -1.0, ..record_at(0.0, 0.0, 0.5, 0.0) },
        ] {
            write_index(&path, vec![wild]).expect("written");
            let said = Index::open(&path).expect_err("wild").to_string();
            assert!(said.contains("image 0 has a pose that no camera can have"), "{said}");
        }
    }

    #[test]
    fn what_is_done_to_the_file_afterwards_changes_nothing_for_a_reader() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = path_of(folder.path(), 1);
        write_index(&path, records(100)).expect("written");
        let index = Index::open(&path).expect("open");
        File::options().write(true).open(&path).expect("writable").set_len(10).expect("cut");
        let mut found: Vec<f32> = index.records().map(|record| record.place[0]).collect();
        found.sort_by(f32::total_cmp);
        assert!(found.iter().enumerate().all(|(i, x)| (x - i as f32 * 0.01).abs() < 1e-4), "{found:?}");
    }
}
