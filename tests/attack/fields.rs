//! Where each number of a ROS 2 message stands in its bytes, by the definition that its channel carries.

use std::collections::BTreeMap;

use realitysim::ros2::{Channel, LogMessage};

use crate::draw::Draw;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Float,
    /// Of so many bytes.
    Whole(usize),
    /// How many bytes or elements follow.
    Length,
}

#[derive(Clone, Debug)]
pub struct Field {
    /// Without indices: all elements of an array have the same name.
    pub name: String,
    pub at: usize,
    pub bytes: usize,
    pub kind: Kind,
}

/// Fields of each type by its name, as `kind, name`.
type Types<'a> = BTreeMap<&'a str, Vec<(&'a str, &'a str)>>;

fn types(channel: &Channel) -> Types<'_> {
    let mut types = Types::new();
    let mut name = channel.type_name.as_str();
    let mut own = Vec::new();
    for line in core::str::from_utf8(&channel.definition).unwrap_or_default().lines() {
        let line = line.split('#').next().unwrap_or_default().trim();
        if let Some(next) = line.strip_prefix("MSG:") {
            types.insert(name, std::mem::take(&mut own));
            name = next.trim();
        } else if !line.contains('=')
            && let Some((kind, field)) = line.split_once(char::is_whitespace)
        {
            own.push((kind, field.trim()));
        }
    }
    types.insert(name, own);
    types
}

/// `pkg/msg/Name` and `pkg/Name` are the same type.
fn same(one: &str, other: &str) -> bool {
    one.replace("/msg/", "/") == other.replace("/msg/", "/")
}

struct Walk<'a> {
    types: Types<'a>,
    data: &'a [u8],
    at: usize,
    found: Vec<Field>,
}

/// All fields of a message, until its bytes end.
pub fn fields(message: &LogMessage) -> Vec<Field> {
    let mut walk = Walk { types: types(&message.channel), data: &message.data, at: 4, found: Vec::new() };
    walk.of_type(&message.channel.type_name, "");
    walk.found
}

impl Walk<'_> {
    fn of_type(&mut self, name: &str, path: &str) -> Option<()> {
        let known = self.types.iter().find(|(other, _)| same(name, other))?.1.clone();
        known.iter().try_for_each(|(kind, field)| self.member(kind, &format!("{path}.{field}")))
    }

    fn member(&mut self, kind: &str, path: &str) -> Option<()> {
        let Some((element, count)) = kind.strip_suffix(']').and_then(|kind| kind.split_once('[')) else {
            return self.one(kind, path);
        };
        let count = match count.parse() {
            Ok(count) => count,
            Err(_) => self.length(path)?,
        };
        if matches!(element, "uint8" | "byte" | "char" | "int8" | "bool") {
            self.at = self.at.checked_add(count).filter(|at| *at <= self.data.len())?;
            return Some(());
        }
        (0..count).try_for_each(|_| self.one(element, path))
    }

    fn one(&mut self, kind: &str, path: &str) -> Option<()> {
        let (bytes, kind) = match kind {
            "float64" => (8, Kind::Float),
            "float32" => (4, Kind::Float),
            "int64" | "uint64" => (8, Kind::Whole(8)),
            "int32" | "uint32" => (4, Kind::Whole(4)),
            "int16" | "uint16" => (2, Kind::Whole(2)),
            "int8" | "uint8" | "byte" | "char" | "bool" => (1, Kind::Whole(1)),
            "string" => {
                let length = self.length(path)?;
                self.at = self.at.checked_add(length).filter(|at| *at <= self.data.len())?;
                return Some(());
            }
            nested => return self.of_type(nested, path),
        };
        self.number(bytes, kind, path).map(|_| ())
    }

    fn length(&mut self, path: &str) -> Option<usize> {
        self.number(4, Kind::Length, &format!("{path}.length")).map(|value| value as usize)
    }

    fn number(&mut self, bytes: usize, kind: Kind, path: &str) -> Option<u64> {
        // Alignment counts from behind the encapsulation's four bytes.
        let at = 4 + (self.at - 4).next_multiple_of(bytes);
        let field = Field { name: path.to_owned(), at, bytes, kind };
        let value = field.bits(self.data)?;
        self.at = at + bytes;
        self.found.push(field);
        Some(value)
    }
}

impl Field {
    fn bits(&self, data: &[u8]) -> Option<u64> {
        let mut word = [0; 8];
        word[..self.bytes].copy_from_slice(data.get(self.at..self.at + self.bytes)?);
        Some(u64::from_le_bytes(word))
    }

    /// If it is a float.
    pub fn float(&self, data: &[u8]) -> Option<f64> {
        let bits = self.bits(data)?;
        match (self.kind, self.bytes) {
            (Kind::Float, 8) => Some(f64::from_bits(bits)),
            (Kind::Float, _) => Some(f64::from(f32::from_bits(bits as u32))),
            _ => None,
        }
    }

    pub fn set_float(&self, data: &mut [u8], value: f64) {
        let bits = if self.bytes == 8 { value.to_bits() } else { u64::from((value as f32).to_bits()) };
        self.set(data, bits);
    }

    fn set(&self, data: &mut [u8], bits: u64) {
        if let Some(place) = data.get_mut(self.at..self.at + self.bytes) {
            place.copy_from_slice(&bits.to_le_bytes()[..self.bytes]);
        }
    }
}

/// What one field is changed to, in whatever message it stands.
#[derive(Clone, Debug)]
pub enum Change {
    Float(f64),
    Whole(u64),
    /// Times this more in each further message.
    Decay(f64),
    /// Of what it says, in each message.
    Times(f64),
    /// More than it says, in each message: a bias.
    Plus(f64),
}

/// One field by its name, and which of several elements of this name.
#[derive(Clone, Debug)]
pub struct Target {
    pub name: String,
    element: usize,
    pub change: Change,
}

impl Target {
    pub fn drawn(draw: &mut Draw, message: &LogMessage) -> Option<Self> {
        let fields = fields(message);
        let mut names: Vec<&str> = fields.iter().map(|field| field.name.as_str()).collect();
        names.sort_unstable();
        names.dedup();
        if names.is_empty() {
            return None;
        }
        let name = (*draw.one_of(&names)).to_owned();
        let alike: Vec<&Field> = fields.iter().filter(|field| field.name == name).collect();
        let element = draw.below(alike.len());
        let field = alike[element];
        let change = match field.float(&message.data) {
            Some(_) if draw.chance(0.15) => Change::Decay(*draw.one_of(&[0.5, 1e-3, 1e-20, 2.0, 1e20])),
            Some(_) if draw.chance(0.2) => Change::Times(*draw.one_of(&[0.0, 0.5, 0.9, 1.1, 2.0, -1.0, 5.0])),
            Some(_) if draw.chance(0.2) => Change::Plus(*draw.one_of(&[-0.05, 0.02, 0.1, 0.3, 1.0, -3.0])),
            Some(now) => Change::Float(draw.float(now)),
            None => Change::Whole(draw.whole(field.bits(&message.data)?, 8 * field.bytes as u32)),
        };
        Some(Self { name, element, change })
    }

    /// `already` is how many messages were changed before this one.
    pub fn apply(&self, message: &mut LogMessage, already: usize) {
        let fields = fields(message);
        let Some(field) = fields.iter().filter(|field| field.name == self.name).nth(self.element) else { return };
        let now = field.float(&message.data).unwrap_or_default();
        let value = match self.change {
            Change::Whole(bits) => return field.set(&mut message.data, bits),
            Change::Float(value) => value,
            Change::Times(by) => now * by,
            Change::Plus(by) => now + by,
            Change::Decay(by) => now * by.powi(already.min(10_000) as i32),
        };
        field.set_float(&mut message.data, value);
    }
}
