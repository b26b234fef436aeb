//! Text as outlines in DejaVu Sans, so that pictures look the same on every computer.

use std::sync::LazyLock;

use skrifa::instance::{LocationRef, Size};
use skrifa::outline::{DrawSettings, OutlinePen};
use skrifa::{FontRef, GlyphId, MetadataProvider};
use tiny_skia::{Path, PathBuilder};

/// The font. Without it there would be no text; the shipped one always loads.
static FONT: LazyLock<Option<FontRef<'static>>> = LazyLock::new(|| FontRef::new(dejavu::sans::regular()).ok());

/// Smallest size of text, pixels: smaller letters cannot be read and are left out.
const MIN_SIZE_PX: f64 = 4.0;
/// Largest number of letters of a line: no picture is wide enough for more.
const MAX_LETTERS: usize = 1_000;

/// Returns the outlines of words. The left end of the baseline is at (0, 0), and y points down.
///
/// `size` is the height from the top of the highest letter to the bottom of the lowest, pixels.
pub(super) fn outline(size: f64, words: &str) -> Option<Path> {
    let font = FONT.as_ref()?;
    let Line { letters, em, .. } = line(size, words)?;
    let (outlines, mut pen) = (font.outline_glyphs(), Pen { path: PathBuilder::new(), x: 0.0 });
    for (letter, x) in letters {
        pen.x = x;
        let settings = DrawSettings::unhinted(Size::new(em), LocationRef::default());
        // A letter that the font cannot draw is left out.
        let _ = outlines.get(letter).map(|outline| outline.draw(settings, &mut pen));
    }
    pen.path.finish()
}

/// Returns the width of words, pixels.
pub(super) fn width(size: f64, words: &str) -> f64 {
    line(size, words).map_or(0.0, |line| f64::from(line.width))
}

/// Breaks words into lines no wider than `room` pixels. A longer word gets a line of its own and sticks out.
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

/// Words set in one line; lengths are pixels.
struct Line {
    /// Letters with the position at which each begins.
    letters: Vec<(GlyphId, f32)>,
    /// Size of the font.
    em: f32,
    width: f32,
}

/// Sets words in one line; `None` if they are too small or there is no font.
fn line(size: f64, words: &str) -> Option<Line> {
    let font = FONT.as_ref().filter(|_| size >= MIN_SIZE_PX)?;
    let whole = font.metrics(Size::unscaled(), LocationRef::default());
    let em = size as f32 * f32::from(whole.units_per_em) / (whole.ascent - whole.descent);
    let (characters, widths) = (font.charmap(), font.glyph_metrics(Size::new(em), LocationRef::default()));
    let (mut letters, mut x) = (Vec::new(), 0.0);
    for letter in words.chars().filter(|letter| !letter.is_control()).take(MAX_LETTERS) {
        let id = characters.map(letter).unwrap_or(GlyphId::NOTDEF);
        letters.push((id, x));
        x += widths.advance_width(id).unwrap_or(0.0);
    }
    Some(Line { letters, em, width: x })
}

/// A pen that appends letters to a path. Fonts have y upwards.
struct Pen {
    path: PathBuilder,
    x: f32,
}

impl OutlinePen for Pen {
    fn move_to(&mut self, x: f32, y: f32) {
        self.path.move_to(self.x + x, -y);
    }

    fn line_to(&mut self, x: f32, y: f32) {
        self.path.line_to(self.x + x, -y);
    }

    fn quad_to(&mut self, cx: f32, cy: f32, x: f32, y: f32) {
        self.path.quad_to(self.x + cx, -cy, self.x + x, -y);
    }

    fn curve_to(&mut self, ax: f32, ay: f32, bx: f32, by: f32, x: f32, y: f32) {
        self.path.cubic_to(self.x + ax, -ay, self.x + bx, -by, self.x + x, -y);
    }

    fn close(&mut self) {
        self.path.close();
    }
}
