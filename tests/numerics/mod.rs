//! Hard cases of the numbers: each fails in a well-known library, or could fail here. One file, one kind of case;
//! docs/reference/numerics.md is their table, `table` holds it to the tests.

mod circular;
mod images;
mod laws;
mod least_squares;
mod lens;
mod oracles;
mod parameters;
mod poses;
mod quadratic;
mod resampling;
pub mod support;
mod table;
mod time;
mod weights;
