//! Calibrates lens, mount, times, odometry and field from one walk over lines.
//!
//! The walk is tagged with what is believed, everything is fitted at once ([`realitysim_localization::smoothing`]), and the walk is
//! tagged again with what was found until that changes no more. What the walk does not determine is held and named.

use std::path::PathBuf;

use thiserror::Error;

use super::calibrated_lens::{CalibratedLens, NEEDED};
use super::error::ReplayError;
use super::offline_refinement::{FittedWalk, RefineError, fit};
use super::replay::{ReplayOptions, replay};
use super::report::ReplayReport;
use realitysim_config::{Settings, lens_text};
use realitysim_geometry::{LensError, LensModel, LensParameters};
use realitysim_localization::smoothing::{
    CONSTANTS, Constants, Frame, Model, NAMES, Smoothed, place_residuals, smooth,
};
use realitysim_recording::{Loss, SESSION_FILE, SessionInfo, read_info, write_atomically};

/// What one walk tells of a robot's camera and of its field.
pub struct WalkCalibration {
    /// Description of the capture that was fitted last.
    pub info: SessionInfo,
    /// The lens as found, and maps over its image.
    pub image: CalibratedLens,
    /// Corrections of what was believed when the walk was tagged last; what is not determined is 0.
    pub corrections: Constants,
    /// Each constant, in the order of [`NAMES`].
    pub constants: Vec<CalibratedConstant>,
    /// Length and width of the field, metres; `None` unless both are determined.
    pub field_size_m: Option<[f64; 2]>,
    /// Mean height of the camera above the ground, metres.
    pub height_m: f64,
    /// Number of frames that took part, and of all frames with a tag.
    pub frames: [usize; 2],
    /// Number of times that the walk was tagged and fitted.
    pub rounds: usize,
    /// Parts of the walk that could not be read.
    pub losses: Vec<Loss>,
}

/// A constant of camera or field, as found.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibratedConstant {
    /// See [`NAMES`].
    pub name: &'static str,
    /// Unit of `value` and `sigma`.
    pub unit: &'static str,
    /// Correction of what was believed when the walk was tagged last.
    pub value: f64,
    /// Standard deviation.
    pub sigma: f64,
    /// Largest standard deviation with which it counts as determined.
    pub needed: f64,
    /// Whether the walk determines it.
    pub determined: bool,
}

/// Why a walk gives no calibration.
#[derive(Debug, Error)]
pub enum CalibrationError {
    /// The walk cannot be fitted.
    #[error(transparent)]
    Refine(#[from] RefineError),
    /// The walk cannot be tagged.
    #[error(transparent)]
    Replay(#[from] ReplayError),
    /// The corrected lens is not valid.
    #[error("the lens: {0}")]
    Lens(#[from] LensError),
    /// Too few frames have a valid tag.
    #[error(
        "{}: only {valid} of {frames} frames could be placed with the lens and field that were given, and {} are needed: \
         check the field's name and size, give the angle of view as in --lens equidistant:180deg, or a start with --initial",
        walk.display(), needed(*frames)
    )]
    Lost {
        /// The walk.
        walk: PathBuf,
        /// Frames with a valid tag.
        valid: u64,
        /// All frames.
        frames: u64,
    },
    /// Each round changes what the round before has found.
    #[error(
        "{}: no convergence: after {rounds} rounds the focal length still changes by {:.2} % and the field by {:.3} m. \
         Nothing is written; start nearer (--lens, --field-size), or walk so that more lines are seen all around",
        walk.display(), 100.0 * focal_share, field_m
    )]
    NoConvergence {
        /// The walk.
        walk: PathBuf,
        /// Number of rounds.
        rounds: usize,
        /// Last change of the focal length.
        focal_share: f64,
        /// Last change of the field's size, metres.
        field_m: f64,
    },
}

/// Share of the frames that must have a valid tag.
const MIN_VALID_SHARE: f64 = 0.3;
/// Changes of the focal length that are tried, one after the other, if a walk cannot be placed. The filter follows a walk whose
/// focal length is 3 % off.
const STARTS: [f64; 4] = [-0.05, 0.05, -0.1, 0.1];
/// Most rounds of tagging and fitting. A start that is 10 % off takes three.
const MAX_ROUNDS: usize = 5;
/// Standard deviations of position (metres) and rotation (radians) with which lines are searched, for each pass of a round: tags
/// made with a wrong lens or field are centimetres off.
const REACHES: [(f64, f64); 3] = [(0.06, 0.02), (0.02, 0.008), (0.006, 0.003)];
/// Changes of focal length (share), centre (pixels) and field (metres) below which another round finds the same.
const SETTLED: [f64; 3] = [0.003, 2.0, 0.01];
/// Indices of the field's size in [`NAMES`].
const FIELD: [usize; 2] = [13, 14];
/// Number of pieces of a walk that alternate between both halves of the cross-validation.
const PIECES: usize = 10;

/// Fewest frames with a valid tag, of so many, from which a walk can be fitted.
pub(super) fn needed(frames: u64) -> u64 {
    (MIN_VALID_SHARE * frames as f64).ceil() as u64
}

/// Calibrates by the walk of `options.source`, a log or a capture; `options.captures` is a folder for what is made on the way.
///
/// A capture is begun with its own tags and settings. `progress` gets the frames done and all frames of the present round.
pub fn calibrate(
    options: &ReplayOptions,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<WalkCalibration, CalibrationError> {
    let mut options = ReplayOptions { warm_start: false, ..options.clone() };
    let is_capture = options.source.join(SESSION_FILE).is_file();
    // What is tagged anew is a capture of a log. The mount of a recorded walk stays that of its config.
    let mut live = None;
    if is_capture {
        let info = read_info(&options.source).map_err(RefineError::from)?;
        (options.settings, live) = (info.settings, info.live);
    }
    let mut last = [0.0; 2];
    for round in 1..=MAX_ROUNDS {
        let session = if is_capture && round == 1 { options.source.clone() } else { tag(&options, progress)? };
        let fitted = fit(&session, &Model::calibration(), &REACHES, progress)?;
        let found = fitted.smoothed.constants;
        if is_settled(&found) {
            let mut found = assess(fitted, round)?;
            found.info.live = live;
            return Ok(found);
        }
        last = [found.focal_share, found.field_m.length()];
        options.settings = corrected(&fitted, &options, round)?;
    }
    let [focal_share, field_m] = last;
    Err(CalibrationError::NoConvergence { walk: options.source, rounds: MAX_ROUNDS, focal_share, field_m })
}

/// Tags the walk and returns its capture. If too few frames can be placed, focal lengths beside the one that was believed are tried.
fn tag(options: &ReplayOptions, progress: &mut dyn FnMut(u64, u64)) -> Result<PathBuf, CalibrationError> {
    let mut all = |options: &ReplayOptions| replay(options, &mut |done, all| progress(done, all.unwrap_or(done)));
    let first = all(options)?;
    let is_enough = |report: &ReplayReport| report.valid >= needed(report.tagged).max(1);
    if is_enough(&first) {
        return Ok(first.session);
    }
    let lens = read_info(&first.session).map_err(RefineError::from)?.lens;
    for share in STARTS {
        let longer = Constants { focal_share: share, ..Constants::default() }.lens(&lens);
        let settings = with_lens(options, &longer, &format!("start{share:+}-lens.toml"))?;
        let report = all(&ReplayOptions { settings, ..options.clone() })?;
        if is_enough(&report) {
            return Ok(report.session);
        }
    }
    let walk = options.source.clone();
    Err(CalibrationError::Lost { walk, valid: first.valid, frames: first.tagged })
}

/// The settings with this lens, which is written beside the captures.
fn with_lens(options: &ReplayOptions, lens: &LensParameters, name: &str) -> Result<Settings, CalibrationError> {
    let mut settings = options.settings.clone();
    let path = options.captures.join(name);
    write_atomically(&path, lens_text(lens, "Found on the way").as_bytes()).map_err(RefineError::from)?;
    settings.camera.lens = Some(path.display().to_string());
    Ok(settings)
}

fn is_settled(found: &Constants) -> bool {
    let Constants { focal_share, centre, field_m, .. } = found;
    let changes = [focal_share.abs(), centre.length(), field_m.abs().max_element()];
    changes.iter().zip(SETTLED).all(|(change, most)| *change < most)
}

/// The settings with the lens and the field that were found, for another round.
fn corrected(fitted: &FittedWalk, options: &ReplayOptions, round: usize) -> Result<Settings, CalibrationError> {
    let lens = fitted.smoothed.constants.lens(&fitted.info.lens);
    let mut settings = with_lens(options, &lens, &format!("round-{round}-lens.toml"))?;
    let field = &fitted.info.field;
    let change = fitted.smoothed.constants.field_m;
    settings.field_size_m = Some([field.length_m + change.x, field.width_m + change.y]);
    Ok(settings)
}

/// Judges a fit: what is determined, where in the image, and whether two halves agree.
fn assess(fitted: FittedWalk, rounds: usize) -> Result<WalkCalibration, CalibrationError> {
    let FittedWalk { info, tags, frames, smoothed, losses } = fitted;
    let mut model = Model::calibration();
    let determined: [bool; CONSTANTS] =
        core::array::from_fn(|i| smoothed.known[i] < NEEDED[i] && smoothed.known[i] < 0.5 * smoothed.believed[i]);
    let all_sigmas = smoothed.known;
    (0..CONSTANTS).filter(|i| !determined[*i]).for_each(|i| model.constants[i] = 0.0);
    let smoothed = smooth(&frames, &info.lens, &model)?;
    let Smoothed { constants: corrections, ref covariance, rms_px: [_, rms_px], .. } = smoothed;
    let lens = corrections.lens(&info.lens);
    let halves = halves(&frames).map(|half| smooth(&half, &info.lens, &model));
    let [first, second] = halves;
    let (first, second) = (first?, second?);
    let lenses = [&first, &second].map(|half| half.constants.lens(&info.lens));
    let [one, other] = lenses;
    let residuals = place_residuals(&frames, &smoothed, &info.lens, &model)?;
    let halves = [(one, &first.covariance), (other, &second.covariance)];
    let image = CalibratedLens::new((lens, covariance), halves, rms_px, |grid| grid.bias(&residuals, rms_px))?;
    let values = corrections.values();
    let constants = (0..CONSTANTS).map(|i| CalibratedConstant {
        name: NAMES[i].0,
        unit: NAMES[i].1,
        value: values[i],
        sigma: if determined[i] { smoothed.known[i] } else { all_sigmas[i] },
        needed: NEEDED[i],
        determined: determined[i],
    });
    let size_m = [info.field.length_m + corrections.field_m.x, info.field.width_m + corrections.field_m.y];
    let heights = smoothed.map_from_optical.iter().map(|pose| pose.translation.z);
    Ok(WalkCalibration {
        constants: constants.collect(),
        field_size_m: FIELD.iter().all(|i| determined[*i]).then_some(size_m),
        height_m: heights.sum::<f64>() / smoothed.map_from_optical.len().max(1) as f64,
        frames: [frames.len(), tags.len()],
        rounds,
        image,
        corrections,
        losses,
        info,
    })
}

/// Two halves of a walk: every other piece of it, so that both see all of the route.
fn halves(frames: &[Frame]) -> [Vec<Frame>; 2] {
    let piece = frames.len().div_ceil(PIECES).max(1);
    [0, 1].map(|half| {
        let pieces = frames.chunks(piece).skip(half).step_by(2);
        pieces.flat_map(<[Frame]>::to_vec).collect()
    })
}

impl WalkCalibration {
    /// Whether the walk determines how the lens projects: its focal length and centre, and its curve if the model has one.
    pub fn determines_lens(&self) -> bool {
        let has_curve = matches!(self.image.lens.model, LensModel::KannalaBrandt { .. });
        let wanted = if has_curve { 4 } else { 3 };
        self.constants.iter().take(wanted).all(|constant| constant.determined)
    }
}
