//! The recorder on a simulated disk that fails on purpose: tests, for thousands of seeds, of what docs/explanation/recording.md
//! promises.

mod disk;
mod disk_full;
mod faults;
mod foreign_input;
mod prng;
mod queue;
mod run;

use std::io::ErrorKind;
use std::path::Path;
use std::time::Duration;

use super::repair::repair;
use super::storage::Storage;
use super::verify::verify;
use disk::{Failure, SimulatedDisk, Trouble};
use prng::Prng;
use run::{CAPTURES, Run, Scripted, script, session};

/// Asserts what holds for every disk that works again: the capture is whole and holds what was confirmed.
fn assert_promises(run: &Run, seed: u64) {
    let Run { disk, .. } = run;
    let Some(session) = session(disk) else {
        assert_eq!(run.confirmed, 0, "seed {seed}: everything is gone");
        return;
    };
    // This program's readers open it at once, with all torn ends.
    let at_once: Vec<u32> = run::read(disk, &session).into_iter().map(|message| message.sequence).collect();
    for sequence in run.confirmed_sequences() {
        assert!(
            at_once.contains(&sequence),
            "seed {seed}: message {sequence} was confirmed, and does not open at once"
        );
    }
    let repaired = repair(disk, &session).unwrap_or_else(|error| panic!("seed {seed}: {error}"));
    assert!(!repaired.in_use);
    let messages = run::read(disk, &session);
    let mut last = 0;
    for message in messages.iter().filter(|message| !run::is_latched(message)) {
        assert!(message.sequence > last, "seed {seed}: message {} after {last}", message.sequence);
        assert!(message.data == run.script[message.sequence as usize].data(), "seed {seed}: other bytes");
        last = message.sequence;
    }
    for sequence in run.confirmed_sequences() {
        let there = messages.iter().any(|message| message.sequence == sequence);
        assert!(there, "seed {seed}: message {sequence} was confirmed, and repair has lost it");
    }
    let verified = verify(disk, &session).unwrap_or_else(|error| panic!("seed {seed}: {error}"));
    assert!(verified.wrong.is_empty(), "seed {seed}: {verified:?}");
    let frames = messages.iter().filter(|message| run::is_frame(message)).count() as u64;
    assert_eq!(run::counts_of_manifest(disk, &session).written, frames, "seed {seed}");
    let before = disk.snapshot();
    let again = repair(disk, &session).unwrap();
    assert!(again.changed_nothing(), "seed {seed}: {again:?}");
    assert!(disk.snapshot() == before, "seed {seed}: a second repair changed something");
}

/// Asserts for a disk that came back before the end that nothing is missing but what was counted as lost.
fn assert_nothing_missing(run: &Run, seed: u64) {
    assert_promises(run, seed);
    let frames = session(&run.disk).map_or(0, |session| {
        run::read(&run.disk, &session).iter().filter(|message| run::is_frame(message)).count() as u64
    });
    let counts = run.shared.counts();
    assert!(run.shared.status().conserved, "seed {seed}: {counts:?}");
    // What is counted as lost may be there nonetheless, if the disk did not even let its file be cut.
    assert!(frames >= counts.written, "seed {seed}: {frames}, {counts:?}");
    assert!(counts.is_conserved(), "seed {seed}: {counts:?}");
    if run.is_finished {
        let frames = |is: fn(&Scripted) -> bool| run.script.iter().filter(|entry| is(entry)).count() as u64;
        let (wanted, thinned) = (frames(Scripted::is_frame), frames(|entry| matches!(entry, Scripted::Thinned)));
        assert_eq!(
            (counts.written, counts.thinned, counts.lost.len()),
            (wanted, thinned, 0),
            "seed {seed}: {counts:?}"
        );
    }
}

/// Number of seeds: `REALITYSIM_DISK_SEEDS`, or `default`.
fn seeds(default: u64) -> u64 {
    std::env::var("REALITYSIM_DISK_SEEDS").ok().and_then(|text| text.parse().ok()).unwrap_or(default)
}

#[test]
fn a_sound_disk_keeps_everything() {
    for seed in 0..20 {
        let run = Run::new(seed, Trouble::default()).until_the_end();
        assert!(run.is_finished);
        assert_eq!(run.confirmed, run.script.len());
        assert!(repair(&run.disk, &session(&run.disk).unwrap()).unwrap().changed_nothing());
        assert_nothing_missing(&run, seed);
        let of_segments = run::counts_of_manifest(&run.disk, &session(&run.disk).unwrap());
        assert_eq!(of_segments.thinned, run.shared.counts().thinned, "each in the segment in which it was");
    }
}

#[test]
fn a_power_cut_costs_only_what_was_not_confirmed() {
    let mut worst = Duration::ZERO;
    for seed in 0..seeds(2500) {
        let mut prng = Prng::new(seed ^ 0xc07);
        let trouble = Trouble { cut_at: Some(1 + prng.below(90)), ..Trouble::default() };
        let run = Run::new(seed, trouble).until_the_end();
        worst = worst.max(run.oldest_unconfirmed);
        run.disk.restart();
        assert_promises(&run, seed);
    }
    // No entry is older than the sync interval and one sync.
    assert!(worst <= run::SYNC_INTERVAL + Duration::from_millis(50), "{worst:?}");
}

#[test]
fn an_error_at_any_operation_is_survived() {
    let all = Run::new(1, Trouble::default()).until_the_end().disk.operations();
    assert!(all > 50, "{all} operations");
    for kind in [ErrorKind::Other, ErrorKind::StorageFull, ErrorKind::ReadOnlyFilesystem, ErrorKind::NotFound] {
        for at in 1..=all {
            for length in [1, 2, 7, 40] {
                let fails = vec![(at..at + length, Failure::Any(kind))];
                let run = Run::new(1, Trouble { fails, ..Trouble::default() }).until_the_end();
                assert!(run.is_finished, "{kind:?} at {at} for {length}");
                run.disk.heal();
                assert_nothing_missing(&run, at);
            }
        }
    }
}

#[test]
fn a_sync_that_fails_is_never_tried_again_on_its_file() {
    for seed in 0..seeds(1000) {
        let mut prng = Prng::new(seed ^ 0xf5);
        let at = 1 + prng.below(70);
        let fails = vec![(at..at + 1 + prng.below(30), Failure::Sync)];
        let cut_at = (prng.below(2) == 0).then(|| at + 1 + prng.below(60));
        let run = Run::new(seed, Trouble { fails, cut_at, ..Trouble::default() }).until_the_end();
        if cut_at.is_some() {
            run.disk.restart();
            assert_promises(&run, seed);
        } else {
            run.disk.heal();
            assert_nothing_missing(&run, seed);
            // The disk has confirmed everything: a power cut must not show that it had not.
            run.disk.restart();
            assert_promises(&run, seed);
        }
    }
}

#[test]
fn errors_stalls_and_a_power_cut_together_break_no_promise() {
    for seed in 0..seeds(1500) {
        let mut prng = Prng::new(seed ^ 0xa11);
        let mut fails = Vec::new();
        for _ in 0..prng.below(4) {
            let at = 1 + prng.below(80);
            let kinds = [Failure::Sync, Failure::Any(ErrorKind::Other), Failure::Any(ErrorKind::StorageFull)];
            fails.push((at..at + 1 + prng.below(20), kinds[prng.below(3) as usize]));
        }
        let stalls = (prng.below(2) == 0).then(|| (1 + prng.below(20), Duration::from_millis(prng.below(900))));
        let cut_at = (prng.below(3) > 0).then(|| 1 + prng.below(120));
        let run = Run::new(seed, Trouble { fails, cut_at, stalls, ..Trouble::default() }).until_the_end();
        if run.disk.is_dead() {
            run.disk.restart();
            assert_promises(&run, seed);
        } else {
            run.disk.heal();
            assert_nothing_missing(&run, seed);
        }
    }
}

#[test]
fn a_repair_that_is_cut_off_is_done_by_the_next() {
    for seed in 0..seeds(600) {
        let mut prng = Prng::new(seed ^ 0x4e9);
        let trouble = Trouble { cut_at: Some(10 + prng.below(80)), ..Trouble::default() };
        let run = Run::new(seed, trouble).until_the_end();
        run.disk.restart();
        for _ in 0..3 {
            let cut_at = Some(run.disk.operations() + 1 + prng.below(12));
            run.disk.trouble(Trouble { cut_at, ..Trouble::default() });
            if let Some(session) = session(&run.disk) {
                let _ = repair(&run.disk, &session);
            }
            run.disk.restart();
        }
        assert_promises(&run, seed);
    }
}

/// A repair is killed at each of its operations. The next one reports the whole loss, and so does the manifest.
#[test]
fn a_repair_that_is_killed_leaves_its_loss_to_the_next_to_tell() {
    let whole = Run::new(3, Trouble::default()).until_the_end();
    let session = session(&whole.disk).unwrap();
    let first = session.join("0000.mcap");
    let content = whole.disk.snapshot()[&first].clone();
    let torn = || {
        let disk = SimulatedDisk::new(0, Trouble::default());
        run::put(&disk, CAPTURES, &session, &whole.disk, &content[..content.len() / 2]);
        disk.append(&session.join("0000.mcap.active")).and_then(|file| file.sync()).unwrap();
        for folder in [&session, Path::new(CAPTURES), Path::new("/")] {
            disk.sync_folder(folder).unwrap();
        }
        disk
    };
    let disk = torn();
    let before = disk.operations();
    let at_once = repair(&disk, &session).unwrap();
    let (all, told) = (disk.operations() - before, run::cut_bytes(&disk, &session));
    assert!(told > 0 && at_once.lost.len() == 1, "{at_once:?}");
    let mut killed = 0;
    for at in 1..=all {
        let disk = torn();
        disk.trouble(Trouble { cut_at: Some(before + at), ..Trouble::default() });
        if repair(&disk, &session).is_ok() {
            continue;
        }
        killed += 1;
        let was_written = {
            disk.restart();
            run::cut_bytes(&disk, &session)
        };
        let next = repair(&disk, &session).unwrap();
        assert_eq!(run::cut_bytes(&disk, &session), told, "killed at operation {at}: {next:?}");
        assert!(was_written == told || next.lost == at_once.lost, "killed at operation {at}: {next:?}");
        assert!(repair(&disk, &session).unwrap().changed_nothing(), "killed at operation {at}");
    }
    assert!(killed > 10, "{killed} of {all}");
}

#[test]
fn a_disk_that_is_full_and_emptied_again_loses_nothing_that_fits() {
    for seed in 0..seeds(300) {
        let mut prng = Prng::new(seed ^ 0xf11);
        let trouble = Trouble { capacity_bytes: Some(4000 + prng.below(60_000)), ..Trouble::default() };
        let mut run = Run::new(seed, trouble);
        run.feed_half();
        run.disk.heal();
        let run = run.until_the_end();
        assert!(run.is_finished, "seed {seed}");
        assert_nothing_missing(&run, seed);
    }
}

/// The disk comes back with little room, and more has to be written than fits.
#[test]
fn a_disk_that_stays_full_has_as_much_as_fits() {
    for seed in 0..seeds(20) {
        let refuses = vec![(0..u64::MAX, Failure::Any(ErrorKind::Other))];
        let mut run = Run::new(seed, Trouble { fails: refuses, ..Trouble::default() });
        run.feed_half();
        let capacity = 24_000 + Prng::new(seed ^ 0xca9).below(8_000);
        run.disk.trouble(Trouble { capacity_bytes: Some(capacity), ..Trouble::default() });
        let run = run.until_the_end();
        assert!(!run.is_finished, "seed {seed}: it has far more");
        let there: usize = run.script[..run.confirmed].iter().map(|entry| entry.data().len()).sum();
        // Most of the little room goes into what describes session and segments.
        assert!(there > 2_000, "seed {seed}: {there} of {capacity} bytes");
        run.disk.heal();
        assert_nothing_missing(&run, seed);
    }
}

#[test]
fn a_session_cut_at_every_byte_is_repaired() {
    let whole = Run::new(3, Trouble::default()).until_the_end();
    let session = session(&whole.disk).unwrap();
    let first = session.join("0000.mcap");
    let content = whole.disk.snapshot()[&first].clone();
    let messages = run::read_file(&whole.disk, &first).len();
    let mut most = 0;
    for length in 0..=content.len() {
        let disk = SimulatedDisk::new(0, Trouble::default());
        run::put(&disk, CAPTURES, &session, &whole.disk, &content[..length]);
        let info = repair(&disk, &session).unwrap();
        let left = if info.removed.is_empty() { run::read_file(&disk, &first).len() } else { 0 };
        assert!(left >= most, "{length} bytes: {left} messages, fewer than with fewer bytes");
        most = left;
        if length % 7 != 0 {
            continue;
        }
        let verified = verify(&disk, &session).unwrap();
        assert!(verified.wrong.is_empty(), "{length} bytes: {verified:?}");
        assert!(repair(&disk, &session).unwrap().changed_nothing(), "{length} bytes");
    }
    assert_eq!(most, messages, "uncut, it is the same");
}

#[test]
fn scripts_differ_and_have_everything_in_them() {
    let scripts: Vec<_> = (0..3).map(script).collect();
    for script in &scripts {
        assert!(script.iter().filter(|entry| entry.is_beginning()).count() >= 2);
        assert!(script.iter().any(|entry| entry.is_frame()) && script.iter().any(|entry| !entry.is_frame()));
    }
    assert!(scripts[0].len() != scripts[1].len() || scripts[1].len() != scripts[2].len());
}
