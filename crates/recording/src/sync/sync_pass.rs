//! One pass of a sync: scan, plan, fetch, verify, put in place, acknowledge.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use serde::Serialize;

use super::error::SyncError;
use super::fetch::Fetcher;
use super::plan::{Plan, plan};
use super::rsync::{Ended, Rsync};
use super::scan::{SourceScan, scan};
use super::selection::Selection;
use super::source::Source;
use super::source_state::SourceState;
use super::store::Store;
use crate::{ACK_FOLDER, NotDistinct, Session, SessionId, SetAside, prove_distinct};

/// What to sync, and how.
#[derive(Clone, Debug)]
pub struct Options {
    /// Where the recordings are.
    pub source: Source,
    /// Which segments are wanted.
    pub selection: Selection,
    /// Command that opens a shell on the robot, as for `rsync -e`.
    pub ssh: String,
    /// Whether to tell the source what is here, so that it may delete it.
    pub acknowledge: bool,
}

/// What people want to know as it happens.
#[derive(Debug)]
pub enum Event<'a> {
    /// The plan is made, and nothing is fetched yet.
    Planned {
        /// Number of sessions at the source.
        sessions: usize,
        /// The plan.
        plan: &'a Plan,
    },
    /// Some bytes have come.
    Progress {
        /// Bytes of this pass that are here.
        done: u64,
        /// Bytes of this pass.
        total: u64,
    },
    /// The link broke, and is tried again.
    Again {
        /// Text of the error.
        said: &'a str,
    },
}

/// Result of a pass.
#[derive(Debug, Default, Serialize)]
pub struct Report {
    /// The source, as people write it.
    pub source: String,
    /// Name of this store in acknowledgements.
    pub receiver: String,
    /// What is here of each session.
    pub sessions: Vec<SessionReport>,
    /// Segments that were transferred.
    pub fetched: u64,
    /// Bytes of these segments.
    pub fetched_bytes: u64,
    /// Segments that were here already and are verified now.
    pub verified: u64,
    /// Segments that were here and verified before.
    pub already: u64,
    /// Segments that are wanted and still not here.
    pub missing: u64,
    /// Finished segments that are not fetched, since their manifest is not believed, or their session has no
    /// `session.json`.
    pub left_there: u64,
    /// Bytes of segments that are not fetched, since the disk has no room for them.
    pub no_room_bytes: u64,
    /// Whether the source knows of everything that is here.
    pub acknowledged: bool,
    /// Sessions that are not acknowledged, since this folder is not farther from the recorder than the source, which
    /// must not delete because of it.
    pub withheld: Vec<String>,
    /// Segments that no store has any more, or not as they were recorded.
    pub lost: Vec<SetAside>,
    /// Segments that the source does not have any more, with the receivers that have them.
    pub elsewhere: Vec<(PathBuf, Vec<String>)>,
    /// What is not understood and left alone.
    pub set_aside: Vec<SetAside>,
    /// Names that several robots share, with a description of each robot.
    #[serde(rename = "namesakes")]
    pub shared_names: BTreeMap<String, Vec<String>>,
    /// Duration of the pass, s.
    pub wall_s: f64,
    /// Why the pass ended early; `None` if it did not.
    pub failed: Option<String>,
    /// Whether the link is at fault, so that another pass may succeed.
    #[serde(skip)]
    pub is_link: bool,
}

/// What is here of one session.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct SessionReport {
    /// Name of its folder here.
    pub session: String,
    /// Identity of the session.
    pub id: SessionId,
    /// Segments that are here and verified.
    pub segments: u64,
    /// Finished segments at the source.
    pub of: u64,
}

/// Bytes that are left free on the disk.
const ROOM_LEFT_BYTES: u64 = 64 << 20;

/// Runs one pass of a sync.
///
/// `tell` is called with each [`Event`]; the pass ends early when `stop` is set. What fails after the plan is made
/// stands in [`Report::failed`]; earlier failures are errors.
pub fn round(
    options: &Options,
    store: &Store,
    stop: &AtomicBool,
    tell: &mut dyn FnMut(Event),
) -> Result<Report, SyncError> {
    let began = Instant::now();
    // This is checked first, since the source's state is kept under the real path of its folder.
    if !options.source.is_remote() && !Path::new(&options.source.folder).is_dir() {
        let said = "there is no such folder".to_owned();
        return Err(SyncError::Absent { source_name: options.source.shown(), said });
    }
    let source_state = store.open_source_state(&options.source)?;
    let rsync = Rsync { source: &options.source, ssh: &options.ssh, stop };
    let mut report =
        Report { source: options.source.shown(), receiver: store.receiver().to_owned(), ..Report::default() };
    let SourceScan { sessions: there, stamps } = scan(&rsync, &source_state, &mut report)?;
    // A listing that was interrupted is incomplete: what it does not name is not lost.
    if stop.load(Ordering::Relaxed) {
        return Ok(report);
    }
    if let Some(asked) = options.selection.sessions.iter().find(|name| !there.iter().any(|s| s.name.starts_with(*name)))
    {
        let there: Vec<&str> = there.iter().map(|session| session.name.as_str()).collect();
        let there = if there.is_empty() { "none".to_owned() } else { there.join(", ") };
        return Err(SyncError::NoSuchSession { source_name: options.source.shown(), asked: asked.clone(), there });
    }
    source_state.note_seen(&options.source, &there)?;
    let (here, strange) = store.sessions()?;
    report.set_aside.extend(strange);
    let pruned: Vec<SessionId> =
        there.iter().map(|s| s.id.clone()).filter(|id| store.pruned().iter().any(|p| p.id == id.as_str())).collect();
    let mut plan = plan(&there, &here, &store.occupied(), store.receiver(), &pruned, &options.selection);
    report.no_room_bytes = skip_without_room(&mut plan, store, &source_state);
    tell(Event::Planned { sessions: there.len(), plan: &plan });
    for (folder, ack) in &plan.withdrawn {
        store.withdraw(folder, std::slice::from_ref(ack))?;
    }
    report.left_there += plan.left_there;
    report.already = plan.done.len() as u64;
    report.lost.append(&mut plan.lost);
    report.elsewhere.append(&mut plan.elsewhere);
    report.set_aside.append(&mut plan.set_aside);
    report.shared_names = std::mem::take(&mut plan.shared_names);
    let (damaged, not_had) = (BTreeMap::new(), Vec::new());
    let mut work = Fetcher {
        store,
        source_state: &source_state,
        rsync: &rsync,
        there: &there,
        report,
        damaged,
        not_had,
        stamps: &stamps,
    };
    let fetched = work.fetch(&plan, tell);
    let mut report = work.report;
    fail(&mut report, fetched);
    // Whatever went wrong, the source may know of the segments that are here.
    let acknowledged = finish(options, store, &source_state, &rsync, &there, &plan, &mut report);
    fail(&mut report, acknowledged);
    report.set_aside.sort();
    report.set_aside.dedup();
    report.wall_s = began.elapsed().as_secs_f64();
    Ok(report)
}

/// Notes the first failure.
fn fail(report: &mut Report, result: Result<(), SyncError>) {
    if let (Err(error), None) = (result, &report.failed) {
        report.is_link = error.is_link();
        report.failed = Some(error.to_string());
    }
}

/// Leaves out segments for which the disk has no room, and returns their bytes. The oldest segments come first; after
/// the first that does not fit, none is begun.
fn skip_without_room(plan: &mut Plan, store: &Store, source_state: &SourceState) -> u64 {
    let Some(free) = store.free_bytes() else { return 0 };
    let (mut room, mut left_out) = (free.saturating_sub(ROOM_LEFT_BYTES), 0);
    plan.items.retain(|item| {
        let staged = fs::metadata(item.staged(source_state)).map_or(0, |metadata| metadata.len());
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

/// Completes sessions whose segments are all here, and acknowledges to the source what is here.
fn finish(
    options: &Options,
    store: &Store,
    source_state: &SourceState,
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
                store.complete(&ours.name, &source_state.known.join(&session.name))?;
            }
            let (session, id) = (ours.map_or(folder, |ours| &ours.name).clone(), session.id.clone());
            report.sessions.push(SessionReport { session, id, segments: verified, of });
        }
        let told = session.acknowledged.get(store.receiver()).map_or(&[][..], Vec::as_slice);
        // Each store relies only on stores that are farther from the recorder, so that the farthest one relies on
        // nobody. Otherwise two folders could each delete because of the other's acknowledgement.
        let relies = ours.filter(|ours| ours.hops() > session.hops());
        let may_hear = if relies.is_some() { acks } else { &[] };
        if options.acknowledge && acks != may_hear {
            report.withheld.push(session.name.clone());
        }
        // A store that may rely on this one is not relied on: it may have acknowledged when it was farther from the
        // recorder than it is now.
        if let (Some(ours), Some(theirs)) = (relies, &session.received) {
            store.no_longer_rely_on(ours, &theirs.receiver)?;
        }
        if options.acknowledge && told != may_hear {
            acknowledge(options, store, source_state, rsync, session, relies)?;
        }
    }
    report.acknowledged = options.acknowledge && !rsync.stop.load(Ordering::Relaxed);
    Ok(())
}

/// Replaces this store's acknowledgements of a session at the source. If the session is not here any more, they
/// become empty.
fn acknowledge(
    options: &Options,
    store: &Store,
    source_state: &SourceState,
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
        // Where only `ack/` may be written, a probe in that folder proves as much.
        let apart = prove_distinct(&there, &ours.folder).or_else(|why| match why {
            NotDistinct::Unproven { .. } => prove_distinct(&there.join(ACK_FOLDER), &ours.folder.join(ACK_FOLDER)),
            same @ NotDistinct::Same(..) => Err(same),
        });
        if let Err(why) = apart {
            return refused(format!("{}: nothing is acknowledged: {why}", session.name));
        }
    }
    let file = match ours {
        Some(ours) => store.acknowledgements(&ours.name),
        None => {
            let nothing = source_state.empty_acknowledgements(store.receiver());
            fs::write(&nothing, "").map_err(|source| SyncError::Io { path: nothing.clone(), source })?;
            nothing
        }
    };
    match rsync.acknowledge(&file, &session.name)? {
        Ended::Partly(said) => refused(format!("what is verified here could not be acknowledged there: {said}")),
        Ended::Whole | Ended::Stopped => Ok(()),
    }
}
