//! Recognizes the kind of a file by its first bytes, and says what can be done with such a file.

use std::fmt;

/// Number of bytes at the start of a file by which its kind is recognized.
pub const START_BYTES: usize = 16;

/// The kind of a file in words, with advice where there is some; made to follow "this file is" in an error.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FileKind(String);

/// For each kind: offset of its magic bytes, these bytes, its name, and what can be done with such a file.
const KINDS: [(usize, &[u8], &str, &str); 19] = [
    (0, b"\x89MCAP0\r\n", "an MCAP log", "`realitysim replay` takes it"),
    (0, b"\xff\xd8\xff", "a JPEG picture", "`realitysim tag` finds the pose of a single picture"),
    (0, b"\x89PNG", "a PNG picture", "`realitysim tag` finds the pose of a single picture"),
    (0, b"GIF8", "a GIF picture", "make a JPEG or PNG of it"),
    (8, b"WEBP", "a WebP picture", "make a JPEG or PNG of it"),
    (4, b"ftyp", "an MP4 video", "record a ROS 2 MCAP log with odometry and IMU"),
    (8, b"AVI ", "an AVI video", "record a ROS 2 MCAP log with odometry and IMU"),
    (0, b"\x1a\x45\xdf\xa3", "a Matroska video", "record a ROS 2 MCAP log with odometry and IMU"),
    (
        0,
        b"SQLite format 3",
        "an SQLite database, as rosbag2 wrote them (.db3)",
        "convert it (BAG is this file, or its folder if that has several): pip install rosbags && \
         rosbags-convert --src BAG --dst NEW --dst-storage mcap",
    ),
    (
        0,
        b"#ROSBAG V",
        "a bag of ROS 1",
        "convert it: pip install rosbags && rosbags-convert --src BAG --dst NEW --dst-storage mcap",
    ),
    (0, b"PK\x03\x04", "a ZIP archive", "unpack it first"),
    (0, b"\x1f\x8b", "compressed by gzip", "unpack it first"),
    (0, b"\x28\xb5\x2f\xfd", "compressed by zstd", "unpack it first"),
    (0, b"\xfd7zXZ", "compressed by xz", "unpack it first"),
    (0, b"BZh", "compressed by bzip2", "unpack it first"),
    (0, b"7z\xbc\xaf", "a 7z archive", "unpack it first"),
    (0, b"\x7fELF", "a program", ""),
    (0, b"%PDF", "a PDF document", ""),
    (0, b"RIFF", "a RIFF file", ""),
];
/// Name of a file that has none of the magic bytes and is text.
const TEXT: &str = "a text";
/// Name of a file without any byte.
const EMPTY: &str = "an empty file";
/// Number of first bytes that are printed for a file of an unknown kind.
const SHOWN_BYTES: usize = 8;

impl FileKind {
    /// Returns the kind of the file that begins with `start`: its first [`START_BYTES`] bytes, or all if it has fewer.
    pub fn of(start: &[u8]) -> Self {
        let begins = |(offset, bytes, ..): &&(usize, &[u8], &str, &str)| {
            start.get(*offset..).is_some_and(|rest| rest.starts_with(bytes))
        };
        Self(match KINDS.iter().find(begins) {
            Some((_, _, what, "")) => (*what).to_owned(),
            Some((_, _, what, advice)) => format!("{what}: {advice}"),
            None if start.is_empty() => EMPTY.to_owned(),
            None if is_text(start) => TEXT.to_owned(),
            None => {
                let bytes: Vec<String> = start.iter().take(SHOWN_BYTES).map(|byte| format!("{byte:02x}")).collect();
                format!("of a kind that is not known here (its first bytes are {})", bytes.join(" "))
            }
        })
    }
}

impl fmt::Display for FileKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// Returns whether these bytes are UTF-8 text without control characters. The last character may be cut off.
fn is_text(start: &[u8]) -> bool {
    let whole = match core::str::from_utf8(start) {
        Ok(text) => text,
        Err(error) if error.error_len().is_none() => {
            core::str::from_utf8(&start[..error.valid_up_to()]).unwrap_or_default()
        }
        Err(_) => return false,
    };
    !whole.is_empty() && whole.chars().all(|letter| !letter.is_control() || letter.is_ascii_whitespace())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_known_by_its_first_bytes() {
        for (start, words) in [
            (b"\xff\xd8\xff\xe0\x00\x10JFIF".as_slice(), "a JPEG picture: `realitysim tag`"),
            (b"\x89PNG\r\n\x1a\n", "a PNG picture"),
            (b"\x89MCAP0\r\n", "an MCAP log: `realitysim replay`"),
            (b"\x00\x00\x00\x18ftypmp42", "an MP4 video"),
            (b"RIFF\x00\x00\x00\x00WEBPVP8 ", "a WebP picture"),
            (b"SQLite format 3\0", "rosbags-convert"),
            (b"hoo hoo\n", "a text"),
            ("Gr\u{fc}\u{df}e".as_bytes(), "a text"),
            (&"Gr\u{fc}".as_bytes()[..3], "a text"),
            (b"", "an empty file"),
            (b"\x00\x01\x02\x03", "(its first bytes are 00 01 02 03)"),
        ] {
            let said = FileKind::of(start).to_string();
            assert!(said.contains(words), "{start:?}: {said}");
        }
    }
}
