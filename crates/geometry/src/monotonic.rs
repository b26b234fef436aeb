//! Roots of rising functions.

/// Largest number of steps of one search. If every Newton step fell back to bisection, 64 steps would exhaust an f64.
const MAX_STEPS: usize = 80;
/// A step that is shorter than this share of the place ends the search. Newton's method doubles the correct digits with each step, so
/// that only rounding is left then.
const TOLERANCE: f64 = 4.0 * f64::EPSILON;

/// Finds where a function that rises from 0 to `end` is zero, by Newton's method that never leaves its bracket.
///
/// `function` gives the value and its derivative, and the search begins at `start`. Where the function is zero nowhere, the answer is
/// the end that is nearer to zero.
pub(crate) fn find_root(start: f64, end: f64, function: impl Fn(f64) -> [f64; 2]) -> f64 {
    let (mut low, mut high) = (0.0, end);
    let mut place = start.min(end);
    for _ in 0..MAX_STEPS {
        let [value, slope] = function(place);
        if value > 0.0 {
            high = place
        } else {
            low = place
        }
        let newton = place - value / slope;
        // A slope beyond the range of numbers would make a step of zero length, which looks like the end of the search.
        let is_within = slope.is_finite() && newton >= low && newton <= high;
        // Both ends belong to the bracket: at the root a step of zero length stays where it is, which is one of them.
        let next = if is_within { newton } else { low + (high - low) / 2.0 };
        let moved = (next - place).abs();
        place = next;
        if moved <= TOLERANCE * place {
            break;
        }
    }
    place
}

#[cfg(test)]
mod tests {
    use core::cell::Cell;

    use super::*;

    /// The profile of a Kannala-Brandt lens minus a radius.
    fn lens_profile(k: [f64; 2], angle: f64, radius: f64) -> [f64; 2] {
        let square = angle * angle;
        let value = angle * (1.0 + square * (k[0] + square * k[1])) - radius;
        [value, 1.0 + square * (3.0 * k[0] + square * 5.0 * k[1])]
    }

    #[test]
    fn a_lens_is_inverted_in_few_steps() {
        for k in [[0.0, 0.0], [0.01, -0.005], [-0.02, 0.003], [0.05, -0.02]] {
            for step in 1..=10_000 {
                let angle = 1.6 * f64::from(step) / 1e4;
                let [radius, _] = lens_profile(k, angle, 0.0);
                let steps = Cell::new(0);
                let found = find_root(radius, 1.7, |angle| {
                    steps.set(steps.get() + 1);
                    lens_profile(k, angle, radius)
                });
                assert!((found - angle).abs() < 4e-15 * angle.max(1.0), "{k:?}: {found} for {angle}");
                assert!(steps.get() <= 6, "{k:?} at {angle}: {} steps", steps.get());
            }
        }
    }

    #[test]
    fn a_function_without_a_root_gives_the_nearer_end() {
        let line = |offset: f64| move |x: f64| [x + offset, 1.0];
        assert!(find_root(0.5, 1.0, line(3.0)).abs() < 1e-15);
        assert!((find_root(0.5, 1.0, line(-3.0)) - 1.0).abs() < 1e-15);
    }

    #[test]
    fn an_infinite_slope_does_not_end_the_search() {
        let root = find_root(0.9, 1.0, |x| [x - 0.25, f64::INFINITY]);
        assert!((root - 0.25).abs() < 1e-15, "{root}");
    }

    #[test]
    fn a_flat_place_is_left_by_bisection() {
        let cube = |x: f64| [(x - 1.0).powi(3), 3.0 * (x - 1.0).powi(2)];
        assert!((find_root(0.0, 3.0, cube) - 1.0).abs() < 1e-5);
    }
}
