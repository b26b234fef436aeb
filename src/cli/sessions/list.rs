//! `realitysim sessions list`

use std::collections::BTreeMap;
use std::path::Path;

use clap::Args;
use serde::Serialize;

use super::CapturesArguments;
use crate::cli::{Outcome, output};
use crate::recording::catalogue::sessions_in;
use crate::recording::{Counts, Session, SessionId, receiver_of, receivers_of};
use crate::sync::known_sources;

/// All sessions: start, duration, frames, validity, size, drops, and who has them
#[derive(Args)]
pub struct ListArguments {
    #[command(flatten)]
    captures: CapturesArguments,
}

/// A session in a line.
#[derive(Serialize)]
pub(super) struct Row {
    pub session: String,
    pub id: SessionId,
    pub robot: String,
    pub robot_id: Option<String>,
    pub started: String,
    pub duration_s: f64,
    /// Of the finished segments; null if nothing says.
    pub frames: Counts,
    pub valid_share: Option<f64>,
    /// Finished ones that are here, and their size.
    pub segments: u64,
    pub bytes: u64,
    /// Removed here to make room, because another store had them.
    pub evicted: u64,
    /// Listed, and not here as they were written, for no known reason.
    pub missing: u64,
    pub open: bool,
    pub pinned: bool,
    /// Of the segments that are here: by how many other stores at least one has them.
    pub synced: u64,
    /// How many segments each receiver has, this folder among them.
    pub receivers: BTreeMap<String, u64>,
    /// Of a folder that is synced into: finished segments at the source when it was last looked at.
    pub at_source: Option<u64>,
    pub set_aside: Vec<String>,
}

pub(super) fn row(session: &Session, own: Option<&str>) -> Row {
    let mut frames = Counts::default();
    session.lines.iter().for_each(|line| frames.add(&line.frames));
    let first = session.lines.iter().map(|line| line.first_ns).min();
    let last = session.lines.iter().map(|line| line.last_ns).max();
    let here: Vec<_> = session.lines.iter().filter(|line| session.segments.contains_key(&line.name)).collect();
    let mut receivers = BTreeMap::new();
    for line in &session.lines {
        for receiver in receivers_of(line, &session.acknowledged) {
            *receivers.entry(receiver.to_owned()).or_default() += 1;
        }
    }
    let synced = here.iter().filter(|line| receivers_of(line, &session.acknowledged).any(|who| Some(who) != own));
    Row {
        session: session.name.clone(),
        id: session.id.clone(),
        robot: session.head.robot.clone(),
        robot_id: session.head.robot_id().map(str::to_owned),
        started: session.head.started.clone(),
        duration_s: first.zip(last).map_or(0.0, |(first, last)| last.saturating_sub(first) as f64 / 1e9),
        valid_share: frames.valid_share(),
        frames,
        segments: session.segments.len() as u64,
        bytes: session.segments.values().sum(),
        evicted: session.lines.iter().filter(|line| session.has_evicted(line)).count() as u64,
        missing: session.missing().count() as u64,
        open: session.open,
        pinned: session.pinned,
        synced: synced.count() as u64,
        receivers,
        at_source: None,
        set_aside: session.set_aside.iter().map(ToString::to_string).collect(),
    }
}

pub fn run(arguments: &ListArguments, json: bool) -> anyhow::Result<Outcome> {
    let folder = arguments.captures.folder()?;
    let (rows, strange) = rows(&folder)?;
    for why in &strange {
        eprintln!("realitysim: set aside: {why}");
    }
    if json {
        output::json(&rows)?;
        return Ok(Outcome::Whole);
    }
    let mut text = format!(
        "{:<34} {:<20} {:>8} {:>8} {:>6} {:>10} {:>7}  {}\n",
        "session", "start", "length", "frames", "valid", "size", "dropped", "state"
    );
    for row in &rows {
        text.push_str(&line(row));
    }
    for row in &rows {
        row.set_aside.iter().for_each(|why| eprintln!("realitysim: set aside: {why}"));
    }
    output::lines(text.trim_end())?;
    Ok(Outcome::Whole)
}

/// With what is known of sources, and not here.
fn rows(folder: &Path) -> anyhow::Result<(Vec<Row>, Vec<String>)> {
    let (sessions, strange) = sessions_in(folder).map_err(|error| crate::cli::paths::cannot_read(folder, error))?;
    let own = receiver_of(folder);
    let mut rows: Vec<Row> = sessions.iter().map(|session| row(session, own.as_deref())).collect();
    for known in known_sources(folder) {
        for there in &known.sessions {
            let finished = there.lines.len() as u64;
            match rows.iter_mut().find(|row| row.id == there.id) {
                Some(row) => {
                    row.at_source = Some(row.at_source.unwrap_or(0).max(finished));
                    for (receiver, acks) in &there.acknowledged {
                        if Some(receiver.as_str()) != own.as_deref() {
                            row.receivers.entry(receiver.clone()).or_insert(acks.len() as u64);
                        }
                    }
                }
                None => {
                    let row = Row {
                        segments: 0,
                        bytes: 0,
                        evicted: 0,
                        missing: 0,
                        at_source: Some(finished),
                        ..row(there, own.as_deref())
                    };
                    rows.push(row);
                }
            }
        }
    }
    rows.sort_by(|a, b| (&a.started, &a.session).cmp(&(&b.started, &b.session)));
    Ok((rows, strange.iter().map(ToString::to_string).collect()))
}

pub(super) fn line(row: &Row) -> String {
    let valid = row.valid_share.map_or_else(|| "-".to_owned(), |share| format!("{:.0} %", 100.0 * share));
    let dropped: u64 = row.frames.dropped.values().sum();
    format!(
        "{:<34} {:<20} {:>6.0} s {:>8} {valid:>6} {:>10} {dropped:>7}  {}\n",
        row.session,
        row.started.get(..20).unwrap_or(&row.started),
        row.duration_s,
        row.frames.captured,
        output::size(row.bytes),
        state(row)
    )
}

/// What is to be said of it, shortest first.
fn state(row: &Row) -> String {
    let mut words = Vec::new();
    match row.at_source {
        Some(of) if row.segments < of => words.push(format!("{} of {of} segments here", row.segments)),
        Some(_) => words.push("whole here".to_owned()),
        None if row.segments + row.evicted > 0 && row.synced == row.segments => words.push("synced".to_owned()),
        None if row.synced > 0 => words.push(format!("{} of {} segments synced", row.synced, row.segments)),
        None => words.push("not synced".to_owned()),
    }
    if row.open {
        words.push("open".to_owned());
    }
    if row.evicted > 0 {
        words.push(format!("{} removed after a sync", row.evicted));
    }
    if row.missing > 0 {
        words.push(format!("{} missing", row.missing));
    }
    if row.frames.thinned > 0 {
        words.push(format!("{} thinned", row.frames.thinned));
    }
    if row.pinned {
        words.push("pinned".to_owned());
    }
    words.join(", ")
}
