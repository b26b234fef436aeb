//! Locates a single image: lens, tilt and height of the camera are known, x, y and yaw on the field are searched.
//!
//! What is found, and how far it may be trusted, is an [`ImageLocation`].

use glam::{DVec2, DVec3};
use nalgebra::{Matrix6, Vector6};

use crate::image_location::{ImageLocation, PoseHypothesis, PoseSigmas, without_mirrors};
use realitysim_geometry::{Euler, Field, Isometry, Lens, Pose2, wrap_angle};
use realitysim_localization::filter::always;
use realitysim_localization::global_search::{self, Candidate, GlobalSearch, SearchRate, SearchRequest, SearchState};
use realitysim_localization::kernel::Points;
use realitysim_localization::line_distance_map::LineDistanceMap;
use realitysim_localization::observation::default_alpha;
use realitysim_localization::refinement::{Agreement, Prior, Refiner, error_between};
use realitysim_localization::{
    Effort, Evidence, Filter, FilterSettings, FilterState, Formula, Model, MotionModel, Observation, Sampling,
    SimdPath, Spread, Support, TriedPose, observation,
};
use realitysim_vision::{BodyMask, Observations, Picture, Vision, VisionSettings};

/// What is known about the camera before the image is looked at.
#[derive(Clone, Debug)]
pub struct ImagePrior {
    /// The lens.
    pub lens: Lens,
    /// Attitude of `camera_link`; yaw is ignored.
    pub attitude: Euler,
    /// Standard deviation of roll and pitch of the attitude.
    pub tilt_sigma_rad: f64,
    /// Height of `camera_link` above the carpet.
    pub height_m: f64,
    /// Standard deviation of the height; [`MEASURED_HEIGHT_SIGMA_M`] of one that was measured.
    pub height_sigma_m: f64,
    /// Approximate pose of `camera_link` in `map`; without it the whole field is searched.
    pub initial: Option<Pose2>,
    /// Pixels that show the robot's own body.
    pub body: Option<BodyMask>,
}

/// What an image shows of the ground, which is the same for every field whose lines are as wide.
pub struct Look<'a> {
    picture: &'a Picture,
    vision: Vision,
    /// The observations with each attitude that is tried, the given one first.
    views: Vec<View>,
}

/// The observations with one attitude of the camera.
struct View {
    footprint_from_link: Isometry,
    seen: Observations,
}

/// Most poses that are returned.
const KEPT: usize = 5;
/// Poses of a survey that are worth a closer look.
const SURVEYED: usize = 12;
/// Of these, how many are worth it for each of the many mounts of a camera whose mount is not known.
const CLIMBED_OF_SURVEYED: usize = 4;
/// Standard deviation of the tilt of one view: what remains to the next view, and the error of the lens file.
const TILT_SIGMA_RAD: f64 = 0.005;
/// Step between the attitudes that are tried.
const TILT_STEP_RAD: f64 = 0.03;
/// Range of the attitudes that are tried around the given one, standard deviations.
const TILT_SIGMAS: f64 = 1.25;
/// Number of points that stand for all lines of the field.
const LINE_POINTS: usize = 700;
/// Width of the band around the carpet in which poses are searched too.
const SEARCH_MARGIN_M: f64 = 0.5;
/// Standard deviations of a pose that the search found, before it is refined.
const START_M: f64 = 0.15;
const START_RAD: f64 = 0.05;
/// Standard deviation of a height that was measured, metres.
pub const MEASURED_HEIGHT_SIGMA_M: f64 = 0.005;
/// Largest error of the height within which lines are looked for, metres.
const HEIGHT_REACH_M: f64 = 0.03;
/// Smallest standard deviation of the tilt, also if it is known exactly: field and lens differ a little from their files.
const MIN_TILT_SIGMA_RAD: f64 = 0.0005;
/// Fewest line places that must fit a refined pose.
const MIN_FITTING: usize = 15;
/// Least share of the expected line places that must fit a refined pose. Fields differ from their files, and refinement
/// moves a pose no farther than its basin.
const MIN_FITTING_SHARE: f64 = 0.25;
/// Spread of the particles around an initial pose.
const INITIAL: Spread = Spread { xy_m: 0.3, yaw_rad: 0.15 };
const INITIAL_PARTICLES: usize = 2000;
const INITIAL_ITERATIONS: usize = 8;

/// Area in which poses on a field are searched, square metres: half of its carpet and a margin, as poses come in mirrored pairs.
///
/// The time that [`ImagePrior::locate`] takes without an initial pose grows with it.
pub fn searched_m2(field: &Field) -> f64 {
    let half = field.carpet_half_extent() + DVec2::splat(SEARCH_MARGIN_M);
    2.0 * half.x * half.y
}

impl ImagePrior {
    /// Pose of `camera_link` in `base_footprint`, the point of the carpet below the camera with the camera's heading.
    ///
    /// `roll` and `pitch` are added to those of the attitude, radians.
    fn footprint_from_link(&self, [roll, pitch]: [f64; 2]) -> Isometry {
        let tilt = Euler { yaw: 0.0, pitch: self.attitude.pitch + pitch, roll: self.attitude.roll + roll };
        Isometry::from_euler(tilt, DVec3::new(0.0, 0.0, self.height_m))
    }

    /// Looks at a picture with the given attitude and, if that may be wrong, with others around it, for lines of this width.
    pub fn look<'a>(&self, picture: &'a Picture, line_width_m: f64) -> Look<'a> {
        self.look_with(picture, line_width_m, tilts(self.tilt_sigma_rad))
    }

    /// Looks at a picture with the given attitude alone.
    pub(crate) fn look_once<'a>(&self, picture: &'a Picture, line_width_m: f64) -> Look<'a> {
        self.look_with(picture, line_width_m, vec![[0.0; 2]])
    }

    /// Looks at a picture with these changes of roll and pitch.
    fn look_with<'a>(&self, picture: &'a Picture, line_width_m: f64, tilts: Vec<[f64; 2]>) -> Look<'a> {
        let settings = VisionSettings {
            reading: observation::reading(Model::Gauss, Formula::Corrected),
            line_width_m,
            tilt_sigma_rad: TILT_SIGMA_RAD,
            reduction: 0,
        };
        let vision = Vision::new(&self.lens, settings);
        let views = tilts.into_iter().map(|more| {
            let footprint_from_link = self.footprint_from_link(more);
            let seen = vision.look(picture, &(footprint_from_link * Isometry::link_from_optical()), self.body.as_ref());
            View { footprint_from_link, seen }
        });
        Look { picture, views: views.collect(), vision: vision.clone() }
    }

    /// Finds the poses on a field that explain what the image shows. `look` is of lines as wide as the field's, `seed` is for the particles around an initial pose.
    pub fn locate(&self, look: &Look, field: &Field, seed: u64) -> ImageLocation {
        let mut searcher = FieldSearch::new(field);
        let candidates = look.views.iter().map(|view| self.candidates(&view.seen, &mut searcher, seed));
        let candidates: Vec<Vec<Candidate>> = candidates.collect();
        self.judged(look, field, &searcher, &candidates)
    }

    /// The same by a survey of the field on a wide grid, and a closer look at its best places: several times as fast, and enough where
    /// many images or assumptions are compared.
    pub fn locate_by_survey(&self, look: &Look, field: &Field, seed: u64) -> ImageLocation {
        let mut survey = FieldSearch::for_survey(field);
        let of_view = |View { seen, .. }: &View| {
            let starts = self.surveyed(seen, &mut survey, seed);
            self.climbed(seen, &mut survey, &starts)
        };
        let candidates: Vec<Vec<Candidate>> = look.views.iter().map(of_view).collect();
        self.judged(look, field, &survey, &candidates)
    }

    /// Fits the candidates of each view of a look to the lines, and judges them by the image.
    pub(crate) fn judged(
        &self,
        look: &Look,
        field: &Field,
        searched: &FieldSearch,
        candidates: &[Vec<Candidate>],
    ) -> ImageLocation {
        let FieldSearch { observation, line_distances, .. } = searched;
        let mut refiner = Refiner::new(field, &self.lens);
        let mut found = Vec::new();
        for (view, candidates) in look.views.iter().zip(candidates) {
            found.extend(candidates.iter().map(|candidate| {
                let start = candidate.pose.to_isometry() * view.footprint_from_link;
                let unrefined = self.weighed(look, observation, line_distances, start, None);
                let Some((pose, lines)) = self.refined(&mut refiner, &view.seen, &candidate.pose, &start) else {
                    return unrefined;
                };
                let refined = self.weighed(look, observation, line_distances, pose, Some(lines));
                // On a field that differs from its file, a refined pose may show less contrast than the one that it came from.
                // The better of both is used to judge the pose.
                let PoseHypothesis { share, weight, log_likelihood, .. } =
                    if refined.log_likelihood >= unrefined.log_likelihood { refined } else { unrefined };
                PoseHypothesis { share, weight, log_likelihood, ..refined }
            }));
        }
        found.sort_by(|a, b| b.log_likelihood.total_cmp(&a.log_likelihood));
        let found = found.into_iter();
        let mut found = without_mirrors(found.filter(|found| found.weight > 0.0));
        found.truncate(KEPT);
        ImageLocation { found, searched: self.initial.is_none(), mount_is_known: true }
    }

    /// The poses in the plane that explain one view best: on the whole field, or near the initial pose.
    fn candidates(&self, seen: &Observations, searcher: &mut FieldSearch, seed: u64) -> Vec<Candidate> {
        let FieldSearch { observation, search, .. } = searcher;
        match self.initial {
            None => {
                let (mut state, mut effort) = (SearchState::default(), Effort::default());
                let request = SearchRequest { candidates: KEPT, rate: SearchRate::Fast };
                let found = search.run(observation, &seen.table, request, &mut state, &mut effort, &mut always);
                found.unwrap_or_default()
            }
            Some(initial) => vec![search_around(observation, seen, initial, seed)],
        }
    }

    /// The best poses in the plane for one view, on a wide grid or near the initial pose; none if there is no line in view.
    fn surveyed(&self, seen: &Observations, survey: &mut FieldSearch, seed: u64) -> Vec<Candidate> {
        match self.initial {
            None => survey.search.survey(&seen.table, SURVEYED),
            Some(initial) => vec![search_around(&survey.observation, seen, initial, seed)],
        }
    }

    /// The best poses in the plane for one view near `starts`.
    fn climbed(&self, seen: &Observations, survey: &mut FieldSearch, starts: &[Candidate]) -> Vec<Candidate> {
        let FieldSearch { observation, search, .. } = survey;
        search.run_from(observation, &seen.table, starts, KEPT)
    }

    /// The best poses in the plane with the given attitude and height alone, by a survey and a closer look at its best places.
    pub(crate) fn placed_by_survey(&self, picture: &Picture, survey: &mut FieldSearch, seed: u64) -> Vec<Candidate> {
        let look = self.look_once(picture, survey.line_width_m);
        let Some(View { seen, .. }) = look.views.first() else { return Vec::new() };
        let mut starts = self.surveyed(seen, survey, seed);
        starts.truncate(CLIMBED_OF_SURVEYED);
        self.climbed(seen, survey, &starts)
    }

    /// The best poses in the plane with the given attitude and height alone, near `starts`.
    pub(crate) fn placed_near(
        &self,
        picture: &Picture,
        survey: &mut FieldSearch,
        starts: &[Candidate],
    ) -> Vec<Candidate> {
        let look = self.look_once(picture, survey.line_width_m);
        let Some(View { seen, .. }) = look.views.first() else { return Vec::new() };
        self.climbed(seen, survey, starts)
    }

    /// Fits a pose to the lines once more, from where it is; `None` if too few of them fit.
    pub(crate) fn refit(
        &self,
        picture: &Picture,
        field: &Field,
        searched: &FieldSearch,
        start: &PoseHypothesis,
    ) -> Option<PoseHypothesis> {
        let look = self.look_once(picture, field.line_width());
        let FieldSearch { observation, line_distances, .. } = searched;
        let mut refiner = Refiner::new(field, &self.lens);
        let seen = &look.views.first()?.seen;
        let (pose, fitted) = self.refined(&mut refiner, seen, &start.place(), &start.map_from_link)?;
        Some(self.weighed(&look, observation, line_distances, pose, Some(fitted)))
    }

    /// The evidence for the best pose, with all poses found as the poses that were tried; `None` if none was found.
    ///
    /// Tried poses are those of the point below `camera_link`; their worth is the log likelihood.
    pub fn evidence(&self, look: &Look, field: &Field, located: &ImageLocation) -> Option<Evidence> {
        let best = located.found.first()?;
        let map_from_optical = best.map_from_link * Isometry::link_from_optical();
        let footprint_from_optical = best.place().to_isometry().inverse() * map_from_optical;
        let seen = look.vision.look(look.picture, &footprint_from_optical, self.body.as_ref());
        let (refiner, line_distances) = (Refiner::new(field, &self.lens), LineDistanceMap::new(field));
        let tried = located.found.iter().map(|found| {
            let Pose2 { x, y, yaw } = found.place();
            let PoseHypothesis { log_likelihood: worth, explained, .. } = *found;
            TriedPose { x, y, yaw_deg: yaw.to_degrees(), worth, fitting: found.lines.fitting, explained }
        });
        Some(Evidence {
            agreement: best.lines,
            explained: line_distances.explained(seen.lines(), &footprint_from_optical, &map_from_optical),
            tried: tried.collect(),
            ..Evidence::of_pose(&seen, &refiner, &line_distances, Some(&footprint_from_optical), &map_from_optical)
        })
    }

    /// Refines a pose of `camera_link` to the lines near it; `None` if too few of them fit.
    fn refined(
        &self,
        refiner: &mut Refiner,
        seen: &Observations,
        place: &Pose2,
        start: &Isometry,
    ) -> Option<(Isometry, Fitted)> {
        let optical = Isometry::link_from_optical();
        let given = place.to_isometry() * self.footprint_from_link([0.0; 2]) * optical;
        let tilt = self.tilt_sigma_rad.max(MIN_TILT_SIGMA_RAD);
        let sigmas = |height: f64, tilt: f64| Vector6::new(START_M, START_M, height, tilt, tilt, START_RAD);
        let covariance = |sigmas: Vector6<f64>| Matrix6::from_diagonal(&sigmas.component_mul(&sigmas));
        let height = self.height_sigma_m;
        let prior = Prior::of_pose(given, &covariance(sigmas(height, tilt)));
        let reach = covariance(sigmas(height.min(HEIGHT_REACH_M), tilt.min(0.6 * TILT_STEP_RAD)));
        let start = error_between(&given, &(*start * optical));
        let refined = refiner.refine_within(&seen.image, &prior, &start, &reach)?;
        let lines = refined.lines;
        let agrees = lines.fitting >= MIN_FITTING && lines.share > MIN_FITTING_SHARE;
        let sigmas = PoseSigmas::of(&(refined.covariance.fixed_view::<6, 6>(0, 0) + refined.by_paint));
        agrees.then(|| (refined.map_from_optical * optical.inverse(), Fitted { lines, sigmas }))
    }

    /// Judges a pose by the image, whose ground is computed as seen from that pose.
    fn weighed(
        &self,
        look: &Look,
        observation: &Observation,
        line_distances: &LineDistanceMap,
        map_from_link: Isometry,
        fitted: Option<Fitted>,
    ) -> PoseHypothesis {
        let optical = Isometry::link_from_optical();
        let place = Pose2::from_isometry(&map_from_link);
        let footprint_from_optical = place.to_isometry().inverse() * map_from_link * optical;
        let seen = look.vision.look(look.picture, &footprint_from_optical, self.body.as_ref());
        let Support { share, weight, .. } = observation.support(seen.lines(), &place);
        let explained =
            line_distances.explained(seen.lines(), &footprint_from_optical, &(map_from_link * optical)).share;
        let tilt = map_from_link.euler();
        let sigma = self.tilt_sigma_rad.max(MIN_TILT_SIGMA_RAD);
        let off = |found: f64, given: f64| wrap_angle(found - given) / sigma;
        let (roll, pitch) = (off(tilt.roll, self.attitude.roll), off(tilt.pitch, self.attitude.pitch));
        // A distribution with heavy tails, because a given tilt is either right or far off.
        let unlikely = libm::log(1.0 + 0.5 * (roll * roll + pitch * pitch));
        let log_likelihood = observation.log_likelihood(&seen.table, &place) - unlikely;
        let (refined, sigmas) = (fitted.is_some(), fitted.map(|fitted| fitted.sigmas));
        let lines = fitted.map(|fitted| fitted.lines).unwrap_or_default();
        PoseHypothesis { map_from_link, sigmas, refined, lines, explained, share, weight, log_likelihood }
    }
}

/// What searching a field for poses needs.
pub(crate) struct FieldSearch {
    observation: Observation,
    line_distances: LineDistanceMap,
    line_width_m: f64,
    search: GlobalSearch,
}

impl FieldSearch {
    pub(crate) fn new(field: &Field) -> Self {
        let alpha = default_alpha(Formula::Corrected);
        let observation = Observation::new(field, LINE_POINTS, Formula::Corrected, alpha, SimdPath::Auto);
        let search = GlobalSearch::new(field, SEARCH_MARGIN_M, &observation);
        Self { observation, line_distances: LineDistanceMap::new(field), line_width_m: field.line_width(), search }
    }

    /// The same on a wider grid, for [`ImagePrior::surveyed`].
    pub(crate) fn for_survey(field: &Field) -> Self {
        let whole = Self::new(field);
        let search = GlobalSearch::for_survey(field, SEARCH_MARGIN_M, &whole.observation);
        Self { search, ..whole }
    }
}

/// How a refined pose fits the lines.
#[derive(Clone, Copy)]
struct Fitted {
    lines: Agreement,
    sigmas: PoseSigmas,
}

/// The changes of roll and pitch that are tried, radians, in order of their size; the first is no change.
fn tilts(sigma_rad: f64) -> Vec<[f64; 2]> {
    let most = TILT_SIGMAS * sigma_rad;
    let steps = libm::round(most / TILT_STEP_RAD) as i32;
    let mut tilts: Vec<[i32; 2]> = (-steps..=steps)
        .flat_map(|roll| (-steps..=steps).map(move |pitch| [roll, pitch]))
        .filter(|[roll, pitch]| roll * roll + pitch * pitch <= steps * steps + 1)
        .collect();
    tilts.sort_by_key(|[roll, pitch]| roll * roll + pitch * pitch);
    tilts.into_iter().map(|tilt| tilt.map(|steps| f64::from(steps) * TILT_STEP_RAD)).collect()
}

/// The best candidate near an initial pose: a particle filter on the one image, then a climb to the maximum.
fn search_around(observation: &Observation, seen: &Observations, initial: Pose2, seed: u64) -> Candidate {
    let settings = FilterSettings {
        sampling: Sampling { particles: INITIAL_PARTICLES, iterations: INITIAL_ITERATIONS, adaptive: false, fewest: 0 },
        motion: MotionModel::default(),
        jitter: Spread { xy_m: 0.05, yaw_rad: 0.03 },
        jitter_shrink: 0.7,
        seed,
    };
    let mut filter = Filter::new(settings, observation.clone(), FilterState::default());
    filter.restart(initial, INITIAL);
    let still = Some(Pose2::default());
    let best = filter.step(still, 0.0, &seen.table, &mut Effort::default(), &mut always).best;
    let start = Candidate { pose: best, log_likelihood: observation.log_likelihood(&seen.table, &best) };
    global_search::climb(observation, &seen.table, start, &mut Points::default(), &mut Effort::default())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tilts_surround_the_given_one_as_far_as_it_may_be_wrong() {
        assert_eq!(tilts(0.0), [[0.0, 0.0]]);
        for sigma_rad in [0.02, 0.035, 0.087] {
            let tilts = tilts(sigma_rad);
            assert_eq!(tilts[0], [0.0, 0.0], "the given one first");
            let sum = tilts.iter().fold([0.0, 0.0], |sum, tilt| [sum[0] + tilt[0], sum[1] + tilt[1]]);
            assert!(sum[0].abs() < 1e-12 && sum[1].abs() < 1e-12, "as many to each side");
            let most = tilts.iter().map(|tilt| tilt[0]).fold(0.0, f64::max);
            assert!((most - TILT_SIGMAS * sigma_rad).abs() <= 0.5 * TILT_STEP_RAD, "{sigma_rad}: {most}");
        }
    }
}
