//! A picture of a capture's route: where the camera was, how well that is known, and why tags are invalid.

use std::collections::BTreeMap;
use std::path::Path;

use glam::DVec2;

use super::super::paths::save;
use super::overlays::session_info;
use crate::evaluation::drawing::{Ellipse, Route, RouteStyle, route_map};
use crate::geometry::{Field, Isometry};
use crate::ros2::messages::FrameTag;

/// Width of the picture, pixels.
const WIDTH_PX: u32 = 1_200;
const VALID: [u8; 3] = [230, 30, 60];
const AMBIGUOUS: [u8; 3] = [150, 60, 200];
/// Colours of the most frequent reasons of invalid tags; the rest share the last.
const REASONS: [[u8; 3]; 4] = [[255, 170, 0], [30, 60, 200], [0, 150, 170], [70, 70, 70]];
const ELLIPSE: [u8; 3] = [255, 255, 255];
/// Number of ellipses, spread evenly over the valid tags.
const ELLIPSES: usize = 60;
/// Largest half axis of a typical ellipse on the map, metres: they are magnified to about this.
const SHOWN_M: f64 = 0.2;
const MAGNIFICATIONS: [f64; 7] = [100.0, 50.0, 20.0, 10.0, 5.0, 2.0, 1.0];

/// Draws the route. Returns the number of tags that it shows.
pub(super) fn route(capture: &Path, tags: &[FrameTag], path: &Path) -> anyhow::Result<usize> {
    let field = Field::new(session_info(capture)?.field)?;
    let classes = classes(tags);
    let routes: Vec<Route> = classes.iter().map(|class| class.route(tags)).collect();
    let (ellipses, times) = ellipses(tags);
    save(&route_map(&field, &routes, &ellipses, WIDTH_PX, &caption(tags, times)), path)?;
    Ok(tags.iter().filter(|tag| place(tag).is_finite()).count())
}

/// Tags that are drawn in one colour.
struct Class {
    label: String,
    colour: [u8; 3],
    reasons: Vec<String>,
    ambiguous: bool,
}

fn classes(tags: &[FrameTag]) -> Vec<Class> {
    let share = |count: usize| 100.0 * count as f64 / tags.len().max(1) as f64;
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    let mut ambiguous = 0;
    for tag in tags {
        ambiguous += usize::from(tag.valid && tag.ambiguous);
        if !tag.valid {
            *counts.entry(&tag.reason).or_default() += 1;
        }
    }
    let mut counts: Vec<(&str, usize)> = counts.into_iter().collect();
    counts.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
    let valid = tags.iter().filter(|tag| tag.valid && !tag.ambiguous).count();
    let class = |label: String, colour, reasons, ambiguous| Class { label, colour, reasons, ambiguous };
    let mut classes = vec![class(format!("valid ({:.1} %)", share(valid)), VALID, Vec::new(), false)];
    if ambiguous > 0 {
        classes.push(class(format!("valid, half unknown ({:.1} %)", share(ambiguous)), AMBIGUOUS, Vec::new(), true));
    }
    let shown = counts.len().min(REASONS.len() - usize::from(counts.len() > REASONS.len()));
    for ((reason, count), colour) in counts[..shown].iter().zip(REASONS) {
        classes.push(class(format!("{reason} ({:.1} %)", share(*count)), colour, vec![(*reason).to_owned()], false));
    }
    if let rest @ [_, ..] = &counts[shown..] {
        let count: usize = rest.iter().map(|(_, count)| count).sum();
        let reasons = rest.iter().map(|(reason, _)| (*reason).to_owned()).collect();
        classes.push(class(format!("other reasons ({:.1} %)", share(count)), REASONS[3], reasons, false));
    }
    classes
}

impl Class {
    fn route(&self, tags: &[FrameTag]) -> Route {
        // Frames of other classes leave a gap.
        let points = tags.iter().map(|tag| if self.holds(tag) { place(tag) } else { DVec2::NAN }).collect();
        Route { label: self.label.clone(), colour: self.colour, points, style: RouteStyle::Thin, dots: true }
    }

    fn holds(&self, tag: &FrameTag) -> bool {
        match self.reasons.is_empty() {
            true => tag.valid && tag.ambiguous == self.ambiguous,
            false => !tag.valid && self.reasons.contains(&tag.reason),
        }
    }
}

/// Position of a tag in `map`, metres; an invalid one may stand anywhere.
fn place(tag: &FrameTag) -> DVec2 {
    Isometry::from(tag.pose.pose).translation.truncate()
}

/// Ellipses of some valid tags, and by how much they are magnified.
fn ellipses(tags: &[FrameTag]) -> (Vec<Ellipse>, f64) {
    let valid: Vec<&FrameTag> = tags.iter().filter(|tag| tag.valid).collect();
    let every = valid.len().div_ceil(ELLIPSES).max(1);
    let of = |tag: &&FrameTag| {
        let covariance = &tag.pose.covariance;
        Ellipse { centre: place(tag), covariance: [covariance[0], covariance[1], covariance[7]], colour: ELLIPSE }
    };
    let mut ellipses: Vec<Ellipse> = valid.iter().step_by(every).map(of).collect();
    let mut axes: Vec<f64> = ellipses.iter().filter_map(|ellipse| Some(ellipse.half_axes()?[0])).collect();
    axes.sort_by(f64::total_cmp);
    let typical_m = axes.get(axes.len() / 2).copied().unwrap_or(SHOWN_M);
    let times = MAGNIFICATIONS.into_iter().find(|times| times * typical_m <= SHOWN_M).unwrap_or(1.0);
    ellipses.iter_mut().for_each(|ellipse| ellipse.covariance = ellipse.covariance.map(|value| value * times * times));
    (ellipses, times)
}

fn caption(tags: &[FrameTag], times: f64) -> Vec<String> {
    let stamps = [tags.first(), tags.last()].map(|tag| tag.map_or(0, |tag| tag.header.stamp.to_nanoseconds()));
    let seconds = 1e-9 * (stamps[1] - stamps[0]) as f64;
    let valid = tags.iter().filter(|tag| tag.valid).count();
    vec![
        format!("route of the camera: {} frames in {seconds:.1} s, {valid} valid", tags.len()),
        format!("white ellipses hold the camera in 95 of 100 cases, {times} times as large as they are"),
    ]
}
