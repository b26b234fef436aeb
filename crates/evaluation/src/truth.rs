//! Where the true poses of a sweep or an experiment come from.

use realitysim_geometry::Isometry;
use realitysim_scene::{Scene, SceneEventKind};

/// True poses of `camera_link` at every frame of a scene.
pub fn of_scene(scene: &Scene) -> Vec<(i64, Isometry)> {
    let pose = |kind| match kind {
        SceneEventKind::Frame { map_from_camera_link, .. } => Some(map_from_camera_link),
        _ => None,
    };
    scene.events().filter_map(|event| Some((event.stamp_ns, pose(event.kind)?))).collect()
}
