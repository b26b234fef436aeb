//! The recorder's thread on a disk that refuses for a while.
//!
//! The fault is named. What fits into memory is kept; what does not is counted, and a gap in the log says so where it
//! happened. When the disk works again, so does the recorder.

use std::io::ErrorKind;
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::disk::{Failure, SimulatedDisk, Trouble};
use super::run::{self, CAPTURES, is_frame, session};
use crate::gap::gaps_in;
use crate::manifest::SESSION_FILE;
use crate::repair::repair;
use crate::session_writer::{Ended, SegmentState, SessionWriter, Writing};
use crate::verify::verify;
use realitysim_ros2::mcap_read::{Channel, LogMessage};
use realitysim_ros2::messages::{CompressedImage, Imu};

const PATIENCE: Duration = Duration::from_secs(60);
/// Size of a made-up frame, bytes: a hundred fill the queue.
const FRAME_BYTES: usize = 10_000;

/// Feeds a session with frames and measurements.
struct Feeder {
    session: SessionWriter,
    image: Arc<Channel>,
    imu: Arc<Channel>,
    frames: u32,
    thinned: u32,
}

impl Feeder {
    fn start(disk: &SimulatedDisk) -> Self {
        let mut info = run::session_info();
        info.settings.recording.queue_mb = 1;
        info.settings.recording.sync_interval_ms = 20;
        let state = SegmentState { log_time_ns: 0, name: "filter_state", state: vec![1; 100] };
        let writing = Writing::Behind { bytes_per_s: 1 };
        let session = SessionWriter::create(Arc::new(disk.clone()), CAPTURES.as_ref(), "s", &info, state, writing);
        let channel = |topic: &str| Arc::new(Channel::of::<CompressedImage>(1, topic, Default::default()));
        Self {
            session: session.unwrap(),
            image: channel(run::IMAGE),
            imu: Arc::new(Channel::of::<Imu>(2, "/imu/data", Default::default())),
            frames: 0,
            thinned: 0,
        }
    }

    /// Feeds a frame and five measurements, and now and then a frame that is thinned out.
    fn feed(&mut self, disk: &SimulatedDisk) {
        disk.pass(Duration::from_millis(33));
        let at_ns = i64::from(self.frames) * 33_000_000;
        let message = |channel: &Arc<Channel>, data: Vec<u8>| LogMessage {
            channel: Arc::clone(channel),
            sequence: self.frames,
            log_time_ns: at_ns,
            publish_time_ns: at_ns,
            data,
        };
        let (frame, imu) = (message(&self.image, vec![7; FRAME_BYTES]), message(&self.imu, vec![1; 320]));
        self.session.pass(&frame, true, false).unwrap();
        for _ in 0..5 {
            self.session.pass(&imu, false, false).unwrap();
        }
        self.frames += 1;
        if self.frames.is_multiple_of(3) {
            self.session.thin_frame().unwrap();
            self.thinned += 1;
        }
    }

    /// Feeds until the condition `is` holds; `what` names it in a failure.
    fn feed_until(&mut self, disk: &SimulatedDisk, what: &str, is: impl Fn(&SessionWriter) -> bool) {
        let began = Instant::now();
        while !is(&self.session) {
            self.feed(disk);
            assert!(began.elapsed() < PATIENCE, "{what}: {:?}", self.session.status());
            std::thread::sleep(Duration::from_millis(2));
        }
    }
}

#[test]
fn a_disk_that_refuses_is_named_and_recovered_from() {
    let refusals = [
        (ErrorKind::ReadOnlyFilesystem, false, "read_only"),
        (ErrorKind::PermissionDenied, false, "no_permission"),
        (ErrorKind::NotFound, false, "disk_gone"),
        (ErrorKind::StorageFull, false, "disk_full"),
        (ErrorKind::StorageFull, true, "no_inodes"),
        (ErrorKind::Other, false, "disk_error"),
    ];
    for (kind, no_inodes, cause) in refusals {
        let disk = SimulatedDisk::new(5, Trouble::default());
        let mut feeder = Feeder::start(&disk);
        feeder.feed_until(&disk, "it writes", |session| session.status().frames_synced > 10);
        disk.trouble(Trouble { fails: vec![(0..u64::MAX, Failure::Any(kind))], no_inodes, ..Trouble::default() });
        feeder.feed_until(&disk, cause, |session| {
            session.status().fault.is_some_and(|fault| fault.cause == cause)
                && session.counts().dropped.contains_key(cause)
        });
        let lost = feeder.session.counts().lost;
        assert!(lost.is_empty(), "{cause}: frames go first, and measurements have a reserve: {lost:?}");
        assert!(feeder.session.status().conserved, "{cause}: {:?}", feeder.session.counts());
        disk.heal();
        let frames = feeder.frames;
        feeder.feed_until(&disk, "it writes again", |session| {
            session.status().fault.is_none() && session.counts().written > u64::from(frames) / 2
        });
        feeder.feed_until(&disk, "frames are taken again", |session| session.status().queue_bytes < 100_000);
        feeder.feed(&disk);
        let (fed, thinned) = (feeder.frames, feeder.thinned);
        let Ended { folder, counts, status } = feeder.session.finish();
        let folder = folder.unwrap();
        assert!(status.conserved && counts.is_conserved(), "{cause}: {counts:?}");
        assert_eq!((counts.captured, counts.thinned), (u64::from(fed + thinned), u64::from(thinned)), "{cause}");
        assert!(status.faults.contains_key(cause) && status.segments_given_up > 0, "{cause}: {status:?}");

        repair(&disk, &folder).unwrap();
        assert!(verify(&disk, &session(&disk).unwrap()).unwrap().wrong.is_empty());
        let messages = run::read(&disk, &folder);
        assert_eq!(messages.iter().filter(|message| is_frame(message)).count() as u64, counts.written, "{cause}");
        let imu = messages.iter().filter(|message| message.channel.topic == "/imu/data").count() as u32;
        assert_eq!(imu, 5 * fed, "{cause}: every measurement is there");
        assert_gaps_stand_where_frames_are_missing(&messages, counts.dropped.values().sum(), fed);
    }
}

/// While the session is recorded, somebody removes its folder, or only the segment.
#[test]
fn a_folder_that_is_removed_is_told_and_another_begun_at_once() {
    for only_the_segment in [false, true] {
        let disk = SimulatedDisk::new(5, Trouble::default());
        let mut feeder = Feeder::start(&disk);
        feeder.feed_until(&disk, "it writes", |session| session.status().frames_synced > 10);
        let removed = session(&disk).unwrap();
        disk.remove_all(&if only_the_segment { removed.join("0000.mcap.active") } else { removed.clone() });
        feeder.feed_until(&disk, "told", |session| session.counts().dropped.contains_key("removed"));
        let frames = feeder.session.counts().written;
        feeder.feed_until(&disk, "it writes again", |session| {
            session.status().fault.is_none() && session.counts().written > frames + 10
        });
        let fed = u64::from(feeder.frames + feeder.thinned);
        let Ended { folder, counts, status } = feeder.session.finish();
        let folder = folder.unwrap();
        assert!(status.conserved && counts.is_conserved() && counts.captured == fed, "{counts:?}");
        assert!(counts.dropped["removed"] > 10 && status.faults["removed"] == 1, "{counts:?} {status:?}");
        let written = run::read(&disk, &folder).iter().filter(|message| is_frame(message)).count();
        assert_eq!(written as u64, counts.written, "each frame after it, and no other");
        assert_eq!(run::counts_of_manifest(&disk, &folder).dropped, counts.dropped, "told in the log");
        let head = String::from_utf8(disk.snapshot().remove(&folder.join(SESSION_FILE)).unwrap()).unwrap();
        assert_eq!(head.contains(run::SESSION_ID), only_the_segment, "what was moved and what is new are two sessions");
        assert_eq!(folder == removed, only_the_segment);
    }
}

/// Asserts that the frames that are missing are those that a gap at that place counts.
fn assert_gaps_stand_where_frames_are_missing(messages: &[LogMessage], dropped: u64, fed: u32) {
    let (mut next, mut missing, mut told) = (0, 0, 0);
    for message in messages {
        told += gaps_in(message).iter().map(|gap| gap.frames).sum::<u64>();
        if is_frame(message) {
            missing += u64::from(message.sequence - next);
            assert_eq!(told, missing, "before frame {}", message.sequence);
            next = message.sequence + 1;
        }
    }
    assert_eq!((told, missing + u64::from(fed - next)), (dropped, dropped));
}

#[test]
fn a_disk_that_never_comes_back_does_not_hold_anybody_up() {
    let disk = SimulatedDisk::new(5, Trouble::default());
    let mut feeder = Feeder::start(&disk);
    feeder.feed_until(&disk, "it writes", |session| session.status().frames_synced > 10);
    disk.trouble(Trouble { fails: vec![(0..u64::MAX, Failure::Any(ErrorKind::Other))], ..Trouble::default() });
    feeder.feed_until(&disk, "full", |session| session.counts().dropped.contains_key("disk_error"));
    let clock = disk.clone();
    let ticking = std::thread::spawn(move || {
        for _ in 0..2000 {
            clock.pass(Duration::from_millis(10));
            std::thread::sleep(Duration::from_millis(1));
        }
    });
    let began = Instant::now();
    let fed = u64::from(feeder.frames + feeder.thinned);
    let Ended { folder, counts, status } = feeder.session.finish();
    assert!(folder.is_err());
    assert!(counts.is_conserved() && status.frames_waiting == 0, "each frame is written or told as lost: {counts:?}");
    assert_eq!(counts.captured, fed, "{counts:?}");
    assert!(began.elapsed() < Duration::from_secs(12), "{:?}", began.elapsed());
    ticking.join().unwrap();
}
