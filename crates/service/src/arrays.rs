//! Arrays in the file formats of numpy: one as `.npy`, several as `.npz`.
//!
//! The formats are those of `numpy.lib.format`, version 1.0. An `.npz` is a ZIP archive of `.npy` files. Its members are stored
//! without compression, so that a program reads them at the speed of memory.

use std::io::{Cursor, Write};

use zip::result::ZipResult;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

/// The values of an array, row by row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Values<'a> {
    /// Bytes.
    U8(&'a [u8]),
    /// 64-bit integers.
    I64(&'a [i64]),
    /// 32-bit floating point numbers.
    F32(&'a [f32]),
    /// 64-bit floating point numbers.
    F64(&'a [f64]),
}

/// The header's end, and with it the first value, lies at a multiple of this many bytes.
const ALIGNMENT: usize = 64;

/// Writes one array as `.npy`. `shape` has one number for each axis, the slowest first; their product is the number of values.
pub fn npy(shape: &[usize], values: Values) -> Vec<u8> {
    let (kind, data) = match values {
        Values::U8(values) => ("|u1", values.to_vec()),
        Values::I64(values) => ("<i8", values.iter().flat_map(|value| value.to_le_bytes()).collect()),
        Values::F32(values) => ("<f4", values.iter().flat_map(|value| value.to_le_bytes()).collect()),
        Values::F64(values) => ("<f8", values.iter().flat_map(|value| value.to_le_bytes()).collect()),
    };
    let sides: String = shape.iter().map(|side| format!("{side}, ")).collect();
    let mut header = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({sides}), }}");
    // Magic, version and length come before the header's text, a line feed after it.
    let before = 10;
    let padding = (before + header.len() + 1).next_multiple_of(ALIGNMENT) - before - header.len() - 1;
    header.push_str(&" ".repeat(padding));
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend(data);
    bytes
}

/// Puts arrays together as `.npz`. Each has a name and its `.npy`.
///
/// # Errors
///
/// An error of the archive's writer, which memory does not give.
pub(super) fn npz(arrays: &[(&str, Vec<u8>)]) -> ZipResult<Vec<u8>> {
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    let stored = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
    for (name, array) in arrays {
        archive.start_file(format!("{name}.npy"), stored)?;
        archive.write_all(array)?;
    }
    Ok(archive.finish()?.into_inner())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_array_begins_with_a_header_of_whole_lines() {
        let bytes = npy(&[2, 3], Values::F32(&[0.5; 6]));
        assert!(bytes.starts_with(b"\x93NUMPY\x01\x00"));
        let length = usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
        let header = core::str::from_utf8(&bytes[10..10 + length]).expect("text");
        assert_eq!(header.trim_end(), "{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3, ), }");
        assert!((10 + length).is_multiple_of(ALIGNMENT) && header.ends_with('\n'));
        assert_eq!(bytes[10 + length..], 0.5f32.to_le_bytes().repeat(6));
    }
}
