//! Checks whether the processor keeps up with the camera: tags a rendered walk seen through the robot's lens, with its
//! settings.

use std::path::PathBuf;

use super::{Finding, bad, good};
use crate::config::{Settings, load_lens};
use crate::scene::{Scene, SceneFile};
use crate::tagging::durations::Durations;
use crate::tagging::frame_cache::{FrameCache, FrameCacheOptions};

/// Share of the time between two frames that tagging may take. Decoding, recording and the team's own programs need the
/// rest.
const TAGGING_SHARE: f64 = 0.5;

/// Compares the time a tag takes with the time between frames. `None` without lens or mount, on which other findings
/// report.
pub(super) fn check_headroom(settings: &Settings) -> Option<Finding> {
    let what = format!("processor with {} threads", std::thread::available_parallelism().map_or(1, usize::from));
    let scene = build_scene(settings)?;
    let options = FrameCacheOptions {
        source: PathBuf::from("a made-up walk"),
        settings: settings.clone(),
        initial: None,
        from_s: 0.0,
        for_s: None,
    };
    let tried = FrameCache::of_scene(&scene, &options, &mut |_, _| {})
        .map_err(|error| error.to_string())
        .and_then(|cache| cache.try_out(settings, &mut |_| {}).map_err(|error| error.to_string()));
    let attempts = match tried {
        Ok(attempts) => attempts,
        Err(error) => return Some(bad(what, error, "see the message")),
    };
    let mut times = Durations::default();
    attempts.iter().filter(|attempt| attempt.seen).for_each(|attempt| times.note(attempt.tag.elapsed_ms));
    let times = times.quantiles();
    let capture = &settings.capture;
    let rate_hz = if capture.max_rate_hz > 0.0 { capture.max_rate_hz.min(capture.rate_hz) } else { capture.rate_hz };
    let between_ms = 1e3 / rate_hz;
    let budget = match settings.filter.budget_ms {
        0.0 => "no budget".to_owned(),
        budget => format!("budget {budget} ms"),
    };
    let said = format!(
        "a tag takes {:.1} ms, 1 % over {:.1} ms ({budget}); {between_ms:.1} ms between frames: {:.0} % free",
        times.p50,
        times.p99,
        (100.0 * (1.0 - times.p50 / between_ms)).max(0.0)
    );
    Some(if times.p50 <= TAGGING_SHARE * between_ms {
        good(what, said)
    } else {
        let most_ms = TAGGING_SHARE * between_ms;
        let remedy = format!("set filter.budget_ms to {most_ms:.0} or less, or capture.max_rate_hz lower");
        bad(what, said, remedy)
    })
}

/// Scene of a walk through the field's centre: ten frames a second for four seconds.
fn build_scene(settings: &Settings) -> Option<Scene> {
    let lens = load_lens(settings.camera.lens.as_deref()?).ok()?.lens;
    let field = settings.field_dimensions().ok()?;
    let mount = &settings.mount;
    let [x, y, z] = mount.camera_xyz_m;
    let file = SceneFile::from_toml(&format!(
        "[scene]\ntitle = \"doctor\"\ntask = \"Load\"\nseed = 1\nfield = \"{}\"\n\
         [camera]\nlens = \"lens\"\nrate_hz = 10.0\njpeg_quality = 90\ntorso_height_m = {:?}\n\
         mount_xyz_m = [{x:?}, {y:?}, {z:?}]\nmount_pitch_deg = {:?}\n\
         [route]\nkind = \"walk\"\nwaypoints = [[-0.5, 0.1], [0.5, 0.1]]\nspeed_m_s = 0.25\nturn_deg_s = 30.0\n\
         [odometry]\nrate_hz = 50.0\n[imu]\nrate_hz = 100.0\n",
        settings.field.escape_default(),
        mount.torso_height_m?,
        mount.camera_rpy_deg[1],
    ))
    .ok()?;
    Scene::build(file, field, lens.parameters().clone()).ok()
}
