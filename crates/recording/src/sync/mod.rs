//! Recordings from a robot, or from a stick, into a folder of captures: planned purely (`plan`), carried by rsync
//! (`rsync`), verified and put in place by us (`store`), one round after the other (`round`: `look`, plan, `fetch`, acknowledge).

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
