//! The messages `builtin_interfaces/Time` and `std_msgs/Header`.

use serde::{Deserialize, Serialize};

use crate::cdr::wire_struct;

const NANOSECONDS_PER_SECOND: i64 = 1_000_000_000;

wire_struct! {
    /// `builtin_interfaces/Time`: time since the epoch of the clock that stamps the log.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
    pub struct Stamp {
        /// Seconds, rounded down.
        pub sec: i32,
        /// Nanoseconds on top of `sec`, below 10^9.
        pub nanosec: u32,
    }
}

wire_struct! {
    /// `std_msgs/Header`: time and coordinate frame of the data of a message.
    #[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
    pub struct Header {
        /// Time at which the data was taken, not logged.
        pub stamp: Stamp,
        /// Coordinate frame in which the data is given.
        pub frame_id: String,
    }
}

impl Stamp {
    /// The earliest time that ROS can express, in 1901.
    pub const MIN: Self = Self { sec: i32::MIN, nanosec: 0 };
    /// The latest time that ROS can express, in January 2038.
    pub const MAX: Self = Self { sec: i32::MAX, nanosec: 999_999_999 };

    /// Converts nanoseconds. A time that ROS cannot express becomes [`Self::MIN`] or [`Self::MAX`].
    pub fn from_nanoseconds(nanoseconds: i64) -> Self {
        let seconds = nanoseconds.div_euclid(NANOSECONDS_PER_SECOND);
        match i32::try_from(seconds) {
            Ok(sec) => Self { sec, nanosec: nanoseconds.rem_euclid(NANOSECONDS_PER_SECOND) as u32 },
            Err(_) if seconds < 0 => Self::MIN,
            Err(_) => Self::MAX,
        }
    }

    /// Converts the stamp to nanoseconds.
    pub fn to_nanoseconds(self) -> i64 {
        i64::from(self.sec) * NANOSECONDS_PER_SECOND + i64::from(self.nanosec)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nanoseconds_there_and_back() {
        for nanoseconds in [0, 1, -1, 999_999_999, -1_000_000_001, 1_760_000_000_020_000_000] {
            let stamp = Stamp::from_nanoseconds(nanoseconds);
            assert_eq!(stamp.to_nanoseconds(), nanoseconds);
            assert!(stamp.nanosec < 1_000_000_000);
        }
        assert_eq!(Stamp::from_nanoseconds(-1), Stamp { sec: -1, nanosec: 999_999_999 });
        assert_eq!(Stamp::from_nanoseconds(i64::MAX), Stamp::MAX);
        assert_eq!(Stamp::from_nanoseconds(i64::MIN), Stamp::MIN);
        assert_eq!(Stamp { sec: i32::MAX, nanosec: u32::MAX }.to_nanoseconds(), 2_147_483_651_294_967_295);
    }
}
