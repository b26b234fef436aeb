//! Tags every frame of a log, or of a rendered scene in its place, and writes a capture.
//!
//!     cargo run --release --example replay_log -- replay/scenes/straight.toml captures/

use std::env::args;

use realitysim_config::Settings;
use realitysim_tagging::{ReplayOptions, replay};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = args().skip(1).collect();
    let [source, captures] = &arguments[..] else {
        return Err("usage: replay_log LOG|SCENE CAPTURES".into());
    };
    let options = ReplayOptions {
        source: source.into(),
        captures: captures.into(),
        settings: Settings::default(),
        initial: None,
        threads: 2,
        realtime: false,
        warm_start: false,
    };
    let report = replay(&options, &mut |done, of| eprint!("\r{done} of {} frames", of.unwrap_or(done)))?;
    println!("\n{} of {} tags are valid: {}", report.valid, report.tagged, report.session.display());
    Ok(())
}
