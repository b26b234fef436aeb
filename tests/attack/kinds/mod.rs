//! What is attacked: one kind of input each.

mod log;

use crate::case::{Case, Outcome};

pub struct Kind {
    pub name: &'static str,
    pub run: fn(&mut Case) -> Outcome,
    /// So many of the cases of one round.
    share: u64,
}

pub const KINDS: [Kind; 1] = [Kind { name: "log", run: log::run, share: 1 }];

/// The kind of the case with this number.
pub fn of(number: u64) -> &'static Kind {
    let round: u64 = KINDS.iter().map(|kind| kind.share).sum();
    let mut left = number % round;
    for kind in &KINDS {
        match left.checked_sub(kind.share) {
            None => return kind,
            Some(rest) => left = rest,
        }
    }
    unreachable!("shares add up to the round")
}
