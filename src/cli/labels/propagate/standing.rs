//! Since when and until when an object has stood where it was seen.

/// The time in which an object has stood, as far as frames tell.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Standing {
    /// From when on it is gone, seconds.
    pub(super) gone_from_s: Option<f64>,
    /// Before when it was not there yet, seconds.
    pub(super) absent_until_s: Option<f64>,
}

/// So many frames in a row, at the end or at the beginning, show something else before the object counts as gone.
const MIN_FRAMES: usize = 3;

impl Standing {
    /// From frames in the order of time: when each was taken, seconds, and whether it shows the object.
    pub(super) fn of(frames: impl Iterator<Item = (f64, bool)>) -> Self {
        let frames: Vec<(f64, bool)> = frames.collect();
        let Some(first) = frames.iter().position(|(_, seen)| *seen) else { return Self::default() };
        let last = frames.iter().rposition(|(_, seen)| *seen).unwrap_or(first);
        let behind = &frames[last + 1..];
        Self {
            gone_from_s: behind.first().filter(|_| behind.len() >= MIN_FRAMES).map(|(time_s, _)| *time_s),
            absent_until_s: (first >= MIN_FRAMES).then(|| frames[first].0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_frames_without_it_at_an_end_are_needed() {
        let standing = |seen: &str| Standing::of(seen.bytes().enumerate().map(|(at, seen)| (at as f64, seen == b'x')));
        assert_eq!(standing("..xx.x.."), Standing::default());
        assert_eq!(standing("...xx...x"), Standing { gone_from_s: None, absent_until_s: Some(3.0) });
        assert_eq!(standing("x..x..."), Standing { gone_from_s: Some(4.0), absent_until_s: None });
        assert_eq!(standing("...."), Standing::default());
        assert_eq!(standing(""), Standing::default());
    }
}
