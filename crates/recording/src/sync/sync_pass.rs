//! One round: what is there, what is missing here, fetch, verify, put in place, acknowledge.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use serde::Serialize;

use super::error::SyncError;
use super::fetch::Work;
use super::plan::{Plan, plan};
use super::rsync::{Ended, Rsync};
use super::scan::{Seen, look};
use super::selection::Selection;
use super::source::Source;
use super::source_state::SourceState;
use super::store::Store;
use crate::{ACK_FOLDER, NotApart, Session, SessionId, SetAside, prove_apart};

#[derive(Clone, Debug)]
pub struct Options {
    pub source: Source,
    pub selection: Selection,
    /// The command that opens a shell on the robot, as for `rsync -e`.
    pub ssh: String,
    /// Tell the source what is here, so that it may delete it.
    pub acknowledge: bool,
}

/// What people want to know as it happens.
#[derive(Debug)]
pub enum Event<'a> {
    /// Before anything is fetched.
    Planned { sessions: usize, plan: &'a Plan },
    /// Bytes of this round that are here, and how many there will be.
    Progress { done: u64, total: u64 },
    /// The link broke, and it is tried again.
    Again { said: &'a str },
}

#[derive(Debug, Default, Serialize)]
pub struct Report {
    pub source: String,
    /// This store's name in acknowledgements.
    pub receiver: String,
    pub sessions: Vec<SessionReport>,
    /// Segments that came, and their bytes.
    pub fetched: u64,
    pub fetched_bytes: u64,
    /// Segments that were here and are verified now.
    pub verified: u64,
    /// Segments that were here and verified before.
    pub already: u64,
    /// Wanted and still not here.
    pub missing: u64,
    /// Finished and not fetched, since what their manifest says of them is not believed, or their session has no head.
    pub left_there: u64,
    /// Not fetched, since the disk has no room for them.
    pub no_room_bytes: u64,
    /// Whether the source knows of everything that is here.
    pub acknowledged: bool,
    /// Sessions there that this folder is not farther from the recorder with: who may not delete on our word.
    pub withheld: Vec<String>,
    /// Can be had nowhere any more, or not as it was recorded.
    pub lost: Vec<SetAside>,
    /// Gone from the source; who has them.
    pub elsewhere: Vec<(PathBuf, Vec<String>)>,
    /// Not understood and left alone.
    pub set_aside: Vec<SetAside>,
    /// Robots of one name.
    pub namesakes: BTreeMap<String, Vec<String>>,
    pub wall_s: f64,
    /// Why it ended before its end.
    pub failed: Option<String>,
    /// The link's fault: worth another round.
    #[serde(skip)]
    pub is_link: bool,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct SessionReport {
    /// Its folder's name here.
    pub session: String,
    pub id: SessionId,
    /// Here and verified, of so many finished ones at the source.
    pub segments: u64,
    pub of: u64,
}

/// Left free on the disk.
const ROOM_LEFT_BYTES: u64 = 64 << 20;

pub fn round(
    options: &Options,
    store: &Store,
    stop: &AtomicBool,
    tell: &mut dyn FnMut(Event),
) -> Result<Report, SyncError> {
    let began = Instant::now();
    // Before a desk is made: a folder is known by where it really lies.
    if !options.source.is_remote() && !Path::new(&options.source.folder).is_dir() {
        let said = "there is no such folder".to_owned();
        return Err(SyncError::Absent { source_name: options.source.shown(), said });
    }
    let desk = store.desk(&options.source)?;
    let rsync = Rsync { source: &options.source, ssh: &options.ssh, stop };
    let mut report =
        Report { source: options.source.shown(), receiver: store.receiver().to_owned(), ..Report::default() };
    let Seen { sessions: there, stamps } = look(&rsync, &desk, &mut report)?;
    // What a listing that was broken off does not name is not lost.
    if stop.load(Ordering::Relaxed) {
        return Ok(report);
    }
    if let Some(asked) = options.selection.sessions.iter().find(|name| !there.iter().any(|s| s.name.starts_with(*name)))
    {
        let there: Vec<&str> = there.iter().map(|session| session.name.as_str()).collect();
        let there = if there.is_empty() { "none".to_owned() } else { there.join(", ") };
        return Err(SyncError::NoSuchSession { source_name: options.source.shown(), asked: asked.clone(), there });
    }
    desk.note_seen(&options.source, &there)?;
    let (here, strange) = store.sessions()?;
    report.set_aside.extend(strange);
    let pruned: Vec<SessionId> =
        there.iter().map(|s| s.id.clone()).filter(|id| store.pruned().iter().any(|p| p.id == id.as_str())).collect();
    let mut plan = plan(&there, &here, &store.occupied(), store.receiver(), &pruned, &options.selection);
    report.no_room_bytes = leave_out_what_has_no_room(&mut plan, store, &desk);
    tell(Event::Planned { sessions: there.len(), plan: &plan });
    for (folder, ack) in &plan.withdrawn {
        store.withdraw(folder, std::slice::from_ref(ack))?;
    }
    report.left_there += plan.left_there;
    report.already = plan.done.len() as u64;
    report.lost.append(&mut plan.lost);
    report.elsewhere.append(&mut plan.elsewhere);
    report.set_aside.append(&mut plan.set_aside);
    report.namesakes = std::mem::take(&mut plan.namesakes);
    let (damaged, not_had) = (BTreeMap::new(), Vec::new());
    let mut work = Work { store, desk: &desk, rsync: &rsync, there: &there, report, damaged, not_had, stamps: &stamps };
    let fetched = work.fetch(&plan, tell);
    let mut report = work.report;
    fail(&mut report, fetched);
    // Whatever went wrong: what is here is here, and the source may know it.
    let acknowledged = finish(options, store, &desk, &rsync, &there, &plan, &mut report);
    fail(&mut report, acknowledged);
    report.set_aside.sort();
    report.set_aside.dedup();
    report.wall_s = began.elapsed().as_secs_f64();
    Ok(report)
}

fn fail(report: &mut Report, result: Result<(), SyncError>) {
    if let (Err(error), None) = (result, &report.failed) {
        report.is_link = error.is_link();
        report.failed = Some(error.to_string());
    }
}

/// The oldest come first; what does not fit any more is not begun.
fn leave_out_what_has_no_room(plan: &mut Plan, store: &Store, desk: &SourceState) -> u64 {
    let Some(free) = store.free_bytes() else { return 0 };
    let (mut room, mut left_out) = (free.saturating_sub(ROOM_LEFT_BYTES), 0);
    plan.items.retain(|item| {
        let staged = fs::metadata(item.staged(desk)).map_or(0, |metadata| metadata.len());
        let needed = if item.is_fetched() { item.line.bytes.saturating_sub(staged) } else { 0 };
        let fits = needed <= room && left_out == 0;
        if fits {
            room -= needed;
        } else {
            left_out = needed.saturating_add(left_out);
        }
        fits
    });
    left_out
}

/// Sessions that are whole now get what describes them, and the source hears of what is here.
fn finish(
    options: &Options,
    store: &Store,
    desk: &SourceState,
    rsync: &Rsync,
    there: &[Session],
    plan: &Plan,
    report: &mut Report,
) -> Result<(), SyncError> {
    let (here, _) = store.sessions()?;
    for session in there {
        let ours = here.iter().find(|ours| ours.id == session.id);
        let acks = ours.and_then(|ours| ours.acknowledged.get(store.receiver())).map_or(&[][..], Vec::as_slice);
        let is_copy = report.sessions.iter().any(|told| told.id == session.id);
        if let Some(folder) = plan.folders.get(&session.id).filter(|_| !is_copy) {
            let verified = session.lines.iter().filter(|line| acks.iter().any(|ack| ack.is_of(line))).count() as u64;
            let of = session.lines.len() as u64;
            if let Some(ours) = ours.filter(|_| verified == of && !session.open) {
                store.complete(&ours.name, &desk.known.join(&session.name))?;
            }
            let (session, id) = (ours.map_or(folder, |ours| &ours.name).clone(), session.id.clone());
            report.sessions.push(SessionReport { session, id, segments: verified, of });
        }
        let told = session.acknowledged.get(store.receiver()).map_or(&[][..], Vec::as_slice);
        // Each relies only on who is farther from the recorder, so the farthest that ever had it relies on nobody: without
        // this two folders could each delete on the other's word.
        let relies = ours.filter(|ours| ours.hops() > session.hops());
        let may_hear = if relies.is_some() { acks } else { &[] };
        if options.acknowledge && acks != may_hear {
            report.withheld.push(session.name.clone());
        }
        // Who may rely on us is not relied on: it may have given its word when it was farther from the recorder than now.
        if let (Some(ours), Some(theirs)) = (relies, &session.received) {
            store.no_longer_rely_on(ours, &theirs.receiver)?;
        }
        if options.acknowledge && told != may_hear {
            acknowledge(options, store, desk, rsync, session, relies)?;
        }
    }
    report.acknowledged = options.acknowledge && !rsync.stop.load(Ordering::Relaxed);
    Ok(())
}

/// Of a session that is not here any more: that nothing is.
fn acknowledge(
    options: &Options,
    store: &Store,
    desk: &SourceState,
    rsync: &Rsync,
    session: &Session,
    ours: Option<&Session>,
) -> Result<(), SyncError> {
    let refused = |said: String| Err(SyncError::Refused { source_name: options.source.shown(), said });
    if session.set_aside.iter().any(|it| it.path == session.folder.join(ACK_FOLDER)) {
        return refused(format!("{}/{ACK_FOLDER} is no folder: nothing is acknowledged there", session.name));
    }
    if let (false, Some(ours)) = (options.source.is_remote(), ours) {
        let there = Path::new(&options.source.folder).join(&session.name);
        // Where only `ack/` may be written, that folder proves as much.
        let apart = prove_apart(&there, &ours.folder).or_else(|why| match why {
            NotApart::Unproven { .. } => prove_apart(&there.join(ACK_FOLDER), &ours.folder.join(ACK_FOLDER)),
            same @ NotApart::Same(..) => Err(same),
        });
        if let Err(why) = apart {
            return refused(format!("{}: nothing is acknowledged: {why}", session.name));
        }
    }
    let file = match ours {
        Some(ours) => store.acknowledgements(&ours.name),
        None => {
            let nothing = desk.nothing(store.receiver());
            fs::write(&nothing, "").map_err(|source| SyncError::Io { path: nothing.clone(), source })?;
            nothing
        }
    };
    match rsync.acknowledge(&file, &session.name)? {
        Ended::Partly(said) => refused(format!("what is verified here could not be acknowledged there: {said}")),
        Ended::Whole | Ended::Stopped => Ok(()),
    }
}
