//! What is not in the default build: `./dev features` builds it and runs these tests.

#[cfg(feature = "live")]
mod live;
#[cfg(feature = "query")]
mod query;
#[cfg(feature = "remote")]
mod remote;
