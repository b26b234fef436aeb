//! The experiments: every method on the same frames.

use serde::Serialize;
use thiserror::Error;

use super::method::{METHODS, Method};
use super::scenes::{self, START_XY_M, START_YAW_RAD, SceneFailure};
use crate::capture::tagged;
use crate::compare::truth_at;
use crate::statistics::{Summary, quantile};
use crate::{Tagged, truth};
use realitysim_config::Settings;
use realitysim_geometry::{Isometry, Pose2, wrap_angle};
use realitysim_localization::random::{Purpose, Stream};
use realitysim_log_input::synchroniser::InitialPose;
use realitysim_scene::Scene;
use realitysim_tagging::{FrameCache, FrameCacheOptions, ReplayError, SetupError, Trial};

/// Extent of the experiments.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Spacing of the grid, metres.
    pub grid_m: f64,
    /// Length of the walk, metres.
    pub walk_m: f64,
    /// Frame rate of the walk, Hz.
    pub walk_hz: f64,
    /// Number of seeds that the walk is tracked with: a filter loses itself with some seeds only.
    pub walk_seeds: u64,
    /// Numbers of particles of Fig. 9. Table 2 and Fig. 10 have that of the paper.
    pub particles: Vec<usize>,
}

impl Plan {
    /// Returns the extent of the paper.
    pub fn full() -> Self {
        Self { grid_m: 0.3, walk_m: 5.8, walk_hz: 10.0, walk_seeds: 5, particles: vec![50, 100, 200, 400, 800, 1600] }
    }

    /// Returns an extent that takes a few seconds: it shows that everything works, but its figures say little.
    pub fn quick() -> Self {
        Self { grid_m: 1.2, walk_m: 1.0, walk_hz: 5.0, walk_seeds: 2, particles: vec![100, 800] }
    }
}

/// Result of one method over one set of frames.
///
/// Every frame counts, even where the filter calls the tag invalid: the paper has no invalid tags.
#[derive(Clone, Debug, Serialize)]
pub struct Run {
    /// The method.
    #[serde(serialize_with = "name")]
    pub method: Method,
    /// Number of particles.
    pub particles: usize,
    /// Position errors in x and y, centimetres.
    pub position_cm: Summary,
    /// Absolute errors of yaw, degrees.
    pub yaw_deg: Summary,
    /// Median time from the decoded image to the tag, milliseconds.
    pub p50_ms: f64,
    /// 99 % quantile of the same times, milliseconds.
    pub p99_ms: f64,
    /// Mean position error of each seed, centimetres.
    pub seed_means_cm: Vec<f64>,
    /// Position error of each frame with the first seed, centimetres.
    #[serde(skip)]
    pub errors_cm: Vec<f64>,
}

/// Results of the experiments.
#[derive(Clone, Debug, Serialize)]
pub struct Paper {
    /// Spacing of the grid, metres.
    pub grid_m: f64,
    /// Number of frames on the grid.
    pub still_frames: usize,
    /// Number of frames of the walk.
    pub walk_frames: usize,
    /// Frame rate of the walk, Hz.
    pub walk_hz: f64,
    /// Results on the grid: Fig. 9 and Table 2.
    pub still: Vec<Run>,
    /// Results of the walk: Fig. 10.
    pub walk: Vec<Run>,
}

/// Reason why the experiments cannot be run.
#[derive(Debug, Error)]
pub enum PaperError {
    /// A scene cannot be made.
    #[error(transparent)]
    Scene(#[from] SceneFailure),
    /// A scene cannot be rendered.
    #[error(transparent)]
    Replay(#[from] ReplayError),
    /// The filter cannot be set up.
    #[error(transparent)]
    Setup(#[from] SetupError),
}

/// Callback with the name of the step, the number of frames that are done, and that of all frames if it is known.
pub type Progress<'a> = &'a mut dyn FnMut(&'static str, u64, Option<u64>);

/// Runs the experiments. Other settings than those of the methods are taken from `settings`.
pub fn reproduce(plan: &Plan, settings: &Settings, progress: Progress) -> Result<Paper, PaperError> {
    let (still_frames, still) = still(plan, settings, progress)?;
    let (walk_frames, walk) = walk(plan, settings, progress)?;
    Ok(Paper { grid_m: plan.grid_m, still_frames, walk_frames, walk_hz: plan.walk_hz, still, walk })
}

fn still(plan: &Plan, settings: &Settings, progress: Progress) -> Result<(usize, Vec<Run>), PaperError> {
    let (scene, places) = scenes::still(plan.grid_m)?;
    let mut settings = settings.clone();
    settings.filter.initial_xy_m = START_XY_M;
    settings.filter.initial_yaw_deg = START_YAW_RAD.to_degrees();
    let starts: Vec<InitialPose> = (0..places).map(|index| draw_start(&scene, index, settings.filter.seed)).collect();
    // The scene ends with a second frame at the last place, which is left out.
    let cache = render(&scene, &settings, Some(places as f64 - 0.5), progress)?.apart(&starts);
    let in_fig9 = plan.particles.iter().flat_map(|particles| METHODS.map(|method| (method, *particles)));
    let wanted: Vec<(Method, usize)> =
        in_fig9.filter(|(method, particles)| method.in_fig9 || *particles == super::PAPER_PARTICLES).collect();
    let runs = runs(&cache, &truth::of_scene(&scene), &wanted, 1, "standing", progress)?;
    Ok((cache.frames(), runs))
}

fn walk(plan: &Plan, settings: &Settings, progress: Progress) -> Result<(usize, Vec<Run>), PaperError> {
    let scene = scenes::walk(plan.walk_m, plan.walk_hz)?;
    let cache = render(&scene, settings, None, progress)?;
    let wanted = METHODS.map(|method| (method, super::PAPER_PARTICLES));
    let runs = runs(&cache, &truth::of_scene(&scene), &wanted, plan.walk_seeds, "walking", progress)?;
    Ok((cache.frames(), runs))
}

fn render(
    scene: &Scene,
    settings: &Settings,
    for_s: Option<f64>,
    progress: Progress,
) -> Result<FrameCache, ReplayError> {
    let source = scene.file().scene.title.clone().into();
    let options = FrameCacheOptions { source, settings: settings.clone(), initial: None, from_s: 0.0, for_s };
    FrameCache::of_scene(scene, &options, &mut |done, total| progress("rendering", done, total))
}

fn runs(
    cache: &FrameCache,
    truth: &[(i64, Isometry)],
    wanted: &[(Method, usize)],
    seeds: u64,
    what: &'static str,
    progress: Progress,
) -> Result<Vec<Run>, SetupError> {
    let (mut done, total) = (0, (wanted.len() * cache.frames()) as u64 * seeds);
    let mut runs = Vec::new();
    for (method, particles) in wanted {
        let mut attempts = Vec::new();
        for seed in 0..seeds {
            let mut settings = method.settings(cache.settings(), *particles);
            settings.filter.seed = settings.filter.seed.wrapping_add(seed);
            attempts.push(cache.try_out(&settings, &mut |_| {
                done += 1;
                progress(what, done, Some(total));
            })?);
        }
        runs.push(Run::of(*method, *particles, &attempts, truth));
    }
    Ok(runs)
}

/// Draws a start pose around the truth at a place of the grid, the same for every method.
fn draw_start(scene: &Scene, index: usize, seed: u64) -> InitialPose {
    let mut draw = Stream::new(seed, Purpose::Start, index as u64, 0, 0);
    let truth = scene.truth(index as f64).map_from_base_footprint;
    let [dx, dy, turn] = [draw.normal(), draw.normal(), draw.normal()];
    let map_from_footprint =
        Pose2::new(truth.x + START_XY_M * dx, truth.y + START_XY_M * dy, wrap_angle(truth.yaw + START_YAW_RAD * turn));
    InitialPose { map_from_footprint, xy_m: None, yaw_rad: None }
}

impl Run {
    /// Summarizes runs of one method, one run per seed.
    fn of(method: Method, particles: usize, attempts: &[Vec<Trial>], truth: &[(i64, Isometry)]) -> Self {
        let judged: Vec<Vec<(f64, f64)>> =
            attempts.iter().map(|run| run.iter().filter_map(|attempt| errors(attempt, truth)).collect()).collect();
        let (all_cm, all_deg): (Vec<f64>, Vec<f64>) = judged.iter().flatten().copied().unzip();
        let errors_cm = |run: &Vec<(f64, f64)>| run.iter().map(|(cm, _)| *cm).collect::<Vec<f64>>();
        let mut times: Vec<f64> = attempts.iter().flatten().map(|attempt| attempt.tag.elapsed_ms).collect();
        times.sort_by(f64::total_cmp);
        Self {
            method,
            particles,
            position_cm: Summary::of(&all_cm),
            yaw_deg: Summary::of(&all_deg),
            p50_ms: quantile(&times, 0.5),
            p99_ms: quantile(&times, 0.99),
            seed_means_cm: judged.iter().map(|run| Summary::of(&errors_cm(run)).mean).collect(),
            errors_cm: judged.first().map(errors_cm).unwrap_or_default(),
        }
    }
}

/// Returns the errors of position in centimetres and of yaw in degrees, whether the tag is valid or not.
fn errors(attempt: &Trial, truth: &[(i64, Isometry)]) -> Option<(f64, f64)> {
    let Tagged { stamp_ns, pose, .. } = tagged(&attempt.tag);
    let wanted = truth_at(truth, stamp_ns)?;
    let off = (pose.translation - wanted.translation).truncate().length();
    Some((100.0 * off, wrap_angle(pose.euler().yaw - wanted.euler().yaw).abs().to_degrees()))
}

fn name<S: serde::Serializer>(method: &Method, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(method.name)
}
