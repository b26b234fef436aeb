//! `realitysim sessions show`

use clap::Args;
use serde::Serialize;

use super::CapturesArguments;
use super::list::{Row, line, row};
use crate::cli::{Outcome, output};
use crate::recording::ManifestLine;
use crate::sync::receiver_of;

/// One session: its segments, what became of its frames, who has it
#[derive(Args)]
pub struct ShowArguments {
    /// Name or folder
    session: String,
    #[command(flatten)]
    captures: CapturesArguments,
}

#[derive(Serialize)]
struct Shown {
    #[serde(flatten)]
    row: Row,
    manifest: Vec<ManifestLine>,
}

pub fn run(arguments: &ShowArguments, json: bool) -> anyhow::Result<Outcome> {
    let session = arguments.captures.session(&arguments.session)?;
    let own = session.folder.parent().and_then(receiver_of);
    let shown = Shown { row: row(&session, own.as_deref()), manifest: session.lines.clone() };
    if json {
        output::json(&shown)?;
    } else {
        output::lines(&for_people(&shown))?;
    }
    Ok(if shown.row.missing > 0 { Outcome::DataLost } else { Outcome::Whole })
}

fn for_people(shown: &Shown) -> String {
    let Shown { row, manifest } = shown;
    let mut text = line(row);
    let robot = row.robot_id.as_deref().map_or_else(String::new, |id| format!(" ({id})"));
    text.push_str(&format!("  id {}, robot {}{robot}\n", row.id.as_str(), row.robot));
    for (receiver, segments) in &row.receivers {
        text.push_str(&format!("  {segments} segments are with {receiver}\n"));
    }
    for (what, causes) in [("dropped", &row.frames.dropped), ("untagged", &row.frames.untagged)] {
        for (cause, count) in causes {
            text.push_str(&format!("  {count} frames {what}: {cause}\n"));
        }
    }
    for why in &row.set_aside {
        text.push_str(&format!("  set aside: {why}\n"));
    }
    for line in manifest {
        let place = line.poses.map_or_else(String::new, |p| {
            format!("  x {:.1} to {:.1} m, y {:.1} to {:.1} m", p.x[0], p.x[1], p.y[0], p.y[1])
        });
        text.push_str(&format!(
            "  {}  {:>10}  {:>6} frames, {:>6} valid{place}\n",
            line.name,
            output::size(line.bytes),
            line.frames.written,
            line.frames.valid
        ));
    }
    text.trim_end().to_owned()
}
