//! Which images a view is made from: near, good, and such that together they show all of it.

use super::gallery::Gallery;
use super::index::Neighbour;
use super::record::Record;
use super::tree::Metric;
use crate::geometry::Isometry;
use crate::views::{Footprint, Seen};

/// Neighbours looked at for each image that is used; farther afield as long as those leave something unseen.
const LOOKED_AT: [usize; 3] = [8, 32, 128];
/// Where images show this share of the view, none are looked for farther away.
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
    gallery: &Gallery,
    pose: &Isometry,
    footprint: &Footprint,
    wanted: usize,
    without: &Without,
) -> Vec<Neighbour> {
    let mut chosen = Vec::new();
    for looked_at in LOOKED_AT {
        let near = without.ranked(gallery, pose, looked_at * wanted);
        let shown;
        (chosen, shown) = complete(gallery, &near, footprint, wanted);
        if shown >= ENOUGH || near.len() < looked_at * wanted {
            break;
        }
    }
    chosen.sort_by(|a, b| a.seems_m.total_cmp(&b.seems_m));
    chosen.into_iter().map(|image| image.neighbour).collect()
}

#[derive(Clone, Copy, Debug)]
struct Image {
    neighbour: Neighbour,
    record: Record,
    pose: Isometry,
    /// Its distance, longer for a worse image.
    seems_m: f64,
}

/// What is not to be used.
pub(super) struct Without {
    pub(super) records: Vec<usize>,
    pub(super) sources: Vec<u32>,
}

impl Without {
    /// Near and good ones first.
    fn ranked(&self, gallery: &Gallery, pose: &Isometry, count: usize) -> Vec<Image> {
        let mut ranked: Vec<(f64, Image)> = self
            .nearest(gallery, pose, count)
            .into_iter()
            .map(|(neighbour, record)| {
                let badness = badness(&record);
                let seems_m = neighbour.distance * (1.0 + QUALITY * badness);
                (badness, Image { neighbour, record, pose: record.pose(), seems_m })
            })
            .collect();
        ranked.sort_by(|a, b| a.1.seems_m.total_cmp(&b.1.seems_m).then(a.0.total_cmp(&b.0)));
        ranked.into_iter().map(|(_, image)| image).collect()
    }

    /// Asks for more until enough of them may be used.
    fn nearest(&self, gallery: &Gallery, pose: &Isometry, count: usize) -> Vec<(Neighbour, Record)> {
        let mut asked = count + self.records.len();
        loop {
            let near = gallery.index().nearest(pose, asked, &gallery.metric());
            let all = near.len() < asked;
            let known = near.into_iter().map(|neighbour| (neighbour, gallery.index().record(neighbour.number)));
            let usable = |(neighbour, record): &(Neighbour, Record)| {
                !self.records.contains(&neighbour.number) && !self.sources.contains(&record.source)
            };
            let found: Vec<_> = known.filter(usable).take(count).collect();
            if all || found.len() == count {
                return found;
            }
            asked *= 4;
        }
    }
}

/// The first one, then those that add something, then those that are near and not all on one side; and the share of the view
/// that they show.
fn complete(gallery: &Gallery, ranked: &[Image], footprint: &Footprint, wanted: usize) -> (Vec<Image>, f64) {
    let metric = gallery.metric();
    let [first, ..] = ranked else { return (Vec::new(), 0.0) };
    let mut different: Vec<Image> = Vec::new();
    for image in ranked {
        if is_apart(&metric, image, ALIKE, &different) {
            different.push(*image);
        }
    }
    let seen: Vec<(Image, Seen)> = different
        .into_iter()
        .filter_map(|image| Some((image, footprint.seen_by(gallery.camera(&image.record)?, &image.pose))))
        .collect();
    let mut chosen = vec![*first];
    let mut shown = seen.first().map_or_else(Seen::default, |(_, seen)| *seen);
    while chosen.len() < wanted {
        let added = |seen: &Seen| footprint.share(seen.without(shown));
        let most = seen.iter().map(|(_, seen)| added(seen)).fold(0.0, f64::max);
        let enough = (NEARLY_AS_MUCH * most).max(WORTHWHILE);
        let Some((image, more)) = seen.iter().find(|(_, seen)| added(seen) >= enough) else { break };
        chosen.push(*image);
        shown = shown.with(*more);
    }
    for apart in [APART, 0.0] {
        for image in ranked {
            let is_known = chosen.iter().any(|known| known.neighbour.number == image.neighbour.number);
            if chosen.len() < wanted && !is_known && is_apart(&metric, image, apart, &chosen) {
                chosen.push(*image);
            }
        }
    }
    (chosen, footprint.share(shown))
}

/// From all of them, by this share of its own distance.
fn is_apart(metric: &Metric, image: &Image, share: f64, others: &[Image]) -> bool {
    others.iter().all(|other| metric.distance(&image.pose, &other.pose) >= share * image.neighbour.distance)
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
