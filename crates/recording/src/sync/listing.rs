//! Parser of what `rsync --list-only` prints: files with sizes, folders, and links.

use crate::sessions::Kind;

/// An entry of a listing.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Entry {
    /// Path from the source's folder, with `/`; rsync prints unprintable characters as `\#ooo`.
    pub path: String,
    /// What the entry is.
    pub kind: Kind,
    /// Size and time as they are printed.
    pub stamp: String,
}

/// Parses a line such as `-rw-r--r--          1,234 2026/11/21 20:53:20 name`, the size with or without separators;
/// `None` if the line is not an entry.
pub fn parse_line(line: &str) -> Option<Entry> {
    let (mode, rest) = line.split_once(' ')?;
    let (size, rest) = rest.trim_start().split_once(' ')?;
    let (date, rest) = rest.split_once(' ')?;
    let (time, path) = rest.split_once(' ')?;
    let is_stamp = |text: &str, mark: char| text.matches(mark).count() == 2;
    if mode.len() < 10 || !is_stamp(date, '/') || !is_stamp(time, ':') || path == "." {
        return None;
    }
    let digits: String = size.chars().filter(char::is_ascii_digit).collect();
    let kind = match mode.as_bytes()[0] {
        b'-' => Kind::File(digits.parse().ok()?),
        b'd' => Kind::Folder,
        b'l' => Kind::Link,
        _ => Kind::Other,
    };
    let path = match kind {
        Kind::Link => path.split(" -> ").next().unwrap_or(path),
        _ => path,
    };
    Some(Entry { path: path.to_owned(), kind, stamp: format!("{size} {date} {time}") })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_read_as_rsync_writes_them() {
        let entry = |line: &str| parse_line(line).map(|entry| (entry.path, entry.kind));
        let some = |path: &str, kind| Some((path.to_owned(), kind));
        assert_eq!(
            entry("-rw-r--r--      1,234,567 2026/11/21 20:53:20 a b/0000.mcap"),
            some("a b/0000.mcap", Kind::File(1_234_567))
        );
        assert_eq!(entry("-rw-rw-r--+           12 2026/11/21 20:53:20 x"), some("x", Kind::File(12)));
        assert_eq!(entry("drwxr-xr-x           4096 1970/01/01 00:00:00 s"), some("s", Kind::Folder));
        assert_eq!(entry("lrwxrwxrwx             11 2026/11/21 20:53:20 s/l -> /etc/passwd"), some("s/l", Kind::Link));
        assert_eq!(entry("prw-r--r--              0 2026/11/21 20:53:20 s/p"), some("s/p", Kind::Other));
        for line in
            ["", "drwxr-xr-x           4096 2026/11/21 20:53:20 .", "sending incremental file list", "ä", "- 1 2 3 4"]
        {
            assert_eq!(entry(line), None, "{line}");
        }
    }
}
