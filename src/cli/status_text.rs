//! A recorder's status as lines of text for people.

use crate::devices::serial::SenderClock;
use crate::live::{LastTag, Port, RecorderState, Status};
use crate::localization::Rejection;
use crate::recording::{Counts, RecorderStatus};

/// The whole status, a fact a line.
pub fn status_text(status: &Status) -> String {
    let session = status.session.as_ref().map_or_else(|| "-".to_owned(), |session| session.display().to_string());
    let mut lines = vec![format!("{}  {session}", state_name(status.state)), frames(&status.counts)];
    let earlier = &status.earlier;
    if earlier.sessions > 0 {
        let (sessions, unfinished) = (earlier.sessions, earlier.unfinished);
        lines.push(format!("before it {sessions} sessions: {}; {unfinished} not whole", frames(&earlier.counts)));
    }
    let dropped: Vec<String> = status.counts.dropped.iter().map(|(cause, count)| format!("{count} {cause}")).collect();
    if !dropped.is_empty() {
        lines.push(format!("dropped: {}", dropped.join(", ")));
    }
    lines.extend(recorder(&status.recorder));
    lines.push(match (&status.camera_lost, &status.camera) {
        (Some(cause), _) => format!("camera: away ({cause})"),
        (None, Some(camera)) => format!("camera: {}", camera.card),
        (None, None) => "camera: none yet".to_owned(),
    });
    lines.extend(last_second(status));
    if let Some(passed_on) = &status.republished {
        let lost = passed_on.lost.as_ref().map_or(String::new(), |why| format!(" ({why})"));
        let (device, passed, missed) = (&passed_on.device, passed_on.passed, passed_on.missed);
        lines.push(format!("{device}: {passed} passed on, {missed} missed{lost}"));
    }
    lines.extend(status.ports.iter().flat_map(|(device, state)| port(device, state)));
    if status.counts.thinned > 0 {
        lines.push(format!("{} thinned out, as recording.thinning asks", status.counts.thinned));
    }
    if let Some(coverage) = &status.coverage {
        // The letters are explained only where they are shown: the page draws the cells on the field.
        let key = if coverage.map.is_empty() { "" } else { ": a digit says of how many, # of all, . of none" };
        lines.push(format!(
            "images of {} of {} poses (cells of {} m, {} headings{key})",
            coverage.filled, coverage.cells, coverage.cell_m, coverage.sectors
        ));
        lines.extend(coverage.map.iter().map(|row| format!("  {row}")));
    }
    lines.extend(status.last_tag.as_ref().map(last_tag));
    lines.join("\n")
}

fn state_name(state: RecorderState) -> &'static str {
    match state {
        RecorderState::Listening => "listening",
        RecorderState::Recording => "recording",
        RecorderState::Stopped => "stopped",
        RecorderState::Ended => "ended",
    }
}

fn frames(counts: &Counts) -> String {
    let Counts { captured, written, tagged, valid, .. } = counts;
    format!("{captured} captured, {written} written, {tagged} tagged, {valid} valid")
}

/// The recorder's queue, what a power cut would cost, and the state of the disk.
fn recorder(recorder: &RecorderStatus) -> Vec<String> {
    let mebibytes = |bytes: f64| bytes / f64::from(1 << 20);
    let conserved = if recorder.conserved {
        "captured = written + thinned + dropped + waiting"
    } else {
        "FRAMES ARE UNACCOUNTED FOR"
    };
    let mut lines = vec![
        format!(
            "recorder: {} frames wait for the disk, {:.1} of {:.0} MiB; {:.0} MiB of the disk free; {conserved}",
            recorder.frames_waiting,
            mebibytes(recorder.queue_bytes as f64),
            mebibytes(recorder.queue_limit_bytes as f64),
            mebibytes(recorder.free_bytes.unwrap_or(0) as f64)
        ),
        match recorder.fault {
            None => format!(
                "a power cut costs at most {:.2} s (worst stall {:.0} ms; worst so far {:.2} s)",
                recorder.loss_bound_ms / 1e3,
                recorder.worst_stall_ms,
                recorder.worst_unsynced_ms / 1e3
            ),
            Some(_) => "a power cut costs all that waits for the disk: it refuses".to_owned(),
        },
    ];
    if let Some(stopped) = &recorder.stopped {
        let what = if stopped.frames_only { "frames are not" } else { "nothing is" };
        lines.push(format!("DISK: {}: {what} recorded", stopped.cause));
    }
    if let Some(fault) = &recorder.fault {
        lines.push(format!("DISK: {}: {}", fault.cause, fault.said));
    }
    let faults: Vec<String> = recorder.faults.iter().map(|(cause, count)| format!("{count} {cause}")).collect();
    if !faults.is_empty() {
        lines.push(format!("disk errors: {}; {} segments given up", faults.join(", "), recorder.segments_given_up));
    }
    lines
}

/// Rates, computing time, validity and the filter's effort.
fn last_second(status: &Status) -> Vec<String> {
    let Status { rates, budget, validity, filter, camera_waiting, .. } = status;
    let mut lines = vec![format!(
        "last second: {:.1} captured, {:.1} written, {:.1} tagged; {camera_waiting} of 16 frames wait to be taken",
        rates.captured_hz, rates.written_hz, rates.tagged_hz
    )];
    if validity.frames == 0 {
        lines.push("tags: none yet".to_owned());
        return lines;
    }
    let allowed = match budget.budget_ms {
        0.0 => String::new(),
        allowed => format!(" of {allowed} ms"),
    };
    lines.extend([
        format!("tags: {:.1} ms each, 1 % over {:.1} ms{allowed}", budget.p50_ms, budget.p99_ms),
        format!("valid: {} of the last {}", validity.valid, validity.frames),
        format!(
            "filter: {:.0} particles, spread {:.1} cm, time was up in {:.0} % of the frames",
            filter.particles,
            100.0 * filter.spread_m,
            100.0 * filter.capped
        ),
    ]);
    lines
}

/// Trouble, counts and clocks of a serial port.
fn port(device: &str, port: &Port) -> Vec<String> {
    if let Some(why) = &port.closed {
        return vec![format!("{device}: {why}")];
    }
    let trouble = port.trouble.as_ref().map(|trouble| format!("{device}: TROUBLE: {}", trouble.said));
    let mut lines: Vec<String> = trouble.into_iter().collect();
    if let Some(line) = &port.line {
        let counts = &line.counts;
        lines.push(format!(
            "{device}: {} messages, {} lost, {} checksums wrong, {} bytes skipped",
            counts.frames.frames, counts.lost, counts.frames.crc_failures, counts.frames.bytes_skipped
        ));
        lines.extend(line.clocks.iter().map(clock));
    }
    lines
}

fn clock(SenderClock { sender, clock, .. }: &SenderClock) -> String {
    format!(
        "  {}.{}: clock {:.6} s behind to {:.2} ms by {}, drift {:.1} ppm",
        sender.system,
        sender.component,
        clock.offset_ns as f64 * 1e-9,
        clock.uncertainty_ns as f64 * 1e-6,
        clock.source.name(),
        clock.drift_ppm
    )
}

/// The latest pose and how far it is to be believed.
fn last_tag(tag: &LastTag) -> String {
    let is_predicted = tag.reason == Rejection::NoFrame.as_str();
    let elapsed = format!("{:.1} ms", tag.elapsed_ms);
    let what = match (is_predicted, tag.valid, tag.ambiguous) {
        (true, _, true) => "predicted, for want of frames; the mirror pose is as likely".to_owned(),
        (true, _, false) => "predicted, for want of frames".to_owned(),
        (false, false, _) => format!("{}, {elapsed}", tag.reason),
        (false, true, true) => format!("valid up to the mirror, {elapsed}"),
        (false, true, false) => format!("valid, {elapsed}"),
    };
    let age = if tag.age_s >= 1.0 { format!(", {:.0} s ago", tag.age_s) } else { String::new() };
    format!(
        "x {:.2} m, y {:.2} m (±{:.1} cm), yaw {:.1} deg: {what}{age}",
        tag.x_m,
        tag.y_m,
        100.0 * tag.sigma_m,
        tag.yaw_rad.to_degrees(),
    )
}
