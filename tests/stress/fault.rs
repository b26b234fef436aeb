//! What goes wrong between the sensors and the agent.

use realitysim::ros2::LogMessage;

use super::case::Draw;
use crate::replay::support::{CAMERA_INFO, IMAGE, IMU, INITIAL, ODOMETRY, TF_STATIC, stamp_later};

#[derive(Clone, Debug)]
pub struct Fault {
    topic: &'static str,
    kind: Kind,
    /// Of the topic's messages.
    share: f64,
    seed: u64,
}

#[derive(Clone, Copy, Debug)]
enum Kind {
    Dropped,
    Twice,
    /// A byte anywhere.
    Flipped,
    /// Eight bytes anywhere say NaN, infinity or 1e300.
    NotANumber,
    Cut,
    /// Its stamp, by nanoseconds.
    Shifted(i64),
    /// Changes places with the message after it.
    Swapped,
}

impl Fault {
    pub fn drawn(draw: &mut Draw) -> Vec<Self> {
        let topics = [IMAGE, IMU, ODOMETRY, IMU, ODOMETRY, IMAGE, CAMERA_INFO, TF_STATIC, INITIAL];
        let kinds = [
            Kind::Dropped,
            Kind::Twice,
            Kind::Flipped,
            Kind::NotANumber,
            Kind::Cut,
            Kind::Shifted(-300_000_000),
            Kind::Shifted(3_000_000),
            Kind::Shifted(-5_000_000_000),
            Kind::Shifted(3_600_000_000_000),
            Kind::Swapped,
        ];
        (0..draw.below(5))
            .map(|_| Self {
                topic: *draw.one_of(&topics),
                kind: *draw.one_of(&kinds),
                share: *draw.one_of(&[0.02, 0.1, 0.5, 1.0]),
                seed: draw.below(1 << 30) as u64,
            })
            .collect()
    }

    pub fn apply(&self, messages: Vec<LogMessage>) -> Vec<LogMessage> {
        let mut draw = Draw::new(self.seed, 9);
        let mut faulty: Vec<LogMessage> = Vec::with_capacity(messages.len());
        let mut held: Option<LogMessage> = None;
        for mut message in messages {
            let hit = message.channel.topic == self.topic && draw.chance(self.share);
            let length = message.data.len();
            match self.kind {
                _ if !hit || length == 0 => faulty.push(message),
                Kind::Dropped => {}
                Kind::Twice => faulty.extend([message.clone(), message]),
                Kind::Flipped => {
                    message.data[draw.below(length)] ^= 1 << draw.below(8);
                    faulty.push(message);
                }
                Kind::NotANumber => {
                    let value = draw.one_of(&[f64::NAN, f64::INFINITY, -1e300, 1e-310]).to_le_bytes();
                    // Behind the four bytes of the encapsulation doubles lie at multiples of eight.
                    let at = 4 + draw.below(length.saturating_sub(12).max(1)) / 8 * 8;
                    if let Some(bytes) = message.data.get_mut(at..at + 8) {
                        bytes.copy_from_slice(&value);
                    }
                    faulty.push(message);
                }
                Kind::Cut => {
                    message.data.truncate(draw.below(length));
                    faulty.push(message);
                }
                Kind::Shifted(by_ns) => {
                    if length >= 12 {
                        stamp_later(&mut message, by_ns);
                    }
                    faulty.push(message);
                }
                Kind::Swapped => {
                    if let Some(held) = held.replace(message) {
                        faulty.push(held);
                    }
                }
            }
        }
        faulty.extend(held);
        faulty
    }
}
