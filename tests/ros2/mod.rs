mod damaged;
mod foreign;
mod python;
mod round_trip;
mod samples;
