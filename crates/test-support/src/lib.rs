//! What the tests of several crates share: an oracle of 256 bits, and the rule for the largest errors that docs/numerics.md states.

pub mod exact;
pub mod measured;
