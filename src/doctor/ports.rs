//! Checks what arrives on the serial ports, and whether it is what a recording needs.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};

use super::{Finding, LISTEN, bad, good};
use crate::config::SerialSettings;
use crate::devices::mavlink::{PortCounts, TimeBase};
use crate::devices::serial::{LineStatus, PortEvent, PortOptions, SenderClock, SerialError, Trouble, run};

/// Messages without which a walk cannot be followed, from any port, with their names for people.
const NEEDED: [(&str, &str); 2] = [("ODOMETRY", "odometry"), ("ATTITUDE_QUATERNION", "attitude")];
/// Message of a turning head; a robot may have none.
const HEAD: (&str, &str) = ("GIMBAL_DEVICE_ATTITUDE_STATUS", "head");

/// Reports on each port, and on all ports together.
pub(super) fn check_ports(serial: &SerialSettings) -> Vec<Finding> {
    if serial.ports.is_empty() {
        return vec![bad("serial", "no port is named", "name the microcontrollers' ports in serial.ports")];
    }
    let options = serial.ports.iter().map(|port| PortOptions {
        device: port.device.clone(),
        baud: port.baud,
        system: serial.system_id,
        poses: None,
    });
    // The ports are heard in parallel, so the wait is that of one.
    let heard: Vec<(PortOptions, PortResult)> = std::thread::scope(|scope| {
        let listening: Vec<_> = options
            .map(|options| {
                scope.spawn(move || {
                    let heard = listen(&options);
                    (options, heard)
                })
            })
            .collect();
        listening.into_iter().filter_map(|thread| thread.join().ok()).collect()
    });
    let mut findings: Vec<Finding> = heard.iter().map(|(options, heard)| report_port(options, heard)).collect();
    findings.push(report_robot(
        heard.iter().filter_map(|(options, heard)| Some((options.device.as_str(), &heard.as_ref().ok()?.counts))),
    ));
    findings
}

type PortResult = Result<LineStatus, SerialError>;

fn listen(options: &PortOptions) -> PortResult {
    let stop = AtomicBool::new(false);
    let (mut status, mut lost) = (None, None);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            std::thread::sleep(LISTEN);
            stop.store(true, Ordering::Relaxed);
        });
        run(options, &stop, |event| match event {
            PortEvent::Status(line) => status = Some(line),
            PortEvent::Lost(error) => lost = Some(error),
            PortEvent::Opened { .. } | PortEvent::Measured(_) => {}
        });
    });
    match (lost, status) {
        (None, Some(status)) => Ok(status),
        (Some(error), _) => Err(error),
        (None, None) => Ok(LineStatus::default()),
    }
}

fn report_port(options: &PortOptions, heard: &PortResult) -> Finding {
    let what = format!("serial {} at {} baud", options.device, options.baud);
    let LineStatus { counts, clocks, .. } = match heard {
        Err(error) => {
            let remedy = match error {
                SerialError::Missing { .. } | SerialError::NoPort { .. } => {
                    "plug it in, or name one that is present in serial.ports"
                }
                SerialError::Permission { .. } => "join the group, and log in again",
                SerialError::Busy { .. } => {
                    "end the other program (fuser names it), or the service itself: systemctl stop realitysim"
                }
                SerialError::Open { .. } | SerialError::Gone { .. } => "try another cable, port or baud rate",
            };
            return bad(what, error.to_string(), remedy);
        }
        Ok(status) => status,
    };
    let mut said: Vec<String> =
        counts.used.iter().map(|(name, count)| format!("{name} {:.0} Hz", rate_hz(*count))).collect();
    said.extend(clocks.iter().map(describe_clock));
    match Trouble::since(&PortCounts::default(), counts) {
        Some(trouble) => {
            said.insert(0, trouble.to_string());
            bad(what, said.join("; "), trouble.remedy())
        }
        None => good(what, said.join("; ")),
    }
}

fn rate_hz(count: u64) -> f64 {
    count as f64 / LISTEN.as_secs_f64()
}

fn describe_clock(of: &SenderClock) -> String {
    let counts_from = match of.base {
        TimeBase::Boot => "its start",
        TimeBase::Unix => "1970",
    };
    format!(
        "clock of {}.{}, from {counts_from}: this machine's less {:.6} s, known to {:.1} ms by {:?}",
        of.sender.system,
        of.sender.component,
        of.clock.offset_ns as f64 * 1e-9,
        of.clock.uncertainty_ns as f64 * 1e-6,
        of.clock.source
    )
}

/// Reports which port sends each measurement, and which measurements are missing.
fn report_robot<'a>(ports: impl Iterator<Item = (&'a str, &'a PortCounts)>) -> Finding {
    let mut senders: BTreeMap<&str, Vec<String>> = BTreeMap::new();
    for (device, counts) in ports {
        for (name, count) in &counts.used {
            senders.entry(name).or_default().push(format!("{:.0} Hz from {device}", rate_hz(*count)));
        }
    }
    let said = |(name, what): (&str, &str)| match senders.get(name) {
        Some(from) => format!("{what} {}", from.join(" and ")),
        None => format!("no {what}"),
    };
    let all = NEEDED.into_iter().chain([HEAD]).map(said).collect::<Vec<_>>().join(", ");
    let missing: Vec<&str> =
        NEEDED.into_iter().map(|(name, _)| name).filter(|name| !senders.contains_key(name)).collect();
    match missing.as_slice() {
        [] => good("measurements", all),
        missing => bad(
            "measurements",
            all,
            format!("no port carries {}: docs/howto/robot.md says what to send", missing.join(" or ")),
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counts(used: &[(&'static str, u64)]) -> PortCounts {
        PortCounts {
            used: used.iter().map(|(name, count)| ((*name).into(), *count)).collect(),
            ..PortCounts::default()
        }
    }

    #[test]
    fn two_boards_are_one_robot() {
        let (a, b) = (counts(&[("ODOMETRY", 150)]), counts(&[("ATTITUDE_QUATERNION", 300)]));
        let found = report_robot([("/dev/a", &a), ("/dev/b", &b)].into_iter());
        assert!(found.good, "{found:?}");
        assert_eq!(found.said, "odometry 50 Hz from /dev/a, attitude 100 Hz from /dev/b, no head");
        let found = report_robot([("/dev/a", &a)].into_iter());
        assert!(!found.good && found.remedy.contains("no port carries ATTITUDE_QUATERNION:"), "{found:?}");
    }
}
