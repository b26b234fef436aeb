//! The Euclidean distance transform (for the observation of Eq. 1), exact up to a reach.

/// Finds the Euclidean distance, in cells, from every cell to the nearest white one; `reach + 1` where none is within `reach`.
///
/// `white` has `width` x `height` cells, row by row.
pub fn nearest(white: &[bool], width: usize, height: usize, reach: usize) -> Vec<f32> {
    if width == 0 || height == 0 {
        return Vec::new();
    }
    let far = (reach + 1) as u32;
    // The first pass runs along columns: the number of rows to the nearest white cell above or below.
    let mut vertical = vec![far; white.len()];
    for row in 0..height {
        for u in 0..width {
            let cell = row * width + u;
            vertical[cell] = if white[cell] {
                0
            } else if row > 0 {
                (vertical[cell - width] + 1).min(far)
            } else {
                far
            };
        }
    }
    for row in (0..height.saturating_sub(1)).rev() {
        for u in 0..width {
            let cell = row * width + u;
            vertical[cell] = vertical[cell].min(vertical[cell + width] + 1);
        }
    }
    // The second pass runs along rows: the smallest hypotenuse within reach, over squares that are padded to avoid checks of bounds.
    let far_square = far * far;
    let mut squares = vec![far_square; width + 2 * reach];
    let mut result = Vec::with_capacity(white.len());
    let mut best = vec![0u32; width];
    for row in vertical.chunks_exact(width) {
        for (square, distance) in squares[reach..reach + width].iter_mut().zip(row) {
            *square = distance * distance;
        }
        best.copy_from_slice(&squares[reach..reach + width]);
        for step in 1..=reach {
            let along = (step * step) as u32;
            let left = &squares[reach - step..][..width];
            let right = &squares[reach + step..][..width];
            for ((best, left), right) in best.iter_mut().zip(left).zip(right) {
                *best = (*best).min(left.min(right) + along);
            }
        }
        result.extend(best.iter().map(|square| (*square as f32).sqrt().min(far as f32)));
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn agrees_with_a_search(white in proptest::collection::vec(proptest::bool::weighted(0.03), 17 * 23), reach in 1usize..30) {
            let (width, height) = (17usize, 23usize);
            let got = nearest(&white, width, height, reach);
            for v in 0..height {
                for u in 0..width {
                    let exact = (0..white.len())
                        .filter(|i| white[*i])
                        .map(|i| ((i % width).abs_diff(u).pow(2) + (i / width).abs_diff(v).pow(2)) as f32)
                        .fold(f32::INFINITY, f32::min)
                        .sqrt();
                    let expected = if exact <= reach as f32 { exact } else { (reach + 1) as f32 };
                    let value = got[v * width + u];
                    // Any value beyond `reach` is right where nothing is within it.
                    prop_assert!(value == expected || (value > reach as f32 && expected > reach as f32));
                }
            }
        }
    }

    #[test]
    fn nothing_white_is_out_of_reach_everywhere() {
        assert!(nearest(&[false; 12], 4, 3, 5).iter().all(|d| *d == 6.0));
        assert!(nearest(&[], 0, 0, 5).is_empty());
    }
}
