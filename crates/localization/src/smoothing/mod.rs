//! Offline refinement of a whole walk: every frame's pose and the constants of the camera, from all frames together.
//!
//! The unknowns of a frame are the six of its pose's error, as in [`crate::refinement`], and how its camera moves during the
//! readout beyond what feet, neck and gyro tell. The unknowns of the walk are focal length, centre and curve of the lens, tilt
//! of the mount, height of the camera, times of the sensor, scale of odometry and size of the field ([`Constants`]); a model holds
//! those that it gives no standard deviation. Lines tell where a ray lies, IMU and
//! mount how the camera leans, odometry how far two frames are apart, and the ground's texture how neighbouring frames lie to
//! each other ([`alignment`]). The fit is Gauss-Newton. Its system is block tridiagonal with a border ([`chain`]), so that one
//! pass forwards and one back solve it, as in a smoother. The module is pure.

pub mod alignment;
pub mod board;
pub mod chain;
mod model;
mod moving_camera;
pub mod projection;
mod residuals;
mod same_ground;

use glam::{DQuat, DVec2, DVec3};
use nalgebra::{Matrix6, SMatrix};

use crate::refinement::line_measurement::{CameraModel, LineMeasurement};
use chain::{Chain, Solution};
use moving_camera::MovingCamera;
use realitysim_geometry::{Isometry, LensError, LensModel, LensParameters, Pose2, Twist};

pub use model::Model;
pub use residuals::{GroundResidual, PlaceResidual, place_residuals};

/// One frame of the walk with its measurements.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// Time of exposure, nanoseconds.
    pub stamp_ns: i64,
    /// Pose of the camera in `map` as tagged.
    pub map_from_optical: Isometry,
    /// Pose of the camera on the robot by IMU, joints and mount. Its heading is not used.
    pub footprint_from_optical: Option<Isometry>,
    /// Pose of `base_footprint` in `odom`.
    pub odometry: Option<Pose2>,
    /// Rotation since the frame before by gyro, radians.
    pub turned_rad: Option<f64>,
    /// Velocity of the camera in its own frame as far as feet, neck and gyro tell; zero if nothing tells.
    pub twist: Twist,
    /// Whether the angular part of `twist` was measured by a gyro.
    pub turn_is_measured: bool,
    /// Line places that were found in the image.
    pub places: Vec<Place>,
    /// Ground that both this frame and the one before show.
    pub overlap: Option<Overlap>,
}

/// Ground that two neighbouring images show.
#[derive(Clone, Debug, PartialEq)]
pub struct Overlap {
    /// Time of the earlier image, nanoseconds.
    pub before_ns: i64,
    /// Points that both show.
    pub matches: Vec<Match>,
}

/// A point of the ground in two images.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Match {
    /// Pixel of the earlier image.
    pub before: DVec2,
    /// Pixel of the later image.
    pub here: DVec2,
}

/// A line place that was found in an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Pixel at which the line was found.
    pub pixel: DVec2,
    /// The corresponding point of the field's line, in `map`, metres.
    pub point: DVec3,
    /// Unit vector along the line, in `map`.
    pub tangent: DVec3,
    /// Displacement of the point, in `map`, for each metre by which the field is longer, and wider.
    pub by_size: [DVec3; 2],
    /// Standard deviation relative to that of a clear line of the best width.
    pub sigmas: f64,
    /// Scale of the image across the line.
    pub pixels_per_rad: f64,
}

/// Number of unknowns of the whole walk.
pub const CONSTANTS: usize = 15;

/// Corrections that are the same in every frame, relative to what was believed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Constants {
    /// Relative error of the focal lengths: positive if they are longer than believed.
    pub focal_share: f64,
    /// Shift of the lens's centre, pixels.
    pub centre: DVec2,
    /// Corrections of k1 to k4 of a Kannala-Brandt lens; 0 for other lenses.
    pub k: [f64; 4],
    /// Rotation of the camera about its own x axis (right) beyond what the mount says, radians.
    pub tilt_x: f64,
    /// Rotation of the camera about its own z axis (forward) beyond what the mount says, radians.
    pub tilt_z: f64,
    /// Height of the camera above what was believed, metres.
    pub height_m: f64,
    /// Time from the exposure of the first row to that of the last, seconds.
    pub readout_s: f64,
    /// Time by which stamps of images are later than their exposure, by the clock of the IMU, seconds.
    pub delay_s: f64,
    /// Relative error of the distances by odometry: positive if the robot goes farther than it says.
    pub odometry_share: f64,
    /// Length and width of the field beyond what was believed, metres.
    pub field_m: DVec2,
}

/// Names and units of [`Constants::values`], for people to read.
pub const NAMES: [(&str, &str); CONSTANTS] = [
    ("focal length", "share"),
    ("centre u", "px"),
    ("centre v", "px"),
    ("k1", "1"),
    ("tilt about the camera's x", "rad"),
    ("tilt about the camera's z", "rad"),
    ("height", "m"),
    ("readout of the sensor", "s"),
    ("k2", "1"),
    ("k3", "1"),
    ("k4", "1"),
    ("delay of the camera", "s"),
    ("odometry's distance", "share"),
    ("field length", "m"),
    ("field width", "m"),
];

/// Covariance of the constants, in the order of [`Constants::values`].
pub type ConstantsCovariance = SMatrix<f64, CONSTANTS, CONSTANTS>;

/// The result of smoothing a walk.
#[derive(Clone, Debug, PartialEq)]
pub struct Smoothed {
    /// Pose of the camera in `map`, by frame.
    pub map_from_optical: Vec<Isometry>,
    /// Covariance of each pose's error.
    pub covariances: Vec<Matrix6<f64>>,
    /// The constants found.
    pub constants: Constants,
    /// Standard deviations of the constants before the fit.
    pub believed: [f64; CONSTANTS],
    /// Standard deviations of the constants after the fit.
    pub known: [f64; CONSTANTS],
    /// Covariance of the constants after the fit.
    pub covariance: ConstantsCovariance,
    /// Root mean square deviation of the line places that fit, pixels: before and after.
    pub rms_px: [f64; 2],
    /// Number of Gauss-Newton iterations.
    pub rounds: usize,
}

/// The fit ends when no step is longer than a tenth of a millimetre or of a milliradian.
const MIN_STEP: f64 = 1e-4;
const MAX_ROUNDS: usize = 12;
/// Smallest standard deviation of a line place, in root mean squares of what lines lie off: worn or crooked paint is the same in
/// every frame and does not average out.
const MIN_SIGMA_RMS: f64 = 2.6;

impl Constants {
    /// The constants in the order of [`NAMES`].
    pub fn values(&self) -> [f64; CONSTANTS] {
        let Self { focal_share, centre, k, tilt_x, tilt_z, height_m, readout_s, delay_s, odometry_share, field_m } =
            *self;
        let [k1, k2, k3, k4] = k;
        let of_refinement = [focal_share, centre.x, centre.y, k1, tilt_x, tilt_z, height_m, readout_s];
        let further = [k2, k3, k4, delay_s, odometry_share, field_m.x, field_m.y];
        core::array::from_fn(|i| if i < 8 { of_refinement[i] } else { further[i - 8] })
    }

    /// The constants with a step of each, in the order of [`NAMES`], added.
    #[must_use]
    pub fn plus(&self, step: &[f64; CONSTANTS]) -> Self {
        Self {
            focal_share: self.focal_share + step[0],
            centre: self.centre + DVec2::new(step[1], step[2]),
            k: [self.k[0] + step[3], self.k[1] + step[8], self.k[2] + step[9], self.k[3] + step[10]],
            tilt_x: self.tilt_x + step[4],
            tilt_z: self.tilt_z + step[5],
            height_m: self.height_m + step[6],
            readout_s: self.readout_s + step[7],
            delay_s: self.delay_s + step[11],
            odometry_share: self.odometry_share + step[12],
            field_m: self.field_m + DVec2::new(step[13], step[14]),
        }
    }

    /// The `believed` lens with these corrections.
    pub fn lens(&self, believed: &LensParameters) -> LensParameters {
        let longer = 1.0 + self.focal_share;
        let model = match believed.model {
            LensModel::KannalaBrandt { k } => {
                LensModel::KannalaBrandt { k: core::array::from_fn(|i| k[i] + self.k[i]) }
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

    /// The rotation of `camera_link` on its carrier with the tilt corrected. `believed` is the rotation that was announced.
    pub fn corrected_link(&self, believed: DQuat) -> DQuat {
        let link_from_optical = Isometry::link_from_optical().rotation;
        // The tilt turns the camera against up; the mount needs the inverse rotation.
        let tilt = DQuat::from_scaled_axis(DVec3::new(self.tilt_x, 0.0, self.tilt_z)).conjugate();
        believed * link_from_optical * tilt * link_from_optical.conjugate()
    }
}

impl Place {
    /// The place that was measured by this camera at this pose; `None` where its lens draws nothing.
    ///
    /// `by_size` is the displacement of its point with the size of the field.
    pub fn new(
        measurement: &LineMeasurement,
        camera_model: &CameraModel,
        map_from_optical: &Isometry,
        by_size: [DVec3; 2],
    ) -> Option<Self> {
        let LineMeasurement { ray, point, tangent, sigmas, pixels_per_rad, row, .. } = *measurement;
        let place = ray * point.distance(map_from_optical.translation);
        let drawn = place + camera_model.moved_until_read(place, row);
        Some(Self {
            pixel: camera_model.projector.lens().project(drawn)?,
            point,
            tangent,
            by_size,
            sigmas,
            pixels_per_rad,
        })
    }
}

/// Finds the poses and constants that fit everything best. Frames are ordered by time.
///
/// # Errors
///
/// A [`LensError`] if the lens, as believed or corrected, is not valid.
pub fn smooth(frames: &[Frame], believed: &LensParameters, model: &Model) -> Result<Smoothed, LensError> {
    let mut walk = Walk::start(frames, believed, model)?;
    let first_rms_px = walk.linearised.rms_px;
    walk.descend(frames, believed, model)?;
    let line_px = MIN_SIGMA_RMS * walk.linearised.rms_px;
    if line_px > model.line_px {
        let model = Model { line_px, ..*model };
        walk.linearised = residuals::linearise(frames, &walk.moving, &walk.constants, believed, &model)?;
        walk.descend(frames, believed, &model)?;
    }
    let Walk { moving, constants, linearised, rounds } = walk;
    let (covariances, known, covariance) = match linearised.chain.solve() {
        Some(solution) => {
            let of_pose = solution.covariances.iter().map(|all| all.fixed_view::<6, 6>(0, 0).into());
            let sigmas = solution.border_sigmas();
            let known = core::array::from_fn(|i| if model.constants[i] > 0.0 { sigmas[i] } else { 0.0 });
            (of_pose.collect(), known, solution.border_covariance)
        }
        None => {
            let believed = ConstantsCovariance::from_diagonal(&model.constants.map(|sigma| sigma * sigma).into());
            (vec![Matrix6::identity(); frames.len()], model.constants, believed)
        }
    };
    Ok(Smoothed {
        map_from_optical: moving.iter().map(|moving| moving.pose).collect(),
        covariances,
        constants,
        believed: model.constants,
        known,
        covariance,
        rms_px: [first_rms_px, linearised.rms_px],
        rounds,
    })
}

/// Root mean square deviations, in pixels, of line places that took no part in the fit: for the poses and the lens that were
/// believed, and for those fitted to the other places.
///
/// Every second place of a frame takes part. Any result fits its own lines; this tells whether it is nearer to the truth.
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
    let before: Vec<MovingCamera> = judges.iter().map(MovingCamera::of).collect();
    let after = before.iter().zip(&smoothed.map_from_optical).map(|(moving, pose)| moving.at_pose(*pose));
    let rms_px = |moving: &[MovingCamera], constants: &Constants| {
        residuals::linearise(&judges, moving, constants, believed, model).map(|judged| judged.robust_rms_px)
    };
    Ok([rms_px(&before, &Constants::default())?, rms_px(&after.collect::<Vec<_>>(), &smoothed.constants)?])
}

/// The state of the Gauss-Newton iteration.
struct Walk {
    moving: Vec<MovingCamera>,
    constants: Constants,
    linearised: Linearised,
    rounds: usize,
}

impl Walk {
    fn start(frames: &[Frame], believed: &LensParameters, model: &Model) -> Result<Self, LensError> {
        let moving: Vec<MovingCamera> = frames.iter().map(MovingCamera::of).collect();
        let constants = Constants::default();
        let linearised = residuals::linearise(frames, &moving, &constants, believed, model)?;
        Ok(Self { moving, constants, linearised, rounds: 0 })
    }

    /// Iterates until the steps are small, halving a step that makes the cost larger.
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
            if better <= 0.0 || longest < MIN_STEP {
                break;
            }
        }
        Ok(())
    }
}

fn stepped(
    moving: &[MovingCamera],
    constants: &Constants,
    solution: &Solution,
    share: f64,
) -> (Vec<MovingCamera>, Constants) {
    let moved = moving.iter().zip(&solution.steps).map(|(moving, step)| moving.moved(&(step * share)));
    (moved.collect(), constants.plus(&(solution.border * share).into()))
}

/// The normal equations and the cost of a walk about one state.
struct Linearised {
    chain: Chain,
    cost: f64,
    rms_px: f64,
    /// Root mean square over all places, where the robust loss bounds those that do not fit.
    robust_rms_px: f64,
}

#[cfg(test)]
mod tests;
