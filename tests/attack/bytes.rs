//! Damage to bytes that knows nothing of what they mean.

use crate::draw::Draw;

/// One to four of: bits flipped, bytes overwritten, a piece cut out, doubled, moved or zeroed, the end cut off or grown.
pub fn damage(draw: &mut Draw, bytes: &mut Vec<u8>) {
    for _ in 0..*draw.one_of(&[1, 1, 1, 2, 4]) {
        damage_once(draw, bytes);
    }
}

fn damage_once(draw: &mut Draw, bytes: &mut Vec<u8>) {
    let length = bytes.len();
    if length == 0 {
        *bytes = draw.bytes(9);
        return;
    }
    // As often in the first hundred bytes, where heads are, and in the last, as anywhere.
    let at = match draw.below(4) {
        0 => draw.below(length.min(100)),
        1 => length - 1 - draw.below(length.min(100)),
        _ => draw.below(length),
    };
    let most = *draw.one_of(&[1, 4, 8, 64, 4096, length]);
    let end = at + 1 + draw.below(most.min(length - at));
    match draw.below(9) {
        0 | 1 => bytes[at] ^= 1 << draw.below(8),
        2 => bytes[at] = draw.byte(),
        3 => drop(bytes.drain(at..end)),
        4 => {
            let piece = bytes[at..end].to_vec();
            let to = draw.below(length);
            bytes.splice(to..to, piece);
        }
        5 => {
            let piece = bytes[at..end].to_vec();
            let to = draw.below(length);
            let room = piece.len().min(length - to);
            bytes[to..to + room].copy_from_slice(&piece[..room]);
        }
        6 => bytes[at..end].fill(*draw.one_of(&[0, 0xff])),
        7 => bytes.truncate(at),
        _ => {
            let count = *draw.one_of(&[1, 8, 300]);
            let tail = draw.bytes(count);
            bytes.extend(tail);
        }
    }
}

/// Overwrites eight, four, two or one byte by a number at an end of its range; `floats` says whether they may be floats.
pub fn number(draw: &mut Draw, bytes: &mut [u8], floats: bool) {
    let size = *draw.one_of(&[8usize, 8, 4, 4, 2, 1]);
    if bytes.len() < size {
        return;
    }
    let aligned = draw.chance(0.7);
    let at = draw.below(bytes.len() - size + 1);
    let at = if aligned { at / size * size } else { at };
    let mut word = [0; 8];
    word[..size].copy_from_slice(&bytes[at..at + size]);
    let word = match size {
        8 if floats => draw.float(f64::from_le_bytes(word)).to_bits(),
        4 if floats && draw.chance(0.7) => {
            u64::from((draw.float(f64::from(f32::from_bits(u64::from_le_bytes(word) as u32))) as f32).to_bits())
        }
        _ => draw.whole(u64::from_le_bytes(word), 8 * size as u32),
    };
    bytes[at..at + size].copy_from_slice(&word.to_le_bytes()[..size]);
}
