//! The Pareto front of a sweep: rows than which no other row is both faster and more accurate.

/// Time and error of a row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// 99 % quantile of the time for a frame, milliseconds.
    pub time_ms: f64,
    /// Mean position error, centimetres; infinite for a row that does not count.
    pub error_cm: f64,
}

impl Point {
    /// Returns whether time and error are finite.
    pub fn counts(&self) -> bool {
        self.time_ms.is_finite() && self.error_cm.is_finite()
    }

    /// Returns whether this point is at least as good as `other` in time and error, and better in one of them.
    fn dominates(&self, other: &Self) -> bool {
        let (faster, sharper) = (self.time_ms <= other.time_ms, self.error_cm <= other.error_cm);
        faster && sharper && (self.time_ms < other.time_ms || self.error_cm < other.error_cm)
    }
}

/// Returns for each point whether it lies on the Pareto front.
pub fn front(points: &[Point]) -> Vec<bool> {
    let undominated = |point: &Point| !points.iter().any(|other| other.counts() && other.dominates(point));
    points.iter().map(|point| point.counts() && undominated(point)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn points() -> impl Strategy<Value = Vec<Point>> {
        // Few different values, so that equal ones happen.
        let value = prop_oneof![(1..12i32).prop_map(f64::from), Just(f64::INFINITY), Just(f64::NAN)];
        proptest::collection::vec((value.clone(), value), 0..30)
            .prop_map(|pairs| pairs.into_iter().map(|(time_ms, error_cm)| Point { time_ms, error_cm }).collect())
    }

    proptest! {
        #[test]
        fn the_front_is_never_dominated_and_dominates_the_rest(points in points()) {
            let on = front(&points);
            for (point, on_front) in points.iter().zip(&on) {
                let dominated = points.iter().any(|other| other.counts() && other.dominates(point));
                prop_assert_eq!(*on_front, point.counts() && !dominated);
                if point.counts() && !on_front {
                    let by_front = points.iter().zip(&on).any(|(other, on)| *on && other.dominates(point));
                    prop_assert!(by_front, "a dominated point is dominated by the front itself");
                }
            }
            prop_assert_eq!(on.iter().any(|on| *on), points.iter().any(Point::counts));
        }
    }
}
