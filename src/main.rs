//! See [`realitysim::cli`].

use std::process::ExitCode;

fn main() -> ExitCode {
    realitysim::cli::run()
}
