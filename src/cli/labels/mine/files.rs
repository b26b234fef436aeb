//! The list of all disagreements, and the page of the worst images.

use std::fmt::Write;
use std::path::Path;

use glam::DVec2;

use super::super::super::paths::{save, write as write_text};
use super::asking::{Asking, Judged};
use super::{FrameRow, sheet};
use crate::labels::Disagreement;

/// First line of the list.
const HEAD: &str = "image,stamp_ns,fault,class,landmark,certainty,u,v,found_u,found_v,off_px,sigma_px\n";

/// Writes the list of all disagreements, and a page of the worst images unless there are none. Images come sorted.
pub(super) fn write(folder: &Path, asking: &Asking, judged: &[Judged]) -> anyhow::Result<()> {
    let mut rows: Vec<(&Judged, &Disagreement)> = judged
        .iter()
        .flat_map(|judged| judged.compared.disagreements.iter().map(move |found| (judged, found)))
        .collect();
    rows.sort_by(|a, b| b.1.certainty.total_cmp(&a.1.certainty));
    let rows: String = rows.into_iter().map(|(judged, found)| row(asking, judged, found)).collect();
    write_text(&folder.join("disagreements.csv"), &format!("{HEAD}{rows}"))?;
    match sheet::draw(asking, judged)? {
        Some(page) => save(&page, &folder.join(sheet::FILE)),
        None => Ok(()),
    }
}

/// An image in the report.
pub(super) fn frame_row(asking: &Asking, judged: &Judged) -> FrameRow {
    let sources = &asking.images.database().contents().sources;
    FrameRow {
        image: judged.number,
        source: sources.get(judged.record.source as usize).map(|source| source.path.clone()).unwrap_or_default(),
        stamp_ns: judged.record.stamp_ns,
        certainty: judged.certainty(),
        disagreements: judged.compared.disagreements.len(),
    }
}

fn row(asking: &Asking, judged: &Judged, found: &Disagreement) -> String {
    let class = asking.classes.names.get(found.class).copied().unwrap_or_default();
    let landmarks = asking.labeller.landmarks();
    let landmark = found.landmark.and_then(|number| landmarks.get(number)).map_or("", |landmark| &landmark.name);
    let mut row = format!(
        "{},{},{},{class},{landmark},{:.3}",
        judged.number,
        judged.record.stamp_ns,
        found.fault.name(),
        found.certainty
    );
    for at in [found.truth, found.found] {
        // As in the detector's answers, the first pixel's centre is (0.5, 0.5).
        let _ = match at.map(|at: DVec2| at + 0.5) {
            Some(at) => write!(row, ",{:.2},{:.2}", at.x, at.y),
            None => write!(row, ",,"),
        };
    }
    let off =
        found.truth.zip(found.found).map_or(String::new(), |(truth, found)| format!("{:.2}", truth.distance(found)));
    row + &format!(",{off},{:.2}\n", found.sigma_px)
}
