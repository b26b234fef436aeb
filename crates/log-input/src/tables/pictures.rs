//! When pictures were taken: by a table, by numbers in their names, or by a rate in the order of their names.

use core::cmp::Ordering;
use core::f64::consts::PI;
use std::collections::HashMap;

use super::Measured;
use super::stamp::{Decimal, InOrder, StampColumn, StampUnit, TimeUnit, seconds};
use super::table::{Table, TableError};
use super::units::{AngleUnit, Quantity};
use realitysim_geometry::{Physical, Pose2};

/// A picture and when it was taken.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StampedPicture {
    /// Name of its file.
    pub name: String,
    /// Time of the exposure, nanoseconds.
    pub stamp_ns: i64,
}

/// Reads a table of `image` (or `file`) and `stamp`. The rows must follow each other in time.
pub fn read(table: &mut Table) -> Result<Measured<StampedPicture>, TableError> {
    let stamps = StampColumn::find(table)?.ok_or_else(|| table.lacks("the column stamp (or time, t) is missing"))?;
    let image = table.take(&["image", "file", "filename", "name"])?;
    let image = image.ok_or_else(|| table.lacks("the column image is missing"))?;
    let mut lines: HashMap<String, u64> = HashMap::new();
    let (mut rows, mut order) = (Vec::new(), InOrder::default());
    for row in table.rows() {
        let row = row?;
        let stamp_ns = stamps.read(&row)?;
        order.check(&row, stamp_ns)?;
        let name = row.text(image).to_owned();
        if name.is_empty() {
            return Err(row.wrong(image, "must name a picture"));
        }
        if let Some(line) = lines.insert(name.clone(), row.line) {
            return Err(row.error(format!("{name} stands in line {line} already: a picture was taken once")));
        }
        rows.push(StampedPicture { name, stamp_ns });
    }
    Ok(Measured { rows, stamps: Some(stamps.unit), assumed: Vec::new() })
}

/// Reads a table that has a stamp for each frame of a video, in their order.
pub fn read_frames(table: &mut Table) -> Result<Measured<i64>, TableError> {
    let stamps = StampColumn::find(table)?.ok_or_else(|| table.lacks("the column stamp (or time, t) is missing"))?;
    let (mut rows, mut order) = (Vec::new(), InOrder::default());
    for row in table.rows() {
        let row = row?;
        let stamp_ns = stamps.read(&row)?;
        order.check(&row, stamp_ns)?;
        rows.push(stamp_ns);
    }
    Ok(Measured { rows, stamps: Some(stamps.unit), assumed: Vec::new() })
}

/// Takes the time of each picture from the number in its name, and sorts them by it.
///
/// A name has one number that is a time between 2000 and 2100 in seconds, milliseconds, microseconds or nanoseconds, perhaps with
/// nine digits of nanoseconds behind seconds (`left_1760000000_250000000.png`), or one number with a decimal point, which are
/// seconds of another clock. The error names the first picture without such a number.
pub fn by_names(names: &[String]) -> Result<Measured<StampedPicture>, String> {
    let mut rows = Vec::with_capacity(names.len());
    let mut unit: Option<(TimeUnit, &String)> = None;
    for name in names {
        let Some((stamp_ns, found)) = time_in(name) else {
            return Err(format!("{name}: its name holds no time"));
        };
        match unit {
            Some((unit, first)) if unit != found => {
                return Err(format!("{name} seems to count in {found}, and {first} in {unit}"));
            }
            _ => unit = Some((found, name)),
        }
        rows.push(StampedPicture { name: name.clone(), stamp_ns });
    }
    rows.sort_by_key(|picture| picture.stamp_ns);
    if let Some([one, other]) = rows.windows(2).find(|pair| pair[0].stamp_ns == pair[1].stamp_ns) {
        return Err(format!("{} and {} have the same stamp ({} s)", one.name, other.name, seconds(one.stamp_ns)));
    }
    let stamps = unit.map(|(unit, _)| StampUnit { unit, is_recognized: true });
    Ok(Measured { rows, stamps, assumed: Vec::new() })
}

/// Gives the pictures times in the natural order of their names, in which `2.png` comes before `10.png`: one each period, from
/// `first_ns` on.
pub fn by_rate(names: &[String], first_ns: i64, rate_hz: f64) -> Vec<StampedPicture> {
    let mut names = names.to_vec();
    names.sort_by(|a, b| natural_order(a, b));
    let stamped = names
        .into_iter()
        .enumerate()
        .map(|(index, name)| StampedPicture { name, stamp_ns: at_rate(index, first_ns, rate_hz) });
    stamped.collect()
}

/// Time of the frame `index` at a rate.
pub fn at_rate(index: usize, first_ns: i64, rate_hz: f64) -> i64 {
    // A conversion of a float to an integer saturates.
    first_ns.saturating_add(libm::round(index as f64 * 1e9 / rate_hz) as i64)
}

/// The time in a picture's name, nanoseconds, and its unit.
fn time_in(name: &str) -> Option<(i64, TimeUnit)> {
    let stem = name.rsplit_once('.').map_or(name, |(stem, _)| stem);
    let numbers: Vec<&str> = stem
        .split(|c: char| !(c.is_ascii_digit() || c == '.'))
        .map(|number| number.trim_matches('.'))
        .filter(|number| !number.is_empty())
        .collect();
    let mut found = None;
    for (index, text) in numbers.iter().enumerate() {
        let Some(number) = Decimal::parse(text) else { continue };
        let Some(unit) = TimeUnit::of_epoch(&number) else { continue };
        if found.is_some() {
            return None;
        }
        let behind = numbers.get(index + 1).filter(|text| text.len() == 9 && !text.contains('.'));
        let more_ns = match (unit, text.contains('.'), behind) {
            (TimeUnit::Seconds, false, Some(text)) => text.parse().ok()?,
            _ => 0,
        };
        found = Some((number.nanoseconds(unit)?.checked_add(more_ns)?, unit));
    }
    if found.is_some() {
        return found;
    }
    let mut with_point = numbers.iter().filter(|number| number.contains('.'));
    match (with_point.next(), with_point.next()) {
        (Some(number), None) => Some((Decimal::parse(number)?.nanoseconds(TimeUnit::Seconds)?, TimeUnit::Seconds)),
        _ => None,
    }
}

/// Compares names as people sort them: digits by the number that they make.
pub fn natural_order(a: &str, b: &str) -> Ordering {
    let (mut rest_a, mut rest_b) = (a, b);
    while let (Some(one), Some(other)) = (rest_a.chars().next(), rest_b.chars().next()) {
        let (order, lengths) = if one.is_ascii_digit() && other.is_ascii_digit() {
            let numbers = [rest_a, rest_b].map(|rest| &rest[..digits(rest)]);
            let [one, other] = numbers.map(|number| number.trim_start_matches('0'));
            (one.len().cmp(&other.len()).then_with(|| one.cmp(other)), numbers.map(str::len))
        } else {
            (one.cmp(&other), [one.len_utf8(), other.len_utf8()])
        };
        if order.is_ne() {
            return order;
        }
        (rest_a, rest_b) = (&rest_a[lengths[0]..], &rest_b[lengths[1]..]);
    }
    rest_a.cmp(rest_b).then_with(|| a.cmp(b))
}

/// Number of digits that a text begins with.
fn digits(text: &str) -> usize {
    text.bytes().take_while(u8::is_ascii_digit).count()
}

/// What is known about the camera of one picture.
#[derive(Clone, Debug, PartialEq)]
pub struct KnownPicture {
    /// Name of its file.
    pub name: String,
    /// Roll and pitch of `camera_link`, radians, if they are known.
    pub tilt_rad: Option<[f64; 2]>,
    /// Height of `camera_link` above the ground, metres, if it is known.
    pub height_m: Option<f64>,
    /// Approximate pose of `camera_link` in `map`, if it is known.
    pub initial: Option<Pose2>,
}

/// Reads a table of `image` and what is known of its camera: `roll`, `pitch` with a unit, `height`, and `x`, `y`, `yaw` with a unit. A cell
/// may be empty.
pub fn read_known(table: &mut Table, angles: Option<AngleUnit>) -> Result<Measured<KnownPicture>, TableError> {
    let image = table.take(&["image", "file", "filename", "name"])?;
    let image = image.ok_or_else(|| table.lacks("the column image is missing"))?;
    let tilt = table.take_numbers([&["roll"], &["pitch"]], Quantity::Angle, angles)?;
    let height = table.take_number(&["height"], Quantity::Length, None)?;
    let position = table.take_numbers([&["x"], &["y"]], Quantity::Length, None)?;
    let yaw = table.take_number(&["yaw", "theta", "heading"], Quantity::Angle, angles)?;
    if position.is_some() != yaw.is_some() {
        return Err(table.lacks("x, y and yaw_deg are needed together"));
    }
    let mut lines: HashMap<String, u64> = HashMap::new();
    let mut rows = Vec::new();
    for row in table.rows() {
        let row = row?;
        let name = row.text(image).to_owned();
        if let Some(line) = lines.insert(name.clone(), row.line) {
            return Err(row.error(format!("{name} stands in line {line} already")));
        }
        let tilt_rad = tilt.map(|columns| row.some_numbers(columns)).transpose()?.flatten();
        if let Some([roll, pitch]) = tilt_rad.filter(|[roll, pitch]| roll.abs() > PI || pitch.abs() > 0.5 * PI) {
            let (roll, pitch) = (roll.to_degrees(), pitch.to_degrees());
            return Err(
                row.error(format!("roll {roll:.0} and pitch {pitch:.0} deg are no attitude: is the unit right?"))
            );
        }
        let height_m =
            height.map(|column| row.some_numbers([column])).transpose()?.flatten().map(|[height_m]| height_m);
        if let Some(height_m) = height_m.filter(|height_m| !HEIGHTS_M.contains(height_m)) {
            return Err(row.error(format!("the height is {height_m} m: it must be 0.01 to 100 m")));
        }
        let initial = match (position, yaw) {
            (Some([x, y]), Some(yaw)) => row.some_numbers([x, y, yaw])?.map(|[x, y, yaw]| Pose2::new(x, y, yaw)),
            _ => None,
        };
        if initial.is_some_and(|pose| !pose.is_possible()) {
            return Err(row.error("x, y, yaw are no pose on a field: is the unit right?".to_owned()));
        }
        rows.push(KnownPicture { name, tilt_rad, height_m, initial });
    }
    Ok(Measured { rows, stamps: None, assumed: Vec::new() })
}

/// Heights of a camera above the ground that are possible, metres.
const HEIGHTS_M: core::ops::RangeInclusive<f64> = 0.01..=100.0;

#[cfg(test)]
mod tests {
    use super::*;

    fn names(names: &[&str]) -> Vec<String> {
        names.iter().map(|name| (*name).to_owned()).collect()
    }

    #[test]
    fn names_are_sorted_by_the_numbers_in_them() {
        let mut sorted =
            names(&["b1.png", "a10.png", "a2.png", "a2.jpg", "a02.png", "a.png", "A1.png", "a10b2.png", "a10b11.png"]);
        sorted.sort_by(|a, b| natural_order(a, b));
        let expected =
            ["A1.png", "a.png", "a2.jpg", "a02.png", "a2.png", "a10.png", "a10b2.png", "a10b11.png", "b1.png"];
        assert_eq!(sorted, expected);
    }

    #[test]
    fn the_order_of_names_is_an_order() {
        let all =
            ["", "1", "01", "a", "a1", "a01", "1a", "a1b", "a1b2", "10", "9", "99999999999999999999999", "é1", "a-1"];
        for a in all {
            for b in all {
                assert_eq!(natural_order(a, b), natural_order(b, a).reverse(), "{a} {b}");
                for c in all {
                    if natural_order(a, b).is_le() && natural_order(b, c).is_le() {
                        assert!(natural_order(a, c).is_le(), "{a} {b} {c}");
                    }
                }
            }
        }
    }

    #[test]
    fn times_in_names_are_recognized() {
        for (name, seconds) in [
            ("1760000000.jpg", "1760000000"),
            ("frame_1760000000250.jpg", "1760000000.25"),
            ("frame-1760000000250000.png", "1760000000.25"),
            ("7_1760000000250000000_left.jpeg", "1760000000.25"),
            ("left_1760000000_250000000.png", "1760000000.25"),
            ("1760000000.25.png", "1760000000.25"),
            ("image_12.5.png", "12.5"),
        ] {
            let found = by_names(&names(&[name])).expect(name);
            assert_eq!(super::seconds(found.rows[0].stamp_ns), seconds, "{name}");
        }
        for name in ["000123.jpg", "a.png", "20251009.jpg", "1760000000_1760000001.png", "1.5_2.5.png", ""] {
            assert!(by_names(&names(&[name])).is_err(), "{name}");
        }
        let error = by_names(&names(&["1760000000.jpg", "1760000001000.jpg"])).expect_err("two units");
        assert!(error.contains("milliseconds") && error.contains("in seconds"), "{error}");
        let error = by_names(&names(&["a1760000000.jpg", "b1760000000.jpg"])).expect_err("one time");
        assert!(error.contains("a1760000000.jpg and b1760000000.jpg have the same stamp"), "{error}");
    }

    #[test]
    fn a_rate_gives_each_picture_its_time() {
        let stamped = by_rate(&names(&["10.png", "9.png"]), 5, 30.0);
        assert_eq!([&stamped[0].name, &stamped[1].name], ["9.png", "10.png"]);
        assert_eq!([stamped[0].stamp_ns, stamped[1].stamp_ns], [5, 33_333_338]);
        assert_eq!(at_rate(usize::MAX, i64::MAX, 0.001), i64::MAX);
    }
}
