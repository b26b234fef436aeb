//! Helpers that the tests of several crates share; no program depends on this crate.
//!
//! [`board_picture`] draws calibration boards through a lens. [`exact`] is an oracle: it evaluates a formula with 256 bits, and a test compares the result in `f64` with it. [`measured`]
//! holds the largest error that a test found against the figure that docs/reference/numerics.md states for it.
//!
//! ```rust
//! use realitysim_test_support::{exact::{exact, rounded}, measured::largest_error};
//!
//! // IEEE 754 has the square root rounded correctly, so it agrees with the oracle to the last bit.
//! assert_eq!(rounded(&exact(2.0).sqrt()), 2.0_f64.sqrt());
//!
//! // A test that found an error of 2e-16 holds a table that says 3e-16.
//! largest_error(2e-16, 3e-16, "m");
//! ```

pub mod board_picture;
pub mod exact;
pub mod measured;
