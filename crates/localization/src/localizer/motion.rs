//! Prediction: the robot's step since the last frame, by odometry and gyro, moves particles, track and hypotheses.

use super::{FrameSensors, Localizer, LocalizerSettings};
use crate::slow_states::Step;
use realitysim_geometry::{Physical, Pose2};

/// Longest step between frames, seconds: a longer gap says nothing more about where the robot went.
const MAX_STEP_S: f64 = 5.0;
/// Highest speed, metres per second: no humanoid walks this fast, so odometry that says so has jumped.
const SPEED_LIMIT_M_PER_S: f64 = 3.0;
/// A torso that rolls and pitches faster than this on average walks, or marches on the spot: 5 degrees a second.
pub(crate) const SWAYS_RAD_PER_S: f64 = 0.09;
/// Longest time without odometry, seconds, for which unknown steps add up in one direction: a walking robot goes on walking.
const ODOMETRY_GAP_LIMIT_S: f64 = 0.5;
/// Highest turning rate, radians per second: a gyro that shows more is broken or counts in degrees.
const TURN_RATE_LIMIT_RAD_PER_S: f64 = 10.0;

impl Localizer {
    /// The robot's step since the last frame, as far as sensors can be trusted. The next step is measured from this frame.
    pub(super) fn measure_step(&mut self, moment: &FrameSensors) -> Step {
        let odometry = moment.odometry.filter(Physical::is_possible);
        let last = self.state.last.replace((moment.stamp_ns, odometry));
        let Some((last_ns, last_odometry)) = last else {
            return Step::none();
        };
        let seconds = (moment.stamp_ns.saturating_sub(last_ns) as f64 * 1e-9).clamp(0.0, MAX_STEP_S);
        if self.settings.random_walk {
            return Step { odometry: None, turned_rad: None, seconds, stamp_sigma_s: 0.0 };
        }
        // Odometry that is the same to the last bit counts only if the torso is known to stand still too.
        let stands = moment.swayed_rad.is_some_and(|swayed| swayed <= SWAYS_RAD_PER_S * seconds);
        let odometry = last_odometry.zip(odometry).filter(|(before, now)| before != now || stands);
        let odometry = odometry.map(|(before, now)| before.inverse().compose(&now));
        let possible = |step: &Pose2| libm::hypot(step.x, step.y) <= SPEED_LIMIT_M_PER_S * seconds.max(0.1);
        let turned_rad = moment.turned_rad.filter(|turned| turned.abs() <= TURN_RATE_LIMIT_RAD_PER_S * seconds);
        Step { odometry: odometry.filter(possible), turned_rad, seconds, stamp_sigma_s: moment.stamp_sigma_s }
    }

    /// The step for the particles: odometry, whose turn is replaced by that of the gyro if there is one.
    pub(super) fn particle_step(&self, step: &Step) -> Option<Pose2> {
        let turned = self.gyro_turn(step);
        step.odometry.map(|odometry| Pose2 { yaw: turned.unwrap_or(odometry.yaw), ..odometry })
    }

    /// The robot's turn by gyro, corrected for its bias, radians.
    pub(super) fn gyro_turn(&self, step: &Step) -> Option<f64> {
        step.turned_rad.and_then(|turned| Some(self.state.track.as_ref()?.turned(turned, step.seconds)))
    }

    /// Moves the last known pose and the search's candidates by the step. Without odometry they turn by gyro: a robot that falls or is
    /// carried turns although odometry does not show it.
    pub(super) fn move_hypotheses(&mut self, step: &Step) {
        let turned = self.gyro_turn(step);
        let walked = step.odometry.unwrap_or_default();
        let walked = Pose2 { yaw: turned.unwrap_or(walked.yaw), ..walked };
        self.state.known.iter_mut().for_each(|known| known.move_by(&walked, step.seconds, turned.is_some()));
        self.state.search.move_by(&walked);
        self.state.fitting.move_by(&walked);
    }

    /// Predicts the track. Where odometry is missing, its uncertainty grows by how far the robot can walk.
    pub(super) fn predict_track(&mut self, step: &Step) {
        let LocalizerSettings { track: model, filter, random_walk, .. } = &self.settings;
        let before_s = self.state.odometry_gap_s;
        let unheard = step.odometry.is_none() && !random_walk;
        self.state.odometry_gap_s = if unheard { (before_s + step.seconds).min(ODOMETRY_GAP_LIMIT_S) } else { 0.0 };
        let reach_m = filter.motion.walk_m_per_s * libm::sqrt(step.seconds * (step.seconds + 2.0 * before_s));
        let reach_rad = filter.motion.turn_rad_per_s * step.seconds;
        if let Some(track) = &mut self.state.track {
            track.predict(step, model, reach_m, reach_rad);
        }
    }
}
