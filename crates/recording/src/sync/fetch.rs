//! Fetching: transfers what is missing here, verifies it and puts it in place. A link that breaks is tried again.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::Duration;

use super::error::SyncError;
use super::plan::{Item, Plan};
use super::rsync::{Ended, Rsync};
use super::scan::scan;
use super::source_state::SourceState;
use super::store::{Store, VerifyOutcome};
use super::sync_pass::{Event, Report};
use crate::{Session, SetAside, receivers_of};

/// Most tries in a row that bring nothing, before the link is given up.
const MAX_FRUITLESS: u32 = 3;
/// Pause between two tries.
const BETWEEN_TRIES: Duration = Duration::from_secs(1);
/// Most times that a file may come with another hash than its manifest's; after that the source is at fault.
const MAX_DAMAGED: u32 = 2;

/// State of one fetch.
pub(super) struct Fetcher<'a> {
    pub(super) store: &'a Store,
    pub(super) source_state: &'a SourceState,
    pub(super) rsync: &'a Rsync<'a>,
    /// Sessions at the source.
    pub(super) there: &'a [Session],
    pub(super) report: Report,
    /// How often each file came damaged, by its path at the source.
    pub(super) damaged: BTreeMap<String, u32>,
    /// What could not be transferred, and what rsync said of it: it may have been removed meanwhile.
    pub(super) not_had: Vec<(Item, String)>,
    /// Sizes and times of the source's files when it was looked at.
    pub(super) stamps: &'a BTreeMap<String, String>,
}

impl Fetcher<'_> {
    /// Verifies and transfers everything that is planned, until nothing is missing or the link is given up.
    pub(super) fn fetch(&mut self, plan: &Plan, tell: &mut dyn FnMut(Event)) -> Result<(), SyncError> {
        let mut waiting: BTreeMap<String, &Item> = BTreeMap::new();
        let mut order = Vec::new();
        for item in &plan.items {
            if !item.is_fetched() && self.store.verify(item, self.head_of(item))? == VerifyOutcome::Verified {
                self.report.verified += 1;
                continue;
            }
            // A file that is here but not as recorded is fetched like a missing one.
            let path = format!("{}/{}", item.there, item.line.name);
            order.push(path.clone());
            waiting.insert(path, item);
        }
        self.skip_known_damaged(&mut waiting);
        let total: u64 = waiting.values().map(|item| item.line.bytes).sum();
        let (mut fruitless, mut most) = (0, 0);
        let result = loop {
            let paths: Vec<String> = order.iter().filter(|path| waiting.contains_key(*path)).cloned().collect();
            if paths.is_empty() {
                break Ok(());
            }
            self.make_folders(&paths)?;
            let ended = self.run_rsync(&paths, &mut waiting, total, tell);
            let settled = self.settle(&mut waiting, &ended);
            let error = match ended {
                Err(error) if !error.is_link() => break Err(error),
                Err(error) => error,
                Ok(_) if settled.is_err() => break settled,
                Ok(Ended::Stopped) => break Ok(()),
                Ok(_) => continue,
            };
            settled?;
            let come = total - remaining_bytes(&waiting, self.source_state, total);
            (fruitless, most) = if come > most { (0, come) } else { (fruitless + 1, most) };
            if fruitless >= MAX_FRUITLESS || self.rsync.stop.load(Ordering::Relaxed) {
                break Err(error);
            }
            tell(Event::Again { said: &error.to_string() });
            std::thread::sleep(BETWEEN_TRIES);
        };
        self.report.missing = (waiting.len() + self.not_had.len()) as u64;
        result.and(self.recheck_source())
    }

    /// Leaves out files that came damaged and have not changed at the source since: they would come damaged again.
    fn skip_known_damaged(&mut self, waiting: &mut BTreeMap<String, &Item>) {
        waiting.retain(|path, item| {
            let is_known = self.store.came_damaged(&self.damage_key(path, item));
            if is_known {
                self.lose(path, "came damaged before, and is still the same there: not fetched again".to_owned());
            }
            !is_known
        });
    }

    /// Key of a file as it is at the source now: its path, the hash that it should have, its size and time there.
    fn damage_key(&self, path: &str, item: &Item) -> String {
        let stamp = self.stamps.get(path).map_or("", String::as_str);
        format!("{}\0{path}\0{}\0{stamp}", self.rsync.source.shown(), item.line.blake3)
    }

    /// Looks at the source again for what could not be transferred: what a robot has removed or moved meanwhile is
    /// not lost.
    fn recheck_source(&mut self) -> Result<(), SyncError> {
        if self.not_had.is_empty() || self.rsync.stop.load(Ordering::Relaxed) {
            return Ok(());
        }
        let now = scan(self.rsync, self.source_state, &mut Report::default())?.sessions;
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

    /// Runs rsync once. Each file that it reports as complete is verified while the rest still comes.
    fn run_rsync(
        &mut self,
        paths: &[String],
        waiting: &mut BTreeMap<String, &Item>,
        total: u64,
        tell: &mut dyn FnMut(Event),
    ) -> Result<Ended, SyncError> {
        let (mut trouble, source_state) = (None, self.source_state);
        let rsync = self.rsync;
        let waiting = std::cell::RefCell::new(waiting);
        let mut arrived = |path: &str| {
            let item = waiting.borrow().get(path).copied();
            // Between two folders of one machine the sending side reports the file: it may not be complete here yet.
            let item = item.filter(|item| is_long_enough(&item.staged(source_state), item));
            if let (Some(item), None) = (item, &trouble) {
                match self.store.place(&item.staged(source_state), item, self.head_of(item)) {
                    Ok(VerifyOutcome::Verified) => {
                        self.count(item);
                        waiting.borrow_mut().remove(path);
                    }
                    // rsync may have noticed it too and be transferring it again; it is checked once more when rsync
                    // has ended.
                    Ok(VerifyOutcome::Damaged) => {}
                    Err(error) => trouble = Some(error),
                }
            }
        };
        let mut tick = || {
            let done = total - remaining_bytes(&waiting.borrow(), source_state, total);
            tell(Event::Progress { done, total });
        };
        let ended = rsync.segments(paths, &source_state.incoming, &mut arrived, &mut tick);
        trouble.map_or(ended, Err)
    }

    /// Handles files that came without a report, that came damaged, or that cannot come.
    fn settle(
        &mut self,
        waiting: &mut BTreeMap<String, &Item>,
        ended: &Result<Ended, SyncError>,
    ) -> Result<(), SyncError> {
        // A run that broke may leave a mixture of old and new blocks, which the next run corrects.
        let ended_well = matches!(ended, Ok(Ended::Whole | Ended::Partly(_)));
        for (path, item) in waiting.clone() {
            let staged = item.staged(self.source_state);
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
                        self.store.note_damaged(self.damage_key(&path, item));
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
                // A file that is there and may not be read is not lost.
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

    /// Reports a file of the source as lost.
    fn lose(&mut self, path: &str, why: String) {
        self.report.lost.push(SetAside::new(PathBuf::from(self.rsync.source.shown()).join(path), why));
    }

    /// Counts a segment that was fetched.
    fn count(&mut self, item: &Item) {
        self.report.fetched += 1;
        self.report.fetched_bytes += item.line.bytes;
    }

    /// Content of the session's `session.json`; empty if the session is unknown.
    fn head_of(&self, item: &Item) -> &[u8] {
        self.there.iter().find(|session| session.name == item.there).map_or(&[], |session| &session.head_bytes)
    }

    /// Makes the folders to transfer into: rsync would make only the innermost, with the robot's permissions.
    fn make_folders(&self, paths: &[String]) -> Result<(), SyncError> {
        for path in paths {
            let folder = self.source_state.incoming.join(path.split('/').next().unwrap_or(path));
            fs::create_dir_all(&folder).map_err(|source| SyncError::Io { path: folder, source })?;
        }
        Ok(())
    }
}

/// Whether a file has at least the size that its manifest says.
fn is_long_enough(staged: &Path, item: &Item) -> bool {
    fs::metadata(staged).is_ok_and(|metadata| metadata.len() >= item.line.bytes)
}

/// Bytes that still have to come, at most `most`.
fn remaining_bytes(waiting: &BTreeMap<String, &Item>, source_state: &SourceState, most: u64) -> u64 {
    let missing = |item: &&Item| {
        let staged = fs::metadata(item.staged(source_state)).map_or(0, |metadata| metadata.len());
        item.line.bytes.saturating_sub(staged)
    };
    waiting.values().map(missing).sum::<u64>().min(most)
}
