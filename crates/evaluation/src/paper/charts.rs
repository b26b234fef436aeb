//! Charts of the paper's figures with the results of this program, and those of the paper beside them.

use glam::DVec2;

use super::experiment::{Paper, Run};
use super::method::{METHODS, Method};
use super::scenes::WALK_M_PER_S;
use super::{PAPER_DISTANCE, PAPER_GAUSS, PAPER_PARTICLES, PAPER_WALK_CM};
use crate::drawing::chart::{Across, Axis, Chart, Layer, Line, Mark, Note, Rule, Scale};
use realitysim_localization::{Formula, Model};

/// Draws the charts; returns file names and SVG contents.
pub fn charts(paper: &Paper) -> [(&'static str, String); 3] {
    [
        ("paper-fig9-error.svg", fig9_error(paper)),
        ("paper-fig9-time.svg", fig9_time(paper)),
        ("paper-fig10.svg", fig10(paper)),
    ]
}

fn fig9_error(paper: &Paper) -> String {
    let reported = [PAPER_GAUSS, PAPER_DISTANCE].map(|reported| reported.error_cm);
    let title = format!("Fig. 9: error against particles, standing on a {:.0} cm grid", 100.0 * paper.grid_m);
    fig9(paper, title, "mean position error in cm", |run| run.position_cm.mean, reported)
}

fn fig9_time(paper: &Paper) -> String {
    let reported = [PAPER_GAUSS, PAPER_DISTANCE].map(|reported| 1e3 * reported.seconds);
    let title = "Fig. 9: time against particles, image to tag".to_owned();
    fig9(paper, title, "time for a frame, median in ms", |run| run.p50_ms, reported)
}

fn fig9(paper: &Paper, title: String, label: &str, value: fn(&Run) -> f64, reported: [f64; 2]) -> String {
    let mut layers: Vec<Layer> = METHODS
        .iter()
        .filter(|method| method.in_fig9)
        .map(|method| {
            let of_method = paper.still.iter().filter(|run| run.method == *method);
            let points = of_method.map(|run| DVec2::new(run.particles as f64, value(run))).collect();
            layer(method, Some(mark(method)), points)
        })
        .collect();
    let reported = reported.map(|value| DVec2::new(PAPER_PARTICLES as f64, value));
    layers.push(Layer {
        name: Some("the paper".to_owned()),
        colour: "#b3261e",
        mark: Some(Mark::Diamond),
        line: None,
        opacity: 1.0,
        points: reported.to_vec(),
    });
    let [gauss, distance] = reported;
    let notes = [(gauss, "Gauss"), (distance, "distance")];
    let axis = |label: &str| Axis { label: label.to_owned(), scale: Scale::Logarithmic };
    Chart {
        title,
        x: axis("particles"),
        y: axis(label),
        layers,
        rules: Vec::new(),
        notes: notes.map(|(at, words)| Note { at, words: words.to_owned() }).to_vec(),
    }
    .to_svg()
}

fn fig10(paper: &Paper) -> String {
    let step_m = WALK_M_PER_S / paper.walk_hz;
    let layers = paper
        .walk
        .iter()
        .map(|run| {
            let points = run.errors_cm.iter().enumerate();
            // An error of 0 would have no place on the logarithmic axis.
            layer(
                &run.method,
                None,
                points.map(|(frame, cm)| DVec2::new(frame as f64 * step_m, cm.max(1e-3))).collect(),
            )
        })
        .collect();
    Chart {
        title: format!("Fig. 10: straight walk, {PAPER_PARTICLES} particles, first seed"),
        x: Axis { label: "walked, in m".to_owned(), scale: Scale::Even },
        y: Axis { label: "position error in cm".to_owned(), scale: Scale::Logarithmic },
        layers,
        rules: vec![Rule {
            across: Across::Y,
            at: PAPER_WALK_CM,
            name: format!("the paper's mean, {PAPER_WALK_CM} cm"),
        }],
        notes: Vec::new(),
    }
    .to_svg()
}

fn layer(method: &Method, mark: Option<Mark>, points: Vec<DVec2>) -> Layer {
    let turned = method.alpha.is_some();
    let line = if method.formula == Formula::Paper { Line::Dashed } else { Line::Solid };
    Layer {
        name: Some(method.name.to_owned()),
        colour: colour(method),
        mark,
        line: Some(line),
        opacity: if turned { 0.5 } else { 1.0 },
        points,
    }
}

fn colour(method: &Method) -> &'static str {
    match (method.refinement, method.model, method.alpha) {
        (true, ..) => "#2a2c2e",
        (_, Model::Gauss, Some(_)) => "#8a6bb8",
        (_, Model::Gauss, None) => "#1f77b4",
        (_, Model::Distance, _) => "#d98a1f",
    }
}

fn mark(method: &Method) -> Mark {
    if method.model == Model::Gauss { Mark::Disc } else { Mark::Square }
}
