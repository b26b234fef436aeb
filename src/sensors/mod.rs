//! The rim towards the hardware and what stands in for it: logs and scenes.

pub mod history;
pub mod transforms;
