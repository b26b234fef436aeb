//! Tests of the queue while the disk stalls.

use std::sync::Arc;
use std::time::Duration;

use crate::entry::{Entry, Kind};
use crate::record_queue::{Next, QueueLimits, RecordQueue};
use realitysim_ros2::mcap_read::{Channel, LogMessage};
use realitysim_ros2::messages::{CompressedImage, FrameTag, Header, Imu, Message, Odometry, PoseWithCovarianceStamped};

const ROOM: QueueLimits = QueueLimits { frames_bytes: 1 << 20, reserve_bytes: 64 << 20 };

fn message<M: Message>(at_ns: i64, data: Vec<u8>, kind: Kind) -> Entry {
    let channel = Arc::new(Channel::of::<M>(1, "/t", Default::default()));
    Entry::Message(LogMessage { channel, sequence: 0, log_time_ns: at_ns, publish_time_ns: at_ns, data }, kind)
}

fn frame(at_ns: i64) -> Entry {
    message::<CompressedImage>(at_ns, vec![0; 80_000], Kind::Frame)
}

fn next(shared: &RecordQueue) -> Option<Entry> {
    match shared.next(Duration::ZERO) {
        Next::Write(waiting) => Some(waiting.entry),
        Next::Idle | Next::Closed => None,
    }
}

/// The sizes are those of the shipped settings; the reserve is that of config/robot.toml.
#[test]
fn a_minute_of_measurements_and_tags_waits_while_frames_are_dropped() {
    let reserve = realitysim_config::RecordingSettings::default().reserve_mb as usize;
    let shared = RecordQueue::new(QueueLimits { reserve_bytes: reserve << 20, ..ROOM });
    let tag = FrameTag { header: Header::at(0, "camera_link"), ..FrameTag::default() };
    for millisecond in 0..60_000_i64 {
        let at_ns = millisecond * 1_000_000;
        if millisecond % 2 == 0 {
            shared.offer(message::<Imu>(at_ns, Imu::default().encode(), Kind::Other), Duration::ZERO);
            shared.offer(message::<Imu>(at_ns, Imu::default().encode(), Kind::Other), Duration::ZERO);
        }
        if millisecond % 10 == 0 {
            shared.offer(message::<Odometry>(at_ns, Odometry::default().encode(), Kind::Other), Duration::ZERO);
        }
        if millisecond % 16 == 0 {
            shared.offer(frame(at_ns), Duration::ZERO);
            shared.offer(message::<FrameTag>(at_ns, tag.encode(), Kind::Tag(Some([0.0, 0.0]))), Duration::ZERO);
            let pose = PoseWithCovarianceStamped::default().encode();
            shared.offer(message::<PoseWithCovarianceStamped>(at_ns, pose, Kind::Other), Duration::ZERO);
        }
    }
    let (counts, status) = (shared.counts(), shared.status());
    assert!(counts.lost.is_empty(), "{counts:?}, {} bytes", status.queue_bytes);
    assert_eq!(counts.dropped["queue_full"], counts.captured - 13, "thirteen frames fit");
    assert!(status.conserved && status.frames_waiting == 13);
    assert!(status.queue_bytes <= status.queue_limit_bytes);
}

#[test]
fn memory_is_bounded_whatever_comes() {
    let shared = RecordQueue::new(QueueLimits { frames_bytes: 1 << 20, reserve_bytes: 1 << 20 });
    for at_ns in 0..20_000 {
        shared.offer(frame(at_ns), Duration::ZERO);
        shared.offer(message::<Imu>(at_ns, vec![0; 320], Kind::Other), Duration::ZERO);
        shared.drop_frames(if at_ns % 2 == 0 { "one" } else { "other" }, 1, at_ns, Duration::ZERO);
        shared.offer(Entry::State("s".into(), vec![0; 100_000]), Duration::ZERO);
    }
    let status = shared.status();
    assert!(status.queue_bytes <= status.queue_limit_bytes + 300 * 200, "{status:?}");
    assert!(status.conserved && !shared.counts().lost.is_empty());
}

#[test]
fn a_gap_stands_between_what_came_before_and_after() {
    let shared = RecordQueue::new(ROOM);
    (0..20).for_each(|at_ns| shared.offer(frame(at_ns), Duration::ZERO));
    let mut written = 0;
    while let Some(entry) = next(&shared) {
        shared.count_written(&entry);
        shared.release(&entry);
        written += 1;
    }
    assert_eq!(written, 13);
    shared.offer(frame(20), Duration::ZERO);
    let Some(Entry::Gap(gap)) = next(&shared) else { panic!("a gap") };
    assert_eq!((gap.cause.as_str(), gap.frames, gap.first_ns, gap.last_ns), ("queue_full", 7, 13, 19));
    assert!(next(&shared).is_some_and(|entry| entry.is_frame()));
    assert!(shared.status().conserved);
}

#[test]
fn a_gap_at_the_end_is_told_too() {
    let shared = RecordQueue::new(ROOM);
    shared.drop_frames("late", 3, 5, Duration::ZERO);
    shared.close(Duration::ZERO);
    let Some(Entry::Gap(gap)) = next(&shared) else { panic!("a gap") };
    assert_eq!((gap.cause.as_str(), gap.frames), ("late", 3));
    assert!(next(&shared).is_none() && shared.is_closed());
}
