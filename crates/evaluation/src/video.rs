//! Videos as Motion JPEG in AVI (RIFF of Microsoft), which every player shows.

/// Joins JPEG images of one size to an AVI file; `None` if its 32-bit lengths overflow.
///
/// `width` and `height` are pixels, `per_second` is the frame rate in Hz.
pub fn avi(jpegs: &[Vec<u8>], width: u32, height: u32, per_second: u32) -> Option<Vec<u8>> {
    let largest = u32::try_from(jpegs.iter().map(Vec::len).max().unwrap_or(0)).ok()?;
    let frames = u32::try_from(jpegs.len()).ok()?;
    let words = |values: &[u32]| values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
    // Microseconds per frame, bytes per second, padding, flags (has an index), frames, .. streams, largest chunk, size.
    let main = words(&[1_000_000 / per_second.max(1), 0, 0, 0x10, frames, 0, 1, largest, width, height, 0, 0, 0, 0]);
    let mut stream = b"vidsMJPG".to_vec();
    stream.extend(words(&[0, 0, 0, 1, per_second, 0, frames, largest, u32::MAX, 0]));
    stream.extend([0u16, 0, width as u16, height as u16].iter().flat_map(|side| side.to_le_bytes()));
    let mut format = words(&[40, width, height]);
    format.extend([1u16, 24].iter().flat_map(|value| value.to_le_bytes()));
    format.extend(b"MJPG");
    format.extend(words(&[width * height * 3, 0, 0, 0, 0]));
    let strl = list(b"strl", &[chunk(b"strh", &stream)?, chunk(b"strf", &format)?].concat())?;
    let hdrl = list(b"hdrl", &[chunk(b"avih", &main)?, strl].concat())?;
    let (mut movie, mut index) = (Vec::new(), Vec::new());
    for jpeg in jpegs {
        // Offsets count from the name of the list `movi`. Flag 0x10: every frame is a key frame.
        index.extend(b"00dc");
        index.extend(words(&[0x10, u32::try_from(movie.len()).ok()?.checked_add(4)?, jpeg.len() as u32]));
        movie.extend(chunk(b"00dc", jpeg)?);
    }
    let movi = list(b"movi", &movie)?;
    let all = [b"AVI ".to_vec(), hdrl, movi, chunk(b"idx1", &index)?].concat();
    chunk(b"RIFF", &all)
}

/// Makes a RIFF chunk; `None` if its length overflows.
fn chunk(name: &[u8; 4], content: &[u8]) -> Option<Vec<u8>> {
    let length = u32::try_from(content.len()).ok()?;
    let mut bytes = [name.as_slice(), &length.to_le_bytes(), content].concat();
    // Chunks begin at even offsets.
    if bytes.len() % 2 == 1 {
        bytes.push(0);
    }
    Some(bytes)
}

/// Makes a RIFF list; `None` if its length overflows.
fn list(name: &[u8; 4], content: &[u8]) -> Option<Vec<u8>> {
    chunk(b"LIST", &[name.as_slice(), content].concat())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_add_up_and_the_index_leads_to_every_frame() {
        let jpegs = [vec![1, 2, 3], vec![4, 5, 6, 7]];
        let avi = avi(&jpegs, 64, 48, 10).expect("small");
        let number = |at: usize| u32::from_le_bytes(core::array::from_fn(|i| avi[at + i])) as usize;
        assert_eq!((&avi[..4], number(4), &avi[8..12]), (&b"RIFF"[..], avi.len() - 8, &b"AVI "[..]));
        let find = |name: &[u8]| avi.windows(name.len()).position(|part| part == name).expect("there");
        let (movi, index) = (find(b"movi"), find(b"idx1"));
        assert_eq!(number(index + 4), 16 * jpegs.len());
        for (i, jpeg) in jpegs.iter().enumerate() {
            let entry = index + 8 + 16 * i;
            let (at, length) = (movi + number(entry + 8), number(entry + 12));
            assert_eq!((&avi[at..at + 4], &avi[at + 8..at + 8 + length]), (&b"00dc"[..], &jpeg[..]));
        }
    }
}
