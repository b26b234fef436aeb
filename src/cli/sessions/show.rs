//! Command `realitysim sessions show`: shows one session in detail.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use clap::Args;
use serde::Serialize;

use super::list::{Row, line, row_of_source_session, row_with_sources};
use super::{CapturesArguments, full_name};
use crate::cli::paths::{check_output, save};
use crate::cli::settings::UsageError;
use crate::cli::{Outcome, output};
use crate::evaluation::drawing::coverage_map;
use crate::geometry::{Field, Isometry, PoseGrid};
use crate::log_input::decode;
use crate::log_input::log::LogSource;
use crate::recording::sessions::session_at;
use crate::recording::sync::known_sources;
use crate::recording::{ManifestLine, Session, SessionInfo, read_coverage, read_info};
use crate::ros2::mcap_read::Selection;
use crate::ros2::messages::{FrameTag, Message};
use crate::ros2::topics;

/// One session: its segments, what became of its frames, who has it
#[derive(Args)]
#[command(after_long_help = "Example:\n  realitysim sessions show 2026-11-21T10")]
pub struct ShowArguments {
    /// Its name or the beginning of it, or its folder
    session: String,
    #[command(flatten)]
    captures: CapturesArguments,
    /// A picture of the field: which places and headings there are images of, and where to walk next
    #[arg(short, long, value_name = "PNG")]
    output: Option<PathBuf>,
}

#[derive(Serialize)]
struct Shown {
    #[serde(flatten)]
    row: Row,
    manifest: Vec<Listed>,
    coverage: Option<Shape>,
}

/// A line of the manifest with the state of its segment.
#[derive(Serialize)]
struct Listed {
    #[serde(flatten)]
    line: ManifestLine,
    state: SegmentState,
}

#[derive(Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
enum SegmentState {
    Here,
    /// Removed to make room, because another store had it.
    Evicted,
    Missing,
    /// The session is at a source only.
    Source,
}

#[derive(Serialize)]
struct Shape {
    #[serde(flatten)]
    grid: PoseGrid,
    map: Vec<String>,
    headings: Vec<Heading>,
}

/// Coverage by images that look in one range of directions.
#[derive(Serialize)]
struct Heading {
    from_deg: f64,
    to_deg: f64,
    /// Cells with an image, and the number of cells.
    filled: usize,
    places: usize,
    map: Vec<String>,
}

pub fn run(arguments: &ShowArguments, json: bool) -> anyhow::Result<Outcome> {
    let Found { session, row, is_here } = find(arguments)?;
    // The session's session.json may have a version that this program cannot read; the rest is shown all the same.
    let info = read_info(&session.folder).ok();
    let grid = info.as_ref().and_then(|info| {
        let counted = || coverage_of(&session, info).filter(|_| is_here);
        read_coverage(&session.folder, row.frames.valid).or_else(counted)
    });
    if let Some(path) = &arguments.output {
        check_output(path, &[])?;
        let (Some(info), Some(grid)) = (&info, &grid) else {
            anyhow::bail!("{}: nothing says which poses it has images of", session.folder.display());
        };
        save(&coverage_map(grid, &Field::new(info.field.clone())?), path)?;
    }
    let coverage = grid.map(|grid| Shape { map: grid.text(), headings: headings(&grid), grid });
    let shown = Shown { row, manifest: listed(&session, is_here), coverage };
    if json {
        output::json(&shown)?;
    } else {
        output::lines(&for_people(&shown))?;
    }
    Ok(if shown.row.missing > 0 { Outcome::DataLost } else { Outcome::Whole })
}

struct Found {
    session: Session,
    row: Row,
    is_here: bool,
}

/// Finds the session here, or else among those known from sources.
fn find(arguments: &ShowArguments) -> anyhow::Result<Found> {
    let path = arguments.captures.path(&arguments.session)?;
    let why = match session_at(&path) {
        Ok(session) => {
            let captures = path.parent().unwrap_or(&path);
            let row = row_with_sources(&session, captures, &known_sources(captures));
            return Ok(Found { session, row, is_here: true });
        }
        Err(why) => UsageError(why.to_string()),
    };
    let captures = path.parent().unwrap_or(&path);
    let known = known_sources(captures);
    let there: BTreeMap<&str, &Session> =
        known.iter().flat_map(|known| &known.sessions).map(|session| (session.name.as_str(), session)).collect();
    let name = full_name(&arguments.session, there.keys().copied())?;
    let session = *name.and_then(|name| there.get(name)).ok_or(why)?;
    Ok(Found { session: session.clone(), row: row_of_source_session(session, captures, &known), is_here: false })
}

fn headings(grid: &PoseGrid) -> Vec<Heading> {
    let width_deg = 360.0 / grid.sectors as f64;
    let heading = |sector: usize| Heading {
        from_deg: sector as f64 * width_deg,
        to_deg: (sector + 1) as f64 * width_deg,
        filled: grid.filled_in_sector(sector),
        places: grid.columns * grid.rows,
        map: grid.text_of_sector(sector),
    };
    (0..grid.sectors).map(heading).collect()
}

fn listed(session: &Session, is_here: bool) -> Vec<Listed> {
    let state = |line: &ManifestLine| match (session.has(line), session.has_evicted(line)) {
        (true, _) => SegmentState::Here,
        (false, true) => SegmentState::Evicted,
        (false, false) if is_here => SegmentState::Missing,
        (false, false) => SegmentState::Source,
    };
    session.lines.iter().map(|line| Listed { line: line.clone(), state: state(line) }).collect()
}

/// Counts coverage from the segments that are here, by valid tags whose image is there.
fn coverage_of(session: &Session, info: &SessionInfo) -> Option<PoseGrid> {
    let field = Field::new(info.field.clone()).ok()?;
    let thinning = &info.settings.recording.thinning;
    let mut grid = PoseGrid::new(field.carpet_half_extent(), thinning.cell_m, usize::from(thinning.headings));
    let files = session.segments.keys().map(|name| session.folder.join(name)).collect();
    let image = info.settings.topics.image.as_str();
    let (mut images, mut tags) = (BTreeSet::new(), Vec::new());
    for message in LogSource::with_outputs(files, Selection::topics([image, topics::FRAME_TAG])).map_while(Result::ok) {
        if message.channel.topic == image {
            images.extend(decode::stamp_ns(&message));
        } else {
            tags.extend(FrameTag::decode(&message.data));
        }
    }
    for tag in tags.iter().filter(|tag| tag.valid && images.contains(&tag.header.stamp.to_nanoseconds())) {
        grid.add(&Isometry::from(tag.pose.pose));
    }
    Some(grid)
}

fn for_people(shown: &Shown) -> String {
    let Shown { row, manifest, coverage } = shown;
    let mut text = line(row, 0);
    let robot = row.robot_id.as_deref().map_or_else(String::new, |id| format!(" ({id})"));
    text.push_str(&format!(
        "  id {}, robot {}{robot}\n",
        row.id.as_str(),
        output::without_control_characters(&row.robot)
    ));
    for (receiver, segments) in &row.receivers {
        text.push_str(&format!("  {segments} segments are with {receiver}\n"));
    }
    for (what, causes) in [("dropped", &row.frames.dropped), ("untagged", &row.frames.untagged)] {
        for (cause, count) in causes {
            text.push_str(&format!("  {count} frames {what}: {cause}\n"));
        }
    }
    for (cause, count) in &row.frames.lost {
        text.push_str(&format!("  {count} other messages lost: {cause}\n"));
    }
    for why in &row.set_aside {
        text.push_str(&format!("  set aside: {why}\n"));
    }
    for Listed { line, state } in manifest {
        let state = match state {
            SegmentState::Here => "",
            SegmentState::Evicted => "  removed after a sync",
            SegmentState::Missing => "  missing, or not as it was written",
            SegmentState::Source => "  not here",
        };
        let place = line.poses.map_or_else(String::new, |p| {
            format!("  x {:.1} to {:.1} m, y {:.1} to {:.1} m", p.x[0], p.x[1], p.y[0], p.y[1])
        });
        let cut =
            line.cut_bytes.map_or_else(String::new, |bytes| format!("  {} lost in a repair", output::size(bytes)));
        text.push_str(&format!(
            "  {}  {:>10}  {:>6} frames, {:>6} valid{place}{cut}{state}\n",
            line.name,
            output::size(line.bytes),
            line.frames.written,
            line.frames.valid
        ));
    }
    if let Some(Shape { grid, map, headings }) = coverage {
        text.push_str(&format!(
            "  images of {} of {} poses (cells of {} m, {} headings: a digit says of how many, # of all, . of none)\n",
            grid.filled, grid.cells, grid.cell_m, grid.sectors
        ));
        map.iter().for_each(|row| text.push_str(&format!("  {row}\n")));
        for Heading { from_deg, to_deg, filled, places, .. } in headings {
            text.push_str(&format!("  looking {from_deg:.0} to {to_deg:.0} deg: {filled} of {places} places\n"));
        }
    }
    text.trim_end().to_owned()
}
