//! Columns of Parquet files: how values of Rust types are stored, and columns of them encoded and read.

use std::io::Write;

use bytes::Bytes;
use parquet::column::reader::{ColumnReader, ColumnReaderImpl};
use parquet::column::writer::{ColumnCloseResult, get_column_writer, get_typed_column_writer};
use parquet::data_type::{
    BoolType, ByteArray, ByteArrayType, DataType, FixedLenByteArray, FixedLenByteArrayType, FloatType, Int32Type,
    Int64Type,
};
use parquet::errors::{ParquetError, Result};
use parquet::file::properties::WriterPropertiesPtr;
use parquet::file::reader::RowGroupReader;
use parquet::file::writer::{SerializedPageWriter, SerializedRowGroupWriter, TrackedWrite};
use parquet::schema::types::ColumnDescPtr;

/// A value that a column can hold.
pub(super) trait Value: Sized {
    /// The physical type in the file.
    type Physical: DataType;
    /// Whether a value may be missing.
    const IS_OPTIONAL: bool = false;
    /// The physical type and what it means, as the text of a schema has them before and after the column's name.
    const TYPE: [&'static str; 2];

    /// The stored value, `None` for a missing one.
    fn stored(&self) -> Option<<Self::Physical as DataType>::T>;
    /// The value of a stored one; `None` if it makes no sense.
    fn restored(stored: Option<<Self::Physical as DataType>::T>) -> Option<Self>;

    /// The column's line in the text of a schema.
    fn declaration(name: &str) -> String {
        let [physical, meaning] = Self::TYPE;
        let repetition = if Self::IS_OPTIONAL { "optional" } else { "required" };
        format!("{repetition} {physical} {name} {meaning};\n")
    }
}

macro_rules! plain_values {
    ($($type:ty, $physical:ty, $text:literal;)*) => { $(
        impl Value for $type {
            type Physical = $physical;
            const TYPE: [&'static str; 2] = [$text, ""];

            fn stored(&self) -> Option<$type> {
                Some(*self)
            }

            fn restored(stored: Option<$type>) -> Option<Self> {
                stored
            }
        }
    )* };
}

plain_values! {
    bool, BoolType, "boolean";
    i32, Int32Type, "int32";
    i64, Int64Type, "int64";
    f32, FloatType, "float";
}

impl Value for String {
    type Physical = ByteArrayType;
    const TYPE: [&'static str; 2] = ["binary", "(STRING)"];

    fn stored(&self) -> Option<ByteArray> {
        Some(ByteArray::from(self.as_str()))
    }

    fn restored(stored: Option<ByteArray>) -> Option<Self> {
        stored?.as_utf8().ok().map(str::to_owned)
    }
}

impl Value for [u8; 16] {
    type Physical = FixedLenByteArrayType;
    const TYPE: [&'static str; 2] = ["fixed_len_byte_array(16)", ""];

    fn stored(&self) -> Option<FixedLenByteArray> {
        Some(FixedLenByteArray::from(self.to_vec()))
    }

    fn restored(stored: Option<FixedLenByteArray>) -> Option<Self> {
        stored?.data().try_into().ok()
    }
}

impl<V: Value> Value for Option<V> {
    type Physical = V::Physical;
    const IS_OPTIONAL: bool = true;
    const TYPE: [&'static str; 2] = V::TYPE;

    fn stored(&self) -> Option<<V::Physical as DataType>::T> {
        self.as_ref().and_then(V::stored)
    }

    fn restored(stored: Option<<V::Physical as DataType>::T>) -> Option<Self> {
        match stored {
            None => Some(None),
            stored => V::restored(stored).map(Some),
        }
    }
}

/// A column of a row group in the bytes of a file, and what the file's end says of it.
pub(super) struct EncodedColumn {
    bytes: Bytes,
    end: ColumnCloseResult,
}

impl EncodedColumn {
    /// Encodes the values of a column.
    pub(super) fn of<'a, V: Value + 'a>(
        values: impl Iterator<Item = &'a V>,
        column: ColumnDescPtr,
        properties: &WriterPropertiesPtr,
    ) -> Result<Self> {
        let mut sink = TrackedWrite::new(Vec::new());
        let pages = Box::new(SerializedPageWriter::new(&mut sink));
        let mut writer = get_typed_column_writer::<V::Physical>(get_column_writer(column, properties.clone(), pages));
        let stored: Vec<_> = values.map(V::stored).collect();
        let levels: Option<Vec<i16>> =
            V::IS_OPTIONAL.then(|| stored.iter().map(|value| i16::from(value.is_some())).collect());
        let present: Vec<_> = stored.into_iter().flatten().collect();
        writer.write_batch(&present, levels.as_deref(), None)?;
        let end = writer.close()?;
        Ok(Self { bytes: Bytes::from(sink.into_inner()?), end })
    }

    /// Writes the column as the next one of a row group.
    pub(super) fn write<W: Write + Send>(self, group: &mut SerializedRowGroupWriter<'_, W>) -> Result<()> {
        group.append_column(&self.bytes, self.end)
    }
}

/// Reads a column of a row group. The schema must be that of the rows.
pub(super) fn read_column<V: Value>(group: &dyn RowGroupReader, column: usize, count: usize) -> Result<Vec<V>> {
    let mut reader = typed::<V::Physical>(group.get_column_reader(column)?)?;
    let (mut levels, mut present) = (Vec::new(), Vec::new());
    let mut read = 0;
    while read < count {
        let (records, ..) =
            reader.read_records(count - read, V::IS_OPTIONAL.then_some(&mut levels), None, &mut present)?;
        if records == 0 {
            return Err(ParquetError::General(format!("column {column} ends after {read} of {count} rows")));
        }
        read += records;
    }
    let mut present = present.into_iter();
    let is_there = |row: usize| !V::IS_OPTIONAL || levels.get(row) == Some(&1);
    let value = |row: usize| V::restored(if is_there(row) { present.next() } else { None });
    let values: Option<Vec<V>> = (0..count).map(value).collect();
    values.ok_or_else(|| ParquetError::General(format!("column {column} has a value that makes no sense")))
}

fn typed<T: DataType>(reader: ColumnReader) -> Result<ColumnReaderImpl<T>> {
    T::get_column_reader(reader).ok_or_else(|| ParquetError::General("a column has another type".to_owned()))
}
