//! Values of arguments. Whatever is given in place of a right one, the message says what would be right.

use std::ops::RangeInclusive;
use std::str::FromStr;

use clap::builder::TypedValueParser;

/// A number of a range, its ends included.
pub fn number(range: RangeInclusive<f64>) -> impl TypedValueParser<Value = f64> {
    within(range, "a number")
}

/// A whole number of a range, its ends included.
pub fn whole<T>(range: RangeInclusive<T>) -> impl TypedValueParser<Value = T>
where
    T: Number + Send + Sync + 'static,
{
    within(range, "a whole number")
}

/// What can be read, compared and shown.
pub trait Number: Clone + FromStr + PartialOrd + ToString {}

impl<T: Clone + FromStr + PartialOrd + ToString> Number for T {}

fn within<T>(range: RangeInclusive<T>, kind: &'static str) -> impl TypedValueParser<Value = T>
where
    T: Number + Send + Sync + 'static,
{
    move |text: &str| {
        let value = text.trim().parse::<T>().ok().filter(|value| range.contains(value));
        value.ok_or_else(|| format!("{kind} from {} to {} is needed", range.start().to_string(), range.end().to_string()))
    }
}
