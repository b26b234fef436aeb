//! Parsers for values of arguments. Each error says which value would be right.

use std::net::SocketAddr;
use std::ops::RangeInclusive;
use std::str::FromStr;

use clap::builder::TypedValueParser;

/// A number type that can be parsed, compared and shown.
pub trait Number: Clone + FromStr + PartialOrd + ToString + Send + Sync + 'static {}

impl<T: Clone + FromStr + PartialOrd + ToString + Send + Sync + 'static> Number for T {}

/// Accepts a number in a range, both ends included.
pub fn number(range: RangeInclusive<f64>) -> impl TypedValueParser<Value = f64> {
    within(range, "a number")
}

/// Accepts a whole number in a range, both ends included.
pub fn whole<T: Number>(range: RangeInclusive<T>) -> impl TypedValueParser<Value = T> {
    within(range, "a whole number")
}

fn within<T: Number>(range: RangeInclusive<T>, kind: &'static str) -> impl TypedValueParser<Value = T> {
    move |text: &str| {
        let value = text.trim().parse::<T>().ok().filter(|value| range.contains(value));
        value.ok_or_else(|| {
            format!("{kind} from {} to {} is needed", range.start().to_string(), range.end().to_string())
        })
    }
}

/// Accepts a finite number above 0.
pub fn above_zero(text: &str) -> Result<f64, String> {
    let value = text.parse::<f64>().ok().filter(|value| value.is_finite() && *value > 0.0);
    value.ok_or_else(|| "expected a number above 0".to_owned())
}

/// Accepts any number; its range is checked by the command.
pub fn any_number(text: &str) -> Result<f64, String> {
    text.trim().parse().map_err(|_| "a number is needed".to_owned())
}

/// Accepts any whole number; its range is checked by the command.
pub fn any_whole<T: FromStr>(text: &str) -> Result<T, String> {
    text.trim().parse().map_err(|_| "a whole number, 0 or more, is needed".to_owned())
}

/// Accepts a socket address; `localhost` stands for 127.0.0.1.
pub fn address(text: &str) -> Result<SocketAddr, String> {
    let numeric = text.replacen("localhost:", "127.0.0.1:", 1);
    numeric.parse().map_err(|_| {
        "an address and a port are needed, as in 127.0.0.1:8765, or 0.0.0.0:8765 for everybody on the network"
            .to_owned()
    })
}
