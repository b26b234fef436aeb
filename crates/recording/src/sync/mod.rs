//! Recordings from a robot, or from a stick, into a folder of captures: planned purely (`plan`), carried by rsync
//! (`rsync`), verified and put in place by us (`store`), one round after the other (`round`: `look`, plan, `fetch`, acknowledge).

mod desk;
mod error;
mod fetch;
mod listing;
mod look;
mod name;
mod plan;
mod prune;
mod removal;
mod round;
mod rsync;
mod selection;
mod source;
mod store;

pub use desk::{Known, known_sources};
pub use error::SyncError;
pub use plan::{Item, Plan, Why, plan};
pub use prune::{Decision, Goal};
pub use removal::Removal;
pub use round::{Event, Options, Report, SessionReport, round};
pub use rsync::SSH;
pub use selection::{Selection, Within, valid_share};
pub use source::{SERVICE_CAPTURES, Source};
pub use store::{Pruned, Store, is_as_recorded};
