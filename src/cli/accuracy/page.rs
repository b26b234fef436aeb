//! The page of a report, and the page with the crossings of a field.

use std::fmt::Write;

use glam::DVec2;

use super::Report;
use super::text::{BLIND_FIT, BLIND_RESIDUALS, BLIND_SPLIT, BLIND_TAPED, BLIND_TURNED, POINT, halving, verdict_text};
use crate::cli::html::{END, escaped, head};
use crate::evaluation::accuracy::crossings::recommended;
use crate::evaluation::accuracy::{Crossing, Measure, SplitHalf, StandError, Taped, Turned};
use crate::evaluation::drawing::FieldSvg;
use crate::geometry::Field;

/// Length of a drawn error for each centimetre, pixels.
const PX_PER_CM: f64 = 8.0;
/// Colours of the headings 0, 90, 180 and 270 degrees.
const HEADINGS: [&str; 4] = ["#c22", "#282", "#24c", "#a50"];

/// Makes the page of a report, which needs no other file.
pub fn report(report: &Report, field: &Field) -> String {
    let [frames, valid] = report.frames;
    let mut html = head("Accuracy of tags");
    let _ = write!(
        html,
        "<h1>Accuracy: {} on {}</h1><p>{valid} of {frames} frames have a valid tag. {} Nothing is aligned.</p>{}<h2>Taped \
         places</h2><p>{POINT}</p>{}<h2>Opposite headings</h2>{}<h2>Two halves of the lines</h2>{}<h2>Where lines lie off</h2>{}\
         <h2>What a fit of the whole walk changes</h2>{}",
        escaped(&report.robot),
        escaped(&report.field),
        if report.refined { "They are refined ones." } else { "They are judged as recorded." },
        verdicts(report),
        taped(report, field),
        turned(&report.turned),
        split_halves(&report.split_half),
        residuals(report),
        fit(report),
    );
    html + END
}

fn verdicts(report: &Report) -> String {
    let mut rows = String::from("<table><tr><th>good enough for<th>verdict<th>by</tr>");
    for verdict in &report.verdicts {
        let _ = write!(
            rows,
            "<tr><td>{}<td><b>{}</b><td>{}</tr>",
            verdict.name,
            escaped(&verdict_text(verdict)),
            escaped(&verdict.figure.replace('`', ""))
        );
    }
    rows + "</table>"
}

fn missing(why: &str) -> String {
    format!("<p><b>Missing:</b> {}.</p>", escaped(&why.replace('`', "")))
}

fn taped(report: &Report, field: &Field) -> String {
    let mut html = String::new();
    for refused in &report.refused {
        let _ = write!(
            html,
            "<p><b>Not used:</b> mark &quot;{}&quot;: {}.</p>",
            escaped(&refused.mark),
            escaped(&refused.why)
        );
    }
    let taped = match &report.taped {
        Measure::Missing { missing: why } => return html + &missing(why),
        Measure::Known(taped) => taped,
    };
    let _ = write!(
        html,
        "<p class=big>{:.2} cm rms, 95 % within {:.2} cm; heading {:.2}&deg; (median)</p><p>{} stands on {} crossings; {} grossly \
         wrong.</p>",
        taped.rms_cm,
        taped.position_cm.p95,
        taped.heading_deg.median,
        taped.stands.len(),
        taped.crossings,
        taped.gross
    );
    html.push_str(&constant_part(taped));
    html.push_str(&stands_svg(taped, field));
    html.push_str(&stand_rows(&taped.stands));
    html + "<p>" + BLIND_TAPED + "</p>"
}

fn constant_part(taped: &Taped) -> String {
    let mut html = match &taped.offset {
        Measure::Missing { missing: why } => missing(why),
        Measure::Known(offset) => format!(
            "<table><tr><th>constant part<th>cm, &plusmn; {:.2}</tr><tr><td>turns with the robot: forward, left<td>{:+.2}, {:+.2}</tr>\
             <tr><td>fixed to the field: x, y<td>{:+.2}, {:+.2}</tr><tr><td>heading, degrees<td>{:+.2}</tr><tr><td>the rest, \
             rms<td>{:.2}</tr></table>",
            offset.sigma_cm,
            offset.forward_left_cm.x,
            offset.forward_left_cm.y,
            offset.field_cm.x,
            offset.field_cm.y,
            offset.turned_deg,
            offset.rest_cm
        ),
    };
    match &taped.held_out {
        Measure::Missing { missing: why } => html.push_str(&missing(why)),
        Measure::Known(held_out) => {
            let _ = write!(
                html,
                "<p>Each crossing held out in turn: {:.2} cm rms are left once the offset by the others, which turns with the robot, is \
                 taken out; {:.2} cm at the worst crossing; heading {:.2}&deg;.</p>",
                held_out.rms_cm, held_out.worst_cm, held_out.heading_deg
            );
        }
    }
    html
}

/// The errors on the field: an arrow for each stand, enlarged, in the colour of its heading.
fn stands_svg(taped: &Taped, field: &Field) -> String {
    let mut picture = FieldSvg::new(
        field,
        &format!("Errors at taped places, 1 cm is {PX_PER_CM} pixels; one colour for each heading"),
    );
    for stand in &taped.stands {
        let quarter = (stand.heading_deg / 90.0).round().rem_euclid(4.0) as usize;
        let along = (stand.off_m * 100.0 * PX_PER_CM).clamp_length_max(120.0);
        picture.dot(stand.at_m, 3.0, "#222");
        picture.arrow(stand.at_m, along, HEADINGS[quarter.min(3)]);
        picture.words(stand.at_m, DVec2::new(6.0, 16.0), 11.0, &stand.crossing);
    }
    picture.finish()
}

fn stand_rows(stands: &[StandError]) -> String {
    let mut rows = String::from(
        "<details><summary>Each stand</summary><table><tr><th>crossing<th>heading<th>off by, cm<th>forward, left<th>heading off<th>left \
         when held out, cm<th>scatter, cm<th>tags</tr>",
    );
    for stand in stands {
        let _ = write!(
            rows,
            "<tr><td>{}<td>{:.0}&deg;<td>{:.2}<td>{:+.2}, {:+.2}<td>{:+.2}&deg;<td>{}<td>{:.2}<td>{}</tr>",
            escaped(&stand.crossing),
            stand.heading_deg,
            100.0 * stand.off_m.length(),
            stand.forward_left_cm.x,
            stand.forward_left_cm.y,
            stand.turned_deg,
            stand.held_out_cm.map_or("-".to_owned(), |left| format!("{left:.2}")),
            stand.scatter_cm,
            stand.tags
        );
    }
    rows + "</table></details>"
}

fn turned(measure: &Measure<Turned>) -> String {
    match measure {
        Measure::Missing { missing: why } => missing(why),
        Measure::Known(turned) => format!(
            "<p>Half the difference of {} pairs of tags on the same crossing: forward {:+.2}, left {:+.2} cm turn with the robot (scatter \
             {:.2} cm). Where the crossing lies cancels. {BLIND_TURNED}</p>",
            turned.pairs, turned.forward_left_cm.x, turned.forward_left_cm.y, turned.scatter_cm
        ),
    }
}

fn split_halves(measures: &[Measure<SplitHalf>]) -> String {
    let mut rows = String::from(
        "<table><tr><th>halves<th>frames<th>apart, cm<th>apart, degrees<th>of what they claim<th>noise of a tag, cm</tr>",
    );
    let mut without = String::new();
    for measure in measures {
        match measure {
            Measure::Missing { missing: why } => without.push_str(&missing(why)),
            Measure::Known(half) => {
                let _ = write!(
                    rows,
                    "<tr><td>{}<td>{}<td>{:.2}<td>{:.2}<td>{:.1}<td>{:.2}</tr>",
                    halving(half.by),
                    half.frames,
                    half.apart_cm,
                    half.apart_deg,
                    half.claimed,
                    half.noise_cm
                );
            }
        }
    }
    rows + "</table>" + &without + "<p>" + BLIND_SPLIT + "</p>"
}

fn residuals(report: &Report) -> String {
    let residuals = &report.residuals;
    format!(
        "<p>{:.2} px rms after the fit. Lines in one part of the image share {:.2} px, those of one piece of line {:.2} cm. Red parts of the \
         image speak of the lens, red pieces of the field of paint that lies elsewhere than the field file has it. \
         {BLIND_RESIDUALS}</p>{}{}",
        residuals.rms_px, residuals.image_px, residuals.field_cm, residuals.image_svg, residuals.field_svg
    )
}

fn fit(report: &Report) -> String {
    let mut rows = format!(
        "<p>It moves the tags by {:.2} cm (rms). What it finds of camera and mount, beyond what the capture says:</p>\
         <table><tr><th>constant<th>found<th>&plusmn;<th>unit</tr>",
        report.fit_moves_cm
    );
    for constant in report.constants.iter().filter(|constant| constant.observable) {
        let bold = if constant.value.abs() > 3.0 * constant.known { "<b>" } else { "" };
        let _ = write!(
            rows,
            "<tr><td>{bold}{}<td>{bold}{:+.4}<td>{:.4}<td>{}</tr>",
            constant.name, constant.value, constant.known, constant.unit
        );
    }
    rows + "</table><p>Bold: more than three standard deviations; calibrate (realitysim calibrate). "
        + BLIND_FIT
        + "</p>"
}

/// Makes the page with the crossings of a field, to take along when they are marked.
pub fn places(field: &Field, crossings: &[Crossing]) -> String {
    let title = &field.dimensions().title;
    let chosen = recommended(crossings);
    let mut picture =
        FieldSvg::new(field, &format!("{title}: crossings; x points to the right, heading 0; heading 90 is up"));
    for (number, crossing) in crossings.iter().enumerate() {
        let is_chosen = chosen.iter().any(|other| other.name == crossing.name);
        picture.dot(crossing.at_m, if is_chosen { 6.0 } else { 3.0 }, if is_chosen { "#c22" } else { "#222" });
        picture.words(crossing.at_m, DVec2::new(8.0, 18.0), 15.0, &(number + 1).to_string());
    }
    let mut rows = String::from("<table><tr><th>number<th>mark<th>x, m<th>y, m</tr>");
    for (number, crossing) in crossings.iter().enumerate() {
        let star = if chosen.iter().any(|other| other.name == crossing.name) { " *" } else { "" };
        let _ = write!(
            rows,
            "<tr><td>{}<td>at {} HEADING{star}<td>{:+.3}<td>{:+.3}</tr>",
            number + 1,
            escaped(&crossing.name),
            crossing.at_m.x,
            crossing.at_m.y
        );
    }
    let mut html = head("Crossings of a field");
    let _ = write!(
        html,
        "<h1>{}</h1><p>Put the point between the robot's feet on the middle of the lines, both feet parallel to the heading. Let it stand \
         for a second, mark, and let it stand for another second. Red, with *: six places that lie far apart; each with headings 0, 90, 180 \
         and 270.</p>{}{rows}</table>",
        escaped(title),
        picture.finish()
    );
    html + END
}
