//! Rendering time of each effect of a scene.
//!
//! Times are processor time of one thread, which does not grow while other programs run. The calibration loop runs in
//! between and tells how fast the machine is at that moment.

use rustix::time::{ClockId, clock_gettime};
use serde::Serialize;

use super::cpu_calibration::{Calibration, REFERENCE_MS};
use realitysim_scene::{Renderer, Scene, SceneError};

/// Rendering times of a scene, milliseconds of processor time for a frame.
#[derive(Clone, Debug, Serialize)]
pub struct SceneCost {
    /// Time without any effect.
    pub bare_ms: f64,
    /// Rendering time of each effect, added to that of those before it, in the order of the scene file.
    pub effects: Vec<EffectCost>,
    /// Time with all effects.
    pub total_ms: f64,
    /// Shortest time of the calibration loop during the measurement.
    pub loop_ms: f64,
}

impl SceneCost {
    /// Returns the time for a frame, milliseconds, scaled to the machine whose calibration loop takes [`REFERENCE_MS`].
    pub fn reference_ms(&self) -> f64 {
        self.total_ms * REFERENCE_MS / self.loop_ms
    }
}

/// Rendering time of one effect.
#[derive(Clone, Debug, Serialize)]
pub struct EffectCost {
    /// Name of the effect.
    pub kind: &'static str,
    /// Added time for a frame, milliseconds; `None` for an effect that changes no pixel.
    pub ms: Option<f64>,
}

/// Number of frames that are rendered, spread over the scene.
const FRAMES: u64 = 6;
/// Number of measurements of each frame. The shortest counts: disturbances only add time.
const ROUNDS: usize = 5;

/// Measures the rendering times of a scene in one thread, from the same poses with and without each effect.
///
/// # Errors
///
/// Fails if the scene cannot be built with only some of its effects.
pub fn measure(scene: &Scene) -> Result<SceneCost, SceneError> {
    let effects = &scene.file().effects;
    // The number of effects: none, then up to and including each effect that acts on images.
    let acting = (0..effects.len()).filter(|index| effects[*index].acts_on_image());
    let counts: Vec<usize> = core::iter::once(0).chain(acting.map(|index| index + 1)).collect();
    let renderers: Vec<Renderer> = counts
        .iter()
        .map(|count| Ok(Renderer::new(&scene.with_first_effects(*count)?)))
        .collect::<Result<_, SceneError>>()?;
    let frames = scene.frame_count().clamp(1, FRAMES);
    let mut best = vec![vec![f64::INFINITY; frames as usize]; renderers.len()];
    let mut pixels = Vec::new();
    let calibration = Calibration::new();
    let mut loop_ms = f64::INFINITY;
    for _ in 0..ROUNDS {
        for frame in 0..frames {
            loop_ms = loop_ms.min(processor_ms(|| calibration.run()));
            let index = frame * scene.frame_count() / frames;
            let pose = scene.truth(scene.frame_time_s(index)).map_from_camera_link;
            for (renderer, best) in renderers.iter().zip(&mut best) {
                let best = &mut best[frame as usize];
                *best = best.min(processor_ms(|| renderer.render_from(&pose, index, &mut pixels)));
            }
        }
    }
    let means: Vec<f64> = best.iter().map(|of_frames| of_frames.iter().sum::<f64>() / frames as f64).collect();
    let mut added = means.windows(2).map(|pair| (pair[1] - pair[0]).max(0.0));
    let cost = |effect: &realitysim_scene::Effect| EffectCost {
        kind: effect.name(),
        ms: if effect.acts_on_image() { added.next() } else { None },
    };
    Ok(SceneCost {
        bare_ms: means[0],
        effects: effects.iter().map(cost).collect(),
        total_ms: means.last().copied().unwrap_or(0.0),
        loop_ms,
    })
}

/// Returns the processor time of this thread for some work, milliseconds.
fn processor_ms(work: impl FnOnce()) -> f64 {
    let now_ms = || {
        let time = clock_gettime(ClockId::ThreadCPUTime);
        time.tv_sec as f64 * 1e3 + time.tv_nsec as f64 * 1e-6
    };
    let started_ms = now_ms();
    work();
    now_ms() - started_ms
}
