//! Refinement: the predicted pose is fitted to the lines of the frame, and corrects the track.

use nalgebra::Vector6;

use super::{Fix, FrameSensors, Localizer};
use crate::estimate::Estimate;
use crate::filter::Effort;
use crate::line_distance_map::ExplainedLines;
use crate::observation::Support;
use crate::refinement::{self, Agreement, OF_LENS, Prior, Refined};
use crate::slow_states::{Prediction, SlowStateFilter, SlowStateModel};
use crate::validation::{TrackingState, agrees, is_contradicted, stands};
use realitysim_geometry::{Isometry, wrap_angle};
use realitysim_vision::Observations;

/// Standard deviation of a walking torso's tilt where nothing measures it: 2.5 degrees.
const UNMEASURED_TILT_RAD: f64 = 0.044;
/// Distance of the best particle from the predicted pose above which refinement starts from both, metres.
const OTHER_BASIN_M: f64 = 0.12;
/// The same for the heading, radians.
const OTHER_BASIN_RAD: f64 = 0.06;
/// Largest deviation of the focal length, as a share, of a lens that was calibrated.
const STRETCH_LIMIT: f64 = 0.03;
/// Squared deviation from the prediction, per unknown, above which the prediction is doubted.
const INNOVATION_THRESHOLD: f64 = 3.0;

impl Localizer {
    /// Refines the predicted pose by the lines of the frame, and updates the track with the result.
    pub(super) fn refine(
        &mut self,
        moment: &FrameSensors,
        seen: &Observations,
        estimate: Estimate,
        support: Support,
    ) -> Fix {
        let prediction = self.prediction(moment);
        let (Some(prediction), true) = (prediction, self.settings.refinement) else {
            return self.predicted_fix(moment, estimate, support);
        };
        let track_pose = self.state.track.as_ref().map_or(estimate.best, SlowStateFilter::pose);
        let turned = wrap_angle(estimate.best.yaw - track_pose.yaw).abs();
        let is_elsewhere = estimate.best.distance(&track_pose) > OTHER_BASIN_M || turned > OTHER_BASIN_RAD;
        let other = moment.footprint_from_optical.filter(|_| is_elsewhere).map(|place| {
            let seen_from = estimate.best.to_isometry() * place;
            refinement::error_between(&prediction.prior.map_from_optical, &seen_from)
        });
        let starts = [Vector6::zeros(), other.unwrap_or_default()];
        let starts = &starts[..1 + usize::from(other.is_some())];
        let Some(mut refined) = self.refiner.refine(&seen.image, &prediction.prior, starts) else {
            return self.predicted_fix(moment, estimate, support);
        };
        if self.state.validator.has_lost_lines(&refined.lines)
            && let Some(nearby) = self.refiner.refine_nearby(&seen.image, &prediction.prior)
            && nearby.cost < refined.cost
        {
            refined = nearby;
        }
        let mut prediction = prediction;
        let agree = agrees(&refined.lines);
        let slips = agree && self.state.track.as_mut().is_some_and(|track| track.slips(&prediction.prior, &refined));
        let contradicts_prediction = (slips
            || normalized_innovation_squared(&prediction.prior, &refined.pose_moved()) > INNOVATION_THRESHOLD)
            && agree;
        if contradicts_prediction {
            // Lines agree with each other but not with the prediction: errors of odometry or IMU are larger than assumed.
            if let Some(track) = &mut self.state.track {
                track.doubt(&refined.moved);
            }
            if let Some(doubted) = self.prediction(moment).map(|prediction| prediction.doubted(&refined.moved))
                && let Some(again) = self.refiner.refine(&seen.image, &doubted.prior, starts)
            {
                (prediction, refined) = (doubted, again);
            }
        }
        let agrees = agrees(&refined.lines);
        if agrees {
            self.state.validator.note_agreement(moment.stamp_ns);
        }
        if agrees && let Some(track) = &mut self.state.track {
            track.update(&prediction, &refined);
        }
        if !agrees && !is_contradicted(&refined.lines) {
            // Too little is in view to correct the pose.
            let mut fix = self.predicted_fix(moment, estimate, support);
            fix.agreement = refined.lines;
            return fix;
        }
        let misfits = matches!(self.state.validator.tracking, TrackingState::Candidate { .. })
            && self.fits_better_unbound(moment, seen, &prediction.prior, &refined);
        Fix {
            estimate,
            support,
            map_from_optical: refined.map_from_optical,
            covariance: refined.pose_covariance(),
            refined: true,
            contradicts_prediction,
            strays: false,
            lacks_odometry: self.state.odometry_gap_s > 0.0,
            misfits,
            agreement: refined.lines,
            explained: ExplainedLines::default(),
            explained_in_view: 1.0,
            effort: Effort::default(),
            ambiguous: self.state.ambiguous,
            rejection: None,
        }
    }

    /// Whether a refinement that leaves lens and mount free contradicts one of them.
    ///
    /// If one is not what it is said to be, some pose in the neighbourhood of the right one has most lines, each beside where it should be.
    pub(super) fn fits_better_unbound(
        &mut self,
        moment: &FrameSensors,
        seen: &Observations,
        prior: &Prior,
        refined: &Refined,
    ) -> bool {
        let Some(unbound) = self.refiner.refine_unbound(&seen.image, prior, refined) else { return false };
        let stretch = prior.lens.stretch + unbound.moved[OF_LENS];
        let sigma = libm::sqrt(unbound.covariance[(OF_LENS, OF_LENS)]);
        let is_better = agrees(&unbound.lines)
            && unbound.lines.share * unbound.lines.foremost >= refined.lines.share * refined.lines.foremost;
        stretch.abs() > STRETCH_LIMIT.max(2.0 * sigma) || (is_better && !stands(moment, &unbound.map_from_optical))
    }

    /// The prediction of the camera's pose by the track; the lens counts as known until the pose is confirmed.
    pub(super) fn prediction(&self, moment: &FrameSensors) -> Option<Prediction> {
        let prediction = self.prediction_of(self.state.track.as_ref()?, moment)?;
        Some(if self.state.validator.is_tracking() { prediction } else { prediction.with_lens_known() })
    }

    /// The prediction of the camera's pose by a given track.
    pub(super) fn prediction_of(&self, track: &SlowStateFilter, moment: &FrameSensors) -> Option<Prediction> {
        let mut prediction = track.prior(&moment.footprint_from_optical?, &self.model(moment));
        prediction.prior.twist = moment.camera_twist.unwrap_or_default();
        prediction.prior.turn_is_measured = moment.turn_is_measured;
        Some(prediction)
    }

    /// The noise of the slow states for this frame.
    pub(super) fn model(&self, moment: &FrameSensors) -> SlowStateModel {
        let model = self.settings.track;
        if !moment.tilt_is_measured {
            return SlowStateModel { tilt_noise_rad: UNMEASURED_TILT_RAD, ..model };
        }
        if moment.tilt_sigma_rad == 0.0 {
            return model;
        }
        // A tilt that is measured badly is never worth less than one that is not measured.
        let tilt_noise_rad = libm::hypot(model.tilt_noise_rad, moment.tilt_sigma_rad).min(UNMEASURED_TILT_RAD);
        SlowStateModel { tilt_noise_rad, ..model }
    }

    /// The answer without refinement by lines: the track's prediction, or the camera of the best particle if poses are not refined.
    pub(super) fn predicted_fix(&self, moment: &FrameSensors, estimate: Estimate, support: Support) -> Fix {
        let place = moment.footprint_from_optical.unwrap_or(Isometry::IDENTITY);
        let (map_from_optical, covariance) = match self.prediction(moment).filter(|_| self.settings.refinement) {
            Some(prediction) => (prediction.prior.map_from_optical, prediction.prior.pose_covariance()),
            None => (estimate.best.to_isometry() * place, estimate.pose_covariance()),
        };
        Fix {
            estimate,
            support,
            map_from_optical,
            covariance,
            refined: false,
            contradicts_prediction: false,
            strays: false,
            lacks_odometry: self.state.odometry_gap_s > 0.0,
            misfits: false,
            agreement: Agreement::default(),
            explained: ExplainedLines::default(),
            explained_in_view: 1.0,
            effort: Effort::default(),
            ambiguous: self.state.ambiguous,
            rejection: None,
        }
    }
}

/// Squared Mahalanobis distance of a correction from the prior, per unknown: 1 is expected.
fn normalized_innovation_squared(prior: &Prior, moved: &Vector6<f64>) -> f64 {
    prior.pose_covariance().cholesky().map_or(0.0, |factor| moved.dot(&factor.solve(moved)) / 6.0)
}
