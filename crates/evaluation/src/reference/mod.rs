//! A reference: the tags of one replay, kept as text so that every later replay of the same log can be held to them,
//! bit for bit.

mod compare;
mod file;
mod identity;

pub use compare::{Difference, Verdict, compare};
pub use file::MAX_REFERENCE_BYTES;
pub use file::{Frames, Reference, ReferenceError};
pub use identity::{Identity, settings_that_matter};
