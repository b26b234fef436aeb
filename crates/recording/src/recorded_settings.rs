//! Settings as a session recorded them, read by another version of the program.

use serde::de::Error;
use serde::{Deserialize, Deserializer};
use serde_json::Value;

use realitysim_config::Settings;

/// Deserializes the settings of a session. Keys that this version does not have are left out: what they were for is not known any
/// more, or not yet, and the recording is worth reading all the same.
pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Settings, D::Error> {
    let mut settings = Value::deserialize(deserializer)?;
    let known = serde_json::to_value(Settings::default()).map_err(D::Error::custom)?;
    remove_unknown(&mut settings, &known);
    serde_json::from_value(settings).map_err(D::Error::custom)
}

/// Removes the keys that `known` does not have, which therefore has to have all of them, null where nothing is set. An empty object of
/// `known` is a map whose keys are free.
fn remove_unknown(value: &mut Value, known: &Value) {
    let (Value::Object(keys), Value::Object(known)) = (value, known) else { return };
    if known.is_empty() {
        return;
    }
    keys.retain(|key, value| {
        let known = known.get(key);
        if let Some(known) = known {
            remove_unknown(value, known);
        }
        known.is_some()
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(settings: &Value) -> Result<Settings, serde_json::Error> {
        deserialize(settings)
    }

    #[test]
    fn keys_of_another_version_are_left_out() {
        let mut settings = Settings::default();
        settings.filter.particles = 77;
        settings.capture.controls.insert("gain".to_owned(), 30);
        // Keys without a default are known, too.
        settings.field_size_m = Some([6.06, 3.96]);
        settings.filter.alpha = Some(2.0);
        settings.camera.fov_deg = Some(180.0);
        settings.mount.torso_height_m = Some(0.4);
        let mut recorded = serde_json::to_value(&settings).unwrap();
        recorded["filter"]["of_another_version"] = 0.7.into();
        recorded["section_of_another_version"] = serde_json::json!({"key": 1});
        assert_eq!(read(&recorded).unwrap(), settings);
    }

    #[test]
    fn values_that_no_version_writes_are_refused() {
        let mut recorded = serde_json::to_value(Settings::default()).unwrap();
        recorded["filter"]["particles"] = "many".into();
        assert!(read(&recorded).unwrap_err().to_string().contains("many"));
    }
}
