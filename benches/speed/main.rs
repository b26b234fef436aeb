//! What the parts of a frame cost, each against a reference in the same run: `cargo bench`.
//!
//! Reference and subject take turns, so that whatever slows the machine down slows both. Ratios can be compared between
//! machines, times cannot. `cargo bench -- --quick` takes seconds.

mod frame;
mod kernel;
mod look;
mod measure;
mod refine;
mod view;

use measure::Bench;

fn main() {
    let quick = std::env::args().any(|argument| argument == "--quick");
    let mut bench = Bench::new(if quick { 30 } else { 400 });
    let view = view::View::new();
    kernel::run(&mut bench, &view);
    look::run(&mut bench, &view);
    refine::run(&mut bench, &view);
    frame::run(quick);
}
