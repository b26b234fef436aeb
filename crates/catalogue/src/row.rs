//! The rows of a catalogue.

use parquet::errors::{ParquetError, Result};
use parquet::file::properties::WriterPropertiesPtr;
use parquet::file::reader::RowGroupReader;
use parquet::schema::types::SchemaDescriptor;

use super::column::{EncodedColumn, Value, read_column};

/// How the values of a column are encoded before they are compressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Packing {
    /// Numbers of a dictionary: few different values.
    Dictionary,
    /// Differences of neighbouring numbers.
    Deltas,
    /// The first bytes of all numbers, then the second bytes, and so on: measured numbers.
    ByByte,
    /// As they are: nothing makes a hash smaller.
    Plain,
}

/// Declares the columns once: as fields of a row, in the schema, and for the writer and the reader.
macro_rules! columns {
    ($($(#[doc = $text:literal])* $name:ident: $type:ty, $packing:ident;)*) => {
        /// One frame of a capture. Columns without a value are `None`: pose and cell of a frame whose tag is not valid, and the place
        /// of a frame that was tagged and not written.
        #[derive(Clone, Debug, Default, PartialEq)]
        pub struct CatalogueRow {
            $($(#[doc = $text])* pub $name: $type,)*
        }

        /// Names of the columns in their order, and how they are packed.
        pub(super) const COLUMNS: &[(&str, Packing)] = &[$((stringify!($name), Packing::$packing)),*];

        /// The schema as text.
        pub(super) fn schema_text() -> String {
            let columns = [$(<$type as Value>::declaration(stringify!($name))),*];
            format!("message frame {{\n{}}}", columns.concat())
        }

        /// Encodes rows as the columns of a row group.
        pub(super) fn encode_group(
            rows: &[&CatalogueRow],
            schema: &SchemaDescriptor,
            properties: &WriterPropertiesPtr,
        ) -> Result<Vec<EncodedColumn>> {
            let mut columns = schema.columns().iter().cloned();
            let mut next = || columns.next().ok_or_else(|| ParquetError::General("the schema has fewer columns than a row".to_owned()));
            Ok(vec![$(EncodedColumn::of::<$type>(rows.iter().map(|row| &row.$name), next()?, properties)?),*])
        }

        /// Reads the rows of a row group, whose schema must be that of [`schema_text`].
        pub(super) fn read_group(group: &dyn RowGroupReader, count: usize) -> Result<Vec<CatalogueRow>> {
            let mut rows = vec![CatalogueRow::default(); count];
            let mut column = 0..;
            $(for (row, value) in rows.iter_mut().zip(read_column::<$type>(group, column.next().unwrap_or_default(), count)?) {
                row.$name = value;
            })*
            Ok(rows)
        }
    };
}

columns! {
    /// Name of the session's folder.
    session: String, Dictionary;
    /// Identity of the session: 32 hexadecimal digits.
    session_id: String, Dictionary;
    /// Number of the frame within the session.
    sequence: i64, Deltas;
    /// Time of exposure by the image's stamp, nanoseconds.
    stamp_ns: i64, Deltas;
    /// Name of the segment's file that holds the image; `None` if the image was not written or its place is not known.
    segment: Option<String>, Dictionary;
    /// Where the image message's data begin in the segment, bytes.
    offset: Option<i64>, Deltas;
    /// Length of the image message's data, bytes.
    length: Option<i32>, Deltas;
    /// The first 16 bytes of the BLAKE3 hash of the image message's data.
    blake3: Option<[u8; 16]>, Plain;
    /// Whether the tag is valid. If not, pose, standard deviations and cell are `None`.
    valid: bool, Dictionary;
    /// Reason why the tag is not valid; empty if it is.
    reason: String, Dictionary;
    /// Whether the half of the field is not known.
    ambiguous: bool, Dictionary;
    /// Whether the pose is one of `refine`.
    refined: bool, Dictionary;
    /// x of `camera_link` in `map`, metres, to 2^-13 m.
    x_m: Option<f32>, ByByte;
    /// y of `camera_link` in `map`, metres, to 2^-13 m.
    y_m: Option<f32>, ByByte;
    /// z of `camera_link` in `map`, metres, to 2^-13 m.
    z_m: Option<f32>, ByByte;
    /// Yaw of `camera_link` in `map`, degrees, −180 to 180, to 2^-7 degrees.
    yaw_deg: Option<f32>, ByByte;
    /// Pitch, degrees, to 2^-7 degrees; above 0 it looks down.
    pitch_deg: Option<f32>, ByByte;
    /// Roll, degrees, to 2^-7 degrees.
    roll_deg: Option<f32>, ByByte;
    /// Standard deviation of x, metres, to 0.4 %, as all standard deviations.
    sigma_x_m: Option<f32>, ByByte;
    /// Standard deviation of y, metres.
    sigma_y_m: Option<f32>, ByByte;
    /// Standard deviation of z, metres.
    sigma_z_m: Option<f32>, ByByte;
    /// Standard deviation of the rotation about the x axis of `map`, degrees.
    sigma_rx_deg: Option<f32>, ByByte;
    /// Standard deviation of the rotation about the y axis of `map`, degrees.
    sigma_ry_deg: Option<f32>, ByByte;
    /// Standard deviation of the rotation about the z axis of `map`, degrees.
    sigma_rz_deg: Option<f32>, ByByte;
    /// Share of the expected line contrast that was found, to 0.4 %.
    residual: f32, ByByte;
    /// Number of line places that the pose expects and nothing hides.
    lines_expected: i32, Deltas;
    /// Number of these where a line was found that fits.
    lines_fitting: i32, Deltas;
    /// Mean of green over the pixels that are not black, 0 to 255; `None` if the image was not written or does not decode.
    brightness: Option<i32>, Deltas;
    /// Mean absolute second difference of green along the rows over the mean of green, to 0.4 %; higher is sharper.
    sharpness: Option<f32>, ByByte;
    /// Name and version of the program that tagged the session.
    software: String, Dictionary;
    /// Hash of the settings that the session was tagged with: 16 hexadecimal digits.
    config_hash: String, Dictionary;
    /// Number of the cell along x: the floor of `x_m` / 0.5.
    cell_x: Option<i32>, Dictionary;
    /// Number of the cell along y: the floor of `y_m` / 0.5.
    cell_y: Option<i32>, Dictionary;
    /// Number of the cell of yaw: the floor of `yaw_deg` / 30.
    cell_yaw: Option<i32>, Dictionary;
}

/// Side of a cell in x and y, metres.
pub(super) const CELL_M: f32 = 0.5;
/// Size of a cell in yaw, degrees.
pub(super) const CELL_DEG: f32 = 30.0;

/// A cell of poses: frames of one cell show nearly the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct PoseCell {
    /// Numbers along x, y and yaw.
    pub numbers: [i32; 3],
}

impl PoseCell {
    /// The cell of a position in metres and a yaw in degrees.
    pub fn of(x_m: f32, y_m: f32, yaw_deg: f32) -> Self {
        let numbers = [x_m / CELL_M, y_m / CELL_M, yaw_deg / CELL_DEG].map(|number| number.floor() as i32);
        Self { numbers }
    }
}

impl CatalogueRow {
    /// States the pose: x, y, z in metres, yaw, pitch, roll in degrees, and the cell that it lies in. All are rounded to what a
    /// tag can be known to.
    pub fn set_pose(&mut self, position_m: [f64; 3], angles_deg: [f64; 3]) {
        let [x, y, z] = position_m.map(|metres| rounded(metres, METRE_STEPS));
        let [yaw, pitch, roll] = angles_deg.map(|degrees| rounded(degrees, DEGREE_STEPS));
        [self.x_m, self.y_m, self.z_m] = [x, y, z].map(Some);
        [self.yaw_deg, self.pitch_deg, self.roll_deg] = [yaw, pitch, roll].map(Some);
        [self.cell_x, self.cell_y, self.cell_yaw] = PoseCell::of(x, y, yaw).numbers.map(Some);
    }

    /// States standard deviations: x, y, z in metres, and rotations about the axes of `map` in degrees.
    pub fn set_sigmas(&mut self, sigmas: [f64; 6]) {
        let [x, y, z, rx, ry, rz] = sigmas.map(|sigma| Some(short(sigma as f32)));
        [self.sigma_x_m, self.sigma_y_m, self.sigma_z_m] = [x, y, z];
        [self.sigma_rx_deg, self.sigma_ry_deg, self.sigma_rz_deg] = [rx, ry, rz];
    }
}

/// Steps of a metre: 0.12 mm, a tenth of what the best tags are known to.
const METRE_STEPS: f64 = 8192.0;
/// Steps of a degree: 0.008 degrees, a tenth of what the best tags are known to.
const DEGREE_STEPS: f64 = 128.0;

fn rounded(value: f64, steps: f64) -> f32 {
    ((value * steps).round() / steps) as f32
}

/// A number to eight binary digits, as bfloat16 has: the lower half of its bytes is 0 and takes no room.
pub(super) fn short(value: f32) -> f32 {
    if value.is_finite() { f32::from_bits(value.to_bits().saturating_add(0x8000) & 0xffff_0000) } else { value }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn a_pose_is_rounded_to_a_tenth_of_its_accuracy(x in -50.0..50.0, yaw in -180.0..180.0, sigma in 1e-6..100.0) {
            let mut row = CatalogueRow::default();
            row.set_pose([x, 0.0, 0.0], [yaw, 0.0, 0.0]);
            row.set_sigmas([sigma; 6]);
            let differs = |found: Option<f32>, wanted: f64| (f64::from(found.unwrap()) - wanted).abs();
            prop_assert!(differs(row.x_m, x) <= 0.5 / METRE_STEPS + 4e-6);
            prop_assert!(differs(row.yaw_deg, yaw) <= 0.5 / DEGREE_STEPS + 1e-5);
            prop_assert!(differs(row.sigma_rz_deg, sigma) <= 0.004 * sigma);
        }

        #[test]
        fn a_pose_lies_in_its_cell(x in -50.0..50.0, y in -50.0..50.0, yaw in -180.0..180.0) {
            let mut row = CatalogueRow::default();
            row.set_pose([x, y, 0.0], [yaw, 0.0, 0.0]);
            let low = |cell: Option<i32>, side: f32| cell.unwrap() as f32 * side;
            prop_assert!((0.0..CELL_M).contains(&(row.x_m.unwrap() - low(row.cell_x, CELL_M))));
            prop_assert!((0.0..CELL_M).contains(&(row.y_m.unwrap() - low(row.cell_y, CELL_M))));
            prop_assert!((0.0..CELL_DEG).contains(&(row.yaw_deg.unwrap() - low(row.cell_yaw, CELL_DEG))));
        }
    }
}
