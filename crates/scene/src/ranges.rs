//! Values that a scene leaves open: `{ uniform = [2, 12], per = "episode" }` in place of a number of an effect.
//!
//! Each has a stream of its own, by seed, effect, key and frame, so that no other value moves it. Drawn before the file
//! is read as what it means: an effect never knows whether somebody wrote its number or it was drawn.

use core::ops::Range as Span;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::SceneError;
use super::check::refuse;
use super::key_lines::Places;
use super::stream::{self, Purpose, Stream};

/// The file's text with the places where numbers have to be filled in.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Template {
    text: String,
    seed: u64,
    pub(super) ranges: Vec<Range>,
}

#[derive(Clone, Debug, PartialEq)]
pub(super) struct Range {
    /// `effect[1].gain`
    pub(super) key: String,
    /// `light`
    pub(super) kind: String,
    /// `gain`
    pub(super) name: String,
    pub(super) low: f64,
    pub(super) high: f64,
    pub(super) per: Per,
    /// Only whole numbers are drawn, both ends among them.
    whole: bool,
    span: Span<usize>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Per {
    Episode,
    Frame,
}

/// One value that was drawn.
#[derive(Clone, Debug, PartialEq)]
pub struct Drawn {
    /// `light.gain`
    pub name: String,
    pub value: f64,
}

/// More than any scene has effects times keys.
const MAX_RANGES: usize = 256;
/// Numbers that count something.
const WHOLE: [(&str, &str); 1] = [("obstacles", "random")];
/// What makes a table a range.
const UNIFORM: &str = "uniform";
const FORM: &str = "a range is { uniform = [low, high], per = \"episode\" } (or per = \"frame\")";

impl Template {
    pub(super) fn new(text: &str, table: &DeTable, places: &Places) -> Result<Self, SceneError> {
        let mut template = Self { text: text.to_owned(), seed: seed_of(table), ranges: Vec::new() };
        let effects = table.get("effect").and_then(|effects| effects.get_ref().as_array());
        for (index, effect) in effects.into_iter().flatten().enumerate() {
            let kind = effect.get_ref().get("kind").and_then(|kind| kind.get_ref().as_str()).unwrap_or_default();
            let key = format!("effect[{index}]");
            template.find(&key, "", kind, effect).map_err(|error| error.at(places))?;
        }
        Ok(template)
    }

    fn find(&mut self, key: &str, name: &str, kind: &str, value: &Spanned<DeValue>) -> Result<(), SceneError> {
        match value.get_ref() {
            DeValue::Table(table) if table.contains_key(UNIFORM) => {
                if self.ranges.len() == MAX_RANGES {
                    return Err(refuse(key, "one range too many", format_args!("a scene has at most {MAX_RANGES}")));
                }
                let (low, high, per) = range_of(table).ok_or_else(|| refuse(key, "no range", FORM))?;
                let whole = WHOLE.contains(&(kind, name));
                if whole && (low.fract() != 0.0 || high.fract() != 0.0) {
                    let expected = format!("both ends of {name} are whole numbers, and such are drawn");
                    return Err(refuse(key, format_args!("from {low} to {high}"), expected));
                }
                let owned = |text: &str| text.to_owned();
                let (key, kind, name, span) = (owned(key), owned(kind), owned(name), value.span());
                self.ranges.push(Range { key, kind, name, low, high, per, whole, span });
            }
            DeValue::Table(table) => {
                for (part, value) in table {
                    let part = part.get_ref();
                    let name = if name.is_empty() { part.to_string() } else { format!("{name}.{part}") };
                    self.find(&format!("{key}.{part}"), &name, kind, value)?;
                }
            }
            DeValue::Array(list) => {
                for (index, value) in list.iter().enumerate() {
                    self.find(&format!("{key}[{index}]"), &format!("{name}[{index}]"), kind, value)?;
                }
            }
            _ => {}
        }
        Ok(())
    }

    /// What is drawn for a frame; for the episode where that is what a range says.
    pub(super) fn value(&self, range: &Range, frame: u64) -> f64 {
        let frame = match range.per {
            Per::Episode => 0,
            Per::Frame => frame + 1,
        };
        let index = range.hash().wrapping_add(frame.wrapping_mul(0xD134_2543_DE82_EF95));
        range.at(Stream::new(self.seed, Purpose::Ranges, index).uniform())
    }

    /// One of so many places: each range is gone through evenly from end to end, and in an order of its own, so that
    /// any two meet in many ways. The same with every seed.
    pub(super) fn between(&self, range: &Range, place: u64, places: u64) -> f64 {
        let key = Stream::new(0, Purpose::Ranges, range.hash()).key();
        let before = (0..places).filter(|other| stream::at(key, *other) < stream::at(key, place)).count();
        range.at((before as f64 + 0.5) / places as f64)
    }

    /// Whether anything is drawn so often.
    pub(super) fn has(&self, per: Per) -> bool {
        self.ranges.iter().any(|range| range.per == per)
    }

    pub(super) fn drawn(&self, per: Per, frame: u64) -> Vec<Drawn> {
        let of = self.ranges.iter().filter(|range| range.per == per);
        let drawn =
            |range: &Range| Drawn { name: format!("{}.{}", range.kind, range.name), value: self.value(range, frame) };
        of.map(drawn).collect()
    }

    /// The file with these numbers in place of its ranges; every line stays where it is.
    pub(super) fn filled(&self, value: impl Fn(&Range) -> f64) -> String {
        self.with(self.ranges.iter().collect(), value)
    }

    /// What was drawn once is filled in; what is drawn for each frame stays a range.
    pub(super) fn filled_for_the_episode(&self) -> String {
        let ranges = self.ranges.iter().filter(|range| range.per == Per::Episode);
        self.with(ranges.collect(), |range| self.value(range, 0))
    }

    fn with(&self, mut ranges: Vec<&Range>, value: impl Fn(&Range) -> f64) -> String {
        let mut text = String::with_capacity(self.text.len());
        let mut done = 0;
        ranges.sort_by_key(|range| range.span.start);
        for range in ranges {
            text.push_str(&self.text[done..range.span.start]);
            let value = value(range);
            // With a point even if it is a whole number by chance.
            text.push_str(&if range.whole { format!("{value:.0}") } else { format!("{value:?}") });
            done = range.span.end;
        }
        text.push_str(&self.text[done..]);
        text
    }
}

impl Range {
    /// Of what it is, not of its place in the file: what stands before it must not matter.
    fn hash(&self) -> u64 {
        let what = format!("{}.{}", self.kind, self.name);
        what.bytes()
            .fold(0xCBF2_9CE4_8422_2325, |hash: u64, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01B3))
    }

    /// The number at a share of the way from end to end, below 1.
    fn at(&self, share: f64) -> f64 {
        if self.whole {
            return libm::floor(self.low + (self.high + 1.0 - self.low) * share).min(self.high);
        }
        self.low + (self.high - self.low) * share
    }
}

fn seed_of(table: &DeTable) -> u64 {
    let scene = table.get("scene").map(Spanned::get_ref);
    let seed = scene.and_then(|scene| scene.get("seed")).and_then(|seed| seed.get_ref().as_integer());
    seed.and_then(|seed| u64::from_str_radix(seed.as_str(), seed.radix()).ok()).unwrap_or(0)
}

fn range_of(table: &DeTable) -> Option<(f64, f64, Per)> {
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
