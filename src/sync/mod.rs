//! Recordings from a robot, or from a stick, into a folder of captures: planned purely (`plan`), carried by rsync
//! (`rsync`), verified and put in place by us (`store`), one round after the other (`round`).

mod error;
mod listing;
mod plan;
mod prune;
mod round;
mod rsync;
mod selection;
mod source;
mod store;

pub use error::SyncError;
pub use plan::{Item, Plan, Why, plan};
pub use prune::{Decision, Goal, decide};
pub use round::{Event, Options, Report, SessionReport, round};
pub use rsync::SSH;
pub use selection::{Selection, Within, valid_share};
pub use source::{SERVICE_CAPTURES, Source};
pub use store::{Known, Pruned, Store, is_as_recorded, known_sources};
