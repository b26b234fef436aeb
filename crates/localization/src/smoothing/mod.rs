//! Tags made better after the walk: every frame's pose and what is constant about the camera, from all frames together.
//!
//! Pure. A frame's unknowns are the six of its pose's error, as in [`crate::refinement`], and how fast its camera goes and
//! turns beyond what feet, neck and gyro tell, which matters while rows are read; those of the whole walk are the lens's focal length,
//! centre and curve, the mount's tilt, the camera's height and the sensor's readout ([`Constants`]). Lines say where a ray lies, IMU
//! and mount how the camera leans, odometry how far apart two frames are, and the ground's texture how one lies to the next
//! ([`alignment`]). Gauss-Newton on all of them: the system is block tridiagonal with a border ([`chain`]), so that its solution is
//! one pass forward and one back, as of a smoother.

pub mod alignment;
pub mod chain;
mod moving;
mod residuals;
mod same_ground;

use glam::{DVec2, DVec3};
use nalgebra::Matrix6;

use crate::refinement::line_measurement::{CameraModel, LineMeasurement};
use chain::{Border, Chain, Solution};
use moving::Moving;
use realitysim_geometry::{Isometry, LensError, LensModel, LensParameters, Pose2, Twist};

pub use residuals::Model;

/// A frame of the walk.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    pub stamp_ns: i64,
    /// As tagged.
    pub map_from_optical: Isometry,
    /// By IMU, joints and mount; its heading means nothing.
    pub footprint_from_optical: Option<Isometry>,
    /// `odom` from `base_footprint`.
    pub odometry: Option<Pose2>,
    /// Since the frame before, by gyro.
    pub turned_rad: Option<f64>,
    /// How the camera moves, as far as feet, neck and gyro tell; not at all if nothing says so.
    pub twist: Twist,
    /// It turns as a gyro has told.
    pub turn_is_felt: bool,
    /// Places of lines that were found in its image.
    pub places: Vec<Place>,
    /// Ground that it shares with the frame before.
    pub overlap: Option<Overlap>,
}

/// What two neighbouring images show both.
#[derive(Clone, Debug, PartialEq)]
pub struct Overlap {
    /// Stamp of the earlier one.
    pub before_ns: i64,
    pub matches: Vec<Match>,
}

/// A place of the ground, pixel by pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Match {
    pub before: DVec2,
    pub here: DVec2,
}

/// A place of a line, found in an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    pub pixel: DVec2,
    /// Of the field's line, in `map`.
    pub point: DVec3,
    /// Unit vector along the line.
    pub tangent: DVec3,
    /// Standard deviation in units of that of a line whose place is known best, in pixels.
    pub sigmas: f64,
    /// Across the line.
    pub pixels_per_rad: f64,
}

/// Unknowns of the whole walk.
pub const CONSTANTS: usize = 8;

/// What is the same in every frame, as a correction of what was believed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Constants {
    /// Share by which the focal lengths are longer.
    pub focal_share: f64,
    /// Pixels.
    pub centre: DVec2,
    /// Added to k1 of a Kannala-Brandt lens; of other lenses 0.
    pub k1: f64,
    /// Turn of the camera about its own x (right) and z (forward) that the mount does not know of, radians.
    pub tilt_x: f64,
    pub tilt_z: f64,
    /// The camera's height above what was believed, metres.
    pub height_m: f64,
    /// From the exposure of the first row to that of the last, seconds.
    pub readout_s: f64,
}

/// Names and units of [`Constants::values`], for people.
pub const NAMES: [(&str, &str); CONSTANTS] = [
    ("focal length", "share"),
    ("centre u", "px"),
    ("centre v", "px"),
    ("k1", "1"),
    ("tilt about the camera's x", "rad"),
    ("tilt about the camera's z", "rad"),
    ("height", "m"),
    ("readout of the sensor", "s"),
];

/// The walk after smoothing.
#[derive(Clone, Debug, PartialEq)]
pub struct Smoothed {
    /// By frame.
    pub map_from_optical: Vec<Isometry>,
    /// Of their errors.
    pub covariances: Vec<Matrix6<f64>>,
    pub constants: Constants,
    /// Standard deviations: before looking, and after.
    pub believed: [f64; CONSTANTS],
    pub known: [f64; CONSTANTS],
    /// Root mean square of the line places that fit, pixels.
    pub rms_px: [f64; 2],
    pub rounds: usize,
}

/// No step changes more than a tenth of a millimetre or of a milliradian any more.
const DONE: f64 = 1e-4;
const MAX_ROUNDS: usize = 12;
/// A place of a line is no better than this many times what lines lie off: paint that is worn or crooked is so in every frame, and is
/// not averaged out.
const OFF_AS_A_WHOLE: f64 = 2.6;

impl Constants {
    pub fn values(&self) -> [f64; CONSTANTS] {
        let Self { focal_share, centre, k1, tilt_x, tilt_z, height_m, readout_s } = *self;
        [focal_share, centre.x, centre.y, k1, tilt_x, tilt_z, height_m, readout_s]
    }

    fn plus(&self, step: &Border) -> Self {
        Self {
            focal_share: self.focal_share + step[0],
            centre: self.centre + DVec2::new(step[1], step[2]),
            k1: self.k1 + step[3],
            tilt_x: self.tilt_x + step[4],
            tilt_z: self.tilt_z + step[5],
            height_m: self.height_m + step[6],
            readout_s: self.readout_s + step[7],
        }
    }

    /// The lens as it is found to be.
    pub fn lens(&self, believed: &LensParameters) -> LensParameters {
        let longer = 1.0 + self.focal_share;
        let model = match believed.model {
            LensModel::KannalaBrandt { k: [k1, k2, k3, k4] } => {
                LensModel::KannalaBrandt { k: [k1 + self.k1, k2, k3, k4] }
            }
            other => other,
        };
        LensParameters {
            fx: believed.fx * longer,
            fy: believed.fy * longer,
            cx: believed.cx + self.centre.x,
            cy: believed.cy + self.centre.y,
            model,
            ..believed.clone()
        }
    }
}

impl Place {
    /// What was measured by this eye at this pose; `None` where its lens draws nothing.
    pub fn new(sight: &LineMeasurement, eye: &CameraModel, map_from_optical: &Isometry) -> Option<Self> {
        let LineMeasurement { ray, point, tangent, sigmas, pixels_per_rad, row, .. } = *sight;
        let place = ray * point.distance(map_from_optical.translation);
        let drawn = place + eye.moved_until_read(place, row);
        Some(Self { pixel: eye.projector.lens().project(drawn)?, point, tangent, sigmas, pixels_per_rad })
    }
}

/// The poses and constants that fit everything best. Frames come in the order of time.
pub fn smooth(frames: &[Frame], believed: &LensParameters, model: &Model) -> Result<Smoothed, LensError> {
    let mut walk = Walk::start(frames, believed, model)?;
    let first_rms_px = walk.linearised.rms_px;
    walk.descend(frames, believed, model)?;
    let line_px = OFF_AS_A_WHOLE * walk.linearised.rms_px;
    if line_px > model.line_px {
        let model = Model { line_px, ..*model };
        walk.linearised = residuals::linearise(frames, &walk.moving, &walk.constants, believed, &model)?;
        walk.descend(frames, believed, &model)?;
    }
    let Walk { moving, constants, linearised, rounds } = walk;
    let (covariances, known) = match linearised.chain.solve() {
        Some(solution) => {
            let of_pose = solution.covariances.iter().map(|all| all.fixed_view::<6, 6>(0, 0).into());
            (of_pose.collect(), solution.border_sigmas())
        }
        None => (vec![Matrix6::identity(); frames.len()], model.constants),
    };
    Ok(Smoothed {
        map_from_optical: moving.iter().map(|moving| moving.pose).collect(),
        covariances,
        constants,
        believed: model.constants,
        known,
        rms_px: [first_rms_px, linearised.rms_px],
        rounds,
    })
}

/// Root mean squares, pixels, over line places that took no part: around the poses and the lens that were believed, and around
/// those that the other places make of them. Every second place of a frame takes part. What is told by it is not how well the
/// result fits its own lines, which any result does, but whether it is nearer to the truth.
pub fn held_out_rms_px(frames: Vec<Frame>, believed: &LensParameters, model: &Model) -> Result<[f64; 2], LensError> {
    let halves = |mut frame: Frame| {
        let places = std::mem::take(&mut frame.places).into_iter().enumerate();
        let (others, own): (Vec<_>, Vec<_>) = places.partition(|(number, _)| number % 2 == 1);
        let [own, others] = [own, others].map(|half| half.into_iter().map(|(_, place)| place).collect());
        let judge = Frame { places: others, overlap: None, ..frame.clone() };
        (Frame { places: own, ..frame }, judge)
    };
    let (frames, judges): (Vec<Frame>, Vec<Frame>) = frames.into_iter().map(halves).unzip();
    let smoothed = smooth(&frames, believed, model)?;
    let before: Vec<Moving> = judges.iter().map(Moving::of).collect();
    let after = before.iter().zip(&smoothed.map_from_optical).map(|(moving, pose)| moving.at_pose(*pose));
    let rms_px = |moving: &[Moving], constants: &Constants| {
        residuals::linearise(&judges, moving, constants, believed, model).map(|judged| judged.robust_rms_px)
    };
    Ok([rms_px(&before, &Constants::default())?, rms_px(&after.collect::<Vec<_>>(), &smoothed.constants)?])
}

/// Where the search for it is.
struct Walk {
    moving: Vec<Moving>,
    constants: Constants,
    linearised: Linearised,
    rounds: usize,
}

impl Walk {
    fn start(frames: &[Frame], believed: &LensParameters, model: &Model) -> Result<Self, LensError> {
        let moving: Vec<Moving> = frames.iter().map(Moving::of).collect();
        let constants = Constants::default();
        let linearised = residuals::linearise(frames, &moving, &constants, believed, model)?;
        Ok(Self { moving, constants, linearised, rounds: 0 })
    }

    fn descend(&mut self, frames: &[Frame], believed: &LensParameters, model: &Model) -> Result<(), LensError> {
        for _ in 0..MAX_ROUNDS {
            self.rounds += 1;
            let Some(solution) = self.linearised.chain.solve() else { break };
            let mut share = 1.0;
            let (moving, constants, next) = loop {
                let (moving, constants) = stepped(&self.moving, &self.constants, &solution, share);
                let next = residuals::linearise(frames, &moving, &constants, believed, model);
                match next {
                    Ok(next) if next.cost <= self.linearised.cost || share < 0.1 => break (moving, constants, next),
                    Err(error) if share < 0.1 => return Err(error),
                    _ => share *= 0.5,
                }
            };
            let better = self.linearised.cost - next.cost;
            if better >= 0.0 {
                (self.moving, self.constants, self.linearised) = (moving, constants, next);
            }
            let longest = solution.steps.iter().map(|step| step.fixed_rows::<6>(0).norm()).fold(0.0, f64::max);
            if better <= 0.0 || longest < DONE {
                break;
            }
        }
        Ok(())
    }
}

fn stepped(moving: &[Moving], constants: &Constants, solution: &Solution, share: f64) -> (Vec<Moving>, Constants) {
    let moved = moving.iter().zip(&solution.steps).map(|(moving, step)| moving.moved(&(step * share)));
    (moved.collect(), constants.plus(&(solution.border * share)))
}

/// What is needed of a linearised walk.
struct Linearised {
    chain: Chain,
    cost: f64,
    rms_px: f64,
    /// Of all places, those that do not fit counted up to a limit.
    robust_rms_px: f64,
}

#[cfg(test)]
mod tests;
