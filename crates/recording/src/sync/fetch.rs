//! What is missing here comes, is verified and put in place; a link that breaks is tried again.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::Duration;

use super::error::SyncError;
use super::plan::{Item, Plan};
use super::rsync::{Ended, Rsync};
use super::scan::look;
use super::source_state::SourceState;
use super::store::{Store, VerifyOutcome};
use super::sync_pass::{Event, Report};
use crate::{Session, SetAside, receivers_of};

/// Tries in a row that bring nothing before the link is given up.
const MAX_FRUITLESS: u32 = 3;
const BETWEEN_TRIES: Duration = Duration::from_secs(1);
/// Times that a file may come with another hash than its manifest's: after that it is the source's.
const MAX_DAMAGED: u32 = 2;

pub(super) struct Work<'a> {
    pub(super) store: &'a Store,
    pub(super) desk: &'a SourceState,
    pub(super) rsync: &'a Rsync<'a>,
    pub(super) there: &'a [Session],
    pub(super) report: Report,
    /// How often each came damaged, by its path at the source.
    pub(super) damaged: BTreeMap<String, u32>,
    /// What could not be had, and what was said of it: perhaps it went away while it was being fetched.
    pub(super) not_had: Vec<(Item, String)>,
    /// As they were when the source was looked at.
    pub(super) stamps: &'a BTreeMap<String, String>,
}

impl Work<'_> {
    pub(super) fn fetch(&mut self, plan: &Plan, tell: &mut dyn FnMut(Event)) -> Result<(), SyncError> {
        let mut waiting: BTreeMap<String, &Item> = BTreeMap::new();
        let mut order = Vec::new();
        for item in &plan.items {
            if !item.is_fetched() && self.store.verify(item, self.head_of(item))? == VerifyOutcome::Verified {
                self.report.verified += 1;
                continue;
            }
            // What is here and is not what was recorded is fetched like what is not here.
            let path = format!("{}/{}", item.there, item.line.name);
            order.push(path.clone());
            waiting.insert(path, item);
        }
        self.leave_out_what_came_damaged(&mut waiting);
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
        self.report.missing = (waiting.len() + self.not_had.len()) as u64;
        result.and(self.look_again())
    }

    /// What came damaged from there, and has not changed since, would come damaged again.
    fn leave_out_what_came_damaged(&mut self, waiting: &mut BTreeMap<String, &Item>) {
        waiting.retain(|path, item| {
            let is_known = self.store.came_damaged(&self.memory_of(path, item));
            if is_known {
                self.lose(path, "came damaged before, and is still the same there: not fetched again".to_owned());
            }
            !is_known
        });
    }

    /// Of one file as it is at the source now: what it should be, its size and time there.
    fn memory_of(&self, path: &str, item: &Item) -> String {
        let stamp = self.stamps.get(path).map_or("", String::as_str);
        format!("{}\0{path}\0{}\0{stamp}", self.rsync.source.shown(), item.line.blake3)
    }

    /// What a robot has removed or moved while it was fetched is not lost.
    fn look_again(&mut self) -> Result<(), SyncError> {
        if self.not_had.is_empty() || self.rsync.stop.load(Ordering::Relaxed) {
            return Ok(());
        }
        let now = look(self.rsync, self.desk, &mut Report::default())?.sessions;
        let mut gone = Vec::new();
        for (item, said) in std::mem::take(&mut self.not_had) {
            let path = format!("{}/{}", item.there, item.line.name);
            let shown = PathBuf::from(self.rsync.source.shown()).join(&path);
            let here = now.iter().find(|session| session.id == item.session && session.name == item.there);
            let before = self.there.iter().find(|session| session.name == item.there);
            let told = here.or(before).map(|session| &session.acknowledged);
            let own = self.store.receiver();
            let holders = told.into_iter().flat_map(|told| receivers_of(&item.line, told));
            let mut holders: Vec<String> = holders.filter(|who| *who != own).map(str::to_owned).collect();
            if let Some(evicted) = here.and_then(|session| session.evicted.get(&item.line.name)) {
                holders.extend(Some(evicted.receiver.clone()).filter(|who| who != own && !holders.contains(who)));
            }
            let is_there = here.is_some_and(|session| session.segments.contains_key(&item.line.name));
            match here {
                None => gone.push(shown),
                Some(_) if !is_there && !holders.is_empty() => self.report.elsewhere.push((shown, holders)),
                Some(_) => self.lose(&path, format!("could not be had: {said}")),
            }
        }
        let Some(first) = gone.first() else { return Ok(()) };
        let more = if gone.len() > 1 { format!(" and {} more", gone.len() - 1) } else { String::new() };
        let said = format!("{}{more} moved or gone there meanwhile: run it again", first.display());
        Err(SyncError::Refused { source_name: self.rsync.source.shown(), said })
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
                    Ok(VerifyOutcome::Verified) => {
                        self.count(item);
                        waiting.borrow_mut().remove(path);
                    }
                    // Perhaps rsync has seen it too and is at it again: looked at once more when it has ended.
                    Ok(VerifyOutcome::Damaged) => {}
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
                    VerifyOutcome::Verified => {
                        self.count(item);
                        waiting.remove(&path);
                        continue;
                    }
                    VerifyOutcome::Damaged if ended_well => {
                        fs::remove_file(&staged).map_err(|source| SyncError::Io { path: staged.clone(), source })?;
                        let times = self.damaged.entry(path.clone()).or_default();
                        *times += 1;
                        if *times < MAX_DAMAGED {
                            continue;
                        }
                        let why = format!("came {times} times with another hash than its manifest says: damaged there");
                        self.lose(&path, why);
                        self.store.note_damaged(self.memory_of(&path, item));
                        waiting.remove(&path);
                        continue;
                    }
                    VerifyOutcome::Damaged => continue,
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
                    self.not_had.push(((*item).clone(), said.to_owned()));
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
fn staging(waiting: &BTreeMap<String, &Item>, desk: &SourceState, most: u64) -> u64 {
    let missing = |item: &&Item| {
        let staged = fs::metadata(item.staged(desk)).map_or(0, |metadata| metadata.len());
        item.line.bytes.saturating_sub(staged)
    };
    waiting.values().map(missing).sum::<u64>().min(most)
}
