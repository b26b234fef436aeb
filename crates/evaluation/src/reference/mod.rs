//! References: the tags of one replay, kept as text, so that later replays of the same log can be compared with them
//! bit for bit.
//!
//! [`Frames`] holds the fields of all tags, [`Identity`] says what they were made from, [`Reference`] is both as a
//! file, and [`compare`](fn@compare) gives a [`Verdict`].

mod compare;
mod file;
mod identity;

pub use compare::{Difference, Verdict, compare};
pub use file::MAX_REFERENCE_BYTES;
pub use file::{Frames, Reference, ReferenceError};
pub use identity::{Identity, settings_that_matter};
