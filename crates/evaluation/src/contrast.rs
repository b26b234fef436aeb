//! How tags fare as lines fade: one walk, painted ever more faintly, tagged by several variants of the filter.
//!
//! [`PAINT`] has the steps, [`variants`] the settings, [`Quality::of`] judges a run, [`chart`] draws all. Frames are the caller's.

use glam::DVec2;
use serde::Serialize;

use super::capture::tagged;
use super::compare::{compare, truth_at, up_to_mirror};
use super::cost::SweepPoint;
use super::drawing::chart::{Axis, Chart, Layer, Line, Mark, Scale};
use super::{Summary, Tagged};
use realitysim_geometry::Isometry;
use realitysim_localization::Model;
use realitysim_localization::refinement::line_measurement::Response;
use realitysim_tagging::Trial;

/// Share of the paint that is left, from well painted to none.
pub const PAINT: [f64; 10] = [1.0, 0.7, 0.5, 0.35, 0.25, 0.18, 0.12, 0.08, 0.05, 0.0];

/// A valid tag this far off is wrong: the program's claim is to have none.
pub const WRONG_CM: f64 = 12.0;

/// A way to tag the same frames.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Variant {
    pub name: &'static str,
    #[serde(flatten)]
    pub knobs: SweepPoint,
}

/// Both observation models with and without refinement, and the default model with four times the particles and twice the points.
pub fn variants(configured: SweepPoint) -> [Variant; 6] {
    let of = |model, refinement| SweepPoint { model, refinement, ..configured };
    let more =
        |knobs: SweepPoint| SweepPoint { particles: 4 * knobs.particles, line_points: 2 * knobs.line_points, ..knobs };
    let (gauss, plain) = (of(Model::Gauss, true), of(Model::Gauss, false));
    [
        Variant { name: "gauss, refined", knobs: gauss },
        Variant { name: "gauss, refined, more", knobs: more(gauss) },
        Variant { name: "distance, refined", knobs: of(Model::Distance, true) },
        Variant { name: "gauss, best particle", knobs: plain },
        Variant { name: "gauss, best particle, more", knobs: more(plain) },
        Variant { name: "distance, best particle", knobs: of(Model::Distance, false) },
    ]
}

/// One step of fading.
#[derive(Clone, Debug, Serialize)]
pub struct Step {
    /// Share of the paint that is left.
    pub paint: f64,
    /// Contrast of the lines over the noise of plain carpet.
    pub contrast_to_noise: f64,
    /// In the order of the variants.
    pub tags: Vec<Quality>,
    /// In the order of [`WIDTHS_PX`].
    pub places: Vec<Detection>,
}

/// Lines are told apart by how wide they are drawn, in pixels: from this to the next.
pub const WIDTHS_PX: [f64; 4] = [1.0, 2.0, 4.0, 8.0];

/// How well line places are told from plain carpet by how far they stand out: the receiver operating characteristic of the matched filter.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Detection {
    pub places: usize,
    /// Share of the line places that stand out more than 99 % of the carpet's.
    pub found_at_1_percent: f64,
    /// More than 90 %.
    pub found_at_10_percent: f64,
    /// How often a line place stands out more than one of carpet: the area under the curve, 0.5 by chance.
    pub area: f64,
}

impl Detection {
    /// Of each class of width.
    pub fn of(responses: &[Response]) -> Vec<Self> {
        let ends = WIDTHS_PX.into_iter().skip(1).chain([f64::INFINITY]);
        let classes = WIDTHS_PX.into_iter().zip(ends).map(|(from, to)| {
            let of_class = responses.iter().filter(|response| (from..to).contains(&response.width_px));
            let (mut lines, mut carpet): (Vec<f64>, Vec<f64>) =
                of_class.map(|response| (response.line, response.carpet)).unzip();
            lines.sort_by(f64::total_cmp);
            carpet.sort_by(f64::total_cmp);
            Self::of_sorted(&lines, &carpet)
        });
        classes.collect()
    }

    fn of_sorted(lines: &[f64], carpet: &[f64]) -> Self {
        let count = lines.len();
        let share = |of: usize| of as f64 / count.max(1) as f64;
        let above = |threshold: f64| share(count - lines.partition_point(|line| *line <= threshold));
        let found_at = |alarms: f64| {
            let at = ((1.0 - alarms) * carpet.len() as f64) as usize;
            carpet.get(at.min(carpet.len().saturating_sub(1))).map_or(0.0, |threshold| above(*threshold))
        };
        let won: f64 = carpet.iter().map(|carpet| above(*carpet)).sum();
        Self {
            places: count,
            found_at_1_percent: found_at(0.01),
            found_at_10_percent: found_at(0.1),
            area: won / carpet.len().max(1) as f64,
        }
    }
}

/// What one variant made of one step's frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Quality {
    pub frames: usize,
    pub valid: usize,
    /// Valid, and more than [`WRONG_CM`] off.
    pub wrong: usize,
    /// Of valid tags, in x and y; an ambiguous tag counts with the nearer of its two poses.
    pub position_cm: Summary,
    /// Share of them whose 95 % ellipse holds the truth.
    pub ellipse95_share: f64,
}

impl Quality {
    pub fn of(run: &[Trial], truth: &[(i64, Isometry)]) -> Self {
        let tags: Vec<Tagged> = run.iter().map(|attempt| tagged(&attempt.tag)).collect();
        let tags = up_to_mirror(&tags, truth);
        let is_wrong = |tag: &&Tagged| {
            let off = truth_at(truth, tag.stamp_ns).map(|pose| (tag.pose.translation - pose.translation).truncate());
            tag.valid && off.is_some_and(|off| 100.0 * off.length() > WRONG_CM)
        };
        let compared = compare(&tags, truth);
        Self {
            frames: compared.frames,
            valid: compared.valid,
            wrong: tags.iter().filter(is_wrong).count(),
            position_cm: compared.position_cm,
            ellipse95_share: compared.ellipse95_share,
        }
    }

    pub fn valid_share(&self) -> f64 {
        self.valid as f64 / self.frames.max(1) as f64
    }
}

const COLOURS: [(&str, Mark, Line); 6] = [
    ("#1f77b4", Mark::Disc, Line::Solid),
    ("#1f77b4", Mark::Disc, Line::Dashed),
    ("#1f77b4", Mark::Square, Line::Solid),
    ("#c2571a", Mark::Disc, Line::Solid),
    ("#c2571a", Mark::Disc, Line::Dashed),
    ("#c2571a", Mark::Square, Line::Solid),
];

/// Share of valid tags above, their mean error below, as one SVG. The step without paint has no place on a logarithmic axis.
pub fn chart(variants: &[Variant], steps: &[Step], title: &str) -> String {
    let layers = |value: &dyn Fn(&Quality) -> f64| -> Vec<Layer> {
        let layer = |(index, (variant, (colour, mark, line))): (usize, (&Variant, (&'static str, Mark, Line)))| {
            let at = |step: &Step| Some(DVec2::new(step.contrast_to_noise, value(step.tags.get(index)?)));
            Layer {
                name: Some(variant.name.to_owned()),
                colour,
                mark: Some(mark),
                line: Some(line),
                opacity: 0.85,
                points: steps.iter().filter_map(at).filter(|at| at.is_finite()).collect(),
            }
        };
        variants.iter().zip(COLOURS).enumerate().map(layer).collect()
    };
    let axis = |label: &str, scale| Axis { label: label.to_owned(), scale };
    let of = |title: String, label: &str, scale, value: &dyn Fn(&Quality) -> f64| Chart {
        title,
        x: axis("line contrast to noise", Scale::Logarithmic),
        y: axis(label, scale),
        layers: layers(value),
        rules: Vec::new(),
        notes: Vec::new(),
    };
    let error = |quality: &Quality| if quality.valid > 0 { quality.position_cm.mean } else { f64::NAN };
    let valid = of(title.to_owned(), "valid tags in %", Scale::Even, &|quality| 100.0 * quality.valid_share());
    let errors = of("Their error".to_owned(), "mean position error in cm", Scale::Logarithmic, &error);
    Chart::stacked(&[valid, errors])
}

#[cfg(test)]
mod tests {
    use super::*;
    use realitysim_config::Settings;
    use realitysim_ros2::messages::{FrameTag, Stamp};

    fn attempt(frame: i64, x: f64, valid: bool) -> Trial {
        let mut tag = FrameTag { valid, ..FrameTag::default() };
        tag.header.stamp = Stamp::from_nanoseconds(frame * 100_000_000);
        (tag.pose.pose.position.x, tag.pose.pose.orientation.w) = (x, 1.0);
        Trial { tag, seen: true }
    }

    #[test]
    fn what_stands_out_alike_is_told_apart_by_chance_and_what_never_does_always() {
        let of = |line: &dyn Fn(f64) -> f64| {
            let responses = (0..1000).map(f64::from);
            let responses: Vec<_> =
                responses.map(|at| Response { width_px: 3.0, line: line(at), carpet: (at * 7.0) % 1000.0 }).collect();
            Detection::of(&responses)
        };
        let [_, alike, _, none] = of(&|at| at)[..] else { panic!("a detection for each class") };
        assert!((alike.area - 0.5).abs() < 0.01 && (alike.found_at_10_percent - 0.1).abs() < 0.01, "{alike:?}");
        assert_eq!((alike.places, none.places), (1000, 0));
        let apart = of(&|at| at + 2000.0)[1];
        assert_eq!((apart.area, apart.found_at_1_percent), (1.0, 1.0));
        // Half of the lines stand out of all carpet, the others of none.
        let half = of(&|at| if at < 500.0 { 2000.0 } else { -1.0 })[1];
        assert_eq!((half.area, half.found_at_1_percent, half.found_at_10_percent), (0.5, 0.5, 0.5));
    }

    #[test]
    fn a_tag_is_wrong_if_it_is_valid_and_far_off() {
        let truth: Vec<(i64, Isometry)> = (0..4).map(|frame| (frame * 100_000_000, Isometry::IDENTITY)).collect();
        let run = [attempt(0, 0.01, true), attempt(1, 0.13, true), attempt(2, 3.0, false), attempt(3, 0.11, true)];
        let quality = Quality::of(&run, &truth);
        assert_eq!((quality.frames, quality.valid, quality.wrong), (4, 3, 1));
        assert!((quality.position_cm.max - 13.0).abs() < 1e-9 && quality.valid_share() == 0.75);
    }

    #[test]
    fn both_charts_show_every_variant() {
        let variants = variants(SweepPoint::of(&Settings::default()));
        let quality = Quality { frames: 10, valid: 5, position_cm: Summary::of(&[1.0]), ..Quality::default() };
        let steps = [4.0, 1.0, 0.0].map(|contrast_to_noise| Step {
            paint: 0.5,
            contrast_to_noise,
            tags: vec![quality; 6],
            places: Vec::new(),
        });
        let svg = chart(&variants, &steps, "faint lines");
        assert!(svg.starts_with("<svg ") && svg.trim_end().ends_with("</svg>"));
        for variant in variants {
            assert_eq!(svg.matches(&format!(">{}<", variant.name)).count(), 2, "{}", variant.name);
        }
    }
}
