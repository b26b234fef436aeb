//! Settings files: what is shipped, what other tools write, what is refused and with which words.

mod fields;
mod lenses;
mod opencv_oracle;
pub mod other_formats;
mod refused;
mod robot;
