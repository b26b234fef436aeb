//! Recordings from robots to dev machines, over real ssh and over a plain folder, whatever happens on the way.

mod bad;
mod cut;
mod folder;
mod last_copy;
mod many;
mod recorder;
mod sessions;
pub mod site;
