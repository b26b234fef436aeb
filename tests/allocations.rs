//! What a steady stream of frames asks of the allocator. A program of its own: it counts every allocation of its threads.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::collections::BTreeMap;
use std::io;
use std::path::PathBuf;
use std::time::Duration;

use realitysim::config::Settings;
use realitysim::devices::camera::{
    BufferInfo, CameraError, CameraOptions, Capture, CaptureEvent, CaptureRules, Driver, Negotiated, PixelFormat,
};
use realitysim::tagging::{FrameCache, FrameCacheOptions};

struct Counting;

thread_local! {
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
}

#[allow(unsafe_code, reason = "an allocator is unsafe by its trait")]
// SAFETY: every call is passed on to the system's allocator as it came.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.set(ALLOCATIONS.get() + 1);
        unsafe { System.alloc(layout) }
    }

    unsafe fn realloc(&self, place: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        ALLOCATIONS.set(ALLOCATIONS.get() + 1);
        unsafe { System.realloc(place, layout, size) }
    }

    unsafe fn dealloc(&self, place: *mut u8, layout: Layout) {
        unsafe { System.dealloc(place, layout) }
    }
}

#[global_allocator]
static COUNTING: Counting = Counting;

/// A frame each time it is asked; every seventh comes with another one behind it, every eleventh is torn.
struct Steady {
    number: u32,
    waiting: bool,
}

const SIZE: (u32, u32) = (640, 480);

impl Driver for Steady {
    fn open(&mut self, wanted: &CameraOptions) -> Result<Negotiated, CameraError> {
        Ok(Negotiated {
            card: String::new(),
            bus: String::new(),
            format: PixelFormat::Grey,
            width: wanted.width,
            height: wanted.height,
            stride: wanted.width,
            rate_hz: Some(30.0),
            controls: BTreeMap::new(),
            refused: Vec::new(),
        })
    }

    fn wait(&mut self, timeout: Duration) -> io::Result<bool> {
        self.waiting |= !timeout.is_zero() || self.number.is_multiple_of(7);
        Ok(self.waiting)
    }

    fn take(&mut self, into: &mut Vec<u8>) -> io::Result<BufferInfo> {
        self.waiting = false;
        self.number += 1;
        into.clear();
        into.resize((SIZE.0 * SIZE.1) as usize, self.number as u8);
        let stamp_ns = i64::from(self.number) * 33_000_000;
        let is_damaged = self.number.is_multiple_of(11);
        Ok(BufferInfo { sequence: self.number, stamp_ns, is_monotonic: true, is_start_of_exposure: true, is_damaged })
    }

    fn close(&mut self) {}
}

#[test]
fn capturing_a_steady_stream_allocates_nothing() {
    let options = CameraOptions {
        device: "steady".to_owned(),
        width: SIZE.0,
        height: SIZE.1,
        format: None,
        rate_hz: 30.0,
        controls: BTreeMap::new(),
    };
    let rules = CaptureRules { options, max_rate_hz: Some(20.0) };
    let mut capture = Capture::new(Steady { number: 0, waiting: false }, rules);
    let now_ns = Cell::new(0);
    let (mut frames, mut dropped, mut done) = (0, 0, None);
    let mut steps = |count: usize| {
        for _ in 0..count {
            now_ns.set(now_ns.get() + 33_000_000);
            capture.step(
                || now_ns.get(),
                |event| match event {
                    CaptureEvent::Frame(frame) => {
                        frames += 1;
                        done = Some(frame.data);
                    }
                    CaptureEvent::Dropped(_, count) => dropped += count,
                    CaptureEvent::Opened(_) | CaptureEvent::Lost { .. } => {}
                },
            );
            if let Some(data) = done.take() {
                capture.give_back(data);
            }
        }
    };
    steps(50);
    let before = ALLOCATIONS.get();
    steps(1_000);
    assert_eq!(ALLOCATIONS.get() - before, 0, "allocations");
    assert!(frames > 300 && dropped > 300, "{frames} frames, {dropped} dropped");
}

/// Looking, filtering and refining allocate nothing; a tag's names (frames, model, formula) are strings of its own.
#[test]
fn tagging_a_frame_allocates_the_names_in_its_tag_and_nothing_else() {
    let options = FrameCacheOptions {
        source: PathBuf::from("replay/scenes/straight.toml"),
        settings: Settings::default(),
        initial: None,
        from_s: 0.0,
        for_s: Some(4.0),
    };
    let cache = FrameCache::load(&options, &mut |_, _| {}).expect("a scene of the shelf");
    let (mut counts, mut last) = (Vec::with_capacity(100), 0);
    cache
        .try_out(cache.settings(), &mut |_| {
            let now = ALLOCATIONS.get();
            counts.push(now - last);
            last = now;
        })
        .expect("possible settings");
    let mut steady = counts[10..].to_vec();
    steady.sort_unstable();
    println!("allocations a frame: {} at the median, {:?} at the most", steady[steady.len() / 2], steady.last());
    assert!(steady.iter().all(|count| *count <= NAMES), "{steady:?}");
}

const NAMES: u64 = 4;
