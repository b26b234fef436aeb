//! Parquet files of a catalogue: the rows of one session, and where they are from.

use std::fs::File;
use std::path::Path;
use std::sync::Arc;

use parquet::basic::{Compression, Encoding, ZstdLevel};
use parquet::errors::ParquetError;
use parquet::file::metadata::{KeyValue, RowGroupMetaData};
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::file::statistics::Statistics;
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::parser::parse_message_type;
use parquet::schema::types::{ColumnPath, SchemaDescriptor};
use serde::{Deserialize, Serialize};

use super::blocks::arrange;
use super::error::{CatalogueError, damaged, io};
use super::row::{COLUMNS, CatalogueRow, Packing, encode_group, read_group, schema_text};
use realitysim_config::plain_file;
use realitysim_database::in_parallel;

/// Version of the files. Readers refuse any other.
pub const FORMAT: u64 = 2;
/// Key of the [`FileHead`], as JSON, in the metadata of a file.
const HEAD_KEY: &str = "realitysim.catalogue";
/// Rows of a row group. A walk of ten minutes at 30 Hz has 36 of them, so that a range of poses prunes within a session.
pub(super) const MAX_GROUP_ROWS: usize = 512;

/// Where the rows of a file are from.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileHead {
    /// Version of the file's format, [`FORMAT`].
    pub format: u64,
    /// Name of the session's folder.
    pub session: String,
    /// Identity of the session.
    pub session_id: String,
    /// Absolute path of the capture that was read.
    pub capture: String,
    /// Hash of what the capture was then: session, manifest, names and sizes of segments, refined tags.
    pub source_hash: String,
    /// Number of rows with a valid tag.
    pub valid: u64,
}

impl Default for FileHead {
    fn default() -> Self {
        let nothing = String::new;
        Self {
            format: FORMAT,
            session: nothing(),
            session_id: nothing(),
            capture: nothing(),
            source_hash: nothing(),
            valid: 0,
        }
    }
}

/// Puts rows with like poses in one row group and makes the bytes of their file. The same rows give the same bytes.
pub fn parquet_of_rows(head: &FileHead, rows: &[CatalogueRow]) -> Result<Vec<u8>, CatalogueError> {
    let schema = Arc::new(parse_message_type(&schema_text())?);
    let properties = Arc::new(properties(head)?);
    let mut writer = SerializedFileWriter::new(Vec::new(), Arc::clone(&schema), Arc::clone(&properties))?;
    let rows = arrange(rows, MAX_GROUP_ROWS);
    let groups: Vec<&[&CatalogueRow]> = rows.chunks(MAX_GROUP_ROWS).collect();
    let schema = SchemaDescriptor::new(schema);
    for columns in in_parallel(groups.len(), |number| encode_group(groups[number], &schema, &properties)) {
        let mut group = writer.next_row_group()?;
        for column in columns? {
            column.write(&mut group)?;
        }
        group.close()?;
    }
    Ok(writer.into_inner()?)
}

/// Reads all rows of a file, in its order.
///
/// # Errors
///
/// Fails as [`read_head`] does, and if a part of the file is damaged.
pub fn read_rows(path: &Path) -> Result<Vec<CatalogueRow>, CatalogueError> {
    let reader = open(path)?;
    head_of(path, &reader)?;
    let mut rows = Vec::new();
    for number in 0..reader.num_row_groups() {
        let group = reader.get_row_group(number).map_err(damaged(path))?;
        let count = usize::try_from(group.metadata().num_rows()).unwrap_or_default().min(MAX_GROUP_ROWS);
        rows.extend(read_group(&*group, count).map_err(damaged(path))?);
    }
    Ok(rows)
}

/// Reads where the rows of a file are from, and their number, from its end.
///
/// # Errors
///
/// Fails if the file is cut, no file of a catalogue, or of another format.
pub fn read_head(path: &Path) -> Result<(FileHead, u64), CatalogueError> {
    let reader = open(path)?;
    let head = head_of(path, &reader)?;
    Ok((head, u64::try_from(reader.metadata().file_metadata().num_rows()).unwrap_or_default()))
}

fn open(path: &Path) -> Result<SerializedFileReader<File>, CatalogueError> {
    SerializedFileReader::new(plain_file::open(path).map_err(io(path))?).map_err(damaged(path))
}

fn head_of(path: &Path, reader: &SerializedFileReader<File>) -> Result<FileHead, CatalogueError> {
    #[derive(Deserialize)]
    struct Version {
        format: u64,
    }
    let metadata = reader.metadata().file_metadata();
    let pairs = metadata.key_value_metadata().into_iter().flatten();
    let text = pairs.filter(|pair| pair.key == HEAD_KEY).find_map(|pair| pair.value.as_deref());
    let text = text.ok_or_else(|| CatalogueError::Foreign { path: path.to_owned() })?;
    let Version { format } = serde_json::from_str(text).map_err(damaged(path))?;
    if format != FORMAT {
        return Err(CatalogueError::Newer { path: path.to_owned(), format });
    }
    if *metadata.schema() != parse_message_type(&schema_text())? {
        return Err(damaged(path)("its columns are others"));
    }
    serde_json::from_str(text).map_err(damaged(path))
}

/// A range of poses, both ends included.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseRange {
    /// Least and greatest x, metres.
    pub x_m: [f32; 2],
    /// Least and greatest y, metres.
    pub y_m: [f32; 2],
    /// Least and greatest yaw, degrees.
    pub yaw_deg: [f32; 2],
}

/// Number of row groups of a file that a query for a range of poses must read, and of all. The others' statistics exclude it.
pub fn pruned_groups(path: &Path, range: &PoseRange) -> Result<[usize; 2], CatalogueError> {
    let reader = open(path)?;
    let wanted = [("x_m", range.x_m), ("y_m", range.y_m), ("yaw_deg", range.yaw_deg)];
    let may_hold = |group: &RowGroupMetaData| wanted.iter().all(|(name, ends)| may_overlap(group, name, *ends));
    let groups = reader.metadata().row_groups();
    Ok([groups.iter().filter(|group| may_hold(group)).count(), groups.len()])
}

/// Whether the statistics of a column leave it possible that one of its values lies between `low` and `high`.
fn may_overlap(group: &RowGroupMetaData, name: &str, [low, high]: [f32; 2]) -> bool {
    let column = COLUMNS.iter().position(|(column, _)| *column == name).map(|index| group.column(index));
    match column.and_then(|column| column.statistics()) {
        Some(Statistics::Float(found)) => match (found.min_opt(), found.max_opt()) {
            (Some(min), Some(max)) => *min <= high && *max >= low,
            // Without a value there is no pose in the row group.
            _ => false,
        },
        _ => true,
    }
}

fn properties(head: &FileHead) -> Result<WriterProperties, CatalogueError> {
    let text = serde_json::to_string(head).map_err(|error| ParquetError::General(error.to_string()))?;
    let builder = WriterProperties::builder()
        .set_created_by("realitysim-catalogue".to_owned())
        .set_compression(Compression::ZSTD(ZstdLevel::try_new(ZSTD_LEVEL)?))
        .set_key_value_metadata(Some(vec![KeyValue::new(HEAD_KEY.to_owned(), text)]))
        .set_statistics_enabled(EnabledStatistics::Chunk);
    let without_statistics = UNASKED.into_iter().fold(builder, |builder, name| {
        builder.set_column_statistics_enabled(ColumnPath::from(name), EnabledStatistics::None)
    });
    let with_packing = COLUMNS.iter().fold(without_statistics, |builder, (name, packing)| {
        let column = ColumnPath::from(*name);
        let builder = builder.set_column_dictionary_enabled(column.clone(), *packing == Packing::Dictionary);
        match packing {
            Packing::Dictionary => builder,
            Packing::Deltas => builder.set_column_encoding(column, Encoding::DELTA_BINARY_PACKED),
            Packing::ByByte => builder.set_column_encoding(column, Encoding::BYTE_STREAM_SPLIT),
            Packing::Plain => builder.set_column_statistics_enabled(column, EnabledStatistics::None),
        }
    });
    Ok(with_packing.build())
}

/// Columns whose least and greatest value in a row group would exclude none of them; they take a tenth of a file.
const UNASKED: [&str; 13] = [
    "segment",
    "offset",
    "length",
    "blake3",
    "sigma_x_m",
    "sigma_y_m",
    "sigma_z_m",
    "sigma_rx_deg",
    "sigma_ry_deg",
    "sigma_rz_deg",
    "residual",
    "lines_expected",
    "lines_fitting",
];

/// Level of compression: zstd's own default.
const ZSTD_LEVEL: i32 = 3;
