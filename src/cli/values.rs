//! Values of arguments. Whatever is given in place of a right one, the message says what would be right.

use std::net::SocketAddr;
use std::ops::RangeInclusive;
use std::str::FromStr;

use clap::builder::TypedValueParser;

/// What can be read, compared and shown.
pub trait Number: Clone + FromStr + PartialOrd + ToString + Send + Sync + 'static {}

impl<T: Clone + FromStr + PartialOrd + ToString + Send + Sync + 'static> Number for T {}

/// A number of a range, its ends included.
pub fn number(range: RangeInclusive<f64>) -> impl TypedValueParser<Value = f64> {
    within(range, "a number")
}

/// A whole number of a range, its ends included.
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

pub fn above_zero(text: &str) -> Result<f64, String> {
    let value = text.parse::<f64>().ok().filter(|value| value.is_finite() && *value > 0.0);
    value.ok_or_else(|| "expected a number above 0".to_owned())
}

/// One whose range is checked with what it belongs to.
pub fn any_number(text: &str) -> Result<f64, String> {
    text.trim().parse().map_err(|_| "a number is needed".to_owned())
}

/// The same, of what is counted.
pub fn any_whole<T: FromStr>(text: &str) -> Result<T, String> {
    text.trim().parse().map_err(|_| "a whole number, 0 or more, is needed".to_owned())
}

/// Where to listen.
pub fn address(text: &str) -> Result<SocketAddr, String> {
    let numeric = text.replacen("localhost:", "127.0.0.1:", 1);
    numeric.parse().map_err(|_| {
        "an address and a port are needed, as in 127.0.0.1:8765, or 0.0.0.0:8765 for everybody on the network"
            .to_owned()
    })
}
