//! Selects the images that a view is made of: near, good, and together showing as much of the view as possible.

use core::cmp::Ordering;

use glam::DVec3;

use super::image_database::ImageDatabase;
use super::index::Neighbour;
use super::kd_tree::Metric;
use super::record::Record;
use realitysim_geometry::{Euler, Isometry};
use realitysim_views::{CoverageMask, PlaceMask};

/// Number of neighbours considered for each image that is wanted.
const CANDIDATES: usize = 8;
/// Number of neighbours considered for each image that is wanted when images of an unseen part are searched.
const ASIDE_CANDIDATES: usize = 3;
/// Directions of the search for an unseen part: shares of the turn from the view's direction to that part.
const ASIDE_TURNS: [f64; 2] = [0.5, 1.0];
/// Factor of the metric's weight of the direction in that search. The images of a walk lie densely, and a farther image that
/// looks there is worth more than a near one that does not.
const ASIDE_DIRECTION_WEIGHT: f64 = 4.0;
/// Most searches for unseen parts.
const ASIDE_SEARCHES: usize = 4;
/// Share of the view from which no further images are searched.
const ENOUGH: f64 = 0.97;
/// Least share of the view that an image must add to be selected for it.
const WORTHWHILE: f64 = 0.03;
/// Share of the largest addition from which a nearer image is preferred to the one that adds most.
const NEARLY_AS_MUCH: f64 = 0.7;
/// Least distance of an image from the selected ones, as a share of its distance from the view. A nearer one adds little.
const APART: f64 = 0.5;
/// Distance between images, as a share of their distance from the view, below which both show the same. Then only the better
/// one is examined.
const ALIKE: f64 = 0.1;
/// Share by which the distance of the worst possible image is lengthened, so that the better of two equally near images is
/// selected.
const QUALITY: f64 = 0.25;

/// The images that a view from `pose` is made of, near and good ones first.
///
/// `footprint` is the coverage mask of the view, `wanted` the number of images, `without` what is excluded.
pub(super) fn choose(
    database: &ImageDatabase,
    pose: &Isometry,
    footprint: &CoverageMask,
    wanted: usize,
    without: &Exclusions,
) -> Vec<Neighbour> {
    let metric = Metric::default();
    let aside = Metric { per_direction: ASIDE_DIRECTION_WEIGHT * metric.per_direction, ..metric };
    let mut near = Near { database, pose, footprint, ranked: Vec::new(), different: Vec::new() };
    near.look(without, pose, CANDIDATES * wanted, &metric);
    let mut choice = near.complete(wanted);
    let mut hopeless = PlaceMask::default();
    for _ in 0..ASIDE_SEARCHES {
        if footprint.share(choice.shown.with(hopeless)) >= ENOUGH {
            break;
        }
        let Some((part, toward)) = footprint.unseen(pose, choice.shown.with(hopeless)) else { break };
        for turn in ASIDE_TURNS {
            near.look(without, &turned(pose, toward, turn), ASIDE_CANDIDATES * wanted, &aside);
        }
        let better = near.complete(wanted);
        if footprint.share(better.shown) < footprint.share(choice.shown) + WORTHWHILE {
            hopeless = hopeless.with(part);
        } else {
            choice = better;
        }
    }
    choice.images.sort_by(|a, b| a.ranked_distance.total_cmp(&b.ranked_distance));
    choice.images.into_iter().map(|image| image.neighbour).collect()
}

/// The pose turned towards the direction `toward` by a share `part` of the way, with the same roll.
fn turned(pose: &Isometry, toward: DVec3, part: f64) -> Isometry {
    let forward = pose.transform_vector(DVec3::X);
    let along = forward.lerp(toward, part).normalize_or(toward);
    let euler =
        Euler { yaw: libm::atan2(along.y, along.x), pitch: -libm::asin(along.z.clamp(-1.0, 1.0)), ..pose.euler() };
    Isometry::from_euler(euler, pose.translation)
}

/// An image near the view.
#[derive(Clone, Copy, Debug)]
struct Image {
    /// The record, with its distance from the view.
    neighbour: Neighbour,
    source: u32,
    pose: Isometry,
    /// The distance from the view, lengthened for a worse image.
    ranked_distance: f64,
    /// 0 for a good image, up to 1.
    badness: f64,
}

/// Images that are not used.
pub(super) struct Exclusions {
    /// Numbers of records.
    pub(super) records: Vec<usize>,
    /// Numbers of sources.
    pub(super) sources: Vec<u32>,
    /// Pairs of source and file numbers.
    pub(super) files: Vec<(u32, u32)>,
}

impl Exclusions {
    /// The `count` nearest images that are not excluded, or fewer if there are no more.
    ///
    /// The index is asked for more and more neighbours until enough of them may be used.
    fn nearest(
        &self,
        database: &ImageDatabase,
        pose: &Isometry,
        count: usize,
        by: &Metric,
    ) -> Vec<(Neighbour, Record)> {
        let mut asked = count + self.records.len();
        loop {
            let near = database.index().nearest(pose, asked, by);
            let all = near.len() < asked;
            let known = near.into_iter().map(|neighbour| (neighbour, database.index().record(neighbour.number)));
            let usable = |(neighbour, record): &(Neighbour, Record)| {
                !self.records.contains(&neighbour.number)
                    && !self.sources.contains(&record.source)
                    && !self.files.contains(&(record.source, record.file))
            };
            let found: Vec<_> = known.filter(usable).take(count).collect();
            if all || found.len() == count {
                return found;
            }
            asked *= 4;
        }
    }
}

/// Images near a view, and what they show of it.
struct Near<'a> {
    database: &'a ImageDatabase,
    pose: &'a Isometry,
    footprint: &'a CoverageMask,
    /// All images, near and good ones first.
    ranked: Vec<Image>,
    /// The images that do not show the same as a better one, with the part of the view that they show.
    different: Vec<(Image, PlaceMask)>,
}

/// Selected images, and the part of the view that they show together.
#[derive(Default)]
struct Choice {
    images: Vec<Image>,
    shown: PlaceMask,
}

impl Near<'_> {
    /// Adds the images nearest to a pose, which need not be the pose of the view.
    fn look(&mut self, without: &Exclusions, from: &Isometry, count: usize, by: &Metric) {
        let metric = Metric::default();
        let known = self.ranked.len();
        for (neighbour, record) in without.nearest(self.database, from, count, by) {
            if self.ranked[..known].iter().any(|image| image.neighbour.number == neighbour.number) {
                continue;
            }
            let pose = record.pose();
            let neighbour = Neighbour { distance: metric.distance(self.pose, &pose), ..neighbour };
            let badness = badness(&record);
            let ranked_distance = neighbour.distance * (1.0 + QUALITY * badness);
            self.ranked.push(Image { neighbour, source: record.source, pose, ranked_distance, badness });
        }
        self.ranked[known..].sort_by(Image::order);
        for image in &self.ranked[known..] {
            if is_apart(&metric, image, ALIKE, self.different.iter().map(|(image, _)| image))
                && let Some(camera) = self.database.camera_of(image.source)
            {
                self.different.push((*image, self.footprint.seen_by(camera, &image.pose)));
            }
        }
        self.ranked.sort_by(Image::order);
        self.different.sort_by(|a, b| Image::order(&a.0, &b.0));
    }

    /// Selects `wanted` images: the best one, then those that add to what is shown, then near ones apart from the others, and
    /// last any near ones.
    fn complete(&self, wanted: usize) -> Choice {
        let metric = Metric::default();
        let footprint = self.footprint;
        let Some((first, mut shown)) = self.different.first().copied() else { return Choice::default() };
        let mut images = vec![first];
        while images.len() < wanted {
            let added = |seen: &PlaceMask| footprint.share(seen.without(shown));
            let most = self.different.iter().map(|(_, seen)| added(seen)).fold(0.0, f64::max);
            let enough = (NEARLY_AS_MUCH * most).max(WORTHWHILE);
            let Some((image, more)) = self.different.iter().find(|(_, seen)| added(seen) >= enough) else { break };
            images.push(*image);
            shown = shown.with(*more);
        }
        for apart in [APART, 0.0] {
            for image in &self.ranked {
                if images.len() == wanted {
                    break;
                }
                let is_known = images.iter().any(|known| known.neighbour.number == image.neighbour.number);
                if !is_known && is_apart(&metric, image, apart, images.iter()) {
                    images.push(*image);
                }
            }
        }
        Choice { images, shown }
    }
}

impl Image {
    /// Order in which near and good images come first.
    fn order(&self, other: &Self) -> Ordering {
        self.ranked_distance.total_cmp(&other.ranked_distance).then(self.badness.total_cmp(&other.badness))
    }
}

/// Whether an image is apart from all others by at least this share of its distance from the view.
fn is_apart<'a>(metric: &Metric, image: &Image, share: f64, mut others: impl Iterator<Item = &'a Image>) -> bool {
    others.all(|other| metric.is_apart(&image.pose, &other.pose, share * image.neighbour.distance))
}

/// How bad an image is: 0 for an accurate tag and a picture that is neither dark nor overexposed nor blurred, up to 1.
fn badness(record: &Record) -> f64 {
    let tag = (record.tag().position_m / 0.05).min(1.0);
    let light = match record.brightness {
        dark if dark < 40.0 => f64::from(40.0 - dark) / 40.0,
        bright if bright > 200.0 => f64::from(bright - 200.0) / 55.0,
        _ => 0.0,
    };
    let blur = (1.0 - f64::from(record.sharpness) / 0.05).clamp(0.0, 1.0);
    (0.5 * tag + 0.25 * light.min(1.0) + 0.25 * blur).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_good_tag_a_sharp_picture_and_good_light_make_an_image_good() {
        let of = |sigma_m: f32, sharpness: f32, brightness: f32| {
            badness(&Record { sigma_m, sharpness, brightness, ..Record::at(&Isometry::IDENTITY) })
        };
        let good = of(0.001, 0.1, 120.0);
        assert!(good < 0.02);
        for worse in [of(0.02, 0.1, 120.0), of(0.001, 0.01, 120.0), of(0.001, 0.1, 10.0), of(0.001, 0.1, 250.0)] {
            assert!(worse > good + 0.1, "{worse} {good}");
        }
        // An unknown accuracy is worse than a good one.
        assert!(of(0.0, 0.1, 120.0) > good + 0.05);
    }
}
