//! The report in lines, and the words that page and lines share.

use super::Report;
use crate::evaluation::accuracy::verdict::Verdict;
use crate::evaluation::accuracy::{Crossing, Halving, Measure, SplitHalf, Taped, Turned, Use};

/// What each measure cannot see.
pub const BLIND_TAPED: &str = "Cannot see how exactly the robot was put on the crossing (about 1 cm by eye).";
pub const BLIND_TURNED: &str = "Cannot see what does not turn with the robot, nor errors of heading.";
pub const BLIND_SPLIT: &str =
    "Cannot see what both halves share: field, IMU, odometry, and a lens or mount that moves both alike.";
pub const BLIND_RESIDUALS: &str = "Cannot see what the fit has put into the poses.";
pub const BLIND_FIT: &str = "Cannot see what the lines do not show, nor a field of another size.";
/// Which point of the robot the tags of a stand are compared by.
pub const POINT: &str = "The point on the crossing is the origin of base_footprint, the point between the feet. It lies below the camera of \
the tag, moved by the horizontal lever arm from base_footprint to camera_link (transforms, head joints, IMU) in the tag's heading.";

/// The report for people.
pub fn summary(report: &Report) -> String {
    let [frames, valid] = report.frames;
    let kind = if report.refined { "refined tags" } else { "tags as recorded" };
    let mut lines =
        vec![format!("{}, {}: {valid} of {frames} frames have a valid tag; {kind}", report.robot, report.field)];
    lines.extend(taped(&report.taped));
    lines.push(turned(&report.turned));
    lines.extend(report.split_half.iter().map(split_half));
    lines.push(format!(
        "residuals: {:.2} px rms; shared by a part of the image {:.2} px, by a piece of line {:.2} cm",
        report.residuals.rms_px, report.residuals.image_px, report.residuals.field_cm
    ));
    lines.push(format!("a fit of the whole walk moves the tags by {:.2} cm (rms)", report.fit_moves_cm));
    lines.extend(report.verdicts.iter().map(|verdict| format!("{}: {}", verdict.name, verdict_text(verdict))));
    lines.join("\n")
}

fn taped(measure: &Measure<Taped>) -> Vec<String> {
    let taped = match measure {
        Measure::Missing { missing } => return vec![format!("taped places: missing: {missing}")],
        Measure::Known(taped) => taped,
    };
    let mut lines = vec![format!(
        "taped places: {:.2} cm rms, 95 % within {:.2} cm, heading {:.2} deg (median); {} stands on {} crossings, {} grossly wrong",
        taped.rms_cm,
        taped.position_cm.p95,
        taped.heading_deg.median,
        taped.stands.len(),
        taped.crossings,
        taped.gross
    )];
    lines.push(match &taped.offset {
        Measure::Known(offset) => format!(
            "  offset that turns with the robot: forward {:+.2}, left {:+.2} cm, heading {:+.2} deg; fixed to the field: x {:+.2}, y {:+.2} cm \
             (each +- {:.2}); the rest {:.2} cm",
            offset.forward_left_cm.x,
            offset.forward_left_cm.y,
            offset.turned_deg,
            offset.field_cm.x,
            offset.field_cm.y,
            offset.sigma_cm,
            offset.rest_cm
        ),
        Measure::Missing { missing } => format!("  offset: missing: {missing}"),
    });
    lines.push(match &taped.held_out {
        Measure::Known(held_out) => format!(
            "  left at a crossing once the others' offset is taken out: {:.2} cm rms, worst crossing {:.2} cm, heading {:.2} deg",
            held_out.rms_cm, held_out.worst_cm, held_out.heading_deg
        ),
        Measure::Missing { missing } => format!("  held-out place: missing: {missing}"),
    });
    lines
}

fn turned(measure: &Measure<Turned>) -> String {
    match measure {
        Measure::Known(turned) => format!(
            "opposite headings: what turns with the robot is forward {:+.2}, left {:+.2} cm ({} pairs, scatter {:.2} cm)",
            turned.forward_left_cm.x, turned.forward_left_cm.y, turned.pairs, turned.scatter_cm
        ),
        Measure::Missing { missing } => format!("opposite headings: missing: {missing}"),
    }
}

fn split_half(measure: &Measure<SplitHalf>) -> String {
    match measure {
        Measure::Known(half) => format!(
            "{}: {:.2} cm and {:.2} deg apart, {:.1} of what they claim; noise of a tag {:.2} cm",
            halving(half.by),
            half.apart_cm,
            half.apart_deg,
            half.claimed,
            half.noise_cm
        ),
        Measure::Missing { missing } => format!("halves of the lines: missing: {missing}"),
    }
}

/// How lines were divided.
pub fn halving(by: Halving) -> &'static str {
    match by {
        Halving::Metres => "odd and even metres of line",
        Halving::Sides => "left and right half of the image",
    }
}

/// The verdict of a use.
pub fn verdict_text(verdict: &Use) -> String {
    let alone = if verdict.noise_alone { "noise alone " } else { "" };
    let value = verdict.value_cm.map_or("-".to_owned(), |value| format!("{alone}{value:.2} cm"));
    let limit = format!("{value}, limit {:.1} cm", verdict.limit_cm);
    match (verdict.verdict, &verdict.missing) {
        (Verdict::Yes, _) => format!("yes ({limit})"),
        (Verdict::No, _) => format!("no ({limit})"),
        (Verdict::NotShown, why) => format!("not shown ({limit}): {}", why.as_deref().unwrap_or_default()),
    }
}

/// The crossings of a field in lines.
pub fn places(crossings: &[Crossing]) -> String {
    let line = |crossing: &Crossing| format!("{:<26} {:+8.3} {:+8.3}", crossing.name, crossing.at_m.x, crossing.at_m.y);
    let lines: Vec<String> = crossings.iter().map(line).collect();
    format!("{:<26} {:>8} {:>8}\n{}", "crossing", "x, m", "y, m", lines.join("\n"))
}
