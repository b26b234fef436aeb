//! Comparison of tags with those of a reference.

use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;
use serde_json::Value;

use super::file::{Frames, Reference, ReferenceError};
use super::identity::{CONTENTS, Identity};

/// Result of a comparison.
#[derive(Clone, Debug, Serialize)]
pub struct Verdict {
    /// Whether all tags equal those of the reference, up to its tolerances.
    pub same: bool,
    /// Number of frames.
    pub frames: usize,
    /// Number of frames of the reference.
    pub frames_of_reference: usize,
    /// Number of frames with a difference beyond its tolerance, or without a counterpart.
    pub frames_differ: usize,
    /// Number of values that differ, but within their tolerance.
    pub tolerated: usize,
    /// Fields that differ, by name.
    pub differences: Vec<Difference>,
    /// Names of the fields that were compared.
    pub compared: Vec<String>,
    /// Settings that differ from those of the reference. They do not count as a difference of the tags.
    pub settings: Vec<String>,
}

/// Difference in one field.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// Name of the field.
    pub field: String,
    /// Number of frames in which it differs.
    pub frames: usize,
    /// Largest difference; `None` if the values are no numbers.
    pub largest: Option<f64>,
    /// Index of the first frame in which it differs.
    pub first_frame: usize,
    /// Value of the reference and value of the replay in that frame.
    pub first: [Value; 2],
    /// Tolerance of the field; 0 if none is stated.
    pub tolerance: f64,
}

/// Compares the tags of a replay with a reference. `file` is the path of the reference, for messages.
///
/// # Errors
///
/// Refuses replays of another log, seed, start or version, and tags with other fields.
pub fn compare(
    reference: &Reference,
    file: &str,
    identity: &Identity,
    settings: &Value,
    frames: &Frames,
) -> Result<Verdict, ReferenceError> {
    if let Some(mut why) = reference.identity.differs(identity) {
        let mut contents = changed_settings(&reference.settings, settings);
        contents.retain(|change| CONTENTS.iter().any(|name| change.starts_with(name)));
        if reference.identity.source == identity.source && !contents.is_empty() {
            why = format!("{why}, and {}", contents.join(", "));
        }
        return Err(ReferenceError::Other { file: file.to_owned(), why });
    }
    let fields = |frames: &Frames| frames.fields.keys().cloned().collect::<BTreeSet<String>>();
    let (then, now) = (fields(&reference.frames), fields(frames));
    if frames.count > 0 && then != now {
        let odd: Vec<String> = then.symmetric_difference(&now).cloned().collect();
        let why = format!("tags have other fields now ({})", odd.join(", "));
        return Err(ReferenceError::Other { file: file.to_owned(), why });
    }
    let (mut differing, mut tolerated) = (BTreeSet::new(), 0);
    let mut differences = Vec::new();
    for (field, then) in &reference.frames.fields {
        let tolerance = reference.tolerance.get(field).copied().unwrap_or(0.0);
        let now = frames.fields.get(field).map_or(&[][..], Vec::as_slice);
        differences.extend(difference(field, then, now, tolerance, &mut differing));
        tolerated += then.iter().zip(now).filter(|(then, now)| then != now && is_within(then, now, tolerance)).count();
    }
    let unpaired = frames.count.abs_diff(reference.frames.count);
    Ok(Verdict {
        same: differences.is_empty() && unpaired == 0,
        frames: frames.count,
        frames_of_reference: reference.frames.count,
        frames_differ: differing.len() + unpaired,
        tolerated,
        differences,
        compared: then.into_iter().collect(),
        settings: changed_settings(&reference.settings, settings),
    })
}

/// Compares one field, and adds the frames in which it differs to `differing`.
fn difference(
    field: &str,
    then: &[Value],
    now: &[Value],
    tolerance: f64,
    differing: &mut BTreeSet<usize>,
) -> Option<Difference> {
    let mut found: Option<Difference> = None;
    for (frame, (then, now)) in then.iter().zip(now).enumerate() {
        if then == now || is_within(then, now, tolerance) {
            continue;
        }
        let distance = distance(then, now);
        differing.insert(frame);
        let found = found.get_or_insert_with(|| Difference {
            field: field.to_owned(),
            frames: 0,
            largest: None,
            first_frame: frame,
            first: [then.clone(), now.clone()],
            tolerance,
        });
        found.frames += 1;
        found.largest = distance.map(|distance| found.largest.unwrap_or(0.0).max(distance)).or(found.largest);
    }
    found
}

/// Returns the absolute difference of two numbers; `None` if one is none.
fn distance(then: &Value, now: &Value) -> Option<f64> {
    then.as_f64().zip(now.as_f64()).map(|(then, now)| (then - now).abs())
}

fn is_within(then: &Value, now: &Value, tolerance: f64) -> bool {
    distance(then, now).is_some_and(|distance| distance <= tolerance)
}

/// Describes changed settings, each as `filter.particles is 400, was 800`.
fn changed_settings(then: &Value, now: &Value) -> Vec<String> {
    let (mut before, mut after) = (BTreeMap::new(), BTreeMap::new());
    collect_leaves(String::new(), then, &mut before);
    collect_leaves(String::new(), now, &mut after);
    for name in CONTENTS.iter().filter(|name| then.get(**name).is_none()) {
        after.retain(|key, _| !key.starts_with(name));
    }
    let keys: BTreeSet<&String> = before.keys().chain(after.keys()).collect();
    let changed = keys.into_iter().filter(|key| before.get(*key) != after.get(*key));
    let shown = |value: Option<&&Value>| value.map_or("not there".to_owned(), ToString::to_string);
    changed.map(|key| format!("{key} is {}, was {}", shown(after.get(key)), shown(before.get(key)))).collect()
}

/// Collects the leaves of a JSON value by name.
fn collect_leaves<'a>(name: String, value: &'a Value, found: &mut BTreeMap<String, &'a Value>) {
    match value {
        Value::Object(map) => {
            for (key, value) in map {
                collect_leaves(if name.is_empty() { key.clone() } else { format!("{name}.{key}") }, value, found);
            }
        }
        value => drop(found.insert(name, value)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use realitysim_ros2::messages::FrameTag;

    fn tags(count: usize) -> Vec<FrameTag> {
        let tag = |index: usize| FrameTag {
            valid: true,
            sequence: index as u64,
            yaw: 0.1 * index as f64,
            elapsed_ms: 7.0 * index as f64,
            reason: "x".to_owned(),
            ..FrameTag::default()
        };
        (0..count).map(tag).collect()
    }

    fn identity() -> Identity {
        Identity {
            software: "s 1".to_owned(),
            source: "a.mcap".to_owned(),
            blake3: "ab".to_owned(),
            seed: 1,
            initial: None,
        }
    }

    fn reference(tolerance: &[(&str, f64)]) -> Reference {
        let tolerance = tolerance.iter().map(|(field, value)| ((*field).to_owned(), *value)).collect();
        let settings = serde_json::json!({ "filter": { "particles": 800 } });
        Reference::new(identity(), tolerance, settings, Frames::of(&tags(9))).expect("a reference")
    }

    fn verdict(reference: &Reference, tags: &[FrameTag]) -> Verdict {
        compare(reference, "f", &identity(), &reference.settings, &Frames::of(tags)).expect("comparable")
    }

    #[test]
    fn the_text_form_keeps_every_bit() {
        let mut odd = tags(3);
        odd[1].pose.pose.position.x = f64::from_bits(0x3FE5_5555_5555_5557);
        odd[2].evidence = -1.0e-310;
        let reference =
            Reference::new(identity(), BTreeMap::new(), Value::Null, Frames::of(&odd)).expect("a reference");
        let text = reference.to_text();
        assert_eq!(Reference::parse(&text, "f").expect("readable"), reference);
        assert_eq!(text.lines().count(), 4);
        assert!(verdict(&reference, &odd).same);
        odd[1].pose.pose.position.x = f64::from_bits(0x3FE5_5555_5555_5556);
        assert_eq!(verdict(&reference, &odd).differences[0].field, "pose.pose.position.x");
    }

    #[test]
    fn differences_are_counted_by_field() {
        let reference = reference(&[]);
        let mut now = tags(9);
        now.iter_mut().for_each(|tag| tag.elapsed_ms = 1.0);
        assert!(verdict(&reference, &now).same, "how long it took is no difference");
        now[4].yaw += 0.25;
        now[5].yaw -= 0.5;
        now[5].reason = "y".to_owned();
        let found = verdict(&reference, &now);
        assert_eq!((found.same, found.frames_differ), (false, 2));
        let [reason, yaw] = &found.differences[..] else { panic!("{found:?}") };
        assert_eq!((reason.field.as_str(), reason.first_frame, reason.largest), ("reason", 5, None));
        assert_eq!((yaw.frames, yaw.first_frame), (2, 4));
        assert!((yaw.largest.expect("a number") - 0.5).abs() < 1e-12);
        let shorter = verdict(&reference, &tags(8));
        assert_eq!((shorter.same, shorter.frames_differ, shorter.frames_of_reference), (false, 1, 9));
    }

    #[test]
    fn a_tolerance_holds_for_its_field_alone() {
        let reference = reference(&[("yaw", 0.3)]);
        let mut now = tags(9);
        now[4].yaw += 0.25;
        assert!(verdict(&reference, &now).same);
        now[4].pitch += 0.25;
        assert_eq!(verdict(&reference, &now).differences[0].field, "pitch");
        for field in ["yew", "reason", "valid"] {
            let tolerance = BTreeMap::from([(field.to_owned(), 1.0)]);
            let refused = Reference::new(identity(), tolerance, Value::Null, Frames::of(&tags(2)));
            let message = refused.expect_err("refused").to_string();
            assert!(message.contains(field) && message.contains("yaw"), "{message}");
        }
    }

    #[test]
    fn tags_that_show_nothing_make_no_reference() {
        let invalid: Vec<FrameTag> = tags(3).into_iter().map(|tag| FrameTag { valid: false, ..tag }).collect();
        for (tags, word) in [(Vec::new(), "no frame"), (invalid, "none of 3 tags")] {
            let refused = Reference::new(identity(), BTreeMap::new(), Value::Null, Frames::of(&tags));
            let message = refused.expect_err("refused").to_string();
            assert!(message.contains(word), "{message}");
        }
    }

    #[test]
    fn a_reference_of_something_else_is_named_and_not_compared() {
        let reference = reference(&[]);
        let frames = Frames::of(&tags(9));
        for (other, words) in [
            (Identity { software: "s 2".to_owned(), ..identity() }, ["made by s 1", "this is s 2"]),
            (
                Identity { blake3: "cd".to_owned(), source: "b.mcap".to_owned(), ..identity() },
                ["another log", "b.mcap (cd)"],
            ),
            (Identity { seed: 5, ..identity() }, ["seed 1", "seed 5"]),
            (Identity { initial: Some([1.0, 2.0, 0.0]), ..identity() }, ["where the log says", "1,2,0"]),
        ] {
            let refused = compare(&reference, "f", &other, &Value::Null, &frames).expect_err("not compared");
            let message = refused.to_string();
            assert!(message.starts_with("f: not compared"), "{message}");
            assert!(words.iter().all(|word| message.contains(word)), "{message}");
        }
        let text = reference.to_text();
        for (changed, word) in [
            (text.replacen("\"realitysim_reference\":1", "\"realitysim_reference\":2", 1), "format 2"),
            (text.lines().take(5).collect::<Vec<_>>().join("\n"), "is it whole?"),
            (text.replacen("[", "[1,", 2), "line"),
            ("{}".to_owned(), "no reference"),
            (String::new(), "no reference"),
        ] {
            let message = Reference::parse(&changed, "f").expect_err("refused").to_string();
            assert!(message.contains(word), "{word}: {message}");
        }
        let settings = serde_json::json!({ "filter": { "particles": 400 } });
        let noted = compare(&reference, "f", &identity(), &settings, &frames).expect("comparable");
        assert_eq!(noted.settings, ["filter.particles is 400, was 800"]);
    }
}
