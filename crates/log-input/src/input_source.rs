//! Tells a rendered scene from a recorded log by the name of its file.

use std::path::Path;

/// What a source of messages is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InputSource {
    /// A recorded log: an MCAP file, or a folder of them.
    Log,
    /// A scene file, which is rendered in place of a log.
    Scene,
}

impl InputSource {
    /// The kind of the source at `path`: a scene if the name ends in `.toml`, whether or not there is such a file.
    pub fn of(path: &Path) -> Self {
        if path.extension().is_some_and(|extension| extension == "toml") { Self::Scene } else { Self::Log }
    }

    /// Whether the source at `path` is a scene.
    pub fn is_scene(path: &Path) -> bool {
        Self::of(path) == Self::Scene
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scenes_are_known_by_their_ending() {
        assert_eq!(InputSource::of(Path::new("replay/scenes/loop.toml")), InputSource::Scene);
        for log in ["walk.mcap", "bag/", "toml", "captures/2025-10-09T08-53-20Z-robot"] {
            assert_eq!(InputSource::of(Path::new(log)), InputSource::Log, "{log}");
        }
    }
}
