//! The decision which sessions may be deleted to make room. It is pure: no file, no clock.

use serde::Serialize;

use crate::{REFINED_FOLDER, Releasable, Session, releasable, saturating_sum};

/// What may be deleted, and when it is enough.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Goal {
    /// Names of the sessions that may be deleted; empty for all.
    pub sessions: Vec<String>,
    /// Only sessions that began before this time (UTC, in the format of `session.json`).
    pub before: Option<String>,
    /// Bytes to free; `None` to delete everything that may be deleted.
    pub bytes: Option<u64>,
    /// Whether pinned sessions may be deleted as well, after all others.
    pub pinned: bool,
    /// Whether sessions may be deleted that no other store is known to have.
    pub force: bool,
}

/// Why a session may be deleted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Reason {
    /// The caller asked for it.
    Forced,
    /// Another store has acknowledged every segment.
    Acknowledged,
    /// A whole copy was found.
    CopyVerified,
}

impl Reason {
    fn said(self) -> &'static str {
        match self {
            Self::Forced => "forced",
            Self::Acknowledged => "acknowledged",
            Self::CopyVerified => "a copy was verified",
        }
    }
}

/// What was found of a session in another folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Copy {
    /// The whole session.
    Whole,
    /// Something that may be the session itself; with the reason.
    Doubted(String),
    /// Nothing.
    None,
}

/// What is to become of a session.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Decision {
    /// Name of the session.
    pub session: String,
    /// Bytes of its segments.
    pub bytes: u64,
    /// Whether it is deleted.
    pub goes: bool,
    /// The reason, in words.
    pub why: String,
    /// Whether it is deleted because a whole copy was found, on whichever stores that copy may rely.
    #[serde(skip)]
    pub relies_on_copy: bool,
}

/// Decides on each session, in the order of [`releasable`]; a session is deleted as a whole or stays.
///
/// `own` is this folder's own name as a receiver. `copy_of` says whether a session was just found whole in another
/// folder, and if what was found does not count, why.
pub fn decide(
    sessions: &[Session],
    own: Option<&str>,
    copy_of: &dyn Fn(&Session) -> Copy,
    goal: &Goal,
) -> Vec<Decision> {
    let asked = sessions.iter().filter(|session| is_asked(session, goal));
    let mut gone = 0;
    let mut decisions = Vec::new();
    for releasable in releasable(asked, own) {
        let session = releasable.session;
        let bytes = saturating_sum(session.segments.values().copied());
        let verdict = verdict(&releasable, copy_of, goal);
        let (goes, why) = match verdict.clone() {
            Ok(_) if goal.bytes.is_some_and(|enough| gone >= enough) => (false, "enough room without it".to_owned()),
            Ok(reason) => (true, reason.said().to_owned()),
            Err(why) => (false, why),
        };
        gone = saturating_sum([gone, if goes { bytes } else { 0 }]);
        let relies_on_copy = goes && verdict == Ok(Reason::CopyVerified);
        decisions.push(Decision { session: session.name.clone(), bytes, goes, why, relies_on_copy });
    }
    decisions
}

/// Whether the goal allows this session at all.
fn is_asked(session: &Session, goal: &Goal) -> bool {
    (goal.sessions.is_empty() || goal.sessions.contains(&session.name))
        && goal.before.as_ref().is_none_or(|before| session.head.started < *before)
}

/// Says why a session may be deleted, or why not.
fn verdict(
    Releasable { session, segments }: &Releasable,
    copy_of: &dyn Fn(&Session) -> Copy,
    goal: &Goal,
) -> Result<Reason, String> {
    if session.open {
        return Err("is being recorded, or was never finished (`sessions repair`)".to_owned());
    }
    if let Some(foreign) = session.set_aside.first() {
        return Err(format!("holds what is not understood, and nothing foreign is deleted: {foreign}"));
    }
    if session.pinned && !goal.pinned {
        return Err("pinned".to_owned());
    }
    if let Some(unlisted) = session.segments.keys().find(|name| !session.lines.iter().any(|line| line.name == **name)) {
        return Err(format!("{unlisted} is in no manifest (`sessions repair`)"));
    }
    if goal.force {
        return Ok(Reason::Forced);
    }
    if session.is_refined {
        return Err(format!("holds {REFINED_FOLDER}/, of which no sync has made a copy (`refine` makes it again)"));
    }
    let (all, safe) = (session.segments.len(), segments.len());
    if all == safe {
        return Ok(Reason::Acknowledged);
    }
    let nowhere = format!("{} of {all} segments are known to be nowhere else", all - safe);
    match copy_of(session) {
        Copy::Whole => Ok(Reason::CopyVerified),
        Copy::Doubted(why) => Err(format!("{nowhere}; {why}")),
        Copy::None => Err(nowhere),
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::path::PathBuf;

    use super::*;
    use crate::{Acknowledgement, Counts, Head, ManifestLine};

    fn session(day: u32, receivers: &[&str]) -> Session {
        let head = format!(r#"{{"format":1,"robot":"r","started":"2026-11-{day:02}T10:00:00Z"}}"#).into_bytes();
        let parsed = Head::parse(&head).unwrap();
        let line = ManifestLine {
            name: "0000.mcap".into(),
            bytes: 100,
            blake3: "a".repeat(64),
            first_ns: 0,
            last_ns: 1,
            messages: 1,
            frames: Counts::default(),
            poses: None,
            cut_bytes: None,
        };
        let acks = receivers.iter().map(|receiver| ((*receiver).to_owned(), vec![Acknowledgement::of(&line)]));
        Session {
            folder: PathBuf::from(format!("day-{day}")),
            name: format!("day-{day}"),
            id: parsed.id(&head),
            head: parsed,
            head_bytes: head,
            acknowledged: acks.collect(),
            lines: vec![line],
            doubted: 0,
            has_ended: true,
            segments: BTreeMap::from([("0000.mcap".to_owned(), 100)]),
            evicted: BTreeMap::new(),
            open: false,
            pinned: false,
            is_refined: false,
            received: None,
            set_aside: Vec::new(),
        }
    }

    fn gone(sessions: &[Session], own: Option<&str>, goal: &Goal) -> Vec<String> {
        let decisions = decide(sessions, own, &|_| Copy::None, goal);
        decisions.into_iter().filter(|decision| decision.goes).map(|decision| decision.session).collect()
    }

    #[test]
    fn oldest_first_pinned_last_and_no_more_than_asked() {
        let mut all = [session(3, &["a"]), session(1, &["a"]), session(2, &["b"])];
        all[1].pinned = true;
        assert_eq!(gone(&all, None, &Goal::default()), ["day-2", "day-3"]);
        assert_eq!(gone(&all, None, &Goal { pinned: true, ..Goal::default() }), ["day-2", "day-3", "day-1"]);
        assert_eq!(gone(&all, None, &Goal { bytes: Some(50), ..Goal::default() }), ["day-2"]);
        let before = Goal { before: Some("2026-11-03".into()), ..Goal::default() };
        assert_eq!(gone(&all, None, &before), ["day-2"]);
    }

    #[test]
    fn what_nobody_else_has_stays_unless_forced() {
        let all = [session(1, &[]), session(2, &["own"]), session(3, &["own", "other"])];
        assert_eq!(gone(&all, Some("own"), &Goal::default()), ["day-3"]);
        assert_eq!(gone(&all, Some("own"), &Goal { force: true, ..Goal::default() }).len(), 3);
        let of = |session: &Session| if session.name == "day-1" { Copy::Whole } else { Copy::None };
        let copies = decide(&all, Some("own"), &of, &Goal::default());
        assert_eq!(copies.iter().filter(|decision| decision.goes).count(), 2);
        let doubted = decide(&all, Some("own"), &|_| Copy::Doubted("the same".into()), &Goal::default());
        assert_eq!(doubted.iter().filter(|decision| decision.why.ends_with("nowhere else; the same")).count(), 2);
    }

    #[test]
    fn an_open_session_or_one_with_foreign_files_stays_even_when_forced() {
        let mut all = [session(1, &["a"]), session(2, &["a"]), session(3, &["a"])];
        all[0].open = true;
        all[1].note("notes.new", crate::sessions::Kind::File(5));
        all[2].segments.insert("0001.mcap".into(), 7);
        assert_eq!(gone(&all, None, &Goal { force: true, pinned: true, ..Goal::default() }), [""; 0]);
    }

    #[test]
    fn a_session_with_refined_tags_goes_only_when_forced() {
        let mut one = session(1, &["a"]);
        one.note("refined", crate::sessions::Kind::Folder);
        one.note("manifest.new", crate::sessions::Kind::File(5));
        assert_eq!(gone(&[one.clone()], None, &Goal::default()), [""; 0]);
        assert_eq!(gone(&[one], None, &Goal { force: true, ..Goal::default() }), ["day-1"]);
    }

    #[test]
    fn an_acknowledgement_of_other_content_is_none() {
        let mut one = session(1, &["a"]);
        one.lines[0].blake3 = "b".repeat(64);
        assert_eq!(gone(&[one], None, &Goal::default()), [""; 0]);
    }
}
