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
const MAX_ATTEMPTS: usize = 80;

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
                let breaks = |case: &Case| outcome(case).err();
                let (case, fault) = shortest(case, fault, breaks);
                panic!("seed {}: {fault}\n\nthe shortest case that fails:\n{case}", case.seed);
            }
        }
        cases += 1;
    }
    println!("{cases} cases, {refused} of them refused with a message, {frames} frames");
    assert!(cases > 0 && refused < cases, "nothing was replayed");
}

/// Leaves out one thing after the other as long as something still breaks.
fn shortest(mut case: Case, mut fault: String, breaks: impl Fn(&Case) -> Option<String>) -> (Case, String) {
    let mut attempts = 0;
    'again: while attempts < MAX_ATTEMPTS {
        for shorter in case.shorter() {
            attempts += 1;
            if let Some(found) = breaks(&shorter) {
                (case, fault) = (shorter, found);
                continue 'again;
            }
        }
        break;
    }
    (case, fault)
}

/// A case breaks whenever it has `both` of two lines: these are all that is left of it.
#[test]
fn the_shortest_case_holds_what_breaks_and_nothing_else() {
    let cases = (0..400).map(Case::drawn);
    let both = ["kind = \"obstacles\"", "particles = 1\n"];
    let text = |case: &Case| format!("{}{}", case.scene("lens.toml"), case.config());
    let breaks = |case: &Case| both.iter().all(|line| text(case).contains(line)).then(|| "breaks".to_owned());
    let found = cases.into_iter().filter(|case| breaks(case).is_some()).max_by_key(|case| text(case).len());
    let (short, fault) = shortest(found.expect("one of 400"), String::new(), breaks);
    assert_eq!(fault, "breaks");
    assert_eq!((text(&short).matches("[[effect]]").count(), short.config().lines().count()), (1, 2), "{short}");
    assert!(short.faults.is_empty() && short.threads == 1, "{short}");
}
