//! The scenes of the experiments: the paper's field and camera, standing on a grid and walking along the field.

use core::f64::consts::PI;

use realitysim_config::{ConfigError, load_field, load_lens};
use realitysim_scene::{Scene, SceneError, SceneFile};

/// Camera, odometry and IMU of both scenes, in the format of scene files.
const ROBOT: &str = r#"
[camera]
lens = "paper-640"
rate_hz = RATE
jpeg_quality = 90
torso_height_m = 0.38
mount_xyz_m = [0.04, 0.0, 0.11]
mount_pitch_deg = 17.0

[odometry]
rate_hz = 50.0

[imu]
rate_hz = 50.0
"#;

/// Effects of the walk: swaying gait and errors of odometry.
const WALKING: &str = r#"
[[effect]]
kind = "gait_sway"
roll_deg = 2.0
pitch_deg = 1.3
lateral_m = 0.018
vertical_m = 0.006
step_hz = 2.4

[[effect]]
kind = "odometry_error"
scale_percent = 6.0
yaw_drift_deg_per_m = 0.0
noise_m_per_m = 0.05
"#;

/// Errors of IMU and image sensor in both scenes: the attitude is off by half a degree, and by a quarter at random.
const SENSORS: &str = r#"
[[effect]]
kind = "imu_error"
roll_bias_deg = 0.5
pitch_bias_deg = -0.5
noise_deg = 0.25
gyro_noise_deg_s = 0.3

[[effect]]
kind = "sensor_noise"
read_noise_dn = 1.5
shot_noise_factor = 0.15
"#;

/// Name of the field.
const FIELD: &str = "kid-2009";
/// Seed of both scenes.
const SEED: u64 = 20_130_601;

/// Reason why a scene of the experiments cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum SceneFailure {
    /// The scene cannot be built.
    #[error("the experiment's scene: {0}")]
    Scene(#[from] SceneError),
    /// A shipped field or lens cannot be loaded.
    #[error(transparent)]
    Config(#[from] ConfigError),
}

/// Returns a scene of a robot standing on a grid, and the number of places.
///
/// The grid is centred on the field and lies within its lines. There is one frame a second, one at each place, and the
/// headings cover the circle.
pub fn still(spacing_m: f64) -> Result<(Scene, usize), SceneFailure> {
    let field = load_field(FIELD)?;
    let count = |length: f64| (libm::floor(length / spacing_m + 1e-9) as usize).max(1);
    let (columns, rows) = (count(field.length_m), count(field.width_m));
    let place = |index: usize, count: usize| (index as f64 - (count - 1) as f64 / 2.0) * spacing_m;
    // In steps of the golden angle no heading repeats.
    let golden_deg = 180.0 * (3.0 - libm::sqrt(5.0));
    let poses: Vec<String> = (0..columns * rows)
        .map(|index| {
            let (x, y) = (place(index % columns, columns), place(index / columns, rows));
            let yaw = (index as f64 * golden_deg) % 360.0 - 180.0;
            format!("[{x:.3}, {y:.3}, {yaw:.3}]")
        })
        .collect();
    let route = format!("[route]\nkind = \"still\"\nhold_s = 1.0\nposes = [{}]\n", poses.join(", "));
    Ok((scene("Standing on a grid", &route, 1.0, "")?, poses.len()))
}

/// Returns a scene of a straight walk along the field, 10 cm beside its long axis.
pub fn walk(length_m: f64, rate_hz: f64) -> Result<Scene, SceneFailure> {
    let from = -2.9;
    let to = from + length_m;
    let route = format!(
        "[route]\nkind = \"walk\"\nwaypoints = [[{from:.3}, 0.1], [{to:.3}, 0.1]]\nspeed_m_s = {WALK_M_PER_S}\nturn_deg_s = 30.0\n"
    );
    scene("Straight walk", &route, rate_hz, WALKING)
}

/// Speed of the walk, metres per second.
pub const WALK_M_PER_S: f64 = 0.25;

fn scene(title: &str, route: &str, rate_hz: f64, motion: &str) -> Result<Scene, SceneFailure> {
    let text = format!(
        "[scene]\ntitle = \"{title}\"\ntask = \"The paper's experiments.\"\nseed = {SEED}\nfield = \"{FIELD}\"\n\
         initial_pose = {{ x_m = -0.06, y_m = 0.053, yaw_deg = 2.0 }}\n{}{route}{motion}{SENSORS}",
        ROBOT.replace("RATE", &format!("{rate_hz:.1}"))
    );
    let file = SceneFile::from_toml(&text)?;
    let lens = load_lens(&file.camera.lens)?;
    Ok(Scene::build(file, load_field(FIELD)?, lens.lens.parameters().clone())?)
}

/// Standard deviation in x and in y of the start pose at a place of the grid, metres.
pub const START_XY_M: f64 = 0.2;
/// Standard deviation of yaw of the start pose at a place of the grid, radians.
pub const START_YAW_RAD: f64 = 8.0 * PI / 180.0;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_grid_covers_the_field_with_all_headings() {
        let (scene, count) = still(0.3).expect("a scene");
        assert_eq!(count, 20 * 13);
        let poses: Vec<_> = (0..count).map(|index| scene.truth(index as f64).map_from_base_footprint).collect();
        for (index, pose) in poses.iter().enumerate() {
            assert!(pose.x.abs() <= 3.0 && pose.y.abs() <= 2.0);
            assert!(poses[..index].iter().all(|other| other.distance(pose) > 0.29), "a place stands twice");
        }
        for quarter in 0..4 {
            let low = f64::from(quarter) * PI / 2.0 - PI;
            let share = poses.iter().filter(|pose| (low..low + PI / 2.0).contains(&pose.yaw)).count();
            assert!(share > count / 5, "{share}");
        }
    }

    #[test]
    fn the_walk_crosses_the_field() {
        let scene = walk(5.8, 10.0).expect("a scene");
        assert_eq!(scene.frame_count(), 233);
        assert!((scene.truth(scene.duration_s()).map_from_base_footprint.x - 2.9).abs() < 1e-6);
    }
}
