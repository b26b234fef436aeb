//! The chart of a sweep: error over time, the Pareto front drawn over the faded other rows.

use glam::DVec2;

use super::pareto_front::front;
use super::recommendation::{Advice, Requirements};
use super::row::{ERROR_RESOLUTION_CM, Row};
use crate::drawing::chart::{Across, Axis, Chart, Layer, Line, Mark, Note, Rule, Scale};
use realitysim_localization::Model;

const REFINED: &str = "#1f77b4";
const PLAIN: &str = "#c2571a";
const FRONT: &str = "#2a2c2e";
const CHOSEN: &str = "#b3261e";

/// Draws a sweep as SVG; `title` names the log.
///
/// The recommended row is marked, and budget and accuracy of `requirements` are drawn as lines.
pub fn chart(rows: &[Row], advice: Option<&Advice>, requirements: &Requirements, title: &str) -> String {
    // Against a run that replaces the truth an error can be 0, which has no place on a logarithmic axis.
    let place = |row: &Row| DVec2::new(row.p99_ms, row.position_cm.mean.max(ERROR_RESOLUTION_CM));
    let on = front(&rows.iter().map(Row::point).collect::<Vec<_>>());
    let judged: Vec<(&Row, bool)> = rows.iter().zip(on).filter(|(row, _)| row.judged > 0).collect();
    let on_front: Vec<&Row> = judged.iter().filter(|(_, on)| *on).map(|(row, _)| *row).collect();
    let kinds = [
        ("Gauss, refined", Model::Gauss, true, REFINED, Mark::Disc),
        ("distance, refined", Model::Distance, true, REFINED, Mark::Square),
        ("Gauss, best particle", Model::Gauss, false, PLAIN, Mark::Disc),
        ("distance, best particle", Model::Distance, false, PLAIN, Mark::Square),
    ];
    let mut layers = Vec::new();
    layers.push(Layer {
        name: Some("Pareto front".to_owned()),
        colour: FRONT,
        mark: None,
        line: Some(Line::Solid),
        opacity: 1.0,
        points: on_front.iter().map(|row| place(row)).collect(),
    });
    for (name, model, refinement, colour, mark) in kinds {
        let of_kind = |row: &&Row| row.sweep_point.model == model && row.sweep_point.refinement == refinement;
        let cloud: Vec<DVec2> =
            judged.iter().filter(|(_, on)| !on).map(|(row, _)| *row).filter(of_kind).map(place).collect();
        let points: Vec<DVec2> = on_front.iter().copied().filter(of_kind).map(place).collect();
        layers.push(Layer { name: None, colour, mark: Some(mark), line: None, opacity: 0.28, points: cloud });
        layers.push(Layer { name: Some(name.to_owned()), colour, mark: Some(mark), line: None, opacity: 1.0, points });
    }
    if let Some(row) = advice.and_then(|advice| rows.get(advice.row)) {
        layers.push(Layer {
            name: Some("recommended".to_owned()),
            colour: CHOSEN,
            mark: Some(Mark::Target),
            line: None,
            opacity: 1.0,
            points: vec![place(row)],
        });
    }
    let budget = requirements.budget_ms.map(|at| Rule { across: Across::X, at, name: format!("budget {at} ms") });
    let accuracy = requirements.accuracy_cm.map(|at| Rule { across: Across::Y, at, name: format!("{at} cm wanted") });
    let axis = |label: &str| Axis { label: label.to_owned(), scale: Scale::Logarithmic };
    let chart = Chart {
        title: title.to_owned(),
        x: axis("time for a frame, p99 in ms"),
        y: axis("mean position error in cm"),
        layers,
        rules: budget.into_iter().chain(accuracy).collect(),
        notes: on_front.iter().map(|row| Note { at: place(row), words: describe_settings(row) }).collect(),
    };
    chart.to_svg()
}

/// Describes the settings that colour and mark do not show.
fn describe_settings(row: &Row) -> String {
    let sweep_point = &row.sweep_point;
    let most = if sweep_point.adaptive { "\u{2264} " } else { "" };
    let mut words = format!("{most}{} \u{d7} {}", sweep_point.particles, sweep_point.iterations);
    if sweep_point.line_points != 350 {
        words.push_str(&format!(", {} points", sweep_point.line_points));
    }
    if sweep_point.image_reduction > 0 {
        words.push_str(&format!(", image 1/{}", sweep_point.image_reduction));
    }
    if sweep_point.budget_ms > 0.0 {
        words.push_str(", capped");
    }
    words
}
