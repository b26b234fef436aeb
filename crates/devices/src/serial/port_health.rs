//! Finds out what is wrong with an open port, by what it has carried in a while.

use std::borrow::Cow;
use std::fmt;

use crate::mavlink::PortCounts;

/// What is wrong with a port.
#[derive(Clone, Debug, PartialEq)]
pub enum Trouble {
    /// No byte came.
    Silent,
    /// Bytes came, but no message.
    NoMessages {
        /// Number of bytes.
        bytes: u64,
    },
    /// Messages came under this program's own name: it receives itself, or another device has its name.
    Echo {
        /// Number of such messages.
        messages: u64,
    },
    /// Messages came with a right checksum and a content that cannot be used.
    Unusable {
        /// Why they cannot be used.
        reason: String,
        /// Number of such messages.
        messages: u64,
    },
    /// Messages are missing.
    Lost {
        /// Number of missing messages.
        messages: u64,
        /// Number of messages that were sent.
        of: u64,
    },
    /// Bytes belong to no valid message.
    Noisy {
        /// Number of such bytes.
        skipped: u64,
        /// Number of all bytes.
        bytes: u64,
    },
}

/// Largest share of lost messages on a good line.
const MAX_LOST: f64 = 0.01;
/// Largest share of skipped bytes on a good line. Some are skipped because reading begins in the middle of a message.
const MAX_SKIPPED: f64 = 0.05;

impl Trouble {
    /// Returns the worst trouble of the port since `before`; `None` if all is well.
    pub fn since(before: &PortCounts, now: &PortCounts) -> Option<Self> {
        let bytes = now.frames.bytes.saturating_sub(before.frames.bytes);
        let messages = now.frames.frames.saturating_sub(before.frames.frames);
        if bytes == 0 {
            return Some(Self::Silent);
        }
        if messages == 0 {
            return Some(Self::NoMessages { bytes });
        }
        let echoes = now.echoes.saturating_sub(before.echoes);
        if echoes > 0 {
            return Some(Self::Echo { messages: echoes });
        }
        let new = |(reason, count): (&Cow<'static, str>, &u64)| {
            let messages = count.saturating_sub(before.unusable.get(reason).copied().unwrap_or(0));
            (messages > 0).then(|| Self::Unusable { reason: reason.to_string(), messages })
        };
        if let Some(unusable) = now.unusable.iter().find_map(new) {
            return Some(unusable);
        }
        let lost = now.lost.saturating_sub(before.lost);
        let (of, skipped) = (messages + lost, now.frames.bytes_skipped.saturating_sub(before.frames.bytes_skipped));
        let damaged = now.frames.crc_failures.saturating_sub(before.frames.crc_failures);
        let is_lossy = lost as f64 > MAX_LOST * of as f64;
        // Messages hit by noise are missing, too. If at least half of the lost ones have failed checksums, the line is noisy,
        // and a higher baud rate would not help.
        if skipped as f64 > MAX_SKIPPED * bytes as f64 || (is_lossy && 2 * damaged >= lost) {
            return Some(Self::Noisy { skipped, bytes });
        }
        is_lossy.then_some(Self::Lost { messages: lost, of })
    }

    /// Returns whether it is of the same kind, whatever its numbers. A trouble of the same kind is no news.
    pub fn is_like(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Unusable { reason: one, .. }, Self::Unusable { reason: other, .. }) => one == other,
            _ => std::mem::discriminant(self) == std::mem::discriminant(other),
        }
    }

    /// Returns the word for this trouble in the status and in logs.
    pub fn cause(&self) -> &'static str {
        match self {
            Self::Silent => "silent",
            Self::NoMessages { .. } => "no_messages",
            Self::Echo { .. } => "echo",
            Self::Unusable { .. } => "unusable",
            Self::Lost { .. } => "lost",
            Self::Noisy { .. } => "noisy",
        }
    }

    /// Returns what to check or change.
    pub fn remedy(&self) -> &'static str {
        match self {
            Self::Silent => "is the device switched on, and are its lines crossed (TX to RX)?",
            Self::NoMessages { .. } => "is the port's baud rate the device's, and MAVLink 2 its protocol?",
            Self::Echo { .. } => "are the port's own TX and RX joined, or does another device send as component 197?",
            Self::Unusable { .. } => "see docs/howto/robot.md for what each message must hold",
            Self::Lost { .. } => "the line is too slow for what is sent: a higher baud rate, or lower rates",
            Self::Noisy { .. } => "the line is noisy: shorter or shielded wires, a common ground, a lower baud rate",
        }
    }
}

impl fmt::Display for Trouble {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Silent => write!(f, "silent"),
            Self::NoMessages { bytes } => write!(f, "{bytes} bytes and no MAVLink 2 message"),
            Self::Echo { messages } => write!(f, "{messages} messages are an echo of what was sent"),
            Self::Unusable { reason, messages } => write!(f, "{messages} messages cannot be used: {reason}"),
            Self::Lost { messages, of } => write!(f, "{messages} of {of} messages were lost"),
            Self::Noisy { skipped, bytes } => write!(f, "{skipped} of {bytes} bytes belong to no sound message"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mavlink::FrameCounts;

    fn counts(bytes: u64, frames: u64, bytes_skipped: u64, lost: u64) -> PortCounts {
        let frames = FrameCounts { bytes, frames, bytes_skipped, ..FrameCounts::default() };
        PortCounts { frames, lost, ..PortCounts::default() }
    }

    #[test]
    fn what_is_wrong_is_of_the_while_and_not_of_before() {
        let before = counts(10_000, 100, 5_000, 50);
        let since = |now: &PortCounts| Trouble::since(&before, now);
        assert_eq!(since(&before), Some(Trouble::Silent));
        assert_eq!(since(&counts(10_900, 100, 5_900, 50)), Some(Trouble::NoMessages { bytes: 900 }));
        assert_eq!(since(&counts(20_000, 200, 5_000, 50)), None);
        assert_eq!(since(&counts(20_000, 200, 5_050, 51)), None, "a spike now and then");
        assert_eq!(since(&counts(20_000, 200, 5_000, 60)), Some(Trouble::Lost { messages: 10, of: 110 }));
        assert_eq!(since(&counts(20_000, 200, 5_600, 50)), Some(Trouble::Noisy { skipped: 600, bytes: 10_000 }));
        let mut hit = counts(20_000, 200, 5_400, 60);
        hit.frames.crc_failures = 7;
        assert_eq!(since(&hit), Some(Trouble::Noisy { skipped: 400, bytes: 10_000 }), "bytes were hit, not left out");
        let heard_itself = PortCounts { echoes: 4, ..counts(20_000, 200, 5_000, 50) };
        assert_eq!(since(&heard_itself), Some(Trouble::Echo { messages: 4 }));
        let mut now = counts(20_000, 200, 5_000, 50);
        now.unusable.insert("no quaternion".into(), 3);
        let unusable = since(&now).expect("unusable");
        assert_eq!(unusable, Trouble::Unusable { reason: "no quaternion".to_owned(), messages: 3 });
        assert_eq!(
            Trouble::since(&now, &PortCounts { frames: counts(30_000, 300, 5_000, 0).frames, ..now.clone() }),
            None
        );
        now.unusable.insert("no quaternion".into(), 9);
        let later = since(&now).expect("unusable");
        assert!(later.is_like(&unusable) && later != unusable && !later.is_like(&Trouble::Silent));
    }
}
