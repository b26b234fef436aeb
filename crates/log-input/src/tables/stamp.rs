//! Times as people write them: seconds, milliseconds, microseconds or nanoseconds, in a column or in the name of a file.

use core::fmt;

use super::table::{Row, Table, TableError};

/// A unit of time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum TimeUnit {
    /// Seconds.
    Seconds,
    /// Milliseconds.
    Milliseconds,
    /// Microseconds.
    Microseconds,
    /// Nanoseconds.
    Nanoseconds,
}

/// The unit of stamps, and how it is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StampUnit {
    /// The unit.
    pub unit: TimeUnit,
    /// Whether the unit was recognized by the magnitude of the numbers. Otherwise their name says it.
    pub is_recognized: bool,
}

impl TimeUnit {
    const ALL: [Self; 4] = [Self::Seconds, Self::Milliseconds, Self::Microseconds, Self::Nanoseconds];

    /// Decimal places from this unit to nanoseconds.
    fn places(self) -> i32 {
        match self {
            Self::Seconds => 9,
            Self::Milliseconds => 6,
            Self::Microseconds => 3,
            Self::Nanoseconds => 0,
        }
    }

    /// Abbreviation, as names of columns carry it.
    pub fn suffix(self) -> &'static str {
        match self {
            Self::Seconds => "s",
            Self::Milliseconds => "ms",
            Self::Microseconds => "us",
            Self::Nanoseconds => "ns",
        }
    }

    /// The unit in which a number is a time between the years 2000 and 2100; `None` if it is none in any.
    ///
    /// These ranges of the units do not overlap.
    pub(super) fn of_epoch(number: &Decimal) -> Option<Self> {
        Self::ALL.into_iter().find(|unit| number.nanoseconds(*unit).is_some_and(|ns| EPOCH_NS.contains(&ns)))
    }
}

/// Times between the beginnings of the years 2000 and 2100 (UTC), nanoseconds since 1970.
const EPOCH_NS: core::ops::Range<i64> = 946_684_800_000_000_000..4_102_444_800_000_000_000;
/// Longest mean time between rows, nanoseconds. Where a recognized unit gives more, it is another.
const MAX_MEAN_STEP_NS: i64 = 60_000_000_000;
/// Most digits of a number of which all count.
const MAX_DIGITS: usize = 30;
/// Names of a column of stamps.
const NAMES: [&str; 4] = ["stamp", "time", "t", "timestamp"];

impl fmt::Display for TimeUnit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Seconds => "seconds",
            Self::Milliseconds => "milliseconds",
            Self::Microseconds => "microseconds",
            Self::Nanoseconds => "nanoseconds",
        })
    }
}

/// A number that is not negative, as it is written: `digits` x 10^`exponent`. A binary fraction would lose nanoseconds of
/// times since 1970.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Decimal {
    digits: u128,
    exponent: i32,
    /// Whether there is a decimal point.
    has_point: bool,
}

impl Decimal {
    /// Parses `12`, `12.5` or `1.25e1`; `None` if the text is no such number.
    pub(super) fn parse(text: &str) -> Option<Self> {
        let (mantissa, exponent) = match text.split_once(['e', 'E']) {
            Some((mantissa, exponent)) => (mantissa, exponent.parse::<i16>().ok()?),
            None => (text, 0),
        };
        let (whole, fraction) = mantissa.split_once('.').unwrap_or((mantissa, ""));
        let is_number = !(whole.is_empty() && fraction.is_empty())
            && whole.bytes().chain(fraction.bytes()).all(|byte| byte.is_ascii_digit());
        if !is_number {
            return None;
        }
        let whole = whole.trim_start_matches('0');
        if whole.len() > MAX_DIGITS {
            return None;
        }
        let fraction = &fraction[..fraction.len().min(MAX_DIGITS - whole.len())];
        let digits =
            whole.bytes().chain(fraction.bytes()).fold(0u128, |sum, digit| 10 * sum + u128::from(digit - b'0'));
        let exponent = i32::from(exponent) - fraction.len() as i32;
        Some(Self { digits, exponent, has_point: mantissa.contains('.') })
    }

    /// The time that this number of `unit` is, rounded to nanoseconds; `None` beyond the years of 64 bits.
    pub(super) fn nanoseconds(&self, unit: TimeUnit) -> Option<i64> {
        let places = self.exponent + unit.places();
        let power = |places: u32| 10u128.checked_pow(places);
        let ns = if places >= 0 {
            match self.digits {
                0 => 0,
                digits => digits.checked_mul(power(places.unsigned_abs())?)?,
            }
        } else {
            match power(places.unsigned_abs()) {
                Some(divisor) => (self.digits + divisor / 2) / divisor,
                None => 0,
            }
        };
        i64::try_from(ns).ok()
    }
}

/// The column of stamps of a table, with the unit of its numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct StampColumn {
    index: usize,
    pub(super) unit: StampUnit,
}

impl StampColumn {
    /// Takes the column of stamps: `stamp`, `time`, `t` or `timestamp`, alone or with `_s`, `_ms`, `_us` or `_ns`; `None` if there is
    /// none.
    ///
    /// Without a unit it is recognized by magnitude: a time between 2000 and 2100 in one of the units, or seconds of another
    /// clock if they are written with a decimal point. What remains is refused.
    pub(super) fn find(table: &mut Table) -> Result<Option<Self>, TableError> {
        let split = |name: &str| {
            NAMES.iter().find_map(|base| match name.strip_prefix(base)? {
                "" => Some(None),
                suffix => {
                    let suffix = suffix.strip_prefix('_')?;
                    TimeUnit::ALL.into_iter().find(|unit| unit.suffix() == suffix).map(Some)
                }
            })
        };
        let Some(index) = table.take_first(|name| split(name).is_some()) else { return Ok(None) };
        let stated = split(table.name(index)).flatten();
        let unit = match stated {
            Some(unit) => StampUnit { unit, is_recognized: false },
            None => StampUnit { unit: recognize(table, index)?, is_recognized: true },
        };
        Ok(Some(Self { index, unit }))
    }

    /// The stamp of a row, nanoseconds.
    pub(super) fn read(&self, row: &Row) -> Result<i64, TableError> {
        let text = row.text(self.index);
        let number = Decimal::parse(text).ok_or_else(|| row.wrong(self.index, "is no time"))?;
        let stamp_ns = number.nanoseconds(self.unit.unit).filter(|stamp_ns| *stamp_ns <= MAX_STAMP_NS);
        stamp_ns.ok_or_else(|| row.wrong(self.index, &format!("is later than the year 2100 in {}", self.unit.unit)))
    }
}

/// Latest time of a stamp, nanoseconds: the end of [`EPOCH_NS`]. Sums of stamps and steps stay within 64 bits.
const MAX_STAMP_NS: i64 = EPOCH_NS.end;

/// Recognizes the unit of a column of stamps by its numbers.
fn recognize(table: &Table, index: usize) -> Result<TimeUnit, TableError> {
    let (mut first, mut last, mut rows, mut has_point) = (None, None, 0i64, false);
    for row in table.rows() {
        let row = row?;
        let number = Decimal::parse(row.text(index)).ok_or_else(|| row.wrong(index, "is no time"))?;
        first = first.or(Some(number));
        last = Some(number);
        has_point |= number.has_point;
        rows += 1;
    }
    let (Some(first), Some(last)) = (first, last) else {
        return Err(table.error(None, "there is no row behind the head".to_owned()));
    };
    let unit = TimeUnit::of_epoch(&first).or_else(|| has_point.then_some(TimeUnit::Seconds));
    let is_plausible = |unit: &TimeUnit| match (first.nanoseconds(*unit), last.nanoseconds(*unit)) {
        (Some(first), Some(last)) => last.saturating_sub(first) / rows.max(1) <= MAX_MEAN_STEP_NS,
        _ => false,
    };
    unit.filter(is_plausible).ok_or_else(|| {
        let name = table.name(index);
        let what = format!(
            "the unit of the column {} is not to be told from its numbers: name it {name}_s, {name}_ms, {name}_us or {name}_ns",
            table.written(index)
        );
        table.error(None, what)
    })
}

/// Refuses a stamp that is not later than that of the row before.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct InOrder {
    last: Option<(i64, u64)>,
}

impl InOrder {
    pub(super) fn check(&mut self, row: &Row, stamp_ns: i64) -> Result<(), TableError> {
        if let Some((last_ns, line)) = self.last
            && stamp_ns <= last_ns
        {
            let what = if stamp_ns == last_ns { "the same as" } else { "earlier than" };
            return Err(row.error(format!(
                "its stamp ({} s) is {what} that of line {line} ({} s): rows must follow each other in time, each with a stamp of \
                 its own",
                seconds(stamp_ns),
                seconds(last_ns)
            )));
        }
        self.last = Some((stamp_ns, row.line));
        Ok(())
    }
}

/// A stamp as seconds with all nanoseconds that are not zero, for people.
pub fn seconds(stamp_ns: i64) -> String {
    let text = format!("{}.{:09}", stamp_ns.div_euclid(1_000_000_000), stamp_ns.rem_euclid(1_000_000_000));
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn numbers_keep_their_nanoseconds() {
        let ns = |text: &str, unit| Decimal::parse(text).and_then(|number| number.nanoseconds(unit));
        assert_eq!(ns("1760000000.123456789", TimeUnit::Seconds), Some(1_760_000_000_123_456_789));
        assert_eq!(ns("1760000000123.456789", TimeUnit::Milliseconds), Some(1_760_000_000_123_456_789));
        assert_eq!(ns("1.760000000123456789e+09", TimeUnit::Seconds), Some(1_760_000_000_123_456_789));
        assert_eq!(ns("0.0000000006", TimeUnit::Seconds), Some(1), "rounded");
        assert_eq!(ns("0", TimeUnit::Seconds), Some(0));
        assert_eq!(ns("0e9999", TimeUnit::Seconds), Some(0));
        for wrong in ["", ".", "-1", "1,5", "nan", "1e", "1e99999", "0x10", "1 2", "1.2.3"] {
            assert_eq!(Decimal::parse(wrong), None, "{wrong}");
        }
        assert_eq!(ns("1e300", TimeUnit::Seconds), None);
        assert_eq!(ns("1e-300", TimeUnit::Seconds), Some(0));
    }

    proptest! {
        #[test]
        fn each_time_of_this_century_is_recognized_in_each_unit(ns in EPOCH_NS) {
            for (unit, divisor) in TimeUnit::ALL.into_iter().zip([1_000_000_000, 1_000_000, 1_000, 1]) {
                let number = Decimal::parse(&(ns / divisor).to_string()).expect("a number");
                // Rounded down, the first second may lie before the range.
                if ns - ns % divisor >= EPOCH_NS.start {
                    prop_assert_eq!(TimeUnit::of_epoch(&number), Some(unit));
                }
            }
        }

        #[test]
        fn what_is_shown_reads_as_the_same_time(ns in 0..MAX_STAMP_NS) {
            let number = Decimal::parse(&seconds(ns)).expect("a number");
            prop_assert_eq!(number.nanoseconds(TimeUnit::Seconds), Some(ns));
        }

        #[test]
        fn no_text_makes_a_number_panic(text in "[0-9eE.+-]{0,60}") {
            if let Some(number) = Decimal::parse(&text) {
                let _ = TimeUnit::ALL.map(|unit| number.nanoseconds(unit));
            }
        }
    }

    #[test]
    fn a_unit_that_numbers_do_not_tell_is_refused() {
        let find = |text: &str| {
            let mut table = Table::parse(text, "imu.csv").expect("a head");
            StampColumn::find(&mut table).map(|found| found.map(|column| (column.unit.unit, column.unit.is_recognized)))
        };
        assert_eq!(find("t\n0.00\n0.01\n"), Ok(Some((TimeUnit::Seconds, true))));
        assert_eq!(find("t_ms\n0\n10\n"), Ok(Some((TimeUnit::Milliseconds, false))));
        assert_eq!(find("timestamp\n1760000000123\n1760000000133\n"), Ok(Some((TimeUnit::Milliseconds, true))));
        assert_eq!(find("x\n1\n"), Ok(None));
        // Frame numbers, and nanoseconds since the robot was switched on that look like milliseconds since 1970.
        for text in ["t\n0\n10\n", "time\n1760000000123\n1760010000123\n"] {
            let error = find(text).expect_err("not to be told").to_string();
            assert!(error.contains("_ns") && error.starts_with("imu.csv: "), "{error}");
        }
    }
}
