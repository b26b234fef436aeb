//! Damaged inputs of every kind against the program: `./dev attack`. docs/explanation/attack.md says what is attacked and what counts as a
//! finding.
//!
//! The campaign runs its cases in processes of their own (this same binary again), whose memory is bounded: whatever a case does
//! to its process, it is counted, and the next case runs. A seed and a number say everything about a case.

mod bytes;
mod campaign;
mod case;
mod draw;
mod fields;
#[allow(dead_code, unused_imports, reason = "the integration tests use the rest")]
#[path = "../config/other_formats.rs"]
mod foreign;
mod judge;
mod kinds;
#[allow(dead_code, reason = "the integration tests use the rest")]
#[path = "../numerics/support.rs"]
mod numerics;
#[allow(dead_code, reason = "the integration tests use the rest")]
#[path = "../replay/support.rs"]
mod support;
mod text;

mod walks;
mod worker;

use std::process::ExitCode;

/// What the campaign says to the processes that it starts.
const WORKER: &str = "--attack-worker";

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match &arguments[..] {
        [flag, rest @ ..] if flag == WORKER => worker::run(rest),
        // As any other test binary is asked.
        _ if arguments.iter().any(|argument| argument == "--list") => println!("attack: test"),
        _ if arguments.iter().any(|argument| !argument.starts_with('-') && !"attack".contains(argument.as_str())) => {}
        _ => return campaign::run(),
    }
    ExitCode::SUCCESS
}
