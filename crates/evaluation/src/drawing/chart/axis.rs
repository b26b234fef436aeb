//! Axes of charts: the mapping from values to shares of an axis, and its ticks.

/// An axis.
#[derive(Clone, Debug)]
pub struct Axis {
    /// Quantity and unit.
    pub label: String,
    /// Scale of the axis.
    pub scale: Scale,
}

/// Scale of an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// Linear scale.
    Even,
    /// Logarithmic scale, for positive values.
    Logarithmic,
}

/// The interval of values that an axis shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Span {
    scale: Scale,
    low: f64,
    high: f64,
}

/// A tick of an axis.
pub(super) struct Tick {
    /// Value at which the tick stands.
    pub value: f64,
    /// Number beside the tick; empty where only a line is drawn.
    pub number: String,
}

/// Free room on each side, as a share of the range of the data.
const ROOM: f64 = 0.07;
/// Smallest ratio of the ends of a logarithmic axis: a smaller one could contain no round value.
const MIN_RATIO: f64 = 4.0;

impl Span {
    /// Returns an interval that contains all values that the scale can show.
    pub(super) fn of(scale: Scale, values: impl Iterator<Item = f64>) -> Self {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for value in values.filter(|value| can_show(scale, *value)) {
            low = low.min(value);
            high = high.max(value);
        }
        if low > high {
            (low, high) = (1.0, 1.0);
        }
        match scale {
            Scale::Even => {
                let room = ROOM * (high - low).max(1e-3 * high.abs().max(low.abs())).max(1e-9);
                Self { scale, low: if low >= 0.0 { (low - room).max(0.0) } else { low - room }, high: high + room }
            }
            Scale::Logarithmic => {
                let widen = libm::sqrt((MIN_RATIO / (high / low)).max(1.0));
                let room = widen * libm::pow(high / low, ROOM);
                Self { scale, low: low / room, high: high * room }
            }
        }
    }

    /// Returns 0 at the low end and 1 at the high end; `None` for a value outside of the axis.
    pub(super) fn share(&self, value: f64) -> Option<f64> {
        if !can_show(self.scale, value) {
            return None;
        }
        let share = match self.scale {
            Scale::Even => (value - self.low) / (self.high - self.low),
            Scale::Logarithmic => libm::log(value / self.low) / libm::log(self.high / self.low),
        };
        (-1e-9..=1.0 + 1e-9).contains(&share).then_some(share)
    }

    pub(super) fn ticks(&self) -> Vec<Tick> {
        match self.scale {
            Scale::Even => self.even_ticks(),
            Scale::Logarithmic => self.logarithmic_ticks(),
        }
    }

    fn even_ticks(&self) -> Vec<Tick> {
        let rough = (self.high - self.low) / 7.0;
        let power = libm::pow(10.0, libm::floor(libm::log10(rough)));
        let step = [1.0, 2.0, 5.0, 10.0].map(|digit| digit * power).into_iter().find(|step| *step >= rough);
        let step = step.unwrap_or(10.0 * power);
        let first = libm::ceil(self.low / step) as i64;
        let last = libm::floor(self.high / step) as i64;
        (first..=last).map(|count| Tick { value: count as f64 * step, number: number(count as f64 * step) }).collect()
    }

    /// Returns 1 to 9 of each decade. Within a decade all bear numbers, else 1, 2 and 5, and over many decades 1 only.
    fn logarithmic_ticks(&self) -> Vec<Tick> {
        let decades = libm::log10(self.high / self.low);
        let (first, last) = (libm::floor(libm::log10(self.low)) as i32, libm::ceil(libm::log10(self.high)) as i32);
        let mut ticks = Vec::new();
        for decade in first..=last {
            for digit in 1..10 {
                let value = f64::from(digit) * libm::pow(10.0, f64::from(decade));
                let numbered = digit == 1 || decades < 1.1 || (decades < 4.0 && matches!(digit, 2 | 5));
                if (self.low..=self.high).contains(&value) && (decades < 6.0 || digit == 1) {
                    ticks.push(Tick { value, number: if numbered { number(value) } else { String::new() } });
                }
            }
        }
        ticks
    }
}

fn can_show(scale: Scale, value: f64) -> bool {
    value.is_finite() && (scale == Scale::Even || value > 0.0)
}

/// Formats a number as short as it is exact, with up to six decimals.
fn number(value: f64) -> String {
    let text = format!("{value:.6}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".to_owned() } else { text.replace('-', "\u{2212}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers(span: &Span) -> Vec<String> {
        span.ticks().into_iter().map(|tick| tick.number).filter(|number| !number.is_empty()).collect()
    }

    #[test]
    fn a_logarithmic_axis_bears_round_numbers() {
        let span = Span::of(Scale::Logarithmic, [0.5, 20.0].into_iter());
        assert_eq!(numbers(&span), ["0.5", "1", "2", "5", "10", "20"]);
        let one = Span::of(Scale::Logarithmic, [3.0].into_iter());
        assert_eq!(numbers(&one), ["2", "3", "4", "5", "6"]);
        assert!((one.share(3.0).expect("on the axis") - 0.5).abs() < 1e-12);
        assert_eq!(span.share(0.0), None);
        assert_eq!(span.share(f64::NAN), None);
    }

    #[test]
    fn an_even_axis_bears_round_numbers() {
        let span = Span::of(Scale::Even, [0.0, 5.8].into_iter());
        assert_eq!(numbers(&span), ["0", "1", "2", "3", "4", "5", "6"]);
        let span = Span::of(Scale::Even, [-0.3, 0.2].into_iter());
        assert_eq!(numbers(&span), ["\u{2212}0.3", "\u{2212}0.2", "\u{2212}0.1", "0", "0.1", "0.2"]);
        assert!(!numbers(&Span::of(Scale::Even, [f64::NAN].into_iter())).is_empty());
    }
}
