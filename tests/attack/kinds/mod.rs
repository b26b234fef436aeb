//! What is attacked: one kind of input each.

mod database;
mod log;
pub mod orders;
mod program;
mod serial;
pub mod service;
mod state;
mod texts;

use crate::case::{Case, Outcome};

pub struct Kind {
    pub name: &'static str,
    pub run: fn(&mut Case) -> Outcome,
    /// So many of the cases of one round.
    share: u64,
}

pub const KINDS: [Kind; 14] = [
    kind("log", log::run, 14),
    kind("config", texts::settings, 4),
    kind("lens", texts::lens, 4),
    kind("field", texts::field, 3),
    kind("scene", texts::scene, 2),
    kind("suite and reference", texts::gate, 2),
    kind("state of an agent", state::run, 4),
    kind("database", database::run, 4),
    kind("serial line", serial::run, 4),
    kind("capture", program::capture, 8),
    kind("picture", program::picture, 3),
    kind("folder of pictures", program::pictures, 2),
    kind("request", service::run, 8),
    kind("order", orders::run, 3),
];

const fn kind(name: &'static str, run: fn(&mut Case) -> Outcome, share: u64) -> Kind {
    Kind { name, run, share }
}

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
