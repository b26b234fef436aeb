//! Whether a camera's JPEG has come whole: a look at its markers (ITU-T T.81, annex B), not at its pixels.

/// Smaller is no image.
const LEAST_BYTES: usize = 128;
/// Some cameras fill up behind the end of the image.
const PADDING_LOOKED_THROUGH: usize = 4096;

/// Start of image first; the segments up to the scan fit into one another; a frame header before the scan; end of image
/// last, but for padding.
pub fn is_whole(data: &[u8]) -> bool {
    data.len() >= LEAST_BYTES && data.starts_with(&[0xff, 0xd8]) && ends(data) && reaches_scan(data)
}

fn ends(data: &[u8]) -> bool {
    let tail = &data[data.len().saturating_sub(PADDING_LOOKED_THROUGH)..];
    tail.windows(2).any(|pair| pair == [0xff, 0xd9])
}

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
