//! Evidence for and against the pose of one frame, for people who want to know why a tag is what it is.

use glam::{DVec2, DVec3};
use serde::Serialize;

use super::relocalization::CandidateRefinement;
use super::{Fix, FrameSensors, Localizer};
use crate::filter::{Effort, always};
use crate::global_search::{SearchRate, SearchRequest, SearchState};
use crate::line_distance_map::{ExplainedLines, LineDistanceMap};
use crate::refinement::line_measurement::Inspected;
use crate::refinement::{Agreement, Refiner};
use realitysim_geometry::Isometry;
use realitysim_vision::Observations;

/// Evidence for and against a pose. Pixels are those of the full-size image, the first one's centre at (0, 0).
#[derive(Clone, Debug)]
pub struct Evidence {
    /// How well the expected lines are where the pose has them.
    pub agreement: Agreement,
    /// How much of the seen line near the robot the pose explains.
    pub explained: ExplainedLines,
    /// Share of the lines in view, at any distance, that the field has where the pose puts them.
    pub explained_in_view: f64,
    /// Line contrast of the best lines in view, as a share of the carpet's brightness; infinite if nothing can be a line.
    pub contrast: f64,
    /// Standard deviation of plain carpet where lines are looked for, as a share of its brightness.
    pub noise: f64,
    /// The line places of the pose.
    pub lines: Vec<Inspected>,
    /// Pixel of each place of the floor that shows a line clearly, and whether the field has one there.
    pub shown: Vec<(DVec2, bool)>,
    /// Outline of the carpet as far as it is seen, pixels; empty if its edge is not found.
    pub carpet: Vec<DVec2>,
    /// Poses that a search of the whole field finds in this frame alone, best first. Each stands for its mirror pose as well.
    pub tried: Vec<TriedPose>,
}

/// A pose of `base_footprint` in `map` that a search has tried.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TriedPose {
    /// Position along x, metres.
    pub x: f64,
    /// Position along y, metres.
    pub y: f64,
    /// Heading, degrees.
    pub yaw_deg: f64,
    /// Rank of the pose: the visible lines that fit, less half of the visible lines, times the explained share of the seen line.
    pub worth: f64,
    /// Number of line places that fit.
    pub fitting: usize,
    /// Share of the seen line that the field has where the pose puts it.
    pub explained: f64,
}

impl Evidence {
    /// Collects the evidence for a pose in what a frame shows.
    ///
    /// `footprint_from_optical` is the camera's place that the frame's ground table was made with. Lines are looked for as if the lens
    /// were as calibrated. `agreement`, `explained` and `tried` are left empty.
    pub fn of_pose(
        seen: &Observations,
        refiner: &Refiner,
        line_distances: &LineDistanceMap,
        footprint_from_optical: Option<&Isometry>,
        map_from_optical: &Isometry,
    ) -> Self {
        let lens = refiner.lens();
        let optical_from_map = map_from_optical.inverse();
        let mut shown = Vec::new();
        let (mut carpet, mut explained_in_view) = (Vec::new(), 1.0);
        if let Some(place) = footprint_from_optical {
            line_distances.each_shown(seen.lines(), place, map_from_optical, |ray, _, is_on_line| {
                let pixel = lens.project(optical_from_map.transform_vector(ray));
                shown.extend(pixel.map(|pixel| (pixel, is_on_line)));
            });
            explained_in_view = line_distances.explained_in_view(seen, lens, place, map_from_optical);
            carpet = border(seen.border(), place, |place: DVec3| lens.project(place));
        }
        Self {
            agreement: Agreement::default(),
            explained: ExplainedLines::default(),
            explained_in_view,
            contrast: f64::from(seen.image.full_contrast()),
            noise: f64::from(seen.image.noise()),
            lines: refiner.inspect(&seen.image, map_from_optical),
            shown,
            carpet,
            tried: Vec::new(),
        }
    }
}

impl Localizer {
    /// Collects the evidence for `fix`, the answer for the frame `seen`.
    pub fn evidence(&self, moment: &FrameSensors, seen: &Observations, fix: &Fix) -> Evidence {
        let place = moment.footprint_from_optical.as_ref();
        Evidence {
            agreement: fix.agreement,
            explained: fix.explained,
            tried: self.search_afresh(moment, seen),
            ..Evidence::of_pose(seen, &self.refiner, &self.line_distances, place, &fix.map_from_optical)
        }
    }

    /// Searches the whole field by this frame alone.
    fn search_afresh(&self, moment: &FrameSensors, seen: &Observations) -> Vec<TriedPose> {
        let mut other = self.clone();
        let mut effort = Effort::default();
        let (mut state, observation) = (SearchState::default(), other.filter.observation());
        let found = other.search.run(
            observation,
            &seen.table,
            SearchRequest { candidates: SHOWN, rate: SearchRate::Fast },
            &mut state,
            &mut effort,
            &mut always,
        );
        other.state.fitting = CandidateRefinement::of(None, &found.unwrap_or_default());
        other.refine_candidates(moment, seen, &mut effort, &mut always);
        other.state.fitting.tried_poses()
    }
}

/// Number of candidates that are shown.
const SHOWN: usize = 8;
/// Number of pieces that each edge of the carpet is drawn in, since a lens bends it.
const PIECES: usize = 12;

/// Projects the outline of the carpet into the image.
fn border(corners: &[DVec2], place: &Isometry, project: impl Fn(DVec3) -> Option<DVec2>) -> Vec<DVec2> {
    let optical_from_footprint = place.inverse();
    let next = corners.iter().cycle().skip(1);
    let edges = corners
        .iter()
        .zip(next)
        .flat_map(|(from, to)| (0..PIECES).map(move |piece| from.lerp(*to, piece as f64 / PIECES as f64)));
    edges.filter_map(|at| project(optical_from_footprint.transform_point(at.extend(0.0)))).collect()
}
