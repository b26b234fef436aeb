//! Synchronization: copies recordings from a robot, or from a memory stick, into a folder of captures.
//!
//! One pass ([`round`]) looks at the source (`scan`), plans what is missing here ([`plan()`], pure), lets rsync carry
//! it (`rsync`, `fetch`), verifies each segment and puts it in place (`store`), and acknowledges to the source what
//! is here. [`Removal`] deletes sessions that lie somewhere else as well.

mod deletion;
mod error;
mod fetch;
mod listing;
mod name;
mod plan;
mod prune;
mod rsync;
mod scan;
mod selection;
mod source;
mod source_state;
mod store;
mod sync_pass;

pub use deletion::Removal;
pub use error::SyncError;
pub use plan::{Item, Plan, TransferReason, plan};
pub use prune::{Decision, Goal};
pub use rsync::SSH;
pub use selection::{Selection, Within, valid_share};
pub use source::{SERVICE_CAPTURES, Source};
pub use source_state::{KnownSource, known_sources};
pub use store::{Pruned, Store, is_as_recorded};
pub use sync_pass::{Event, Options, Report, SessionReport, round};
