//! Reads from a capture what its accuracy is judged by.

use std::collections::HashMap;
use std::path::Path;

use anyhow::{Context, bail};

use super::Report;
use crate::cli::export::TRAINING_SIGMA_M;
use crate::cli::output;
use crate::database::{TagLimits, best_tags};
use crate::evaluation::accuracy::{
    Halving, Limits, Measure, SeenFrame, crossings, footprint, residual_maps, split_half, stands, taped, turned,
    verdicts,
};
use crate::evaluation::statistics::rms;
use crate::geometry::{Field, Isometry};
use crate::localization::smoothing::Model;
use crate::log_input::log::is_mark;
use crate::recording::{Loss, Readout, ReadoutError, read_info, read_topic};
use crate::ros2::messages::{DiagnosticArray, FrameTag, Message};
use crate::ros2::topics::DIAGNOSTICS;
use crate::tagging::offline_refinement::{FittedWalk, fitted_walk, refined_constants};
use crate::tagging::robot_track::{TrackedFrame, robot_track};

/// Radius of the ball, metres: half of the 14 cm that a ball of a scene measures if its file says nothing.
const BALL_RADIUS_M: f64 = 0.07;

/// What a capture tells.
pub struct Evidence {
    pub field: Field,
    /// The tags that a database takes.
    pub tags: Vec<FrameTag>,
    /// Times in nanoseconds and texts of the marks.
    pub marks: Vec<(i64, String)>,
    refined: bool,
    track: Vec<TrackedFrame>,
    walk: FittedWalk,
    lost: Vec<Loss>,
}

impl Evidence {
    /// Reads a capture. Fails if none of its tags is valid.
    pub fn read(capture: &Path) -> anyhow::Result<Self> {
        let info = read_info(capture).with_context(|| capture.display().to_string())?;
        let (refined, Readout { found: tags, losses: mut lost, .. }) = best_tags(capture)?;
        if !tags.iter().any(|tag| tag.valid) {
            bail!(
                "{}: none of its {} tags is valid: nothing can be judged; `realitysim explain` says why a frame has no pose",
                capture.display(),
                tags.len()
            );
        }
        let marks = marks(capture)?;
        let mut progress = output::Progress::new("reading");
        let (track, losses) = robot_track(capture, &info.settings, &mut |done, all| progress.set(done, Some(all)))?;
        progress.finish();
        let mut progress = output::Progress::new("looking");
        let walk = fitted_walk(capture, &Model::default(), &mut |done, all| progress.set(done, Some(all)))?;
        progress.finish();
        for loss in losses.into_iter().chain(walk.losses.iter().cloned()) {
            if !lost.contains(&loss) {
                lost.push(loss);
            }
        }
        Ok(Self { field: Field::new(info.field)?, tags, marks, refined: refined.is_some(), track, walk, lost })
    }

    /// Judges what was read.
    pub fn report(&self) -> anyhow::Result<Report> {
        let FittedWalk { info, frames, smoothed, .. } = &self.walk;
        let (found, refused) = stands(&self.marks, &self.seen_frames(), &crossings(&self.field));
        let taped = taped(&found);
        let turned = turned(&taped);
        let halves = [Halving::Metres, Halving::Sides].map(|by| split_half(by, frames, smoothed, &info.lens));
        let split_half: Vec<Measure<_>> = halves.into_iter().collect::<Result<_, _>>()?;
        let limits =
            Limits { labels_m: TagLimits::default().sigma_m, views_m: TRAINING_SIGMA_M, ball_m: BALL_RADIUS_M };
        Ok(Report {
            robot: info.robot.clone(),
            field: self.field.dimensions().title.clone(),
            frames: [self.tags.len(), self.tags.iter().filter(|tag| tag.valid).count()],
            refined: self.refined,
            refused,
            verdicts: verdicts(&limits, &taped, &turned, &split_half),
            taped,
            turned,
            split_half,
            residuals: residual_maps(frames, smoothed, &info.lens, &self.field)?,
            constants: refined_constants(smoothed, &smoothed.constants.lens(&info.lens)),
            fit_moves_cm: self.fit_moves_cm(),
            lost: self.lost.clone(),
        })
    }

    /// The valid tags: times in nanoseconds and poses of `camera_link` in `map`.
    pub fn valid_tags(&self) -> impl Iterator<Item = (i64, Isometry)> + '_ {
        let valid = self.tags.iter().filter(|tag| tag.valid);
        valid.map(|tag| (tag.header.stamp.to_nanoseconds(), Isometry::from(tag.pose.pose)))
    }

    fn seen_frames(&self) -> Vec<SeenFrame> {
        let tags: HashMap<i64, Isometry> = self.valid_tags().collect();
        let frame = |tracked: &TrackedFrame| SeenFrame {
            stamp_ns: tracked.stamp_ns,
            tagged: (tags.get(&tracked.stamp_ns).zip(tracked.footprint_from_link))
                .map(|(map_from_link, footprint_from_link)| footprint(map_from_link, &footprint_from_link)),
            odometry: tracked.odometry,
        };
        self.track.iter().map(frame).collect()
    }

    fn fit_moves_cm(&self) -> f64 {
        let FittedWalk { frames, smoothed, .. } = &self.walk;
        let tags: HashMap<i64, Isometry> = self.valid_tags().collect();
        let moved = frames.iter().zip(&smoothed.map_from_optical).filter_map(|(frame, pose)| {
            let off = pose.translation - tags.get(&frame.stamp_ns)?.translation;
            Some(100.0 * off.truncate().length())
        });
        rms(moved)
    }
}

/// The marks of a capture: times in nanoseconds and texts.
fn marks(capture: &Path) -> anyhow::Result<Vec<(i64, String)>> {
    let read = match read_topic(capture, DIAGNOSTICS, String::new) {
        Err(ReadoutError::NoMessages { .. }) => return Ok(Vec::new()),
        read => read?,
    };
    let mut marks = Vec::new();
    for message in &read.found {
        // Other programs use the topic as well. What cannot be decoded is not from this one.
        let Ok(report) = DiagnosticArray::decode(&message.data) else { continue };
        let of_mark = report.status.iter().filter(|status| is_mark(status));
        marks.extend(of_mark.map(|status| (report.header.stamp.to_nanoseconds(), status.message.clone())));
    }
    Ok(marks)
}
