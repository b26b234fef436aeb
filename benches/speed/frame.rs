//! Whole frames: from the decoded image to the tag, in one thread.

use std::path::PathBuf;

use realitysim::config::Settings;
use realitysim::localization::SimdPath;
use realitysim::tagging::{FrameCache, FrameCacheOptions};

use super::measure::{Times, told};

pub fn run(quick: bool) {
    let options = FrameCacheOptions {
        source: PathBuf::from("replay/scenes/straight.toml"),
        settings: Settings::default(),
        initial: None,
        from_s: 0.0,
        for_s: Some(if quick { 2.0 } else { 15.0 }),
    };
    let cache = FrameCache::load(&options, &mut |_, _| {}).expect("a scene of the shelf");
    let times = |adaptive: bool, simd: SimdPath| {
        let mut settings = cache.settings().clone();
        (settings.filter.adaptive, settings.filter.simd) = (adaptive, simd);
        let attempts = cache.try_out(&settings, &mut |_| {}).expect("possible settings");
        Times::of(attempts.iter().map(|attempt| attempt.tag.elapsed_ms).collect())
    };
    times(true, SimdPath::Auto);
    let [plain, fixed, adaptive] =
        [(false, SimdPath::Scalar), (false, SimdPath::Auto), (true, SimdPath::Auto)].map(|(a, s)| times(a, s));
    told("whole frame, 800 x 5 x 350 and refinement; scalar kernel", fixed, plain, "");
    told("whole frame, adaptive; 800 x 5", adaptive, fixed, "");
}
