//! Two ways to do the same, taking turns.

use std::hint::black_box;
use std::time::Instant;

use realitysim::localization::{SimdPath, kernel};

pub struct Bench {
    rounds: usize,
}

/// Milliseconds.
#[derive(Clone, Copy)]
pub struct Times {
    pub median: f64,
    pub p99: f64,
}

impl Bench {
    pub fn new(rounds: usize) -> Self {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let path = kernel::available(SimdPath::Auto);
        println!("{rounds} rounds on a {cores}-core {} machine with {path:?}", std::env::consts::ARCH);
        println!("{:<58} {:>9} {:>9}   {:>9}  ratio", "", "median ms", "p99 ms", "reference");
        Self { rounds }
    }

    /// `units` of work are done by each: how many a second is told.
    pub fn compare<A, B>(
        &mut self,
        what: &str,
        units: Option<(f64, &str)>,
        mut reference: impl FnMut() -> A,
        mut subject: impl FnMut() -> B,
    ) {
        let (mut theirs, mut ours) = (Vec::new(), Vec::new());
        // The reference may be a hundred times slower: it gets fewer turns.
        let every = 10;
        for round in 0..self.rounds {
            if round % every == 0 {
                theirs.push(timed(&mut reference));
            }
            ours.push(timed(&mut subject));
        }
        let (theirs, ours) = (Times::of(theirs), Times::of(ours));
        let rate = units
            .map_or(String::new(), |(count, unit)| format!("   {:.2} G {unit}/s", count / (ours.median * 1e-3) * 1e-9));
        told(what, ours, theirs, &rate);
    }
}

pub fn told(what: &str, ours: Times, theirs: Times, more: &str) {
    println!(
        "{what:<58} {:>9.3} {:>9.3}   {:>9.3}  {:>5.2}{more}",
        ours.median,
        ours.p99,
        theirs.median,
        theirs.median / ours.median
    );
}

fn timed<R>(work: &mut impl FnMut() -> R) -> f64 {
    let start = Instant::now();
    black_box(work());
    start.elapsed().as_secs_f64() * 1e3
}

impl Times {
    pub fn of(mut times: Vec<f64>) -> Self {
        times.sort_by(f64::total_cmp);
        let at = |share: f64| times[((times.len() - 1) as f64 * share).round() as usize];
        Self { median: at(0.5), p99: at(0.99) }
    }
}
