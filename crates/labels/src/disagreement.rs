//! Where a detector and the projected landmarks disagree, and how sure it is that the detector is wrong.

use glam::{DVec2, DVec3};

use crate::annotation::{Keypoint, LabelBox, Seen, Visibility};
use crate::class_map::SIGMAS;
use crate::detections::anchor;
use crate::{ClassList, Detection, Labeller, LandmarkKind, PosedImage};

/// How a detector is wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Fault {
    /// A landmark in plain view is not found.
    Missed,
    /// Something is found where no landmark of its class is.
    False,
    /// A landmark is found beside its place.
    Displaced,
}

impl Fault {
    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Missed => "missed",
            Self::False => "false",
            Self::Displaced => "displaced",
        }
    }
}

/// A detector and the truth in disagreement about one landmark.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Disagreement {
    /// How the detector is wrong.
    pub fault: Fault,
    /// Number of the class: that of the landmark, of a false detection its own.
    pub class: usize,
    /// The landmark's number in [`Labeller::landmarks`]; of a false detection, the landmark of another class that is there.
    pub landmark: Option<usize>,
    /// Where the landmark is, pixels; the first pixel's centre is (0, 0).
    pub truth: Option<DVec2>,
    /// Where the detector has it.
    pub found: Option<DVec2>,
    /// Standard deviation of the truth along its longer axis, pixels: of a false detection, that of the ground there.
    pub sigma_px: f64,
    /// How sure it is that the detector is wrong, 0 to 1.
    pub certainty: f64,
}

/// A detector's answer for an image, held against the truth.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Comparison {
    /// Landmarks that are found where they are, by their numbers in [`Labeller::landmarks`].
    pub right: Vec<usize>,
    /// The others, and what is found in vain.
    pub disagreements: Vec<Disagreement>,
}

/// A landmark counts as displaced up to so many times the distance within which it counts as found.
const DISPLACED_FACTOR: f64 = 4.0;
/// Smaller side of a box for which a miss is half as sure as for a large one, pixels.
const HALF_SURE_SIDE_PX: f64 = 16.0;
/// A miss nearer to the edge of the image is less sure, pixels.
const EDGE_PX: f64 = 32.0;

impl Labeller {
    /// Compares the detections in an image with its landmarks. One is found within `within_px` pixels and twice its own standard
    /// deviation, and displaced up to four times as far.
    ///
    /// Landmarks that are small, hidden or cut by the edge of the image may be found or not.
    pub fn compare(&self, image: &PosedImage, classes: ClassList, found: &[Detection], within_px: f64) -> Comparison {
        let truths = self.truths(image, classes);
        let judge = Judge { seen: Seen::new(self, image), truths: &truths, within_px };
        let pairs = judge.pairs(found);
        let mut comparison = Comparison::default();
        for (place, truth) in truths.iter().enumerate() {
            let detection = pairs.iter().find(|(own, _)| *own == place).map(|(_, which)| &found[*which]);
            match judge.fault(truth, detection) {
                Some(disagreement) => comparison.disagreements.push(disagreement),
                None if detection.is_some() => comparison.right.push(truth.landmark),
                None => {}
            }
        }
        let is_alone = |which: &usize| pairs.iter().all(|(_, paired)| paired != which);
        let alone = (0..found.len()).filter(is_alone);
        comparison.disagreements.extend(alone.map(|which| judge.false_detection(&found[which])));
        comparison
    }

    /// The landmarks in an image that have a class.
    fn truths(&self, image: &PosedImage, classes: ClassList) -> Vec<Truth> {
        let own = self.landmarks.iter().zip(self.keypoints(image)).zip(self.landmark_boxes(image)).enumerate();
        let truth = |(landmark, ((known, keypoint), label_box)): (usize, ((&crate::Landmark, Keypoint), _))| {
            let is_inside = keypoint.visibility != Visibility::Outside;
            let class = classes.class(known.kind).filter(|_| is_inside)?;
            Some(Truth { landmark, class, keypoint, label_box })
        };
        own.filter_map(truth).collect()
    }
}

/// A landmark in an image.
struct Truth {
    landmark: usize,
    class: usize,
    keypoint: Keypoint,
    /// Its box, if a detector should find it.
    label_box: Option<LabelBox>,
}

impl Truth {
    /// Where a detection of it should be.
    fn place(&self, detection: &Detection) -> DVec2 {
        let own_box = self.label_box.filter(|_| detection.is_box);
        own_box.map_or(self.keypoint.at, |own| anchor(own.from, own.to, own.kind == LandmarkKind::PostFoot) - 0.5)
    }

    fn distance(&self, detection: &Detection) -> f64 {
        self.place(detection).distance(detection.at)
    }
}

/// Holds detections against the truth of one image.
struct Judge<'a> {
    seen: Seen<'a>,
    truths: &'a [Truth],
    within_px: f64,
}

impl Judge<'_> {
    /// The distance within which a landmark of this standard deviation counts as found, pixels.
    fn tolerance(&self, sigma_px: f64) -> f64 {
        self.within_px + SIGMAS * sigma_px
    }

    /// Pairs of a truth and a detection of its class that may be it, each used once, the nearest first.
    fn pairs(&self, found: &[Detection]) -> Vec<(usize, usize)> {
        let mut near: Vec<(f64, usize, usize)> = Vec::new();
        for (place, truth) in self.truths.iter().enumerate() {
            let reach = DISPLACED_FACTOR * self.tolerance(truth.keypoint.sigma_px);
            for (which, detection) in found.iter().enumerate().filter(|(_, found)| found.class == truth.class) {
                let off = truth.distance(detection);
                if off <= reach {
                    near.push((off, place, which));
                }
            }
        }
        near.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut pairs: Vec<(usize, usize)> = Vec::new();
        for (_, place, which) in near {
            if pairs.iter().all(|pair| pair.0 != place && pair.1 != which) {
                pairs.push((place, which));
            }
        }
        pairs
    }

    /// What is wrong about a landmark, with the detection that may be it.
    fn fault(&self, truth: &Truth, detection: Option<&Detection>) -> Option<Disagreement> {
        let Keypoint { sigma_px, visibility, .. } = truth.keypoint;
        let label_box = truth.label_box.filter(|_| visibility == Visibility::Visible);
        let plain = label_box.map_or(0.0, |label_box| self.plainness(&truth.keypoint, &label_box));
        let known = self.within_px / self.tolerance(sigma_px);
        let (fault, certainty) = match detection.map(|detection| truth.distance(detection)) {
            None if label_box.is_some() => (Fault::Missed, plain * known),
            Some(off) if off > self.tolerance(sigma_px) && label_box.is_some() => {
                (Fault::Displaced, plain * known * (1.0 - self.tolerance(sigma_px) / off))
            }
            _ => return None,
        };
        let found = detection.map(|detection| detection.at);
        let place = detection.map_or(truth.keypoint.at, |detection| truth.place(detection));
        let (class, landmark) = (truth.class, Some(truth.landmark));
        Some(Disagreement { fault, class, landmark, truth: Some(place), found, sigma_px, certainty })
    }

    /// How plainly a landmark is in view, 0 to 1: large, nothing before it, and not at the edge.
    fn plainness(&self, keypoint: &Keypoint, label_box: &LabelBox) -> f64 {
        let side = (label_box.to - label_box.from).min_element();
        let last = DVec2::new(self.seen.width() as f64, self.seen.height() as f64) - 1.0;
        let margin = keypoint.at.min(last - keypoint.at).min_element().max(0.0);
        let size = side / (side + HALF_SURE_SIDE_PX);
        size * (1.0 - label_box.hidden_share) * (margin / EDGE_PX).min(1.0)
    }

    /// A detection that is no landmark of its class.
    fn false_detection(&self, detection: &Detection) -> Disagreement {
        let sigma_px = self.seen.ground(detection.at).map_or(0.0, |at: DVec3| self.seen.sigma_px(at, detection.at));
        let tolerance = self.tolerance(sigma_px);
        let distance = |truth: &Truth| truth.distance(detection);
        let same = self.truths.iter().filter(|truth| truth.class == detection.class).map(distance);
        let apart = same.fold(f64::INFINITY, f64::min);
        let here = self.truths.iter().filter(|truth| truth.class != detection.class && distance(truth) <= tolerance);
        let there = here.min_by(|a, b| distance(a).total_cmp(&distance(b)));
        Disagreement {
            fault: Fault::False,
            class: detection.class,
            landmark: there.map(|truth| truth.landmark),
            truth: None,
            found: Some(detection.at),
            sigma_px,
            certainty: detection.score * self.within_px / tolerance * (1.0 - tolerance / apart.max(tolerance)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{LANDMARK_CLASSES, PoseCovariance};
    use realitysim_config::{load_field, load_lens};
    use realitysim_geometry::{Euler, Field, Isometry};
    use realitysim_views::{Camera, SURE};

    const WITHIN_PX: f64 = 5.0;

    fn with_image<T>(use_it: impl Fn(&Labeller, &PosedImage) -> T) -> T {
        let camera = Camera::new(&load_lens("fisheye-640").unwrap().lens);
        let labeller = Labeller::new(&Field::new(load_field("kid-2020").unwrap()).unwrap(), true);
        let euler = Euler { yaw: 0.1, pitch: 30f64.to_radians(), roll: 0.02 };
        let image = PosedImage {
            camera: &camera,
            map_from_link: Isometry::from_euler(euler, DVec3::new(1.0, 0.2, 0.5)),
            covariance: PoseCovariance::isotropic(0.003, 0.001),
            shown: &vec![SURE; camera.width() * camera.height()],
            body: &[],
        };
        use_it(&labeller, &image)
    }

    /// Compares what `detect` makes of the landmarks in plain view with the truth.
    fn compare(detect: impl Fn(Vec<Detection>) -> Vec<Detection>) -> (usize, Comparison) {
        with_image(|labeller, image| {
            let truths = labeller.truths(image, LANDMARK_CLASSES);
            let plain = truths.iter().filter(|t| t.label_box.is_some() && t.keypoint.visibility == Visibility::Visible);
            let all: Vec<Detection> =
                plain.map(|truth| Detection::point(truth.class, truth.keypoint.at + 0.5, 1.0)).collect();
            let count = all.len();
            (count, labeller.compare(image, LANDMARK_CLASSES, &detect(all), WITHIN_PX))
        })
    }

    #[test]
    fn the_truth_itself_agrees_and_nothing_found_misses_it_all() {
        let (count, same) = compare(|all| all);
        assert!(count > 5 && same.right.len() == count && same.disagreements.is_empty(), "{count} {same:?}");
        let (count, none) = compare(|_| Vec::new());
        assert!(none.right.is_empty() && none.disagreements.len() == count);
        for found in none.disagreements {
            assert!(found.fault == Fault::Missed && (0.0..=1.0).contains(&found.certainty), "{found:?}");
        }
    }

    #[test]
    fn the_boxes_of_the_labels_agree_with_the_labels() {
        with_image(|labeller, image| {
            let boxes = labeller.boxes(image).into_iter().filter_map(|own| {
                let class = LANDMARK_CLASSES.class(own.kind)?;
                Some(Detection::of_box(LANDMARK_CLASSES, class, [own.from, own.to], 1.0))
            });
            let found: Vec<Detection> = boxes.collect();
            let compared = labeller.compare(image, LANDMARK_CLASSES, &found, 0.5);
            assert!(compared.right.len() == found.len() && compared.disagreements.is_empty(), "{compared:?}");
        });
    }

    #[test]
    fn misplaced_misnamed_and_twice_found_are_told_apart() {
        let faults = |detect: &dyn Fn(&mut Vec<Detection>)| {
            let (_, compared) = compare(|mut all| {
                detect(&mut all);
                all
            });
            let mut faults: Vec<Fault> = compared.disagreements.iter().map(|found| found.fault).collect();
            faults.sort();
            faults
        };
        assert_eq!(faults(&|all| all[0].at.x += WITHIN_PX - 0.1), []);
        assert_eq!(faults(&|all| all[0].at.y += 2.0 * WITHIN_PX), [Fault::Displaced]);
        assert_eq!(faults(&|all| all[0].at.y -= 100.0), [Fault::Missed, Fault::False]);
        assert_eq!(faults(&|all| all[0].class = 3), [Fault::Missed, Fault::False]);
        assert_eq!(faults(&|all| all.push(all[0])), [Fault::False]);
        assert_eq!(faults(&|all| all.truncate(all.len() - 1)), [Fault::Missed]);
    }
}
