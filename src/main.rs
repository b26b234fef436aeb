//! Entry point of the program; its commands are in [`realitysim::cli`].

use std::process::ExitCode;

fn main() -> ExitCode {
    realitysim::cli::run()
}
