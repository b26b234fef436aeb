//! The reference file: JSON Lines, first a head that identifies the replay, then a line per frame.

use std::collections::BTreeMap;
use std::path::Path;

use serde::{Deserialize, Serialize};
use serde_json::Value;
use thiserror::Error;

use super::identity::Identity;
use realitysim_config::plain_file;
use realitysim_ros2::messages::FrameTag;

/// Reason why a reference cannot be made, read or compared.
#[derive(Debug, Error)]
pub enum ReferenceError {
    /// A file cannot be read.
    #[error("{file}: cannot be read: {message}")]
    Read {
        /// Path of the file.
        file: String,
        /// Error of the operating system.
        message: String,
    },
    /// The file is no reference, or is damaged.
    #[error("{file}: {message}")]
    Format {
        /// Path of the file.
        file: String,
        /// Description of the problem, with its line.
        message: String,
    },
    /// The description of the session cannot be read.
    #[error("{0}")]
    Session(String),
    /// The reference is of another log, seed, start, version or format.
    #[error("{file}: not compared: {why}. `--bless` makes a new reference")]
    Other {
        /// Path of the reference.
        file: String,
        /// The difference.
        why: String,
    },
    /// There are no frames, or no valid tags.
    #[error("nothing was exercised: {0}")]
    Unexercised(String),
    /// A tolerance names a field that does not exist or holds no numbers.
    #[error("--tolerance {field}: there is no such field with numbers; there are {known}")]
    Tolerance {
        /// Name in the tolerance.
        field: String,
        /// Names of the fields with numbers.
        known: String,
    },
}

/// The fields of all tags by name (`pose.pose.position.x`), without the time that a tag took.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Frames {
    /// Number of frames.
    pub count: usize,
    /// Values of each field, one per frame.
    pub fields: BTreeMap<String, Vec<Value>>,
}

/// The tags of a replay and what they were made from.
#[derive(Clone, Debug, PartialEq)]
pub struct Reference {
    /// Log, seed, start and version of the replay.
    pub identity: Identity,
    /// Largest difference of each named field that counts as equal; other fields must be equal bit for bit.
    pub tolerance: BTreeMap<String, f64>,
    /// Settings of the replay, for messages.
    pub settings: Value,
    /// The tags.
    pub frames: Frames,
}

/// Largest size of a reference file, bytes. An hour at 30 Hz takes some ten MiB.
pub const MAX_REFERENCE_BYTES: u64 = 256 << 20;
/// Version of the file format.
const FORMAT: u32 = 1;

/// The first line of the file.
#[derive(Serialize, Deserialize)]
struct Head {
    realitysim_reference: u32,
    #[serde(flatten)]
    identity: Identity,
    frames: usize,
    tolerance: BTreeMap<String, f64>,
    /// Values of the fields that are the same in every frame.
    constant: BTreeMap<String, Value>,
    /// Names of the fields whose values the further lines hold.
    columns: Vec<String>,
    settings: Value,
}

impl Frames {
    /// Takes the fields out of tags.
    pub fn of(tags: &[FrameTag]) -> Self {
        let mut frames = Self { count: tags.len(), ..Self::default() };
        for tag in tags {
            // Times differ from run to run, whatever was computed.
            let tag = FrameTag { elapsed_ms: 0.0, ..tag.clone() };
            // A struct of numbers, strings and structs always has a JSON form.
            flatten(String::new(), serde_json::to_value(&tag).unwrap_or_default(), &mut frames.fields);
        }
        frames.fields.remove("elapsed_ms");
        frames
    }

    /// Returns the number of valid tags.
    pub fn valid(&self) -> usize {
        let valid = self.fields.get("valid").into_iter().flatten();
        valid.filter(|value| **value == Value::Bool(true)).count()
    }
}

/// Appends the leaves of a JSON value to the fields of their names.
fn flatten(name: String, value: Value, fields: &mut BTreeMap<String, Vec<Value>>) {
    let join = |part: &str| if name.is_empty() { part.to_owned() } else { format!("{name}.{part}") };
    match value {
        Value::Object(map) => map.into_iter().for_each(|(key, value)| flatten(join(&key), value, fields)),
        Value::Array(list) => {
            list.into_iter().enumerate().for_each(|(index, value)| flatten(join(&index.to_string()), value, fields));
        }
        value => fields.entry(name).or_default().push(value),
    }
}

impl Reference {
    /// Makes a reference.
    ///
    /// # Errors
    ///
    /// Refuses tags that would show nothing, and tolerances of fields without numbers.
    pub fn new(
        identity: Identity,
        tolerance: BTreeMap<String, f64>,
        settings: Value,
        frames: Frames,
    ) -> Result<Self, ReferenceError> {
        check_exercised(&frames)?;
        if let Some((field, known)) = find_tolerance_without_numbers(&tolerance, &frames) {
            return Err(ReferenceError::Tolerance { field, known });
        }
        Ok(Self { identity, tolerance, settings, frames })
    }

    /// Returns the text of the reference file.
    pub fn to_text(&self) -> String {
        let is_constant = |values: &Vec<Value>| values.windows(2).all(|pair| pair[0] == pair[1]);
        let fields = &self.frames.fields;
        let constant = fields.iter().filter(|(_, values)| is_constant(values));
        let columns: Vec<(&String, &Vec<Value>)> = fields.iter().filter(|(_, values)| !is_constant(values)).collect();
        let head = Head {
            realitysim_reference: FORMAT,
            identity: self.identity.clone(),
            frames: self.frames.count,
            tolerance: self.tolerance.clone(),
            constant: constant.filter_map(|(name, values)| Some((name.clone(), values.first()?.clone()))).collect(),
            columns: columns.iter().map(|(name, _)| (*name).clone()).collect(),
            settings: self.settings.clone(),
        };
        let mut text = line(&head);
        for frame in 0..self.frames.count {
            text.push_str(&line(&columns.iter().map(|(_, values)| &values[frame]).collect::<Vec<_>>()));
        }
        text
    }

    /// Reads and checks a reference file.
    pub fn load(path: &Path) -> Result<Self, ReferenceError> {
        let file = path.display().to_string();
        let text = plain_file::read_text(path, MAX_REFERENCE_BYTES)
            .map_err(|error| ReferenceError::Read { file: file.clone(), message: error.to_string() })?;
        Self::parse(&text, &file)
    }

    /// Parses and checks the text of a reference file. `file` is its path, for messages.
    pub fn parse(text: &str, file: &str) -> Result<Self, ReferenceError> {
        let refuse = |message: String| ReferenceError::Format { file: file.to_owned(), message };
        // An editor may leave empty lines at the end.
        let mut lines = text.trim_end().lines();
        let first: Value = lines.next().and_then(|line| serde_json::from_str(line).ok()).unwrap_or_default();
        match first.get("realitysim_reference").and_then(Value::as_u64) {
            None => return Err(refuse("no reference: `realitysim replay --check FILE --bless` makes one".to_owned())),
            Some(version) if version != u64::from(FORMAT) => {
                let why = format!("it is of format {version}, this program knows format {FORMAT}");
                return Err(ReferenceError::Other { file: file.to_owned(), why });
            }
            Some(_) => {}
        }
        let head: Head = serde_json::from_value(first).map_err(|error| refuse(format!("line 1: {error}")))?;
        let mut columns = vec![Vec::new(); head.columns.len()];
        let mut count = 0;
        for (index, line) in lines.enumerate() {
            let values: Vec<Value> =
                serde_json::from_str(line).map_err(|error| refuse(format!("line {}: {error}", index + 2)))?;
            if values.len() != columns.len() {
                let message = format!("line {}: {} values, {} are needed", index + 2, values.len(), columns.len());
                return Err(refuse(message));
            }
            columns.iter_mut().zip(values).for_each(|(column, value)| column.push(value));
            count += 1;
        }
        if count != head.frames {
            return Err(refuse(format!("{count} frames, and its first line says {}: is it whole?", head.frames)));
        }
        // Constants are expanded after the check of the count: the first line may state any number of frames.
        let constant = head.constant.into_iter().map(|(name, value)| (name, vec![value; count]));
        let mut fields: BTreeMap<String, Vec<Value>> = constant.collect();
        fields.extend(head.columns.into_iter().zip(columns));
        let frames = Frames { count, fields };
        check_exercised(&frames)?;
        if let Some((field, known)) = find_tolerance_without_numbers(&head.tolerance, &frames) {
            let message = format!("line 1: tolerance.{field}: there is no such field with numbers; there are {known}");
            return Err(refuse(message));
        }
        if let Some((field, value)) = head.tolerance.iter().find(|(_, value)| **value < 0.0) {
            return Err(refuse(format!("line 1: tolerance.{field} is {value}: it must be 0 or more")));
        }
        Ok(Self { identity: head.identity, tolerance: head.tolerance, settings: head.settings, frames })
    }
}

/// Returns the first field with a tolerance that does not hold numbers, and the names of those that do.
fn find_tolerance_without_numbers(tolerance: &BTreeMap<String, f64>, frames: &Frames) -> Option<(String, String)> {
    let is_number = |values: &Vec<Value>| values.iter().all(Value::is_number);
    let field = tolerance.keys().find(|field| !frames.fields.get(*field).is_some_and(is_number))?;
    let numbers = frames.fields.iter().filter(|(_, values)| is_number(values));
    let known: Vec<&str> = numbers.map(|(name, _)| name.as_str()).collect();
    Some((field.clone(), known.join(", ")))
}

/// Refuses frames that show nothing: a log without frames or without a valid tag would pass every check.
fn check_exercised(frames: &Frames) -> Result<(), ReferenceError> {
    match (frames.count, frames.valid()) {
        (0, _) => Err(ReferenceError::Unexercised("there is no frame".to_owned())),
        (count, 0) => Err(ReferenceError::Unexercised(format!("none of {count} tags is valid"))),
        _ => Ok(()),
    }
}

fn line(content: &impl Serialize) -> String {
    // Names, numbers and strings always have a JSON form.
    serde_json::to_string(content).unwrap_or_default() + "\n"
}
