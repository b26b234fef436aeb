//! True poses of rendered scenes.

use realitysim_geometry::Isometry;
use realitysim_scene::{Scene, SceneEventKind};

/// Returns the true pose of `camera_link` in `map` at every frame of a scene, with its time in nanoseconds.
pub fn of_scene(scene: &Scene) -> Vec<(i64, Isometry)> {
    let pose = |kind| match kind {
        SceneEventKind::Frame { map_from_camera_link, .. } => Some(map_from_camera_link),
        _ => None,
    };
    scene.events().filter_map(|event| Some((event.stamp_ns, pose(event.kind)?))).collect()
}
