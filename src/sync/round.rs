//! One round: what is there, what is missing here, fetch, verify, put in place, acknowledge.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use serde::Serialize;

use super::error::SyncError;
use super::listing::Entry;
use super::plan::{Item, Plan, plan};
use super::rsync::{Ended, Rsync};
use super::selection::Selection;
use super::source::Source;
use super::store::{Desk, Placed, Store};
use crate::recording::catalogue::{Kind, is_plain_name, sessions_in};
use crate::recording::{ACK_FOLDER, Session, SessionId, SetAside};

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

/// Tries in a row that bring nothing before the link is given up.
const MAX_FRUITLESS: u32 = 3;
const BETWEEN_TRIES: Duration = Duration::from_secs(1);
/// Times that a file may come with another hash than its manifest's: after that it is the source's.
const MAX_DAMAGED: u32 = 2;
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
    let there = look(&rsync, &desk, &mut report)?;
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
    report.already = plan.done.len() as u64;
    report.lost.append(&mut plan.lost);
    report.elsewhere.append(&mut plan.elsewhere);
    report.set_aside.append(&mut plan.set_aside);
    report.namesakes = std::mem::take(&mut plan.namesakes);
    let mut work = Work { store, desk: &desk, rsync: &rsync, there: &there, report, damaged: BTreeMap::new() };
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

/// Sessions at the source: what they say of themselves, and what lies in their folders.
fn look(rsync: &Rsync, desk: &Desk, report: &mut Report) -> Result<Vec<Session>, SyncError> {
    // In this order: a recorder gives a segment its name before its line, so that what the manifest lists is there when the
    // folder is looked at.
    // What became a link there would stay here as it was.
    desk.forget_acknowledgements()?;
    if let Ended::Partly(said) = rsync.heads(&desk.known)? {
        report.set_aside.push(SetAside::new(rsync.source.shown(), said));
    }
    let (entries, ended) = rsync.list()?;
    let shown = PathBuf::from(rsync.source.shown());
    let as_there =
        |path: &Path| path.strip_prefix(&desk.known).map_or_else(|_| path.to_owned(), |rest| shown.join(rest));
    let (mut sessions, strange) =
        sessions_in(&desk.known).map_err(|source| SyncError::Io { path: desk.known.clone(), source })?;
    report.set_aside.extend(strange.into_iter().map(|it| SetAside::new(as_there(&it.path), it.why)));
    for session in &mut sessions {
        session.folder = as_there(&session.folder);
        for it in &mut session.set_aside {
            it.path = as_there(&it.path);
        }
    }
    if let Ended::Partly(said) = ended {
        let unread = leave_out_unread(&mut sessions, &entries, &said);
        if let [first, ..] = unread.as_slice() {
            report.failed = Some(first.to_string());
        }
        report.set_aside.extend(unread);
    }
    for entry in entries {
        let (folder, name) = entry.path.split_once('/').map_or((entry.path.as_str(), None), |(a, b)| (a, Some(b)));
        let session = sessions.iter_mut().find(|session| session.name == folder);
        match (session, name, entry.kind) {
            // A link there is no folder to acknowledge into.
            (Some(session), Some(name), kind) => session.note(name, kind),
            (_, None, Kind::Link | Kind::Other) => {
                report.set_aside.push(SetAside::new(shown.join(folder), "a link or a device: not followed"));
            }
            (None, None, Kind::Folder) if !is_plain_name(folder) || !desk.known.join(folder).exists() => {
                report.set_aside.push(SetAside::new(shown.join(folder), "no session: left alone"));
            }
            _ => {}
        }
    }
    Ok(sessions)
}

/// What could not be looked into is not empty: nothing is said of it, and nothing taken back.
fn leave_out_unread(sessions: &mut Vec<Session>, entries: &[Entry], said: &str) -> Vec<SetAside> {
    let is_read = |session: &Session| {
        entries.iter().any(|entry| entry.path.split_once('/').is_some_and(|(folder, _)| folder == session.name))
    };
    let (read, unread): (Vec<_>, Vec<_>) = std::mem::take(sessions).into_iter().partition(is_read);
    *sessions = read;
    unread.into_iter().map(|session| SetAside::new(session.folder, format!("cannot be looked into: {said}"))).collect()
}

/// The oldest come first; what does not fit any more is not begun.
fn leave_out_what_has_no_room(plan: &mut Plan, store: &Store, desk: &Desk) -> u64 {
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

struct Work<'a> {
    store: &'a Store,
    desk: &'a Desk,
    rsync: &'a Rsync<'a>,
    there: &'a [Session],
    report: Report,
    /// How often each came damaged, by its path at the source.
    damaged: BTreeMap<String, u32>,
}

impl Work<'_> {
    fn fetch(&mut self, plan: &Plan, tell: &mut dyn FnMut(Event)) -> Result<(), SyncError> {
        let mut waiting: BTreeMap<String, &Item> = BTreeMap::new();
        let mut order = Vec::new();
        for item in &plan.items {
            if !item.is_fetched() && self.store.verify(item, self.head_of(item))? == Placed::Verified {
                self.report.verified += 1;
                continue;
            }
            // What is here and is not what was recorded is fetched like what is not here.
            let path = format!("{}/{}", item.there, item.line.name);
            order.push(path.clone());
            waiting.insert(path, item);
        }
        let total: u64 = waiting.values().map(|item| item.line.bytes).sum();
        let (mut fruitless, mut most) = (0, 0);
        let result = loop {
            let paths: Vec<String> = order.iter().filter(|path| waiting.contains_key(*path)).cloned().collect();
            if paths.is_empty() {
                break Ok(());
            }
            self.make_folders(&paths)?;
            let ended = self.carry(&paths, &mut waiting, total, tell);
            let settled = self.settle(&mut waiting, &ended);
            let error = match ended {
                Err(error) if !error.is_link() => break Err(error),
                Err(error) => error,
                Ok(_) if settled.is_err() => break settled,
                Ok(Ended::Stopped) => break Ok(()),
                Ok(_) => continue,
            };
            settled?;
            let come = total - staging(&waiting, self.desk, total);
            (fruitless, most) = if come > most { (0, come) } else { (fruitless + 1, most) };
            if fruitless >= MAX_FRUITLESS || self.rsync.stop.load(Ordering::Relaxed) {
                break Err(error);
            }
            tell(Event::Again { said: &error.to_string() });
            std::thread::sleep(BETWEEN_TRIES);
        };
        self.report.missing = waiting.len() as u64;
        result
    }

    /// One run of rsync; what it takes for done is verified while the rest still comes.
    fn carry(
        &mut self,
        paths: &[String],
        waiting: &mut BTreeMap<String, &Item>,
        total: u64,
        tell: &mut dyn FnMut(Event),
    ) -> Result<Ended, SyncError> {
        let (mut trouble, desk) = (None, self.desk);
        let rsync = self.rsync;
        let waiting = std::cell::RefCell::new(waiting);
        let mut arrived = |path: &str| {
            let item = waiting.borrow().get(path).copied();
            // Between two folders of one machine it is told by who sends it: it may not have been received yet.
            let item = item.filter(|item| is_long_enough(&item.staged(desk), item));
            if let (Some(item), None) = (item, &trouble) {
                match self.store.place(&item.staged(desk), item, self.head_of(item)) {
                    Ok(Placed::Verified) => {
                        self.count(item);
                        waiting.borrow_mut().remove(path);
                    }
                    // Perhaps rsync has seen it too and is at it again: looked at once more when it has ended.
                    Ok(Placed::Damaged) => {}
                    Err(error) => trouble = Some(error),
                }
            }
        };
        let mut tick = || {
            let done = total - staging(&waiting.borrow(), desk, total);
            tell(Event::Progress { done, total });
        };
        let ended = rsync.segments(paths, &desk.incoming, &mut arrived, &mut tick);
        trouble.map_or(ended, Err)
    }

    /// What has come and was not told of, or has come wrong, or cannot come.
    fn settle(
        &mut self,
        waiting: &mut BTreeMap<String, &Item>,
        ended: &Result<Ended, SyncError>,
    ) -> Result<(), SyncError> {
        // A run that broke may leave old and new blocks side by side: the next one sorts them out.
        let ended_well = matches!(ended, Ok(Ended::Whole | Ended::Partly(_)));
        for (path, item) in waiting.clone() {
            let staged = item.staged(self.desk);
            if is_long_enough(&staged, item) {
                match self.store.place(&staged, item, self.head_of(item))? {
                    Placed::Verified => {
                        self.count(item);
                        waiting.remove(&path);
                        continue;
                    }
                    Placed::Damaged if ended_well => {
                        fs::remove_file(&staged).map_err(|source| SyncError::Io { path: staged.clone(), source })?;
                        let times = self.damaged.entry(path.clone()).or_default();
                        *times += 1;
                        if *times < MAX_DAMAGED {
                            continue;
                        }
                        let why = format!("came {times} times with another hash than its manifest says: damaged there");
                        self.lose(&path, why);
                        waiting.remove(&path);
                        continue;
                    }
                    Placed::Damaged => continue,
                }
            }
            if ended_well {
                let said = match ended {
                    Ok(Ended::Partly(said)) => said.as_str(),
                    _ => "shorter than its manifest says",
                };
                // What is there and may not be read is not lost.
                if said.contains("Permission denied") {
                    self.report.failed.get_or_insert_with(|| format!("{path} may not be read there: {said}"));
                } else {
                    self.lose(&path, format!("could not be had: {said}"));
                }
                waiting.remove(&path);
            }
        }
        Ok(())
    }

    fn lose(&mut self, path: &str, why: String) {
        self.report.lost.push(SetAside::new(PathBuf::from(self.rsync.source.shown()).join(path), why));
    }

    fn count(&mut self, item: &Item) {
        self.report.fetched += 1;
        self.report.fetched_bytes += item.line.bytes;
    }

    fn head_of(&self, item: &Item) -> &[u8] {
        self.there.iter().find(|session| session.name == item.there).map_or(&[], |session| &session.head_bytes)
    }

    /// rsync makes one folder, not two: and what it makes has the robot's permissions.
    fn make_folders(&self, paths: &[String]) -> Result<(), SyncError> {
        for path in paths {
            let folder = self.desk.incoming.join(path.split('/').next().unwrap_or(path));
            fs::create_dir_all(&folder).map_err(|source| SyncError::Io { path: folder, source })?;
        }
        Ok(())
    }
}

fn is_long_enough(staged: &Path, item: &Item) -> bool {
    fs::metadata(staged).is_ok_and(|metadata| metadata.len() >= item.line.bytes)
}

/// Bytes that still have to come.
fn staging(waiting: &BTreeMap<String, &Item>, desk: &Desk, most: u64) -> u64 {
    let missing = |item: &&Item| {
        let staged = fs::metadata(item.staged(desk)).map_or(0, |metadata| metadata.len());
        item.line.bytes.saturating_sub(staged)
    };
    waiting.values().map(missing).sum::<u64>().min(most)
}

/// Sessions that are whole now get what describes them, and the source hears of what is here.
fn finish(
    options: &Options,
    store: &Store,
    desk: &Desk,
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
    desk: &Desk,
    rsync: &Rsync,
    session: &Session,
    ours: Option<&Session>,
) -> Result<(), SyncError> {
    let refused = |said: String| Err(SyncError::Refused { source_name: options.source.shown(), said });
    if session.set_aside.iter().any(|it| it.path == session.folder.join(ACK_FOLDER)) {
        return refused(format!("{}/{ACK_FOLDER} is no folder: nothing is acknowledged there", session.name));
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::catalogue::session_at;

    #[test]
    fn a_folder_that_cannot_be_read_is_not_taken_for_an_empty_one() {
        let captures = tempfile::tempdir().unwrap();
        let mut sessions = Vec::new();
        for name in ["read", "unread"] {
            let folder = captures.path().join(name);
            fs::create_dir(&folder).unwrap();
            fs::write(folder.join("session.json"), r#"{"format":1,"robot":"r","started":"t"}"#).unwrap();
            sessions.push(session_at(&folder).unwrap());
        }
        let entry = |path: &str, kind| Entry { path: path.to_owned(), kind };
        let entries =
            [entry("read", Kind::Folder), entry("read/session.json", Kind::File(40)), entry("unread", Kind::Folder)];
        let aside = leave_out_unread(&mut sessions, &entries, "Permission denied");
        assert_eq!(sessions.iter().map(|session| session.name.as_str()).collect::<Vec<_>>(), ["read"]);
        assert!(aside.len() == 1 && aside[0].to_string().contains("unread: cannot be looked into: Permission denied"));
    }
}
