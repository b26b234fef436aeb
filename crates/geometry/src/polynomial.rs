//! The smallest argument at which a polynomial is no longer positive.
//!
//! Applied to the derivative of a lens polynomial, it tells up to which angle the lens is monotonic.

/// Evaluates a polynomial by Horner's scheme; `coefficients[i]` is the factor of x^i.
pub fn evaluate(coefficients: &[f64], x: f64) -> f64 {
    coefficients.iter().rev().fold(0.0, |sum, c| sum * x + c)
}

/// Finds the smallest x in [0, `end`] with p(x) <= 0, or `None` if p is positive in the whole interval.
///
/// Between neighbouring roots of its derivative a polynomial is monotonic, so bisection between them finds
/// every sign change. A minimum that only touches zero is found at the root of the derivative itself.
pub fn first_non_positive(coefficients: &[f64], end: f64) -> Option<f64> {
    let mut stops = real_roots(&derivative(coefficients), end);
    stops.push(end);
    let mut start = 0.0;
    if evaluate(coefficients, start) <= 0.0 {
        return Some(start);
    }
    for stop in stops {
        if evaluate(coefficients, stop) <= 0.0 {
            return Some(bisect(coefficients, start, stop));
        }
        start = stop;
    }
    None
}

/// Multiplies two polynomials.
pub fn product(a: &[f64], b: &[f64]) -> Vec<f64> {
    let mut product = vec![0.0; (a.len() + b.len()).saturating_sub(1)];
    for (i, a) in a.iter().enumerate() {
        for (j, b) in b.iter().enumerate() {
            product[i + j] += a * b;
        }
    }
    product
}

fn derivative(coefficients: &[f64]) -> Vec<f64> {
    coefficients.iter().enumerate().skip(1).map(|(power, c)| power as f64 * c).collect()
}

/// Finds the points of (0, `end`) at which p changes its sign, in ascending order.
fn real_roots(coefficients: &[f64], end: f64) -> Vec<f64> {
    if coefficients.len() < 2 {
        return Vec::new();
    }
    let mut stops = real_roots(&derivative(coefficients), end);
    stops.push(end);
    let mut roots = Vec::new();
    let mut start = 0.0;
    for stop in stops {
        if (evaluate(coefficients, start) > 0.0) != (evaluate(coefficients, stop) > 0.0) {
            roots.push(bisect(coefficients, start, stop));
        }
        start = stop;
    }
    roots
}

/// Bisects the sign change between `low` and `high` to the last bit, and returns the end on the side of `high`.
fn bisect(coefficients: &[f64], mut low: f64, mut high: f64) -> f64 {
    let positive_at_low = evaluate(coefficients, low) > 0.0;
    // 2^-1100 of the interval is below the smallest number, so the loop always ends by the `break`.
    for _ in 0..1100 {
        let middle = low + (high - low) / 2.0;
        if middle <= low || middle >= high {
            break;
        }
        if (evaluate(coefficients, middle) > 0.0) == positive_at_low { low = middle } else { high = middle }
    }
    high
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_dip_between_the_ends_is_found() {
        // (x - 1)(x - 1.001): positive at 0 and 2, negative only between the roots.
        let p = [1.001, -2.001, 1.0];
        let x = first_non_positive(&p, 2.0).expect("the dip");
        assert!((x - 1.0).abs() < 1e-9);
    }

    #[test]
    fn a_positive_polynomial_has_none() {
        assert_eq!(first_non_positive(&[1.0, 0.0, 0.0, 0.0, 1e-3], 10.0), None);
    }

    proptest! {
        #[test]
        fn agrees_with_a_dense_scan(c in proptest::collection::vec(-1.0..1.0f64, 4)) {
            let p = [1.0, c[0], c[1], c[2], c[3]];
            let scan = (0..=20000).map(|i| i as f64 * 1e-4).find(|x| evaluate(&p, *x) <= 0.0);
            match (first_non_positive(&p, 2.0), scan) {
                (Some(exact), Some(scanned)) => prop_assert!(exact <= scanned + 1e-12 && scanned - exact <= 1.1e-4),
                (None, Some(_)) => prop_assert!(false, "missed a root"),
                _ => {}
            }
        }
    }
}
