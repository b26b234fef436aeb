//! The plan of a sync: what is to be fetched, given what lies at the source and what lies here. It is pure: no file,
//! no clock.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use super::selection::Selection;
use crate::{Acknowledgement, MANIFEST_FILE, ManifestLine, Session, SessionId, SetAside, receivers_of};

/// One segment that is to be fetched or verified.
#[derive(Clone, Debug, PartialEq)]
pub struct Item {
    /// Identity of the session.
    pub session: SessionId,
    /// Name of the session's folder at the source.
    pub there: String,
    /// Name of the session's folder here; it is made if it does not exist.
    pub here: String,
    /// Number of copies between the recorder and the source.
    pub hops: u32,
    /// The segment, as the source's manifest describes it.
    pub line: ManifestLine,
    /// What is to be done.
    pub why: TransferReason,
}

/// Why a segment is in the plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TransferReason {
    /// The segment is not here.
    Fetch,
    /// The segment is here, has the right size, and has not been verified.
    Verify,
    /// The segment is here and not as it was recorded: it is moved aside and fetched anew.
    Replace,
}

/// What a sync is to do, and what it cannot do.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Plan {
    /// Segments to fetch or to verify, oldest first.
    pub items: Vec<Item>,
    /// Segments that are here and verified already.
    pub done: Vec<(SessionId, ManifestLine)>,
    /// Acknowledgements to take back, since the segments are not here any more, with the session's folder here.
    pub withdrawn: Vec<(String, Acknowledgement)>,
    /// Segments that the source lists and does not have, and that no store has acknowledged.
    pub lost: Vec<SetAside>,
    /// Segments that the source does not have any more, with the receivers that have them.
    pub elsewhere: Vec<(PathBuf, Vec<String>)>,
    /// What is not understood at the source.
    pub set_aside: Vec<SetAside>,
    /// Finished segments that are not fetched, since their manifest is not believed, or contradicts the one here.
    pub left_there: u64,
    /// Names that several robots share, each with these robots' numbers and a session's folder of each.
    pub shared_names: BTreeMap<String, Vec<String>>,
    /// Folders here, by session.
    pub folders: BTreeMap<SessionId, String>,
}

impl Plan {
    /// Takes back acknowledgements of segments that are not here any more, whatever is selected this time.
    fn withdraw_what_is_gone(&mut self, ours: &Session, receiver: &str) {
        let acks = ours.acknowledged.get(receiver).into_iter().flatten();
        let gone = acks.filter(|ack| ours.segments.get(&ack.file) != Some(&ack.bytes));
        self.withdrawn.extend(gone.map(|ack| (ours.name.clone(), ack.clone())));
    }

    /// Bytes to transfer.
    pub fn bytes(&self) -> u64 {
        self.items.iter().filter(|item| item.why != TransferReason::Verify).map(|item| item.line.bytes).sum()
    }
}

/// Plans a sync from the sessions `there` at the source and `here` in this store.
///
/// `occupied` are all names in this store's folder, `receiver` is its name. `pruned` are sessions that were deleted
/// here; they are fetched again only when the selection names them.
pub fn plan(
    there: &[Session],
    here: &[Session],
    occupied: &[String],
    receiver: &str,
    pruned: &[SessionId],
    selection: &Selection,
) -> Plan {
    let mut plan = Plan::default();
    let best = best_copies(there);
    let mut names: Vec<String> =
        here.iter().map(|session| session.name.clone()).chain(occupied.iter().cloned()).collect();
    for session in there {
        plan.set_aside.extend(session.set_aside.iter().cloned());
        if let Some(best) = best.get(&session.id).filter(|best| best.name != session.name) {
            let why = format!("the same session as {}: a copy, with no more of it than that", best.name);
            plan.set_aside.push(SetAside::new(&session.folder, why));
            continue;
        }
        let ours = here.iter().find(|known| known.id == session.id);
        if let Some(ours) = ours {
            plan.withdraw_what_is_gone(ours, receiver);
        }
        let named = !selection.sessions.is_empty();
        if !selection.takes_session(&session.name) || (ours.is_none() && pruned.contains(&session.id) && !named) {
            continue;
        }
        let folder = ours.map_or_else(|| free_name(session, &names), |ours| ours.name.clone());
        names.push(folder.clone());
        plan.folders.insert(session.id.clone(), folder.clone());
        let unlisted = unlisted(session);
        plan.set_aside.extend(unlisted.first().map(|first| report_unlisted(session, first, unlisted.len())));
        // Segments of damaged lines are not listed either. While a robot is about to end its recording, an unlisted
        // segment is no fault.
        let unlisted = if session.has_ended { unlisted.len() as u64 } else { 0 };
        plan.left_there += session.doubted.max(unlisted);
        for line in session.lines.iter().filter(|line| selection.takes(line)) {
            plan_segment(&mut plan, session, ours, &folder, line, receiver);
        }
    }
    plan.items.sort_by(|a, b| (a.line.times(), &a.there, &a.line.name).cmp(&(b.line.times(), &b.there, &b.line.name)));
    plan.shared_names = shared_names(there.iter().chain(here));
    plan
}

/// Of folders that hold the same session, selects the one with the most whole segments, then the first by name.
fn best_copies(there: &[Session]) -> BTreeMap<&SessionId, &Session> {
    let whole = |session: &Session| session.lines.iter().filter(|line| session.has(line)).count();
    let mut best: BTreeMap<&SessionId, &Session> = BTreeMap::new();
    for session in there {
        let known = best.entry(&session.id).or_insert(session);
        if (whole(known), &session.name) < (whole(session), &known.name) {
            *known = session;
        }
    }
    best
}

/// Segments of a finished session that its manifest does not list: nobody can say whether they are whole.
fn unlisted(session: &Session) -> Vec<&String> {
    let listed: BTreeSet<&String> = session.lines.iter().map(|line| &line.name).collect();
    session.segments.keys().filter(|name| !session.open && !listed.contains(name)).collect()
}

/// Reports segments that the manifest does not list.
fn report_unlisted(session: &Session, first: &str, count: usize) -> SetAside {
    let more = if count > 1 { format!(" and {} more", count - 1) } else { String::new() };
    let why = format!("{first}{more} in no line of its manifest: not fetched (`sessions repair` there lists them)");
    SetAside::new(session.folder.join(MANIFEST_FILE), why)
}

/// Plans what to do with one segment.
fn plan_segment(
    plan: &mut Plan,
    session: &Session,
    ours: Option<&Session>,
    folder: &str,
    line: &ManifestLine,
    receiver: &str,
) {
    let known = ours.and_then(|ours| ours.lines.iter().find(|known| known.name == line.name));
    if known.is_some_and(|known| (&known.blake3, known.bytes) != (&line.blake3, line.bytes)) {
        let why = "its manifest has another hash than the manifest here: neither is believed";
        plan.set_aside.push(SetAside::new(session.folder.join(&line.name), why));
        if let Some(ours) = ours {
            let acks = ours.acknowledged.get(receiver).into_iter().flatten();
            let doubted = acks.filter(|ack| ack.file == line.name);
            plan.withdrawn.extend(doubted.map(|ack| (ours.name.clone(), ack.clone())));
        }
        plan.left_there += 1;
        return;
    }
    let acknowledged = ours
        .and_then(|ours| ours.acknowledged.get(receiver))
        .is_some_and(|acks| acks.iter().any(|ack| ack.is_of(line)));
    let size = ours.and_then(|ours| ours.segments.get(&line.name));
    let why = match size {
        Some(size) if *size == line.bytes && acknowledged && known.is_some() => {
            plan.done.push((session.id.clone(), line.clone()));
            return;
        }
        Some(size) if *size == line.bytes => TransferReason::Verify,
        Some(_) => TransferReason::Replace,
        None => TransferReason::Fetch,
    };
    let path = session.folder.join(&line.name);
    match session.segments.get(&line.name) {
        _ if why == TransferReason::Verify => {}
        Some(size) if *size == line.bytes => {}
        Some(size) => {
            let why = format!("has {size} bytes, and its manifest says {}: cut or changed", line.bytes);
            plan.lost.push(SetAside::new(path, why));
            return;
        }
        None => {
            let holders: Vec<String> = receivers_of(line, &session.acknowledged)
                .filter(|holder| *holder != receiver)
                .map(str::to_owned)
                .collect();
            if holders.is_empty() {
                let why = match session.evicted.get(&line.name) {
                    Some(evicted) => {
                        format!("removed there because {} had it, which it has not any more", evicted.receiver)
                    }
                    None => "listed and not there, and nobody has acknowledged it".to_owned(),
                };
                plan.lost.push(SetAside::new(path, why));
            } else {
                plan.elsewhere.push((path, holders));
            }
            return;
        }
    }
    let (there, here) = (session.name.clone(), folder.to_owned());
    plan.items.push(Item { session: session.id.clone(), there, here, hops: session.hops(), line: line.clone(), why });
}

/// Name of a session's folder here: the session's own, or if another session has it, with digits of its identity
/// behind it.
fn free_name(session: &Session, taken: &[String]) -> String {
    let is_free = |name: &String| !taken.contains(name);
    let longer = |digits: usize| format!("{}-{}", session.name, &session.id.as_str()[..digits]);
    Some(session.name.clone()).filter(is_free).or_else(|| Some(longer(6)).filter(is_free)).unwrap_or_else(|| longer(32))
}

/// Finds names that several robots share.
fn shared_names<'a>(sessions: impl Iterator<Item = &'a Session>) -> BTreeMap<String, Vec<String>> {
    let mut machines: BTreeMap<&str, BTreeMap<&str, &str>> = BTreeMap::new();
    for session in sessions {
        if let Some(id) = session.head.robot_id() {
            machines.entry(&session.head.robot).or_default().entry(id).or_insert(&session.name);
        }
    }
    let several = machines.into_iter().filter(|(_, ids)| ids.len() > 1);
    several
        .map(|(robot, ids)| {
            (robot.to_owned(), ids.iter().map(|(id, folder)| format!("{} ({folder})", &id[..6])).collect())
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::{Counts, Head};

    const OWN: &str = "own";

    /// A segment as it lies at the source and here.
    #[derive(Clone, Debug)]
    struct Case {
        /// Size at the source, bytes; the manifest says 10.
        there: Option<u64>,
        /// Size here, bytes.
        here: Option<u64>,
        acknowledged: bool,
        elsewhere: bool,
    }

    fn case() -> impl Strategy<Value = Case> {
        let bytes = || prop_oneof![Just(None), Just(Some(10)), Just(Some(7))];
        let cases = (bytes(), bytes(), any::<bool>(), any::<bool>());
        cases.prop_map(|(there, here, acknowledged, elsewhere)| Case { there, here, acknowledged, elsewhere })
    }

    fn session(name: &str, number: u8) -> Session {
        let head = format!(r#"{{"format":1,"robot":"r","started":"t","id":"{number:032x}"}}"#).into_bytes();
        let parsed = Head::parse(&head).unwrap();
        Session {
            folder: name.into(),
            name: name.into(),
            id: parsed.id(&head),
            head: parsed,
            head_bytes: head,
            lines: Vec::new(),
            doubted: 0,
            has_ended: true,
            segments: BTreeMap::new(),
            evicted: BTreeMap::new(),
            open: false,
            pinned: false,
            is_refined: false,
            received: None,
            acknowledged: BTreeMap::new(),
            set_aside: Vec::new(),
        }
    }

    fn both(cases: &[Case]) -> [Session; 2] {
        let (mut there, mut here) = (session("there", 1), session("here", 1));
        for (index, case) in cases.iter().enumerate() {
            let line = ManifestLine {
                name: format!("{index:04}.mcap"),
                bytes: 10,
                blake3: "a".repeat(64),
                first_ns: index as i64,
                last_ns: index as i64,
                messages: 1,
                frames: Counts::default(),
                poses: None,
                cut_bytes: None,
            };
            there.segments.extend(case.there.map(|bytes| (line.name.clone(), bytes)));
            here.segments.extend(case.here.map(|bytes| (line.name.clone(), bytes)));
            if case.here.is_some() || case.acknowledged {
                here.lines.push(line.clone());
            }
            if case.acknowledged {
                here.acknowledged.entry(OWN.into()).or_default().push(Acknowledgement::of(&line));
            }
            if case.elsewhere {
                there.acknowledged.entry("other".into()).or_default().push(Acknowledgement::of(&line));
            }
            there.lines.push(line);
        }
        [there, here]
    }

    proptest! {
        #[test]
        fn every_segment_has_one_fate_and_what_is_planned_is_done_once(cases in prop::collection::vec(case(), 0..12)) {
            let [there, mut here] = both(&cases);
            let plan = plan(std::slice::from_ref(&there), std::slice::from_ref(&here), &[], OWN, &[], &Selection::default());
            let fates = plan.items.len() + plan.done.len() + plan.lost.len() + plan.elsewhere.len();
            prop_assert_eq!(fates, cases.len());
            for item in &plan.items {
                prop_assert!(item.why == TransferReason::Verify || there.segments.get(&item.line.name) == Some(&10));
            }
            let gone = cases.iter().filter(|case| case.acknowledged && case.here != Some(10)).count();
            prop_assert_eq!(plan.withdrawn.len(), gone, "what is acknowledged is here or taken back");
            for (_, ack) in &plan.withdrawn {
                here.acknowledged.get_mut(OWN).unwrap().retain(|known| known != ack);
            }
            for item in &plan.items {
                here.segments.insert(item.line.name.clone(), 10);
                if !here.lines.contains(&item.line) {
                    here.lines.push(item.line.clone());
                }
                here.acknowledged.entry(OWN.into()).or_default().push(Acknowledgement::of(&item.line));
            }
            let again = super::plan(&[there], &[here], &[], OWN, &[], &Selection::default());
            prop_assert_eq!((again.items, again.withdrawn), (Vec::new(), Vec::new()));
        }
    }

    #[test]
    fn a_name_that_another_session_has_here_gets_a_piece_of_the_number() {
        let (there, here) = (session("s", 0x2a), session("s", 7));
        let plan = plan(core::slice::from_ref(&there), &[here], &[], OWN, &[], &Selection::default());
        assert_eq!(plan.folders[&there.id], "s-000000");
    }

    #[test]
    fn what_was_pruned_here_comes_only_when_it_is_named() {
        let [there, _] = both(&[Case { there: Some(10), here: None, acknowledged: false, elsewhere: false }]);
        let planned = |selection: &Selection| {
            plan(std::slice::from_ref(&there), &[], &[], OWN, std::slice::from_ref(&there.id), selection).items.len()
        };
        assert_eq!(planned(&Selection::default()), 0);
        assert_eq!(planned(&Selection { sessions: vec!["the".into()], ..Selection::default() }), 1);
    }
}
