//! The serial path end to end over a pty: at the other end pymavlink, which shares no code with this program.

use std::io::Write;
use std::os::fd::OwnedFd;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use mavlink::dialects::common::{ATTITUDE_QUATERNION_DATA, MavMessage};
use mavlink::{MAVLinkV2MessageRaw, MavHeader};
use realitysim::devices::clock::Source;
use realitysim::devices::mavlink::Content;
use realitysim::devices::serial::{LineStatus, Measured, PortEvent, PortOptions, SerialError, run};
use rustix::fs::{Mode, OFlags};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};

/// Two ptys joined back to back: a null-modem cable, each of whose ends is a name.
pub struct Cable {
    pub ends: [String; 2],
    /// Held open, so that a reader may come and go.
    _held: [OwnedFd; 2],
    stop: std::sync::Arc<AtomicBool>,
    pump: Option<std::thread::JoinHandle<()>>,
}

impl Cable {
    pub fn new() -> Self {
        let masters = [0, 1].map(|_| {
            // Of this process alone: what a child of another test inherits would outlive this one.
            let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).expect("a pty");
            grantpt(&master).and_then(|()| unlockpt(&master)).expect("unlocked");
            rustix::fs::fcntl_setfl(&master, OFlags::RDWR | OFlags::NONBLOCK).expect("no waiting");
            master
        });
        let opened = masters.each_ref().map(|master| {
            let name = ptsname(master, Vec::new()).expect("a name").into_string().expect("ASCII");
            // Raw from the start: an echo would answer for the device.
            let end = rustix::fs::open(name.as_str(), OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC, Mode::empty())
                .expect("end");
            let mut modes = rustix::termios::tcgetattr(&end).expect("modes");
            modes.make_raw();
            rustix::termios::tcsetattr(&end, rustix::termios::OptionalActions::Now, &modes).expect("raw");
            (name, end)
        });
        let [(one, held_one), (other, held_other)] = opened;
        let stop = std::sync::Arc::new(AtomicBool::new(false));
        let stopped = std::sync::Arc::clone(&stop);
        let pump = std::thread::spawn(move || carry(&masters, &stopped));
        Self { ends: [one, other], _held: [held_one, held_other], stop, pump: Some(pump) }
    }
}

fn carry(masters: &[OwnedFd; 2], stop: &AtomicBool) {
    use rustix::event::{PollFd, PollFlags, Timespec, poll};
    let mut buffer = [0u8; 4096];
    while !stop.load(Ordering::Relaxed) {
        let mut waiting = [PollFd::new(&masters[0], PollFlags::IN), PollFd::new(&masters[1], PollFlags::IN)];
        let patience = Timespec { tv_sec: 0, tv_nsec: 20_000_000 };
        if poll(&mut waiting, Some(&patience)).is_err() {
            return;
        }
        let ready = waiting.each_ref().map(|fd| fd.revents().contains(PollFlags::IN));
        for (from, to) in [(0, 1), (1, 0)] {
            if ready[from] {
                let count = rustix::io::read(&masters[from], &mut buffer).unwrap_or(0);
                let mut rest = &buffer[..count];
                while !rest.is_empty() && !stop.load(Ordering::Relaxed) {
                    match rustix::io::write(&masters[to], rest) {
                        Ok(written) => rest = &rest[written..],
                        // Nobody reads at the other end: the cable can be unplugged all the same.
                        Err(rustix::io::Errno::AGAIN) => std::thread::sleep(Duration::from_millis(5)),
                        Err(_) => break,
                    }
                }
            }
        }
    }
}

impl Drop for Cable {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        let _ = self.pump.take().map(std::thread::JoinHandle::join);
    }
}

fn microcontroller(tty: &str, seconds: f64, corrupt_percent: f64) -> Option<Child> {
    let python = std::env::var("REALITYSIM_PYTHON").ok();
    if python.is_none() {
        assert!(std::env::var("CI").is_err(), "REALITYSIM_PYTHON is not set: `./dev test` sets it");
        eprintln!("skipped: REALITYSIM_PYTHON is not set (`./dev test` sets it)");
    }
    let mut command = Command::new(python?);
    command.args(["tests/serial/microcontroller.py", tty, &seconds.to_string(), &corrupt_percent.to_string()]);
    Some(command.stdout(Stdio::piped()).spawn().expect("Python"))
}

struct Heard {
    measured: Vec<Measured>,
    status: LineStatus,
    losses: Vec<SerialError>,
}

/// For as long as `going_on`.
fn listen(device: &str, baud: u32, mut going_on: impl FnMut() -> bool + Send) -> Heard {
    let options = PortOptions { device: device.to_owned(), baud, system: 1, poses: None };
    let stop = AtomicBool::new(false);
    let (mut measured, mut status, mut losses) = (Vec::new(), None, Vec::new());
    std::thread::scope(|scope| {
        scope.spawn(|| {
            while going_on() {
                std::thread::sleep(Duration::from_millis(20));
            }
            stop.store(true, Ordering::Relaxed);
        });
        run(&options, &stop, |event| match event {
            PortEvent::Opened { .. } => {}
            PortEvent::Lost(error) => losses.push(error),
            PortEvent::Measured(one) => measured.push(one),
            PortEvent::Status(now) => status = Some(now),
        });
    });
    Heard { measured, status: status.expect("told at the end"), losses }
}

/// What the sender says it did, after all of it was heard.
fn conversation(baud: u32, seconds: f64, corrupt_percent: f64) -> Option<(Heard, serde_json::Value)> {
    let cable = Cable::new();
    let mut child = microcontroller(&cable.ends[0], seconds, corrupt_percent)?;
    let mut after = None;
    let heard = listen(&cable.ends[1], baud, || {
        if child.try_wait().expect("a child").is_some() {
            after.get_or_insert_with(Instant::now);
        }
        after.is_none_or(|since: Instant| since.elapsed() < Duration::from_millis(300))
    });
    let output = child.wait_with_output().expect("ended");
    assert!(output.status.success());
    Some((heard, serde_json::from_slice(&output.stdout).expect("JSON")))
}

#[test]
fn what_pymavlink_sends_is_measured_on_the_host_s_clock() {
    let Some((heard, said)) = conversation(921_600, 4.0, 0.0) else { return };
    let counts = &heard.status.counts;
    let sent: std::collections::BTreeMap<String, u64> = serde_json::from_value(said["sent"].clone()).expect("counts");
    let used: std::collections::BTreeMap<String, u64> =
        counts.used.iter().map(|(name, count)| (name.to_string(), *count)).collect();
    assert_eq!(used, sent);
    assert_eq!((counts.lost, counts.frames.crc_failures, counts.frames.bytes_skipped), (0, 0, 0));
    assert!(heard.losses.is_empty(), "{:?}", heard.losses);
    let clock = heard.status.clocks.iter().find(|clock| clock.clock.exchanges > 5).expect("asked and answered");
    assert_eq!(clock.clock.source, Source::Timesync);
    // Both read the same clock of the machine: what is left is the way through two ptys.
    let error_ns = clock.clock.offset_ns - said["offset_ns"].as_i64().expect("a number");
    assert!(error_ns.abs() < 10_000_000, "{error_ns} ns");
    assert!(error_ns.abs() <= clock.clock.uncertainty_ns + 500_000, "{error_ns} ns of {}", clock.clock.uncertainty_ns);
    let pan = heard.measured.iter().find_map(|one| match one.content {
        Content::Head(head) => Some(head.pan),
        _ => None,
    });
    assert!((pan.expect("a head") + 0.2).abs() < 1e-4, "to the right is negative");
    // In three frames by turns, and always the same walk.
    let walked = heard.measured.iter().filter_map(|one| match &one.content {
        Content::Odometry(step) => Some(step.odom_from_body),
        _ => None,
    });
    let walked: Vec<_> = walked.collect();
    assert!(walked.iter().all(|pose| (pose.translation.y - 0.5).abs() < 1e-6 && pose.euler().yaw.abs() < 1e-6));
    assert!(walked.is_sorted_by(|one, next| one.translation.x < next.translation.x), "{walked:?}");
    let x = walked.last().expect("odometry").translation.x;
    assert!((0.8..1.0).contains(&x), "{x}");
}

#[test]
fn a_line_that_corrupts_is_survived_and_counted() {
    for percent in [0.5, 2.0, 10.0] {
        let Some((heard, said)) = conversation(3_000_000, 1.5, percent) else { return };
        let counts = &heard.status.counts;
        let sent: u64 = said["sent"].as_object().expect("counts").values().filter_map(serde_json::Value::as_u64).sum();
        let used: u64 = counts.used.values().sum();
        assert!(used > 0 && used < sent, "{percent} %: {used} of {sent}");
        assert!(counts.lost > 0 && counts.frames.crc_failures > 0 && counts.frames.bytes_skipped > 0, "{counts:?}");
    }
}

/// Three million baud without a pause: 300 bytes a millisecond.
#[test]
fn at_full_rate_the_messages_that_were_not_hit_are_read() {
    let mut noise = 1u64;
    let mut draw = move || {
        noise = noise.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (noise >> 11) as f64 / (1u64 << 53) as f64
    };
    for percent in [0.0, 1.0, 10.0] {
        let (mut bytes, mut untouched) = (Vec::new(), 0);
        let mut header = MavHeader { system_id: 1, component_id: 1, sequence: 0 };
        for number in 0..4_000u32 {
            let attitude =
                ATTITUDE_QUATERNION_DATA { time_boot_ms: number, q1: 1.0, ..ATTITUDE_QUATERNION_DATA::DEFAULT };
            let mut raw = MAVLinkV2MessageRaw::new();
            raw.serialize_message(header, &MavMessage::ATTITUDE_QUATERNION(attitude));
            header.sequence = header.sequence.wrapping_add(1);
            let sent = raw.raw_bytes();
            let hit: Vec<u8> = sent.iter().map(|b| if draw() * 100.0 < percent { b ^ 0x55 } else { *b }).collect();
            untouched += u64::from(hit == sent);
            bytes.extend(hit);
        }
        let cable = Cable::new();
        let mut line = std::fs::OpenOptions::new().write(true).open(&cable.ends[0]).expect("the line");
        let mut after = None;
        let mut sender = Some(std::thread::spawn(move || {
            let began = Instant::now();
            for (millisecond, piece) in bytes.chunks(300).enumerate() {
                std::thread::sleep(Duration::from_millis(100 + millisecond as u64).saturating_sub(began.elapsed()));
                line.write_all(piece).expect("sent");
            }
        }));
        let heard = listen(&cable.ends[1], 3_000_000, || {
            if sender.as_ref().is_some_and(std::thread::JoinHandle::is_finished) {
                sender.take().expect("once").join().expect("sent");
                after = Some(Instant::now());
            }
            after.is_none_or(|since: Instant| since.elapsed() < Duration::from_millis(500))
        });
        let counts = &heard.status.counts;
        let used = counts.used.get("ATTITUDE_QUATERNION").copied().unwrap_or(0);
        // One that was hit in its type and its length can look like a longer message of an unknown type, whose checksum nobody
        // knows: seen once in five hundred.
        let least = untouched - untouched / 100;
        assert!((least..untouched + 5).contains(&used), "{percent} %: {used} of {untouched}: {counts:?}");
        if percent == 0.0 {
            assert_eq!((used, counts.lost, counts.frames.bytes_skipped), (4_000, 0, 0), "{counts:?}");
        }
    }
}

#[test]
fn a_port_that_another_program_has_is_named_and_waited_for() {
    let cable = Cable::new();
    let theirs = serialport::new(&cable.ends[1], 115_200).open_native().expect("free");
    let began = Instant::now();
    let mut theirs = Some(theirs);
    let Some(mut child) = microcontroller(&cable.ends[0], 3.0, 0.0) else { return };
    let heard = listen(&cable.ends[1], 115_200, || {
        if began.elapsed() > Duration::from_millis(700) {
            theirs.take();
        }
        child.try_wait().expect("a child").is_none()
    });
    assert!(matches!(heard.losses[0], SerialError::Busy { .. }), "{:?}", heard.losses);
    assert!(heard.losses[0].to_string().contains("another program"), "{:?}", heard.losses);
    assert!(heard.measured.len() > 50, "{}", heard.measured.len());
}

#[test]
fn a_port_that_is_not_there_is_waited_for() {
    let folder = tempfile::tempdir().expect("a folder");
    let link = folder.path().join("robot-imu");
    let cable = Cable::new();
    let Some(mut child) = microcontroller(&cable.ends[0], 2.0, 0.0) else { return };
    let began = Instant::now();
    let heard = listen(link.to_str().expect("a name"), 115_200, || {
        if began.elapsed() > Duration::from_millis(500) && !link.exists() {
            std::os::unix::fs::symlink(&cable.ends[1], &link).expect("a link, as udev makes it");
        }
        child.try_wait().expect("a child").is_none()
    });
    assert!(matches!(heard.losses[0], SerialError::Missing { .. }), "{:?}", heard.losses);
    assert!(heard.losses.len() < 10, "tried less and less often: {}", heard.losses.len());
    assert!(heard.measured.len() > 50, "{}", heard.measured.len());
}
