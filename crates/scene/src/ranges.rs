//! Ranges: values that a scene leaves open, `{ uniform = [2, 12], per = "episode" }` in place of a number of an effect.
//!
//! Each range has its own random stream, selected by seed, effect, key and frame, so that no other range changes its
//! values. Values are filled into the text before the file is deserialized. An effect cannot tell a drawn number from a
//! written one.

use core::ops::Range as Span;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::SceneError;
use super::check::refuse;
use super::key_lines::KeyLines;
use super::stream::{self, Purpose, Stream};

/// The text of a scene file with the positions of its ranges.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Template {
    text: String,
    seed: u64,
    pub(super) ranges: Vec<Range>,
}

/// A number that the file leaves open.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Range {
    /// Key in the file, for example `effect[1].gain`.
    pub(super) key: String,
    /// Kind of the effect, for example `light`.
    pub(super) kind: String,
    /// Key within the effect, for example `gain`.
    pub(super) name: String,
    pub(super) low: f64,
    pub(super) high: f64,
    pub(super) per: Per,
    /// True if only integers are drawn, both ends included.
    is_integer: bool,
    /// Bytes of the text that the value replaces.
    span: Span<usize>,
}

/// How often a value is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Per {
    /// Once for the whole scene.
    Episode,
    /// Anew for each frame.
    Frame,
}

/// A value that was drawn for a range of the scene file.
#[derive(Clone, Debug, PartialEq)]
pub struct Drawn {
    /// Effect and key, for example `light.gain`.
    pub name: String,
    /// Drawn value, in the unit of the key.
    pub value: f64,
}

/// Maximum number of ranges in a scene: more than any scene has effects times keys.
const MAX_RANGES: usize = 256;
/// Effects and keys whose values are integers.
const INTEGER_KEYS: [(&str, &str); 1] = [("obstacles", "random")];
/// The key that marks a table as a range.
const UNIFORM: &str = "uniform";
/// Description of a correct range, for error messages.
const FORM: &str = "a range is { uniform = [low, high], per = \"episode\" } (or per = \"frame\")";

impl Template {
    /// Finds the ranges in the text. `table` is the parsed text, `key_lines` gives lines for error messages.
    pub(super) fn new(text: &str, table: &DeTable, key_lines: &KeyLines) -> Result<Self, SceneError> {
        let mut template = Self { text: text.to_owned(), seed: parse_seed(table), ranges: Vec::new() };
        let effects = table.get("effect").and_then(|effects| effects.get_ref().as_array());
        for (index, effect) in effects.into_iter().flatten().enumerate() {
            let kind = effect.get_ref().get("kind").and_then(|kind| kind.get_ref().as_str()).unwrap_or_default();
            let key = format!("effect[{index}]");
            template.collect_ranges(&key, "", kind, effect).map_err(|error| error.with_line(key_lines))?;
        }
        Ok(template)
    }

    /// Adds the ranges in `value` and in all that it contains. `key` and `name` are those of `value`.
    fn collect_ranges(
        &mut self,
        key: &str,
        name: &str,
        kind: &str,
        value: &Spanned<DeValue>,
    ) -> Result<(), SceneError> {
        match value.get_ref() {
            DeValue::Table(table) if table.contains_key(UNIFORM) => {
                if self.ranges.len() == MAX_RANGES {
                    return Err(refuse(key, "one range too many", format_args!("a scene has at most {MAX_RANGES}")));
                }
                let (low, high, per) = parse_range(table).ok_or_else(|| refuse(key, "no range", FORM))?;
                let is_integer = INTEGER_KEYS.contains(&(kind, name));
                if is_integer && (low.fract() != 0.0 || high.fract() != 0.0) {
                    let expected = format!("both ends of {name} are whole numbers, and such are drawn");
                    return Err(refuse(key, format_args!("from {low} to {high}"), expected));
                }
                let owned = |text: &str| text.to_owned();
                let (key, kind, name, span) = (owned(key), owned(kind), owned(name), value.span());
                self.ranges.push(Range { key, kind, name, low, high, per, is_integer, span });
            }
            DeValue::Table(table) => {
                for (part, value) in table {
                    let part = part.get_ref();
                    let name = if name.is_empty() { part.to_string() } else { format!("{name}.{part}") };
                    self.collect_ranges(&format!("{key}.{part}"), &name, kind, value)?;
                }
            }
            DeValue::Array(list) => {
                for (index, value) in list.iter().enumerate() {
                    self.collect_ranges(&format!("{key}[{index}]"), &format!("{name}[{index}]"), kind, value)?;
                }
            }
            _ => {}
        }
        Ok(())
    }

    /// Value drawn for a frame. A range per episode has the same value in all frames.
    pub(super) fn value(&self, range: &Range, frame: u64) -> f64 {
        let frame = match range.per {
            Per::Episode => 0,
            Per::Frame => frame + 1,
        };
        let index = range.hash().wrapping_add(frame.wrapping_mul(0xD134_2543_DE82_EF95));
        range.at(Stream::new(self.seed, Purpose::Ranges, index).uniform())
    }

    /// Value of a range in sample `sample` of `samples`, for trying many combinations of values.
    ///
    /// The samples cover each range evenly. Each range has its own order, so that the values of two ranges meet in many
    /// combinations (a Latin hypercube). The values do not depend on the seed.
    pub(super) fn stratified_value(&self, range: &Range, sample: u64, samples: u64) -> f64 {
        let key = Stream::new(0, Purpose::Ranges, range.hash()).key();
        let rank = (0..samples).filter(|other| stream::at(key, *other) < stream::at(key, sample)).count();
        range.at((rank as f64 + 0.5) / samples as f64)
    }

    /// Whether any value is drawn per episode, or per frame.
    pub(super) fn has_ranges_per(&self, per: Per) -> bool {
        self.ranges.iter().any(|range| range.per == per)
    }

    /// Values drawn per episode or per frame, with their names.
    pub(super) fn drawn(&self, per: Per, frame: u64) -> Vec<Drawn> {
        let ranges = self.ranges.iter().filter(|range| range.per == per);
        let drawn =
            |range: &Range| Drawn { name: format!("{}.{}", range.kind, range.name), value: self.value(range, frame) };
        ranges.map(drawn).collect()
    }

    /// The text with `value` in place of each range. Line numbers stay the same.
    pub(super) fn fill(&self, value: impl Fn(&Range) -> f64) -> String {
        self.substitute(self.ranges.iter().collect(), value)
    }

    /// The text with the values that are drawn per episode. Ranges per frame stay ranges.
    pub(super) fn fill_per_episode(&self) -> String {
        let ranges = self.ranges.iter().filter(|range| range.per == Per::Episode);
        self.substitute(ranges.collect(), |range| self.value(range, 0))
    }

    /// The text with `value` in place of each of `ranges`.
    fn substitute(&self, mut ranges: Vec<&Range>, value: impl Fn(&Range) -> f64) -> String {
        let mut text = String::with_capacity(self.text.len());
        let mut done = 0;
        ranges.sort_by_key(|range| range.span.start);
        for range in ranges {
            text.push_str(&self.text[done..range.span.start]);
            let value = value(range);
            // The debug format writes a decimal point even if the number happens to be an integer.
            text.push_str(&if range.is_integer { format!("{value:.0}") } else { format!("{value:?}") });
            done = range.span.end;
        }
        text.push_str(&self.text[done..]);
        text
    }
}

impl Range {
    /// FNV-1a hash of kind and name. The position in the file does not count, so that other entries do not change the draws.
    fn hash(&self) -> u64 {
        let what = format!("{}.{}", self.kind, self.name);
        what.bytes()
            .fold(0xCBF2_9CE4_8422_2325, |hash: u64, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01B3))
    }

    /// The number at `share` of the way from low to high, 0 <= `share` < 1.
    fn at(&self, share: f64) -> f64 {
        if self.is_integer {
            return libm::floor(self.low + (self.high + 1.0 - self.low) * share).min(self.high);
        }
        self.low + (self.high - self.low) * share
    }
}

/// `scene.seed` of the file, or 0 if it is missing or wrong. Deserialization reports that later.
fn parse_seed(table: &DeTable) -> u64 {
    let scene = table.get("scene").map(Spanned::get_ref);
    let seed = scene.and_then(|scene| scene.get("seed")).and_then(|seed| seed.get_ref().as_integer());
    seed.and_then(|seed| u64::from_str_radix(seed.as_str(), seed.radix()).ok()).unwrap_or(0)
}

/// Low end, high end and frequency of a range, or `None` if the table is not a correct range.
fn parse_range(table: &DeTable) -> Option<(f64, f64, Per)> {
    let known = ["uniform", "per"];
    if table.len() != known.len() || !known.iter().all(|key| table.contains_key(*key)) {
        return None;
    }
    let ends = table.get("uniform")?.get_ref().as_array()?;
    let number = |index: usize| {
        let value = ends.get(index)?.get_ref();
        let text = match value {
            DeValue::Integer(integer) if integer.radix() == 10 => integer.as_str(),
            DeValue::Float(float) => float.as_str(),
            _ => return None,
        };
        text.parse().ok().filter(|value: &f64| value.is_finite())
    };
    let (low, high) = (number(0)?, number(1)?);
    let per = match table.get("per")?.get_ref().as_str()? {
        "episode" => Per::Episode,
        "frame" => Per::Frame,
        _ => return None,
    };
    (ends.len() == 2 && low <= high).then_some((low, high, per))
}
