//! The answer of a detector that judges a picture by one number.

use anyhow::Context;

use super::shortened;

/// The one finite number in a detector's answer; words around it do not matter.
///
/// # Errors
///
/// Fails if there is none, or more than one.
pub fn number_in(answer: &str) -> anyhow::Result<f64> {
    let mut numbers = answer.split_whitespace().filter_map(|word| word.parse::<f64>().ok());
    let only = numbers.next().filter(|number| number.is_finite() && numbers.next().is_none());
    only.with_context(|| format!("printed {:?}: one finite number is needed", shortened(answer)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_number_is_an_answer_and_nothing_else_is() {
        assert_eq!(number_in("2.5\n").ok(), Some(2.5));
        assert_eq!(number_in("found 7 lines in /a picture.png").ok(), Some(7.0));
        for answer in ["NaN", "1 2 3", "", "inf", "none"] {
            let error = number_in(answer).expect_err(answer).to_string();
            assert!(error.contains("one finite number"), "{answer}: {error}");
        }
    }
}
