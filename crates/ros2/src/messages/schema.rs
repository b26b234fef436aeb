//! Compares the definition of a type that a log states with the one that this crate decodes.

use std::collections::BTreeMap;

use super::{
    CameraInfo, CompressedImage, Image, Imu, JointState, LowState, Message, Odometer, Odometry, PoseStamped,
    PoseWithCovarianceStamped, TFMessage, TwistStamped, TwistWithCovarianceStamped,
};

/// Definitions of the types that measurements are read from.
const KNOWN: [(&str, &str); 13] = [
    (CameraInfo::TYPE, CameraInfo::DEFINITION),
    (CompressedImage::TYPE, CompressedImage::DEFINITION),
    (Image::TYPE, Image::DEFINITION),
    (Imu::TYPE, Imu::DEFINITION),
    (JointState::TYPE, JointState::DEFINITION),
    (LowState::TYPE, LowState::DEFINITION),
    (Odometer::TYPE, Odometer::DEFINITION),
    (Odometry::TYPE, Odometry::DEFINITION),
    (PoseStamped::TYPE, PoseStamped::DEFINITION),
    (PoseWithCovarianceStamped::TYPE, PoseWithCovarianceStamped::DEFINITION),
    (TFMessage::TYPE, TFMessage::DEFINITION),
    (TwistStamped::TYPE, TwistStamped::DEFINITION),
    (TwistWithCovarianceStamped::TYPE, TwistWithCovarianceStamped::DEFINITION),
];
/// Largest definition that is compared, bytes: those of real types take some kilobytes.
const MAX_DEFINITION_BYTES: usize = 1 << 20;

/// The first field in which a definition is not the one that this crate decodes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SchemaDifference {
    /// The nested type that the field belongs to; empty if it is the message itself.
    pub within: String,
    /// Type and name of the field in the log's definition, if there is one.
    pub found: Option<String>,
    /// Type and name that are expected there, if any.
    pub expected: Option<String>,
}

/// Returns the first difference between a definition in the form `ros2msg` and the known one of the same type.
///
/// `None` if they agree, if the type is not known, or if the definition is empty: many writers leave it out.
pub fn difference(type_name: &str, definition: &[u8]) -> Option<SchemaDifference> {
    let (_, known) = KNOWN.iter().find(|(name, _)| *name == type_name)?;
    let found = core::str::from_utf8(definition.get(..MAX_DEFINITION_BYTES).unwrap_or(definition)).ok()?;
    if found.trim().is_empty() {
        return None;
    }
    let (known, found) = (parts(known), parts(found));
    known.iter().find_map(|(within, expected)| {
        // A nested type that the log does not define is taken to be the usual one.
        let found = found.get(within)?;
        let index = (0..expected.len().max(found.len())).find(|index| expected.get(*index) != found.get(*index))?;
        let field = |fields: &[String]| fields.get(index).cloned();
        Some(SchemaDifference { within: within.clone(), found: field(found), expected: field(expected) })
    })
}

/// Returns the fields of the message, under the empty name, and of each nested type.
fn parts(definition: &str) -> BTreeMap<String, Vec<String>> {
    let mut parts: BTreeMap<String, Vec<String>> = BTreeMap::new();
    let mut within = String::new();
    parts.insert(within.clone(), Vec::new());
    for line in definition.lines().map(|line| line.split('#').next().unwrap_or_default().trim()) {
        if let Some(name) = line.strip_prefix("MSG:") {
            within = last_part(name.trim()).to_owned();
            parts.insert(within.clone(), Vec::new());
        } else if let Some(field) = field(line) {
            parts.entry(within.clone()).or_default().push(field);
        }
    }
    parts
}

/// Returns type and name of a field, without the type's package and without a default value; `None` for other lines.
fn field(line: &str) -> Option<String> {
    let (kind, rest) = line.split_once(char::is_whitespace)?;
    let name = rest.split_whitespace().next()?;
    // A constant is no field.
    let is_constant = name.contains('=') || rest.trim_start().strip_prefix(name)?.trim_start().starts_with('=');
    (!is_constant).then(|| format!("{} {name}", last_part(kind)))
}

/// Returns the name of a type without its package.
fn last_part(name: &str) -> &str {
    name.rsplit_once('/').map_or(name, |(_, last)| last)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_known_definition_agrees_with_itself() {
        for (name, definition) in KNOWN {
            assert_eq!(difference(name, definition.as_bytes()), None, "{name}");
        }
    }

    #[test]
    fn comments_packages_defaults_and_constants_make_no_difference() {
        let other =
            "# An odometer\nfloat32 x   # forwards\n\nfloat32 y 0.0\nuint8 KIND=3\nuint8 OTHER = 4\nfloat32 theta\n";
        assert_eq!(difference(Odometer::TYPE, other.as_bytes()), None);
        let long = "std_msgs/msg/Header header\ngeometry_msgs/msg/Pose pose\n";
        assert_eq!(difference(PoseStamped::TYPE, long.as_bytes()), None, "nested types are left out");
        assert_eq!(difference(Odometer::TYPE, b""), None);
        assert_eq!(difference("std_msgs/msg/String", b"int32 x"), None, "not a type that is read");
    }

    #[test]
    fn a_field_more_or_less_or_of_another_type_is_a_difference() {
        let stamped = "std_msgs/Header header\nfloat32 x\nfloat32 y\nfloat32 theta\n";
        let found = difference(Odometer::TYPE, stamped.as_bytes()).expect("another version");
        assert_eq!((found.found.as_deref(), found.expected.as_deref()), (Some("Header header"), Some("float32 x")));
        let longer = "float32 x\nfloat32 y\nfloat32 theta\nfloat32 z\n";
        let found = difference(Odometer::TYPE, longer.as_bytes()).expect("longer");
        assert_eq!((found.found.as_deref(), found.expected), (Some("float32 z"), None));
        let nested = LowState::DEFINITION.replace("float32[3] gyro", "float64[3] gyro");
        let found = difference(LowState::TYPE, nested.as_bytes()).expect("a nested type");
        assert_eq!((found.within.as_str(), found.found.as_deref()), ("ImuState", Some("float64[3] gyro")));
    }
}
