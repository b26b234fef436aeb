//! Residuals of a walk and their derivatives.

use glam::{DMat3, DQuat, DVec2, DVec3};

use super::chain::{Border, Chain, FRAME_UNKNOWNS, FrameVector};
use super::model::{HELD, Model};
use super::moving_camera::MovingCamera;
use super::{CONSTANTS, Constants, Frame, Linearised, Place, Smoothed, same_ground};
use crate::refinement::error_between;
use crate::refinement::miscalibration::{UNSEEN_M_PER_S, row, unmeasured_rad_per_s};
use realitysim_geometry::{Isometry, Lens, LensError, LensModel, LensParameters, Pose2, Twist, wrap_angle};

/// Rays that fall less steeply than this (sine) are not followed to the ground.
const MIN_SLOPE: f64 = 0.05;
/// Scale of the robust loss (Geman-McClure), in standard deviations.
pub(super) const ROBUST: f64 = 4.0;
/// Odometry does not link frames that are farther apart in time.
const STEP_LIMIT_NS: i64 = 1_000_000_000;
/// Standard deviation of the camera's angular rate by gyro.
const MEASURED_RAD_PER_S: f64 = 0.02;
/// Smallest readout time that motion during the readout is computed with, so that its variance is not zero.
const MIN_READOUT_S: f64 = 1e-4;
/// Step of derivatives by differences.
pub(super) const DIFFERENCE_STEP: f64 = 1e-6;
/// Steps of derivatives by lens and sensor, with their index in [`Constants::values`]: small enough for linearity, large enough
/// for precision.
const FOCAL_STEP: (usize, f64) = (0, 1e-5);
const CENTRE_STEPS: [(usize, f64); 2] = [(1, 1e-3), (2, 1e-3)];
const K_STEPS: [(usize, f64); 4] = [(3, 1e-5), (8, 1e-5), (9, 1e-5), (10, 1e-5)];
const READOUT_STEP: (usize, f64) = (7, 1e-5);
/// Indices in [`Constants::values`] of what has derivatives in closed form.
const TILT_X: usize = 4;
const TILT_Z: usize = 5;
const HEIGHT: usize = 6;
const DELAY: usize = 11;
const ODOMETRY: usize = 12;
const LENGTH: usize = 13;
const WIDTH: usize = 14;

/// Builds the normal equations and the cost about this state.
pub(super) fn linearise(
    frames: &[Frame],
    moving: &[MovingCamera],
    constants: &Constants,
    believed: &LensParameters,
    model: &Model,
) -> Result<Linearised, LensError> {
    let cameras = Cameras::new(constants, believed, model)?;
    let mut chain = Chain::new(frames.len());
    let (mut cost, mut squares, mut fitting) = (0.0, 0.0, 0usize);
    let (mut robust_squares, mut all) = (0.0, 0usize);
    for (i, (frame, here)) in frames.iter().zip(moving).enumerate() {
        for place in &frame.places {
            let Some(line) = cameras.line(place, here) else { continue };
            let sigma_px = model.line_px * place.sigmas;
            let off = line.off_rad * place.pixels_per_rad / sigma_px;
            let square = off * off / (ROBUST * ROBUST);
            cost += 0.5 * off * off / (1.0 + square);
            robust_squares += off * off / (1.0 + square) * model.line_px * model.line_px;
            all += 1;
            let weight = 1.0 / (1.0 + square);
            let scale = weight * place.pixels_per_rad / sigma_px;
            chain.add(i, weight * off, &(line.by_frame * scale), &(line.by_camera * scale));
            if off.abs() < ROBUST {
                squares += (off * model.line_px) * (off * model.line_px);
                fitting += 1;
            }
        }
        cost += add_tag(&mut chain, i, frame, here, constants, model);
        cost += add_tilt(&mut chain, i, frame, &here.pose, constants, model);
        if let (Some(next), Some(there)) = (frames.get(i + 1), moving.get(i + 1)) {
            cost += add_step(&mut chain, i, [frame, next], [here, there], constants, model);
            cost += same_ground::add(&mut chain, i, [frame, next], [here, there], &cameras, model);
        }
    }
    for (i, (value, sigma)) in constants.values().iter().zip(model.constants).enumerate() {
        let sigma = sigma.max(HELD);
        let mut row = Border::zeros();
        row[i] = 1.0 / sigma;
        chain.add_common(value / sigma, &row);
        cost += 0.5 * (value / sigma) * (value / sigma);
    }
    let [rms_px, robust_rms_px] =
        [(squares, fitting), (robust_squares, all)].map(|(squares, count)| libm::sqrt(squares / count.max(1) as f64));
    Ok(Linearised { chain, cost, rms_px, robust_rms_px })
}

/// The camera as believed, and with a small change in each of its constants.
pub(super) struct Cameras {
    pub(super) camera: Camera,
    pub(super) changed: Vec<Changed>,
    /// Length and width of the field beyond what was believed, metres.
    field_m: DVec2,
}

/// A camera with a change in one constant.
pub(super) struct Changed {
    /// Index in [`Constants::values`].
    pub(super) constant: usize,
    /// Size of the change.
    pub(super) step: f64,
    pub(super) camera: Camera,
}

/// Lens and readout time of a sensor.
pub(super) struct Camera {
    pub(super) lens: Lens,
    readout_s: f64,
}

/// The residual of a line place, the angle between the line's plane and the ray on which it was seen, with its derivatives.
struct Line {
    off_rad: f64,
    /// Unit normal of the line's plane, in `map`.
    normal: DVec3,
    by_frame: FrameVector,
    by_camera: Border,
}

impl Cameras {
    fn new(constants: &Constants, believed: &LensParameters, model: &Model) -> Result<Self, LensError> {
        let of_lens: &[(usize, f64)] =
            if matches!(believed.model, LensModel::KannalaBrandt { .. }) { &K_STEPS } else { &[] };
        let steps = [FOCAL_STEP].into_iter().chain(CENTRE_STEPS).chain(of_lens.iter().copied()).chain([READOUT_STEP]);
        let free = steps.filter(|(constant, _)| model.constants[*constant] > 0.0);
        let changed = free.map(|(constant, step)| {
            let mut border = [0.0; CONSTANTS];
            border[constant] = step;
            Ok(Changed { constant, step, camera: Camera::new(&constants.plus(&border), believed)? })
        });
        let changed = changed.collect::<Result<_, LensError>>()?;
        Ok(Self { camera: Camera::new(constants, believed)?, changed, field_m: constants.field_m })
    }

    /// The residual of a line place in the image; `None` where the lens draws nothing.
    fn residual(&self, place: &Place, moving: &MovingCamera) -> Option<PlaceResidual> {
        let line = self.line(place, moving)?;
        let pose = self.camera.pose_at(place.pixel, moving);
        let drawn = |off_rad: f64| {
            let along = self.camera.lens.unproject(place.pixel)?;
            let normal = pose.rotation.conjugate() * line.normal;
            self.camera.lens.project(along - normal * off_rad)
        };
        // A step of a milliradian: where a line fits exactly, its direction in the image is asked for too.
        let across = (place.pixel - drawn(1e-3)?).normalize_or_zero();
        let off_px = (place.pixel - drawn(line.off_rad)?).dot(across);
        let ground = self.ground_residual(place, moving, line.normal);
        Some(PlaceResidual { pixel: place.pixel, across, off_px, sigmas: place.sigmas, ground })
    }

    /// The residual of a line place on the ground: where its ray, and one a little across the line, meet the plane of the lines.
    fn ground_residual(&self, place: &Place, moving: &MovingCamera, normal: DVec3) -> Option<GroundResidual> {
        let Ray { from, along } = self.camera.ray(place.pixel, moving)?;
        let across = place.tangent.truncate().perp().try_normalize()?;
        let [longer, wider] = place.by_size;
        let point = place.point + longer * self.field_m.x + wider * self.field_m.y;
        let off_m = |along: DVec3| {
            let meets = (along.z < -MIN_SLOPE).then(|| from + along * ((point.z - from.z) / along.z))?;
            Some((meets - point).truncate().dot(across))
        };
        let here = off_m(along)?;
        let m_per_px = (off_m(along + normal * 1e-3)? - here).abs() / (1e-3 * place.pixels_per_rad);
        Some(GroundResidual { point: point.truncate(), across, off_m: here, m_per_px })
    }

    /// The residual of a line place; `None` where the lens draws nothing or the camera lies on the line.
    fn line(&self, place: &Place, moving: &MovingCamera) -> Option<Line> {
        let seen = self.camera.ray(place.pixel, moving)?;
        let [longer, wider] = place.by_size;
        let point = place.point + longer * self.field_m.x + wider * self.field_m.y;
        let across = (point - seen.from).cross(place.tangent);
        let length = across.length();
        if length < 1e-6 {
            return None;
        }
        let normal = across / length;
        let off_rad = seen.along.dot(normal);
        let turned = seen.along.cross(normal);
        let moved = -place.tangent.cross(seen.along - normal * off_rad) / length;
        let mut by_camera = Border::zeros();
        for Changed { constant, step, camera } in &self.changed {
            let other = camera.ray(place.pixel, moving)?;
            by_camera[*constant] = ((other.along - seen.along).dot(normal) + moved.dot(other.from - seen.from)) / step;
        }
        (by_camera[LENGTH], by_camera[WIDTH]) = (-moved.dot(longer), -moved.dot(wider));
        let row = row(&self.camera.lens, place.pixel);
        let [extra_motion, rounder] = [moved, turned].map(|by| moving.pose.rotation.conjugate() * by * row);
        let by_frame = gradient([moved, turned, extra_motion, rounder]);
        Some(Line { off_rad, normal, by_frame, by_camera })
    }
}

/// A ray in `map`.
pub(super) struct Ray {
    /// Position of the camera, metres.
    pub(super) from: DVec3,
    /// Unit vector.
    pub(super) along: DVec3,
}

impl Camera {
    fn new(constants: &Constants, believed: &LensParameters) -> Result<Self, LensError> {
        Ok(Self { lens: Lens::new(constants.lens(believed))?, readout_s: constants.readout_s })
    }

    /// Pose of the camera when the row of a pixel is exposed.
    pub(super) fn pose_at(&self, pixel: DVec2, moving: &MovingCamera) -> Isometry {
        moving.at(row(&self.lens, pixel), self.readout_s)
    }

    /// The ray on which a pixel sees.
    pub(super) fn ray(&self, pixel: DVec2, moving: &MovingCamera) -> Option<Ray> {
        let pose = self.pose_at(pixel, moving);
        Some(Ray { from: pose.translation, along: pose.transform_vector(self.lens.unproject(pixel)?) })
    }
}

/// How far a line place was found from where the fit has it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaceResidual {
    /// Pixel at which the line was found.
    pub pixel: DVec2,
    /// Unit vector across the line in the image.
    pub across: DVec2,
    /// Distance along that vector from where the fit draws the line to where it was found, pixels.
    pub off_px: f64,
    /// Standard deviation relative to that of a clear line of the best width.
    pub sigmas: f64,
    /// The same on the ground; `None` of what is not painted on it, and near the horizon.
    pub ground: Option<GroundResidual>,
}

/// How far on the ground a line was found from where the field has it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroundResidual {
    /// Point of the field's line, in `map`, metres.
    pub point: DVec2,
    /// Unit vector across the line, in `map`.
    pub across: DVec2,
    /// Distance along that vector from the field's line to where the ray meets the ground, metres.
    pub off_m: f64,
    /// Distance on the ground for each pixel across the line, metres.
    pub m_per_px: f64,
}

/// The residuals of all line places that fit, by frame.
///
/// # Errors
///
/// A [`LensError`] if the lens is not valid.
pub fn place_residuals(
    frames: &[Frame],
    smoothed: &Smoothed,
    believed: &LensParameters,
    model: &Model,
) -> Result<Vec<Vec<PlaceResidual>>, LensError> {
    let cameras = Cameras::new(&smoothed.constants, believed, model)?;
    let largest_px = ROBUST * model.line_px.max(smoothed.rms_px[1]);
    let of_frame = |(frame, pose): (&Frame, &Isometry)| {
        let moving = MovingCamera::of(frame).at_pose(*pose);
        let of_place = |place: &Place| cameras.residual(place, &moving).filter(|it| it.off_px.abs() < largest_px);
        frame.places.iter().filter_map(of_place).collect()
    };
    Ok(frames.iter().zip(&smoothed.map_from_optical).map(of_frame).collect())
}

/// Adds the prior of a frame: its tag, and the motion during the readout that feet, neck and gyro tell. Returns its cost.
fn add_tag(
    chain: &mut Chain,
    i: usize,
    frame: &Frame,
    here: &MovingCamera,
    constants: &Constants,
    model: &Model,
) -> f64 {
    let tagged = error_between(&frame.map_from_optical, &here.pose);
    let Twist { linear, angular } = here.extra_motion;
    let rad_per_s = if frame.turn_is_measured { MEASURED_RAD_PER_S } else { unmeasured_rad_per_s(&frame.twist) };
    let [way_m, turn_rad] =
        [UNSEEN_M_PER_S, rad_per_s].map(|rate| rate * libm::hypot(constants.readout_s, MIN_READOUT_S));
    let mut cost = 0.0;
    for k in 0..FRAME_UNKNOWNS {
        let (off, sigma) = match k {
            0..3 => (tagged[k], model.tag_m),
            3..6 => (tagged[k], model.tag_rad),
            6..9 => (linear[k - 6], way_m),
            _ => (angular[k - 9], turn_rad),
        };
        let mut row = FrameVector::zeros();
        row[k] = 1.0 / sigma;
        chain.add(i, off / sigma, &row, &Border::zeros());
        cost += 0.5 * (off / sigma) * (off / sigma);
    }
    cost
}

/// The derivatives of a residual by the unknowns of a frame, from their four parts.
fn gradient(by: [DVec3; FRAME_UNKNOWNS / 3]) -> FrameVector {
    FrameVector::from_fn(|k, _| by[k / 3][k % 3])
}

/// Adds the vertical by IMU and mount as seen in the camera, and the camera's height. Returns their cost.
fn add_tilt(chain: &mut Chain, i: usize, frame: &Frame, pose: &Isometry, constants: &Constants, model: &Model) -> f64 {
    let Some(place) = &frame.footprint_from_optical else { return 0.0 };
    let tilt = DQuat::from_scaled_axis(DVec3::new(constants.tilt_x, 0.0, constants.tilt_z));
    // This is the vertical as the mount has it, turned into the camera as it is really mounted.
    let at_stamp = place.rotation.conjugate() * DVec3::Z;
    // The image was exposed before its stamp; only a gyro tells how the camera leaned in between.
    let turning = if frame.turn_is_measured { frame.twist.angular.cross(at_stamp) } else { DVec3::ZERO };
    let believed = at_stamp + turning * constants.delay_s;
    let turn = DMat3::from_quat(pose.rotation * tilt);
    let up = turn * believed;
    let by_tilt = |axis: DVec3| turn * axis.cross(believed);
    let (by_x, by_z, by_delay) = (by_tilt(DVec3::X), by_tilt(DVec3::Z), turn * turning);
    let mut cost = 0.0;
    for (off, by_turn, by_constants) in [
        (up.x, DVec3::new(0.0, up.z, -up.y), [by_x.x, by_z.x, by_delay.x]),
        (up.y, DVec3::new(-up.z, 0.0, up.x), [by_x.y, by_z.y, by_delay.y]),
    ] {
        let row = gradient([DVec3::ZERO, by_turn / model.tilt_rad, DVec3::ZERO, DVec3::ZERO]);
        let mut border = Border::zeros();
        for (constant, by) in [TILT_X, TILT_Z, DELAY].into_iter().zip(by_constants) {
            border[constant] = by / model.tilt_rad;
        }
        chain.add(i, off / model.tilt_rad, &row, &border);
        cost += 0.5 * (off / model.tilt_rad) * (off / model.tilt_rad);
    }
    let off = (pose.translation.z - place.translation.z - constants.height_m) / model.height_m;
    let row = gradient([DVec3::Z / model.height_m, DVec3::ZERO, DVec3::ZERO, DVec3::ZERO]);
    let mut border = Border::zeros();
    border[HEIGHT] = -1.0 / model.height_m;
    chain.add(i, off, &row, &border);
    cost + 0.5 * off * off
}

/// Adds the step of the feet between two frames, compared with odometry and gyro. Returns its cost.
fn add_step(
    chain: &mut Chain,
    i: usize,
    frames: [&Frame; 2],
    moving: [&MovingCamera; 2],
    constants: &Constants,
    model: &Model,
) -> f64 {
    let [from, to] = frames;
    let elapsed_ns = to.stamp_ns - from.stamp_ns;
    let odometry = from.odometry.zip(to.odometry);
    let (Some((before, after)), Some(place_from), Some(place_to)) =
        (odometry, &from.footprint_from_optical, &to.footprint_from_optical)
    else {
        return 0.0;
    };
    if !(0..=STEP_LIMIT_NS).contains(&elapsed_ns) {
        return 0.0;
    }
    let seconds = elapsed_ns as f64 * 1e-9;
    let said = before.inverse().compose(&after);
    let turned = to.turned_rad.unwrap_or(said.yaw);
    let feet = |pose: &Isometry, place: &Isometry| Pose2::from_isometry(&(*pose * place.inverse()));
    let off = |a: &Isometry, b: &Isometry| {
        let step = feet(a, place_from).inverse().compose(&feet(b, place_to));
        let longer = 1.0 + constants.odometry_share;
        [step.x - said.x * longer, step.y - said.y * longer, wrap_angle(step.yaw - turned)]
    };
    let here = off(&moving[0].pose, &moving[1].pose);
    let distance = libm::hypot(said.x, said.y);
    let sigma_m = DVec2::new(model.sway_m, model.step_share * distance).length() + model.drift_m_per_s * seconds;
    let turn_share = if to.turned_rad.is_some() { model.gyro_share } else { model.turn_share };
    let sigma_rad = turn_share * turned.abs() + model.drift_rad_per_s * seconds + model.tilt_rad;
    let sigmas = [sigma_m, sigma_m, sigma_rad];
    let mut rows = [[FrameVector::zeros(); 2]; 3];
    for k in 0..6 {
        let mut small = FrameVector::zeros();
        small[k] = DIFFERENCE_STEP;
        let [from, to] = moving.map(|moving| moving.moved(&small).pose);
        let moved = [off(&from, &moving[1].pose), off(&moving[0].pose, &to)];
        for (row, sigma) in (0..3).zip(sigmas) {
            (0..2).for_each(|which| {
                rows[row][which][k] = wrap_angle(moved[which][row] - here[row]) / (DIFFERENCE_STEP * sigma)
            });
        }
    }
    let mut cost = 0.0;
    for ((row, by_odometry), (off, sigma)) in rows.iter().zip([-said.x, -said.y, 0.0]).zip(here.iter().zip(sigmas)) {
        let off = off / sigma;
        let mut border = Border::zeros();
        border[ODOMETRY] = by_odometry / sigma;
        // Feet slip: the robust loss bounds what is far off.
        let square = off * off / (ROBUST * ROBUST);
        let weight = 1.0 / (1.0 + square);
        chain.add_between(i, weight * off, &(row[0] * weight), &(row[1] * weight), &(border * weight));
        cost += 0.5 * off * off / (1.0 + square);
    }
    cost
}
