//! Which images a view is made from: near, good, and such that together they show all of it.

use core::cmp::Ordering;

use glam::DVec3;

use super::image_database::ImageDatabase;
use super::index::Neighbour;
use super::kd_tree::Metric;
use super::record::Record;
use realitysim_geometry::{Euler, Isometry};
use realitysim_views::{CoverageMask, PlaceMask};

/// Neighbours looked at for each image that is used.
const LOOKED_AT: usize = 8;
/// And for each that look to where those show nothing: half the way there, and straight at it.
const LOOKED_AT_ASIDE: usize = 3;
const TURNS: [f64; 2] = [0.5, 1.0];
/// The images of a walk lie densely: of those that look there, one farther off is worth more than near ones that do not.
const DIRECTION_COUNTS_ASIDE: f64 = 4.0;
/// As long as something is unseen, so often.
const ASIDE: usize = 4;
/// Where images show this share of the view, no others are looked for.
const ENOUGH: f64 = 0.97;
/// An image is taken for what it adds from this share of the view on...
const WORTHWHILE: f64 = 0.03;
/// ...and rather than a farther one, if it adds this share of what that one does.
const NEARLY_AS_MUCH: f64 = 0.7;
/// One nearer to another image than this share of its own distance shows little that the other does not.
const APART: f64 = 0.5;
/// Images nearer to each other than this share of their distance show the same: only the better one is asked what it shows.
const ALIKE: f64 = 0.1;
/// Of two images about as near, the better one is taken: how much nearer a worse one may seem, at most.
const QUALITY: f64 = 0.25;

/// The images that a view of this pose is made from, near and good ones first. `footprint` is of the view.
pub(super) fn choose(
    gallery: &ImageDatabase,
    pose: &Isometry,
    footprint: &CoverageMask,
    wanted: usize,
    without: &Exclusions,
) -> Vec<Neighbour> {
    let metric = gallery.metric();
    let aside = Metric { per_direction: DIRECTION_COUNTS_ASIDE * metric.per_direction, ..metric };
    let mut near = Near { gallery, pose, footprint, ranked: Vec::new(), different: Vec::new() };
    near.look(without, pose, LOOKED_AT * wanted, &metric);
    let mut choice = near.complete(wanted);
    let mut hopeless = PlaceMask::default();
    for _ in 0..ASIDE {
        if footprint.share(choice.shown.with(hopeless)) >= ENOUGH {
            break;
        }
        let Some((part, toward)) = footprint.unseen(pose, choice.shown.with(hopeless)) else { break };
        for turn in TURNS {
            near.look(without, &turned(pose, toward, turn), LOOKED_AT_ASIDE * wanted, &aside);
        }
        let better = near.complete(wanted);
        if footprint.share(better.shown) < footprint.share(choice.shown) + WORTHWHILE {
            hopeless = hopeless.with(part);
        } else {
            choice = better;
        }
    }
    choice.images.sort_by(|a, b| a.seems_m.total_cmp(&b.seems_m));
    choice.images.into_iter().map(|image| image.neighbour).collect()
}

/// As upright as before, this part of the way to looking along `toward`.
fn turned(pose: &Isometry, toward: DVec3, part: f64) -> Isometry {
    let forward = pose.transform_vector(DVec3::X);
    let along = forward.lerp(toward, part).normalize_or(toward);
    let euler =
        Euler { yaw: libm::atan2(along.y, along.x), pitch: -libm::asin(along.z.clamp(-1.0, 1.0)), ..pose.euler() };
    Isometry::from_euler(euler, pose.translation)
}

#[derive(Clone, Copy, Debug)]
struct Image {
    /// Its distance is from the view.
    neighbour: Neighbour,
    source: u32,
    pose: Isometry,
    /// Its distance, longer for a worse image.
    seems_m: f64,
    badness: f64,
}

/// What is not to be used.
pub(super) struct Exclusions {
    pub(super) records: Vec<usize>,
    pub(super) sources: Vec<u32>,
    /// By source and number.
    pub(super) files: Vec<(u32, u32)>,
}

impl Exclusions {
    /// Asks for more until enough of them may be used.
    fn nearest(&self, gallery: &ImageDatabase, pose: &Isometry, count: usize, by: &Metric) -> Vec<(Neighbour, Record)> {
        let mut asked = count + self.records.len();
        loop {
            let near = gallery.index().nearest(pose, asked, by);
            let all = near.len() < asked;
            let known = near.into_iter().map(|neighbour| (neighbour, gallery.index().record(neighbour.number)));
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

/// Images near a pose, and what they show of its view.
struct Near<'a> {
    gallery: &'a ImageDatabase,
    pose: &'a Isometry,
    footprint: &'a CoverageMask,
    /// Near and good ones first.
    ranked: Vec<Image>,
    /// Those among them that do not show the same as a better one.
    different: Vec<(Image, PlaceMask)>,
}

#[derive(Default)]
struct Choice {
    images: Vec<Image>,
    shown: PlaceMask,
}

impl Near<'_> {
    /// Adds the images nearest to a pose, which need not be the one that the view is of.
    fn look(&mut self, without: &Exclusions, from: &Isometry, count: usize, by: &Metric) {
        let metric = self.gallery.metric();
        let known = self.ranked.len();
        for (neighbour, record) in without.nearest(self.gallery, from, count, by) {
            if self.ranked[..known].iter().any(|image| image.neighbour.number == neighbour.number) {
                continue;
            }
            let pose = record.pose();
            let neighbour = Neighbour { distance: metric.distance(self.pose, &pose), ..neighbour };
            let badness = badness(&record);
            let seems_m = neighbour.distance * (1.0 + QUALITY * badness);
            self.ranked.push(Image { neighbour, source: record.source, pose, seems_m, badness });
        }
        self.ranked[known..].sort_by(Image::order);
        for image in &self.ranked[known..] {
            if is_apart(&metric, image, ALIKE, self.different.iter().map(|(image, _)| image))
                && let Some(camera) = self.gallery.camera_of(image.source)
            {
                self.different.push((*image, self.footprint.seen_by(camera, &image.pose)));
            }
        }
        self.ranked.sort_by(Image::order);
        self.different.sort_by(|a, b| Image::order(&a.0, &b.0));
    }

    /// The first one, then those that add something, then those that are near and not all on one side.
    fn complete(&self, wanted: usize) -> Choice {
        let metric = self.gallery.metric();
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
    /// Near and good ones first.
    fn order(&self, other: &Self) -> Ordering {
        self.seems_m.total_cmp(&other.seems_m).then(self.badness.total_cmp(&other.badness))
    }
}

/// From all of them, by this share of its own distance.
fn is_apart<'a>(metric: &Metric, image: &Image, share: f64, mut others: impl Iterator<Item = &'a Image>) -> bool {
    others.all(|other| metric.is_apart(&image.pose, &other.pose, share * image.neighbour.distance))
}

/// 0 for a good tag and a picture that is neither dark, nor blown out, nor blurred, up to 1.
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
        // What nobody knows is worse than what is known to be good.
        assert!(of(0.0, 0.1, 120.0) > good + 0.05);
    }
}
