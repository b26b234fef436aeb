//! Tests of the rules of capturing against a driver that follows a script, with every error code.

use std::cell::{Cell, RefCell};
use std::collections::{BTreeMap, VecDeque};
use std::io;
use std::rc::Rc;
use std::time::Duration;

use rustix::io::Errno;

use super::*;
use realitysim_ros2::messages::Header;

/// One thing that the kernel does.
enum Act {
    /// Opening fails with this error.
    Refuse(CameraError),
    /// Opening succeeds with this format.
    Negotiate(PixelFormat),
    /// A buffer is filled, this long after the last act.
    Frame {
        sequence: u32,
        after_ms: i64,
        data: Vec<u8>,
        change: fn(&mut BufferInfo),
    },
    Error(Errno),
    /// Nothing happens for this long.
    Silence {
        ms: i64,
    },
}

#[derive(Default)]
struct Script {
    acts: VecDeque<Act>,
    opened: u32,
    closed: u32,
    states_no_rate: bool,
}

#[derive(Clone)]
struct Scripted {
    script: Rc<RefCell<Script>>,
    now_ns: Rc<Cell<i64>>,
}

const SIZE: (u32, u32) = (8, 4);

impl Driver for Scripted {
    fn open(&mut self, wanted: &CameraOptions) -> Result<Negotiated, CameraError> {
        let mut script = self.script.borrow_mut();
        let mut format = wanted.format.unwrap_or(PixelFormat::Grey);
        match script.acts.pop_front() {
            Some(Act::Refuse(error)) => return Err(error),
            Some(Act::Negotiate(other)) => format = other,
            Some(other) => script.acts.push_front(other),
            None => {}
        }
        script.opened += 1;
        Ok(Negotiated {
            card: "scripted".into(),
            bus: String::new(),
            format,
            width: SIZE.0,
            height: SIZE.1,
            stride: SIZE.0,
            rate_hz: (!script.states_no_rate).then_some(30.0),
            controls: BTreeMap::new(),
            refused: Vec::new(),
        })
    }

    fn wait(&mut self, timeout: Duration) -> io::Result<bool> {
        let mut script = self.script.borrow_mut();
        match script.acts.front_mut() {
            Some(Act::Frame { after_ms, .. }) if *after_ms * 1_000_000 > timeout.as_nanos() as i64 => {
                *after_ms -= timeout.as_millis() as i64;
                self.now_ns.set(self.now_ns.get() + timeout.as_nanos() as i64);
                Ok(false)
            }
            Some(Act::Frame { .. } | Act::Error(_)) => Ok(true),
            Some(Act::Silence { ms }) => {
                self.now_ns.set(self.now_ns.get() + timeout.as_nanos() as i64);
                *ms -= timeout.as_millis() as i64;
                if *ms <= 0 {
                    script.acts.pop_front();
                }
                Ok(false)
            }
            Some(Act::Refuse(_) | Act::Negotiate(_)) | None => {
                self.now_ns.set(self.now_ns.get() + timeout.as_nanos() as i64);
                Ok(false)
            }
        }
    }

    fn take(&mut self, into: &mut Vec<u8>) -> io::Result<BufferInfo> {
        match self.script.borrow_mut().acts.pop_front() {
            Some(Act::Frame { sequence, after_ms, data, change }) => {
                self.now_ns.set(self.now_ns.get() + after_ms * 1_000_000);
                *into = data;
                let stamp_ns = self.now_ns.get() - 2_000_000;
                let mut info = BufferInfo {
                    sequence,
                    stamp_ns,
                    is_monotonic: true,
                    is_start_of_exposure: true,
                    is_damaged: false,
                };
                change(&mut info);
                Ok(info)
            }
            Some(Act::Error(errno)) => Err(errno.into()),
            _ => panic!("nothing is ready"),
        }
    }

    fn close(&mut self) {
        self.script.borrow_mut().closed += 1;
    }
}

fn frame(sequence: u32, after_ms: i64) -> Act {
    Act::Frame { sequence, after_ms, data: vec![7; 32], change: |_| {} }
}

fn options(format: Option<PixelFormat>) -> CameraOptions {
    let (width, height) = SIZE;
    CameraOptions { device: "/dev/x".into(), width, height, format, rate_hz: 30.0, controls: BTreeMap::new() }
}

/// What happened during a script, and how often the device was opened and closed.
struct Run {
    frames: Vec<Frame>,
    formats: Vec<PixelFormat>,
    lost: Vec<&'static str>,
    waits_ms: Vec<u128>,
    dropped: BTreeMap<&'static str, u64>,
    opened: u32,
    closed: u32,
}

/// Captures until the script is over.
fn run(acts: Vec<Act>, max_rate_hz: Option<f64>, format: Option<PixelFormat>) -> Run {
    let now_ns = Rc::new(Cell::new(1_000_000_000_000));
    let script = Rc::new(RefCell::new(Script { acts: acts.into(), ..Script::default() }));
    let driver = Scripted { script: Rc::clone(&script), now_ns: Rc::clone(&now_ns) };
    let mut capture = Capture::new(driver, CaptureRules { options: options(format), max_rate_hz });
    let mut run = Run {
        frames: vec![],
        formats: vec![],
        lost: vec![],
        waits_ms: vec![],
        dropped: BTreeMap::new(),
        opened: 0,
        closed: 0,
    };
    for _ in 0..10_000 {
        if script.borrow().acts.is_empty() {
            break;
        }
        now_ns.set(now_ns.get() + capture.idle(now_ns.get()).as_nanos() as i64);
        capture.step(
            || now_ns.get(),
            |event| match event {
                CaptureEvent::Opened(negotiated) => run.formats.push(negotiated.format),
                CaptureEvent::Frame(frame) => run.frames.push(frame),
                CaptureEvent::Lost { error, retry_in } => {
                    assert!(error.to_string().starts_with("/dev/x"), "{error}");
                    run.lost.push(error.cause());
                    run.waits_ms.push(retry_in.as_millis());
                }
                CaptureEvent::Dropped(cause, count) => *run.dropped.entry(cause.cause()).or_default() += count,
            },
        );
    }
    assert!(script.borrow().acts.is_empty(), "the script did not end");
    (run.opened, run.closed) = (script.borrow().opened, script.borrow().closed);
    run
}

#[test]
fn every_error_code_is_a_beginning_anew() {
    for errno in 1..=133 {
        let errno = Errno::from_raw_os_error(errno);
        let run = run(vec![frame(0, 33), Act::Error(errno), frame(0, 33), frame(1, 33)], None, None);
        assert_eq!(run.frames.len(), 3, "{errno:?}");
        if errno == Errno::INTR {
            assert_eq!((run.opened, run.lost.len()), (1, 0), "a signal is no fault");
            continue;
        }
        assert_eq!((run.opened, run.closed, run.lost.len()), (2, 1, 1), "{errno:?}");
        let cause = match errno {
            Errno::NODEV | Errno::NXIO => "unplugged",
            Errno::BUSY | Errno::ADDRINUSE => "busy",
            Errno::ACCESS | Errno::PERM => "no_permission",
            Errno::TIMEDOUT => "stalled",
            _ => "io",
        };
        assert_eq!(run.lost, [cause], "{errno:?}");
        assert!(run.dropped.is_empty(), "numbers that begin anew are no gap: {:?}", run.dropped);
    }
}

#[test]
fn it_is_tried_less_and_less_often_until_frames_come_again() {
    let missing = || Act::Refuse(CameraError::Missing { device: "/dev/x".into(), present: "none".into() });
    let mut acts: Vec<Act> = (0..8).map(|_| missing()).collect();
    acts.extend([frame(0, 33), Act::Error(Errno::IO), frame(0, 33)]);
    let run = run(acts, None, None);
    assert_eq!(run.waits_ms, [100, 200, 400, 800, 1600, 2000, 2000, 2000, 100]);
    assert_eq!(run.frames.len(), 2);
}

#[test]
fn a_camera_that_opens_and_never_sends_is_not_hammered() {
    let run = run((0..4).flat_map(|_| [Act::Error(Errno::IO)]).collect(), None, None);
    assert_eq!(run.waits_ms, [100, 200, 400, 800]);
}

#[test]
fn silence_is_a_stall() {
    let run = run(vec![frame(0, 33), Act::Silence { ms: 1_500 }, frame(1, 33)], None, None);
    assert_eq!((run.lost, run.frames.len(), run.opened), (vec!["stalled"], 2, 2));
}

#[test]
fn the_newest_frame_counts_and_the_others_are_counted() {
    let run = run(vec![frame(0, 33), frame(1, 0), frame(2, 0), frame(5, 33)], None, None);
    let sequences: Vec<u32> = run.frames.iter().map(|frame| frame.sequence).collect();
    assert_eq!(sequences, [2, 5]);
    assert_eq!(run.dropped, BTreeMap::from([("skipped", 2), ("camera", 2)]));
}

#[test]
fn every_frame_that_the_camera_made_is_delivered_or_counted() {
    let mut noise = 1u64;
    let mut acts = Vec::new();
    let mut sequence = 0;
    for _ in 0..2_000 {
        noise = noise.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let random = noise >> 40;
        sequence += 1 + u32::from(random.is_multiple_of(7)) * (random % 5) as u32;
        let bytes = if random.is_multiple_of(11) { 31 } else { 32 };
        let change: fn(&mut BufferInfo) =
            if random.is_multiple_of(13) { |info| info.is_damaged = true } else { |_| {} };
        let after_ms = if random.is_multiple_of(3) { 0 } else { 33 };
        acts.push(Act::Frame { sequence, after_ms, data: vec![0; bytes], change });
    }
    let run = run(acts, Some(10.0), None);
    let dropped: u64 = run.dropped.values().sum();
    // Counting begins with the first number.
    let first = 1;
    assert_eq!(run.frames.len() as u64 + dropped, u64::from(sequence - first + 1), "{:?}", run.dropped);
    assert_eq!(run.dropped.len(), 4, "each cause: {:?}", run.dropped);
}

#[test]
fn a_rate_is_kept_on_average_and_what_is_over_is_counted() {
    let acts = (0..300).map(|sequence| frame(sequence, 33)).collect();
    let run = run(acts, Some(10.0), None);
    assert_eq!(run.frames.len() as u64 + run.dropped["rate"], 300);
    assert!((95..=105).contains(&run.frames.len()), "{}", run.frames.len());
}

#[test]
fn stamps_say_whose_they_are() {
    let clocks = |change: fn(&mut BufferInfo)| {
        let acts = vec![Act::Frame { sequence: 0, after_ms: 33, data: vec![0; 32], change }];
        let frame = run(acts, None, None).frames.remove(0);
        (frame.clock, frame.stamp_ns)
    };
    let arrived_ns = 1_000_033_000_000;
    assert_eq!(clocks(|_| {}), (StampClock::StartOfExposure, arrived_ns - 2_000_000));
    assert_eq!(clocks(|info| info.is_start_of_exposure = false).0, StampClock::EndOfFrame);
    assert_eq!(clocks(|info| info.is_monotonic = false), (StampClock::Arrival, arrived_ns));
    assert_eq!(clocks(|info| info.stamp_ns += 3_000_000_000), (StampClock::Arrival, arrived_ns));
    assert_eq!(clocks(|info| info.stamp_ns = 0), (StampClock::Arrival, arrived_ns));
    // The kernel's driver vivid delivers a frame before the end that its stamp states.
    let ahead = clocks(|info| (info.stamp_ns, info.is_start_of_exposure) = (info.stamp_ns + 30_000_000, false));
    assert_eq!(ahead, (StampClock::EndOfFrame, arrived_ns + 28_000_000));
}

#[test]
fn a_camera_may_come_back_with_another_format() {
    let jpeg = jpeg();
    let torn = jpeg[..jpeg.len() / 2].to_vec();
    let compressed = |sequence, data| Act::Frame { sequence, after_ms: 33, data, change: |_| {} };
    let acts = vec![
        frame(0, 33),
        Act::Error(Errno::NODEV),
        Act::Refuse(CameraError::Missing { device: "/dev/x".into(), present: "none".into() }),
        Act::Negotiate(PixelFormat::Mjpeg),
        compressed(0, jpeg),
        // Longer than a gray frame, but an incomplete JPEG.
        compressed(1, torn),
        Act::Error(Errno::NODEV),
        frame(0, 33),
    ];
    let run = run(acts, None, None);
    assert_eq!(run.formats, [PixelFormat::Grey, PixelFormat::Mjpeg, PixelFormat::Grey]);
    assert_eq!(run.lost, ["unplugged", "missing", "unplugged"]);
    assert_eq!((run.frames.len(), run.dropped), (3, BTreeMap::from([("torn", 1)])));
}

#[test]
fn a_stamp_that_goes_back_or_stands_still_is_of_no_use() {
    let stamped =
        |sequence, change: fn(&mut BufferInfo)| Act::Frame { sequence, after_ms: 33, data: vec![0; 32], change };
    let back: fn(&mut BufferInfo) = |info| info.stamp_ns -= 500_000_000;
    let run = run(
        vec![frame(0, 33), stamped(1, back), stamped(2, |info| info.stamp_ns -= 66_000_000), frame(3, 33)],
        None,
        None,
    );
    let clocks: Vec<StampClock> = run.frames.iter().map(|frame| frame.clock).collect();
    use StampClock::{Arrival, StartOfExposure};
    assert_eq!(clocks, [StartOfExposure, Arrival, Arrival, StartOfExposure]);
    assert!(run.frames.is_sorted_by_key(|frame| frame.stamp_ns));
}

#[test]
fn a_camera_that_does_not_say_its_rate_has_that_which_was_asked_for() {
    let mut slow = options(None);
    slow.rate_hz = 0.5;
    let now_ns = Rc::new(Cell::new(1_000_000_000_000));
    let acts = VecDeque::from([frame(0, 33), Act::Silence { ms: 9_000 }, frame(1, 33)]);
    let script = Rc::new(RefCell::new(Script { acts, states_no_rate: true, ..Script::default() }));
    let driver = Scripted { script: Rc::clone(&script), now_ns: Rc::clone(&now_ns) };
    let mut capture = Capture::new(driver, CaptureRules { options: slow, max_rate_hz: None });
    let mut frames = 0;
    while !script.borrow().acts.is_empty() {
        capture.step(
            || now_ns.get(),
            |event| match event {
                CaptureEvent::Frame(_) => frames += 1,
                CaptureEvent::Lost { error, .. } => panic!("{error}"),
                _ => {}
            },
        );
    }
    assert_eq!(frames, 2);
}

fn jpeg() -> Vec<u8> {
    let mut data = Vec::new();
    let pixels: Vec<u8> = (0..64 * 48 * 3).map(|i| (i * 7 % 251) as u8).collect();
    jpeg_encoder::Encoder::new(&mut data, 90).encode(&pixels, 64, 48, jpeg_encoder::ColorType::Rgb).expect("encoded");
    data
}

#[test]
fn a_jpeg_that_is_cut_anywhere_is_torn() {
    let whole = jpeg();
    assert!(is_whole(&whole));
    for length in 0..whole.len() - 1 {
        assert!(!is_whole(&whole[..length]), "{length} of {}", whole.len());
    }
    // The whole buffer, from a driver that does not state how much of it is used.
    assert!(is_whole(&[whole.clone(), vec![0; 1_000]].concat()));
    assert!(!is_whole(&[&[0u8][..], &whole].concat()), "something stands before it");
    let run = run(
        [whole.clone(), whole[..whole.len() / 2].to_vec(), whole]
            .into_iter()
            .enumerate()
            .map(|(index, data)| Act::Frame { sequence: index as u32, after_ms: 33, data, change: |_| {} })
            .collect(),
        None,
        Some(PixelFormat::Mjpeg),
    );
    assert_eq!((run.frames.len(), run.dropped), (2, BTreeMap::from([("torn", 1)])));
}

#[test]
fn no_bytes_make_the_look_at_a_jpeg_panic() {
    let whole = jpeg();
    for at in 0..whole.len().min(700) {
        for value in [0x00, 0xff, 0xd9, 0x01] {
            let mut data = whole.clone();
            data[at] = value;
            is_whole(&data);
        }
    }
}

/// A gray ramp with one colour gives the same picture in each format.
#[test]
fn raw_formats_become_the_same_picture() {
    let (width, height, stride) = (64u32, 48u32, 80u32);
    let luma = |u: usize, v: usize| (60 + u + 2 * v) as u8;
    let (cb, cr) = (100u8, 150u8);
    let message = |format: PixelFormat, stride: u32, data: Vec<u8>, quality: Option<u8>| {
        let camera = Negotiated {
            card: String::new(),
            bus: String::new(),
            format,
            width,
            height,
            stride,
            rate_hz: None,
            controls: BTreeMap::new(),
            refused: Vec::new(),
        };
        let frame = Frame { data, stamp_ns: 0, clock: StampClock::Arrival, sequence: 0 };
        image_message(frame, &camera, quality, Header::default()).expect("encoded")
    };
    let mut yuyv = vec![0; 2 * stride as usize * height as usize];
    let mut nv12 = vec![0; stride as usize * height as usize * 3 / 2];
    for v in 0..height as usize {
        for u in 0..width as usize {
            let at = 2 * stride as usize * v + 2 * u;
            (yuyv[at], yuyv[at + 1]) = (luma(u, v), if u % 2 == 0 { cb } else { cr });
            nv12[stride as usize * v + u] = luma(u, v);
            nv12[stride as usize * (height as usize + v / 2) + u] = if u % 2 == 0 { cb } else { cr };
        }
    }
    for (format, stride, data) in [(PixelFormat::Yuyv, 2 * stride, yuyv), (PixelFormat::Nv12, stride, nv12)] {
        let ImageMessage::Compressed(image) = message(format, stride, data, Some(95)) else { panic!("a JPEG") };
        let rgb = image::load_from_memory(&image.data).expect("decodes").to_rgb8();
        for (u, v, pixel) in rgb.enumerate_pixels() {
            let (y, b, r) = (f64::from(luma(u as usize, v as usize)), f64::from(cb) - 128.0, f64::from(cr) - 128.0);
            // The conversion of ITU-R BT.601, as in JFIF.
            let expected = [y + 1.402 * r, y - 0.344_136 * b - 0.714_136 * r, y + 1.772 * b];
            for (found, expected) in pixel.0.into_iter().zip(expected) {
                assert!((f64::from(found) - expected).abs() < 6.0, "{format:?} at {u}, {v}: {found} for {expected}");
            }
        }
    }
    let grey: Vec<u8> = vec![9; stride as usize * height as usize];
    let ImageMessage::Raw(raw) = message(PixelFormat::Grey, stride, grey, None) else { panic!("raw") };
    assert_eq!((raw.encoding.as_str(), raw.step, raw.width), ("mono8", stride, width));
}

/// What was passed on to a sink, and what it does: it may fail to open, be full, or break.
#[derive(Default)]
struct SinkState {
    frames: Vec<(u32, i64, Vec<u8>)>,
    opened: u32,
    closed: u32,
    missing: bool,
    full: bool,
    broken: bool,
}

struct ScriptedSink(Rc<RefCell<SinkState>>);

impl Sink for ScriptedSink {
    fn open(&mut self, _: &Negotiated) -> io::Result<()> {
        let mut sink = self.0.borrow_mut();
        if sink.missing {
            return Err(io::ErrorKind::NotFound.into());
        }
        sink.opened += 1;
        Ok(())
    }

    fn write(&mut self, data: &[u8], info: &BufferInfo) -> io::Result<bool> {
        let mut sink = self.0.borrow_mut();
        if sink.broken {
            return Err(Errno::IO.into());
        }
        if !sink.full {
            sink.frames.push((info.sequence, info.stamp_ns, data.to_vec()));
        }
        Ok(!sink.full)
    }

    fn close(&mut self) {
        self.0.borrow_mut().closed += 1;
    }
}

/// Passes on a camera's frames, `count` of them; `change` is called before each.
fn pass_on(
    count: u32,
    change: impl Fn(u32, &mut SinkState),
) -> (Rc<RefCell<SinkState>>, std::sync::Arc<Republished>, u32) {
    let now_ns = Rc::new(Cell::new(1_000_000_000_000));
    let acts = (0..count).map(|sequence| Act::Frame {
        sequence,
        after_ms: 33,
        data: vec![sequence as u8; if sequence == 3 { 31 } else { 32 }],
        change: |_| {},
    });
    let script = Rc::new(RefCell::new(Script { acts: acts.collect(), ..Script::default() }));
    let sink = Rc::new(RefCell::new(SinkState::default()));
    let report = std::sync::Arc::new(Republished::default());
    let camera = Scripted { script: Rc::clone(&script), now_ns: Rc::clone(&now_ns) };
    let driver = Republishing::new(camera, ScriptedSink(Rc::clone(&sink)), std::sync::Arc::clone(&report));
    let mut capture = Capture::new(driver, CaptureRules { options: options(None), max_rate_hz: Some(5.0) });
    let mut delivered = 0;
    while !script.borrow().acts.is_empty() {
        change(count - script.borrow().acts.len() as u32, &mut sink.borrow_mut());
        capture.step(|| now_ns.get(), |event| delivered += u32::from(matches!(event, CaptureEvent::Frame(_))));
    }
    (sink, report, delivered)
}

#[test]
fn every_frame_is_passed_on_untouched_whatever_is_recorded_of_it() {
    let (sink, report, delivered) = pass_on(30, |_, _| {});
    assert!(delivered < 10, "{delivered}: most are over the rate");
    let sink = sink.borrow();
    let sequences: Vec<u32> = sink.frames.iter().map(|(sequence, ..)| *sequence).collect();
    assert_eq!(sequences, (0..30).collect::<Vec<u32>>(), "torn ones and those over the rate too");
    for (sequence, stamp_ns, data) in &sink.frames {
        assert_eq!(*stamp_ns, 1_000_000_000_000 + (i64::from(*sequence) + 1) * 33_000_000 - 2_000_000);
        assert!(data.iter().all(|value| *value == *sequence as u8));
    }
    assert_eq!((report.passed(), report.missed(), report.lost()), (30, 0, None));
}

#[test]
fn a_broken_or_full_republishing_device_costs_no_recorded_frame() {
    let recorded = pass_on(100, |_, _| {}).2;
    let (sink, report, delivered) = pass_on(100, |frame, sink| sink.missing = frame < 50);
    assert_eq!((delivered, sink.borrow().opened), (recorded, 1));
    assert_eq!(report.passed() + report.missed(), 100);
    assert!(report.passed() >= 20 && report.lost().is_none(), "tried again: {report:?}");
    let (_, report, delivered) = pass_on(100, |_, sink| sink.full = true);
    assert_eq!((delivered, report.passed(), report.missed(), report.lost()), (recorded, 0, 100, None));
    let (sink, report, delivered) = pass_on(100, |frame, sink| sink.broken = frame >= 50);
    assert_eq!((delivered, report.passed()), (recorded, 50));
    assert!(report.lost().is_some() && sink.borrow().closed >= 1, "{report:?}");
}
