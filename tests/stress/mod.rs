//! Random scenes, faults and settings through the whole agent, from message to capture, for as long as one likes:
//! `./dev stress`. What fails is made as short as it can be before it is told.

mod case;
mod fault;
mod outcome;

use std::time::{Duration, Instant};

use case::Case;
use outcome::{Outcome, outcome};

/// Seconds; `./dev stress` asks for more.
const USUAL_S: u64 = 5;
/// Attempts at a shorter case that fails as well.
const MOST_ATTEMPTS: usize = 80;

fn wanted(name: &str, usual: u64) -> u64 {
    std::env::var(name).map_or(usual, |text| text.parse().unwrap_or_else(|_| panic!("{name}={text}: a whole number")))
}

#[test]
fn random_scenes_faults_and_settings_break_nothing() {
    let time = Duration::from_secs(wanted("REALITYSIM_STRESS_SECONDS", USUAL_S));
    let first = wanted("REALITYSIM_STRESS_SEED", 1);
    println!("seed {first}, {} s", time.as_secs());
    let started = Instant::now();
    let (mut cases, mut frames, mut refused) = (0, 0, 0);
    while started.elapsed() < time {
        let case = Case::drawn(first.wrapping_add(cases));
        match outcome(&case) {
            Ok(Outcome::Replayed(tags)) => frames += tags,
            Ok(Outcome::Refused) => refused += 1,
            Err(fault) => {
                let (case, fault) = shortest(case, fault);
                panic!("seed {}: {fault}\n\nthe shortest case that fails:\n{case}", case.seed);
            }
        }
        cases += 1;
    }
    println!("{cases} cases, {refused} of them refused with a message, {frames} frames");
    assert!(cases > 0 && refused < cases, "nothing was replayed");
}

/// Leaves out one thing after the other as long as something still breaks.
fn shortest(mut case: Case, mut fault: String) -> (Case, String) {
    let mut attempts = 0;
    'again: while attempts < MOST_ATTEMPTS {
        for shorter in case.shorter() {
            attempts += 1;
            if let Err(found) = outcome(&shorter) {
                (case, fault) = (shorter, found);
                continue 'again;
            }
        }
        break;
    }
    (case, fault)
}
