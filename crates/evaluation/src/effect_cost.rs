//! What each effect of a scene costs in every frame.
//!
//! Time of the processor, in one thread: while others run, nothing is counted. A fixed loop in between tells how fast the
//! machine is just then.

use rustix::time::{ClockId, clock_gettime};
use serde::Serialize;

use super::cpu_yardstick::{Calibration, REFERENCE_MS};
use realitysim_scene::{Renderer, Scene, SceneError};

#[derive(Clone, Debug, Serialize)]
pub struct SceneCost {
    /// Without any effect.
    pub bare_ms: f64,
    /// In the order of the file; what each adds to those before it.
    pub effects: Vec<EffectCost>,
    pub total_ms: f64,
    /// What the calibration loop took meanwhile.
    pub loop_ms: f64,
}

impl SceneCost {
    /// What a frame would take on the machine whose loop takes [`REFERENCE_MS`]: the same on a slow or busy one.
    pub fn reference_ms(&self) -> f64 {
        self.total_ms * REFERENCE_MS / self.loop_ms
    }
}

#[derive(Clone, Debug, Serialize)]
pub struct EffectCost {
    pub kind: &'static str,
    /// None of an effect that changes no pixel.
    pub ms: Option<f64>,
}

/// Frames that are rendered, spread over the scene.
const FRAMES: u64 = 6;
/// The shortest time counts: what disturbs only ever adds.
const ROUNDS: usize = 5;

/// In one thread, from the same poses with and without each effect.
pub fn measure(scene: &Scene) -> Result<SceneCost, SceneError> {
    let effects = &scene.file().effects;
    // Without any effect, then up to each that acts on images.
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

/// Of this thread.
fn processor_ms(work: impl FnOnce()) -> f64 {
    let now_ms = || {
        let time = clock_gettime(ClockId::ThreadCPUTime);
        time.tv_sec as f64 * 1e3 + time.tv_nsec as f64 * 1e-6
    };
    let started_ms = now_ms();
    work();
    now_ms() - started_ms
}
