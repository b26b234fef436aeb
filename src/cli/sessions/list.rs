//! Command `realitysim sessions list`: lists all sessions.

use std::collections::BTreeMap;
use std::path::Path;

use clap::Args;
use jiff::Timestamp;
use serde::Serialize;

use super::CapturesArguments;
use crate::cli::sessions_where::WhereArguments;
use crate::cli::{Outcome, output};
use crate::recording::sessions::sessions_in;
use crate::recording::sync::{KnownSource, known_sources};
use crate::recording::{Counts, ManifestLine, Session, SessionId, receiver_of, receivers_of, saturating_sum};

/// All sessions: start, duration, frames, validity, size, drops, and who has them
#[derive(Args)]
#[command(after_long_help = "Example:\n  realitysim sessions list --captures captures/")]
pub struct ListArguments {
    #[command(flatten)]
    captures: CapturesArguments,
    #[command(flatten)]
    condition: WhereArguments,
}

const SESSION: &str = "session";

/// Summary of a session, a line of the list.
#[derive(Serialize)]
pub(super) struct Row {
    pub session: String,
    pub id: SessionId,
    pub robot: String,
    pub robot_id: Option<String>,
    pub started: String,
    pub duration_s: f64,
    /// Sums over the finished segments.
    pub frames: Counts,
    pub valid_share: Option<f64>,
    /// Finished segments that are here, and their size in bytes.
    pub segments: u64,
    pub bytes: u64,
    /// Segments that were removed here to make room, because another store had them.
    pub evicted: u64,
    /// Bytes that a repair cut off, since they could not be read.
    pub cut_bytes: u64,
    /// Segments in the manifest that are missing or changed here for no known reason.
    pub missing: u64,
    /// In a folder that is synced into: segments that were not compared with their hashes since they came or were found
    /// damaged.
    pub unverified: u64,
    pub open: bool,
    pub pinned: bool,
    /// Segments here that at least one other store has.
    pub synced: u64,
    /// Number of segments that each receiver has, this folder among them.
    pub receivers: BTreeMap<String, u64>,
    /// In a folder that is synced into: finished segments at the source when it was last seen.
    pub at_source: Option<u64>,
    /// State of the session at its source, if it has one.
    pub source: Option<AtSource>,
    pub set_aside: Vec<String>,
}

/// State of a session at its source when it was last seen.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub(super) struct AtSource {
    /// No more segments will come.
    ended: bool,
    segments: u64,
    /// UTC, by this machine's clock; null if unknown.
    seen: Option<String>,
    name: String,
}

fn row(session: &Session, own: Option<&str>) -> Row {
    let mut frames = Counts::default();
    session.lines.iter().for_each(|line| frames.add(&line.frames));
    let times = ManifestLine::times_of(&session.lines);
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
        duration_s: times.map_or(0.0, |(first, last)| last.saturating_sub(first) as f64 / 1e9),
        valid_share: frames.valid_share(),
        frames,
        segments: session.segments.len() as u64,
        bytes: saturating_sum(session.segments.values().copied()),
        evicted: session.lines.iter().filter(|line| session.has_evicted(line)).count() as u64,
        cut_bytes: saturating_sum(session.lines.iter().filter_map(|line| line.cut_bytes)),
        missing: session.missing().count() as u64,
        unverified: 0,
        open: session.open,
        pinned: session.pinned,
        synced: synced.count() as u64,
        receivers,
        at_source: None,
        source: None,
        set_aside: session.set_aside.iter().map(ToString::to_string).collect(),
    }
}

pub fn run(arguments: &ListArguments, json: bool) -> anyhow::Result<Outcome> {
    let folder = arguments.captures.folder()?;
    let (mut rows, strange) = rows(&folder)?;
    arguments.condition.chosen(&folder)?.keep(&mut rows, |row| Some(row.id.clone()));
    for why in &strange {
        output::say(&format!("set aside: {why}"));
    }
    if json {
        output::json(&rows)?;
        return Ok(Outcome::Whole);
    }
    let width = rows.iter().map(|row| row.session.chars().count()).max().unwrap_or(0).max(SESSION.len());
    let mut text = format!(
        "{SESSION:<width$} {:<20} {:>9} {:>8} {:>6} {:>10} {:>7}  {}\n",
        "start", "length", "frames", "valid", "size", "dropped", "state"
    );
    for row in &rows {
        text.push_str(&line(row, width));
    }
    for row in &rows {
        row.set_aside.iter().for_each(|why| output::say(&format!("set aside: {why}")));
    }
    output::lines(text.trim_end())?;
    Ok(Outcome::Whole)
}

/// Rows of all sessions here and of those known to be at sources only, and the folders that were set aside.
fn rows(folder: &Path) -> anyhow::Result<(Vec<Row>, Vec<String>)> {
    let (sessions, strange) = sessions_in(folder).map_err(|error| crate::cli::paths::cannot_read(folder, error))?;
    let known = known_sources(folder);
    let mut rows: Vec<Row> = sessions.iter().map(|session| row_with_sources(session, folder, &known)).collect();
    for there in known.iter().flat_map(|known| &known.sessions) {
        if !rows.iter().any(|row| row.id == there.id) {
            rows.push(row_of_source_session(there, folder, &known));
        }
    }
    rows.sort_by(|a, b| (&a.started, &a.session).cmp(&(&b.started, &b.session)));
    Ok((rows, strange.iter().map(ToString::to_string).collect()))
}

/// Row of a session that is at a source only.
pub(super) fn row_of_source_session(there: &Session, captures: &Path, known: &[KnownSource]) -> Row {
    let nothing_here = Session { segments: BTreeMap::new(), lines: Vec::new(), ..there.clone() };
    let Row { frames, valid_share, duration_s, cut_bytes, .. } = row(there, None);
    Row { frames, valid_share, duration_s, cut_bytes, ..row_with_sources(&nothing_here, captures, known) }
}

/// Row of a session in this folder, completed by what is known of its sources.
pub(super) fn row_with_sources(session: &Session, captures: &Path, known: &[KnownSource]) -> Row {
    let own = receiver_of(captures);
    let mut row = row(session, own.as_deref());
    for known in known {
        let Some(there) = known.sessions.iter().find(|there| there.id == session.id) else { continue };
        let source = AtSource {
            ended: known.ended.contains(&there.id),
            segments: there.lines.len() as u64,
            seen: known.seen.map(|seen| seen.to_string()),
            name: known.source.clone(),
        };
        for (receiver, acks) in &there.acknowledged {
            if Some(receiver.as_str()) != own.as_deref() {
                row.receivers.entry(receiver.clone()).or_insert(acks.len() as u64);
            }
        }
        // Of several sources, the one that knows most of the session counts.
        row.source = row.source.into_iter().chain([source]).max();
    }
    let verified = own.map_or(0, |own| row.receivers.get(&own).copied().unwrap_or(0));
    row.unverified = if row.source.is_some() { row.segments.saturating_sub(verified) } else { 0 };
    row.at_source = row.source.as_ref().map(|source| source.segments);
    row
}

/// Formats a row in columns, the first of this width.
pub(super) fn line(row: &Row, width: usize) -> String {
    let valid = row.valid_share.map_or_else(|| "-".to_owned(), |share| format!("{:.0} %", 100.0 * share));
    let dropped = row.frames.all_dropped();
    format!(
        "{:<width$} {:<20} {:>7.0} s {:>8} {valid:>6} {:>10} {dropped:>7}  {}\n",
        row.session,
        start(&row.started),
        row.duration_s,
        row.frames.captured,
        output::size(row.bytes),
        state(row, Timestamp::now())
    )
}

/// Start time to the second; a text that is no time is shown as it is.
fn start(started: &str) -> String {
    match started.parse::<Timestamp>() {
        Ok(time) => time.strftime("%Y-%m-%dT%H:%M:%SZ").to_string(),
        Err(_) => output::without_control_characters(started).to_string(),
    }
}

/// State of a session in words, where it is stored first.
fn state(row: &Row, now: Timestamp) -> String {
    let mut words = Vec::new();
    match &row.source {
        Some(AtSource { segments: of, .. }) if row.segments < *of => {
            words.push(format!("{} of {of} segments here", row.segments));
        }
        Some(_) if row.unverified > 0 => words.push(format!("{} segments here", row.segments)),
        Some(AtSource { ended: true, .. }) => words.push("whole here".to_owned()),
        Some(_) => words.push(format!("{} segments here", row.segments)),
        None if row.segments + row.evicted > 0 && row.synced == row.segments => words.push("synced".to_owned()),
        None if row.synced > 0 => words.push(format!("{} of {} segments synced", row.synced, row.segments)),
        None => words.push("not synced".to_owned()),
    }
    if let Some(AtSource { ended: false, seen, name, .. }) = &row.source {
        let age = seen.as_ref().and_then(|seen| Some(now.duration_since(seen.parse().ok()?).as_secs()));
        let age = age.map_or_else(|| "once".to_owned(), ago);
        words.push(format!("not ended at {name}, seen {age}"));
    }
    if row.unverified > 0 {
        words.push(format!("{} not verified: sync again", row.unverified));
    }
    if row.open {
        words.push("open".to_owned());
    }
    if row.evicted > 0 {
        words.push(format!("{} removed after a sync", row.evicted));
    }
    if row.cut_bytes > 0 {
        words.push(format!("{} lost in a repair", output::size(row.cut_bytes)));
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

/// Age in words. It can be negative, since the clock may have been set since.
fn ago(seconds: i64) -> String {
    match seconds {
        ..0 => "by a clock that was ahead".to_owned(),
        0..120 => format!("{seconds} s ago"),
        120..7_200 => format!("{} min ago", seconds / 60),
        7_200..172_800 => format!("{} h ago", seconds / 3600),
        _ => format!("{} days ago", seconds / 86_400),
    }
}
