//! Words as pixels: DejaVu Sans, so that pictures look the same on every computer.

use std::sync::LazyLock;

use ab_glyph::{Font, FontRef, Glyph, PxScale, ScaleFont, point};
use glam::DVec2;

/// Without a font there are no words; the shipped one always loads.
static FONT: LazyLock<Option<FontRef<'static>>> =
    LazyLock::new(|| FontRef::try_from_slice(dejavu::sans::regular()).ok());

/// Smaller letters are only dirt.
const SMALLEST: f64 = 4.0;
/// No picture is wide enough for more.
const MOST_LETTERS: usize = 1_000;

/// Calls `pixel(x, y, coverage)` for every pixel touched; `at` is the left end of the baseline.
pub(super) fn rasterise(at: DVec2, size: f64, words: &str, mut pixel: impl FnMut(i32, i32, f32)) {
    let Some(font) = FONT.as_ref() else { return };
    if !at.is_finite() {
        return;
    }
    for glyph in glyphs(size, words).0 {
        let Some(outline) = font.outline_glyph(shifted(glyph, at)) else { continue };
        let corner = outline.px_bounds().min;
        outline.draw(|x, y, coverage| pixel(corner.x as i32 + x as i32, corner.y as i32 + y as i32, coverage.min(1.0)));
    }
}

/// How far the words reach to the right.
pub(super) fn width(size: f64, words: &str) -> f64 {
    glyphs(size, words).1
}

/// Lines no wider than `room`, broken between words; a longer word has a line of its own and sticks out.
pub(super) fn wrap(size: f64, words: &str, room: f64) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in words.split_whitespace() {
        match lines.last_mut() {
            Some(line) if width(size, &format!("{line} {word}")) <= room => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

fn glyphs(size: f64, words: &str) -> (Vec<Glyph>, f64) {
    let Some(font) = FONT.as_ref().filter(|_| size >= SMALLEST) else { return (Vec::new(), 0.0) };
    let scale = PxScale::from(size as f32);
    let scaled = font.as_scaled(scale);
    let (mut glyphs, mut x, mut last) = (Vec::new(), 0.0, None);
    for letter in words.chars().filter(|letter| !letter.is_control()).take(MOST_LETTERS) {
        let id = scaled.glyph_id(letter);
        x += last.map_or(0.0, |last| scaled.kern(last, id));
        glyphs.push(id.with_scale_and_position(scale, point(x, 0.0)));
        x += scaled.h_advance(id);
        last = Some(id);
    }
    (glyphs, f64::from(x))
}

fn shifted(mut glyph: Glyph, by: DVec2) -> Glyph {
    glyph.position.x += by.x as f32;
    glyph.position.y += by.y as f32;
    glyph
}
