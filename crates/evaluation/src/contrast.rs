//! Quality of tags as lines fade: the frames of one walk, painted ever more faintly, tagged by several variants of the
//! filter.
//!
//! [`PAINT`] has the steps, [`variants`] the settings, [`Quality::of`] judges a run, [`chart`] draws all steps. The
//! caller renders the frames.

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

/// Shares of the paint that is left, from fully painted to none.
pub const PAINT: [f64; 10] = [1.0, 0.7, 0.5, 0.35, 0.25, 0.18, 0.12, 0.08, 0.05, 0.0];

/// Error in x and y beyond which a valid tag is wrong, centimetres. The program claims to have no wrong tags.
pub const WRONG_CM: f64 = 12.0;

/// Named filter settings that the same frames are tagged with.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Variant {
    /// Name for tables and legends.
    pub name: &'static str,
    /// Settings of the filter.
    #[serde(flatten)]
    pub sweep_point: SweepPoint,
}

/// Returns both observation models with and without refinement, and the default model with four times the particles and
/// twice the line points.
pub fn variants(configured: SweepPoint) -> [Variant; 6] {
    let of = |model, refinement| SweepPoint { model, refinement, ..configured };
    let more = |sweep_point: SweepPoint| SweepPoint {
        particles: 4 * sweep_point.particles,
        line_points: 2 * sweep_point.line_points,
        ..sweep_point
    };
    let (gauss, plain) = (of(Model::Gauss, true), of(Model::Gauss, false));
    [
        Variant { name: "gauss, refined", sweep_point: gauss },
        Variant { name: "gauss, refined, more", sweep_point: more(gauss) },
        Variant { name: "distance, refined", sweep_point: of(Model::Distance, true) },
        Variant { name: "gauss, best particle", sweep_point: plain },
        Variant { name: "gauss, best particle, more", sweep_point: more(plain) },
        Variant { name: "distance, best particle", sweep_point: of(Model::Distance, false) },
    ]
}

/// Results of all variants at one share of paint.
#[derive(Clone, Debug, Serialize)]
pub struct Step {
    /// Share of the paint that is left, 0 to 1.
    pub paint: f64,
    /// Contrast of the lines in standard deviations of plain carpet.
    pub contrast_to_noise: f64,
    /// Counts and errors of the tags, in the order of the variants.
    pub tags: Vec<Quality>,
    /// Detection of line places, in the order of [`WIDTHS_PX`].
    pub places: Vec<Detection>,
}

/// Lower limits of the classes of line width in the image, pixels; each class ends where the next begins.
pub const WIDTHS_PX: [f64; 4] = [1.0, 2.0, 4.0, 8.0];

/// Separation of line places from plain carpet by the response of the matched filter: its receiver operating
/// characteristic (ROC).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Detection {
    /// Number of line places.
    pub places: usize,
    /// Share of the line places with a larger response than 99 % of the places on carpet.
    pub found_at_1_percent: f64,
    /// Share of the line places with a larger response than 90 % of the places on carpet.
    pub found_at_10_percent: f64,
    /// Area under the ROC curve: how often a line place has a larger response than a place on carpet, 0.5 by chance.
    pub area: f64,
}

impl Detection {
    /// Computes the detection of each class of [`WIDTHS_PX`].
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

    /// Computes the detection from ascending responses on lines and on carpet.
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

/// Counts and errors of the tags of one run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Quality {
    /// Number of frames.
    pub frames: usize,
    /// Number of valid tags.
    pub valid: usize,
    /// Number of valid tags that are more than [`WRONG_CM`] off.
    pub wrong: usize,
    /// Errors of the valid tags in x and y, centimetres. Of an ambiguous tag the nearer of its two poses counts.
    pub position_cm: Summary,
    /// Share of the judged tags whose 95 % ellipse contains the truth.
    pub ellipse95_share: f64,
}

impl Quality {
    /// Judges a run; `truth` is in order of time.
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

    /// Returns the share of the frames that have a valid tag.
    pub fn valid_share(&self) -> f64 {
        self.valid as f64 / self.frames.max(1) as f64
    }
}

/// Colour, mark and line of each variant, in the order of [`variants`].
const COLOURS: [(&str, Mark, Line); 6] = [
    ("#1f77b4", Mark::Disc, Line::Solid),
    ("#1f77b4", Mark::Disc, Line::Dashed),
    ("#1f77b4", Mark::Square, Line::Solid),
    ("#c2571a", Mark::Disc, Line::Solid),
    ("#c2571a", Mark::Disc, Line::Dashed),
    ("#c2571a", Mark::Square, Line::Solid),
];

/// Draws the share of valid tags above and their mean error below, as one SVG.
///
/// The step without paint has no place on the logarithmic axis.
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
    fn the_roc_area_is_half_for_equal_responses_and_one_for_separate_ones() {
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
        // Half of the lines respond more than all carpet, the others less.
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
