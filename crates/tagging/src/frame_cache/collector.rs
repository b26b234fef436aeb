//! Collects the frames of a cache from the messages of a log or scene.

use std::path::Path;

use super::super::budget::Budget;
use super::{CachedFrame, Claims, FrameCache, FrameCacheOptions, Start};
use crate::checkpoint::Checkpoint;
use crate::error::ReplayError;
use crate::perception_pool::PerceptionError;
use crate::setup::Setup;
use crate::tagger::Tagger;
use realitysim_localization::LocalizerState;
use realitysim_log_input::FrameAssembler;
use realitysim_log_input::synchroniser::Frame;
use realitysim_recording::Loss;
use realitysim_ros2::mcap_read::LogMessage;
use realitysim_vision::Observations;

/// Most frames of a cache. The filter needs consecutive frames, and this many are enough to compare settings.
const MAX_FRAMES: usize = 300;
/// Most bytes of decoded pictures in a cache.
const MAX_CACHED_BYTES: usize = 1 << 30;

/// Takes messages and keeps the frames of a window of time. Frames before the window are tracked, so that the pose is known
/// at its first frame.
pub(super) struct FrameCollector {
    setup: Setup,
    assembler: FrameAssembler,
    start: Start,
    lead_in: Option<Tagger>,
    seen: Observations,
    from_ns: i64,
    for_ns: Option<i64>,
    first_ns: Option<i64>,
    last_ns: i64,
    cached: Vec<CachedFrame>,
    bytes: usize,
    /// A limit of frames or bytes was reached within the window.
    full: bool,
    /// No further frame is kept.
    past: bool,
}

impl FrameCollector {
    pub(super) fn new(options: &FrameCacheOptions, setup: Setup, checkpoint: Option<Checkpoint>) -> Self {
        let (state, known) = checkpoint.map_or_else(
            || (LocalizerState::default(), None),
            |checkpoint| (checkpoint.tagger, Some(checkpoint.synchroniser)),
        );
        let start = Start { state, initial: options.initial };
        let assembler = setup.assembler(known, options.initial.is_some());
        let nanoseconds = |seconds: f64| (seconds * 1e9) as i64;
        Self {
            setup,
            assembler,
            start,
            lead_in: None,
            seen: Observations::default(),
            from_ns: nanoseconds(options.from_s),
            for_ns: options.for_s.map(nanoseconds),
            first_ns: None,
            last_ns: i64::MIN,
            cached: Vec::new(),
            bytes: 0,
            full: false,
            past: false,
        }
    }

    pub(super) fn take_all(
        &mut self,
        messages: impl Iterator<Item = Result<LogMessage, ReplayError>>,
        progress: &mut dyn FnMut(u64),
    ) -> Result<(), ReplayError> {
        let (mut messages, mut frames) = (messages.fuse(), 0);
        while let Some(frame) = self.assembler.frames_of(&mut messages).next().transpose()? {
            frames += 1;
            self.take(frame);
            progress(frames);
            if self.past {
                break;
            }
        }
        Ok(())
    }

    fn take(&mut self, frame: Frame) {
        self.last_ns = frame.stamp_ns;
        let since_ns = frame.stamp_ns.saturating_sub(*self.first_ns.get_or_insert(frame.stamp_ns));
        if since_ns < self.from_ns {
            let Setup { settings, field, perception, .. } = &self.setup;
            let lens = perception.vision.lens();
            let tagger = self.lead_in.get_or_insert_with(|| self.start.tagger(settings, field, lens));
            CachedFrame::new(frame, lens).tag(
                0,
                &Claims::default(),
                perception,
                tagger,
                &mut Budget::default(),
                &mut self.seen,
            );
            return;
        }
        self.past |= self.for_ns.is_some_and(|length_ns| since_ns - self.from_ns >= length_ns);
        if self.past {
            return;
        }
        if self.cached.len() >= MAX_FRAMES || self.bytes >= MAX_CACHED_BYTES {
            (self.full, self.past) = (true, true);
            return;
        }
        let frame = CachedFrame::new(frame, self.setup.perception.vision.lens());
        self.bytes += frame.bytes();
        self.cached.push(frame);
    }

    fn losses(&self, source: &Path) -> Vec<Loss> {
        let mut losses = Vec::new();
        let unreadable = self.assembler.unreadable();
        if unreadable > 0 {
            let what = format!("{unreadable} messages are not what their type says");
            Loss::new(source, what).join(&mut losses);
        }
        let broken = || self.cached.iter().filter_map(|frame| frame.picture.as_ref().err());
        if let Some(PerceptionError::Decode(error)) =
            broken().find(|unseen| matches!(unseen, PerceptionError::Decode(_)))
        {
            Loss::new(source, format!("images do not decode, the first because {error}")).join(&mut losses);
        }
        losses
    }

    pub(super) fn finish(self, source: &Path) -> Result<FrameCache, ReplayError> {
        if self.cached.is_empty() {
            let told = match self.first_ns {
                None => "there is none".to_owned(),
                Some(first_ns) => {
                    let length_s = self.last_ns.saturating_sub(first_ns) as f64 * 1e-9;
                    format!("the last one comes {length_s:.1} s after the first, which is before the window begins")
                }
            };
            return Err(ReplayError::NoFrame(format!("{}: {told}", source.display())));
        }
        let losses = self.losses(source);
        let start = match self.lead_in {
            Some(tagger) => Start { state: tagger.state(), initial: None },
            None => self.start,
        };
        let Setup { settings, field, perception, .. } = self.setup;
        Ok(FrameCache {
            lens: perception.vision.lens().clone(),
            settings,
            field,
            start,
            frames: self.cached,
            apart: false,
            full: self.full,
            losses,
        })
    }
}
