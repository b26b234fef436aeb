//! The tables of `measure gap` for people.

use std::fmt::Write;

use super::Row;
use crate::evaluation::perception::{DetectorReport, Interval, Light, ReportCell, Statistics};
use crate::evaluation::views::Detection;
use crate::labels::LANDMARK_CLASSES;

/// The tables of all forms.
pub fn tables(rows: &[Row]) -> String {
    let mut text = table(rows);
    let reports: Vec<(&str, &DetectorReport)> =
        rows.iter().filter_map(|row| Some((row.form, row.detector.as_ref()?))).collect();
    if !reports.is_empty() {
        text.push_str(&detector_table(&reports));
    }
    text
}

fn table(rows: &[Row]) -> String {
    let mut text = format!(
        "Means over {} images.\n\n| | response on lines | lines missed | false lines | histogram distance | PSNR on the ground |\n\
         | --- | --- | --- | --- | --- | --- |\n",
        rows[0].images
    );
    for row in rows {
        let Detection { response, missed, false_lines, .. } = row.detection;
        let psnr = if row.psnr_db > 90.0 { "-".to_owned() } else { format!("{:.1} dB", row.psnr_db) };
        let _ = writeln!(
            text,
            "| {} | {response:.3} | {:.1} % | {:.2} % | {:.3} | {psnr} |",
            row.form,
            100.0 * missed,
            100.0 * false_lines,
            row.histogram
        );
    }
    text
}

/// How the user's detector does, for each class: over all, by distance, and by light.
fn detector_table(reports: &[(&str, &DetectorReport)]) -> String {
    let (_, recorded) = reports[0];
    let mut text = format!(
        "\nYour detector takes {:.0} ms (median; 99 %: {:.0} ms) for a recorded image, with the start of its command.\n\
         Bias is detection minus landmark, spread is without the labels' own error. In brackets: what holds in 95 of 100 cases.\n\n\
         | landmark | where | picture | to be seen | found | false ones a picture | px right, down | spread px | bearing deg | distance cm |\n\
         | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |\n",
        recorded.delay_ms.median, recorded.delay_ms.p99
    );
    for class in LANDMARK_CLASSES.names {
        let margins = |cell: &&ReportCell| cell.class == *class && (cell.distance_m.is_none() || cell.light.is_none());
        let mut cells: Vec<(String, &str, &ReportCell)> = Vec::new();
        for (form, report) in reports {
            cells.extend(report.cells.iter().filter(margins).map(|cell| (condition(cell), *form, cell)));
        }
        // A stable sort keeps the order of forms.
        cells.sort_by(|(_, _, a), (_, _, b)| order(a).total_cmp(&order(b)));
        for (name, form, cell) in &cells {
            let _ = writeln!(text, "| {class} | {name} | {form} | {} |", figures(&cell.statistics));
        }
    }
    text
}

/// Where a cell stands in the table: over all first, then by distance, then by light.
fn order(cell: &ReportCell) -> f64 {
    let by_light = |light: Light| 1e6 + f64::from(light as u8);
    cell.distance_m.map(|band| band.from).or(cell.light.map(by_light)).unwrap_or(-1.0)
}

fn condition(cell: &ReportCell) -> String {
    match (cell.distance_m, cell.light) {
        (Some(band), _) => format!("{band} m"),
        (None, Some(light)) => light.name().to_owned(),
        (None, None) => "all".to_owned(),
    }
}

fn figures(statistics: &Statistics) -> String {
    let between = |of: &Interval, scale: f64| format!("{:.0}-{:.0}", scale * of.low, scale * of.high);
    let dash = || "-".to_owned();
    let found = statistics.detection_probability.as_ref();
    let found = found.map_or_else(dash, |of| format!("{:.0} % ({})", 100.0 * of.value, between(of, 100.0)));
    let wrong = statistics.false_per_picture.as_ref();
    let wrong = wrong.map_or_else(dash, |of| format!("{:.2} ({:.2}-{:.2})", of.value, of.low, of.high));
    let pixel = statistics.pixel.as_ref();
    let bias = pixel.map_or_else(dash, |of| format!("{:+.1}, {:+.1}", of.bias_px[0], of.bias_px[1]));
    let spread = pixel.and_then(|of| of.covariance_px2);
    let spread = spread.map_or_else(dash, |[[u, _], [_, v]]| format!("{:.1}", (0.5 * (u + v)).sqrt()));
    let ground = statistics.ground.as_ref();
    let spread_of = |axis: usize, scale: f64| {
        let variance = ground.and_then(|of| of.covariance).map(|covariance| covariance[axis][axis]);
        variance.map_or(String::new(), |variance| format!(" \u{b1} {:.2}", scale * variance.sqrt()))
    };
    let bearing = ground.map_or_else(dash, |of| format!("{:+.2}{}", of.bearing_bias_deg, spread_of(0, 1.0)));
    let distance = ground.map_or_else(dash, |of| format!("{:+.1}{}", 100.0 * of.distance_bias_m, spread_of(1, 100.0)));
    format!("{} | {found} | {wrong} | {bias} | {spread} | {bearing} | {distance}", statistics.to_be_seen)
}
