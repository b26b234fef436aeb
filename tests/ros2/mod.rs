pub mod damaged;
mod foreign;
mod python;
mod round_trip;
pub mod samples;
