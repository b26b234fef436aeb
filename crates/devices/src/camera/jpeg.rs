//! Checks whether a JPEG of a camera is complete, by its markers (ITU-T T.81, annex B) and without decoding its pixels.

/// Smallest size of an image, bytes.
const MIN_BYTES: usize = 128;
/// Number of last bytes in which the end of the image is looked for: some cameras add padding after it.
const PADDING_LOOKED_THROUGH: usize = 4096;

/// Returns whether a JPEG is complete.
///
/// It must begin with the start of image; its segments must follow one another up to the scan, with a frame header among them;
/// and it must end with the end of image, apart from padding.
pub fn is_whole(data: &[u8]) -> bool {
    data.len() >= MIN_BYTES && data.starts_with(&[0xff, 0xd8]) && has_end_marker(data) && reaches_scan(data)
}

/// Returns whether the end of image is among the last bytes.
fn has_end_marker(data: &[u8]) -> bool {
    let tail = &data[data.len().saturating_sub(PADDING_LOOKED_THROUGH)..];
    tail.windows(2).any(|pair| pair == [0xff, 0xd9])
}

/// Returns whether the segments follow one another up to the scan, with a frame header among them.
fn reaches_scan(data: &[u8]) -> bool {
    let (mut at, mut has_frame_header) = (2, false);
    loop {
        let [0xff, marker, rest @ ..] = &data[at..] else { return false };
        match marker {
            // Fill bytes may stand before any marker.
            0xff => at += 1,
            0xda => return has_frame_header,
            0xd8..=0xd9 => return false,
            _ => {
                has_frame_header |= matches!(marker, 0xc0..=0xc2);
                let [high, low, ..] = rest else { return false };
                let length = usize::from(u16::from_be_bytes([*high, *low]));
                if length < 2 || at + 2 + length > data.len() {
                    return false;
                }
                at += 2 + length;
            }
        }
    }
}
