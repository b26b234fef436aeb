//! A table with named columns: its head, its delimiter, and its cells as numbers.

use csv::{ReaderBuilder, StringRecord, Trim};
use glam::DQuat;
use thiserror::Error;

use super::units::{AngleUnit, Quantity};
use realitysim_geometry::physical::settled;

/// Largest table, bytes: an hour of attitudes at 500 Hz with ten columns.
pub const MAX_TABLE_BYTES: u64 = 256 << 20;
/// Most rows of a table: an hour at 1 kHz.
pub(super) const MAX_TABLE_ROWS: usize = 4_000_000;
/// Most columns of a table.
const MAX_TABLE_COLUMNS: usize = 1000;
/// Most characters of a cell that an error quotes.
const MAX_QUOTED_CHARACTERS: usize = 60;
/// How far the length of a quaternion may be from 1: rounded to two decimals it still is nearer.
const MAX_LENGTH_ERROR: f64 = 0.02;

/// What is wrong with a table, with its file and line.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("{file}: {}{what}", line.map_or_else(String::new, |line| format!("line {line}: ")))]
pub struct TableError {
    /// Name of the file.
    pub file: String,
    /// Number of the line, from 1; `None` if no single line is wrong.
    pub line: Option<u64>,
    /// What is wrong, and what would be right.
    pub what: String,
}

/// A table as text. Its columns are taken by name; its rows are read one by one.
#[derive(Clone, Debug)]
pub struct Table<'t> {
    file: String,
    delimiter: u8,
    columns: Vec<Column>,
    /// The rows behind the head.
    body: &'t str,
    /// Number of lines before the body.
    lines_before: u64,
}

#[derive(Clone, Debug)]
struct Column {
    /// Name as the file writes it.
    written: String,
    /// Name in lower case, with `_` in place of blanks, brackets and slashes.
    name: String,
    taken: bool,
}

/// A row of a table.
#[derive(Clone, Debug)]
pub struct Row<'a> {
    /// Number of the line, from 1.
    pub line: u64,
    file: &'a str,
    columns: &'a [Column],
    cells: StringRecord,
}

/// A column of numbers and the factor that turns them into SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct NumberColumn {
    index: usize,
    factor: f64,
}

impl<'t> Table<'t> {
    /// Reads the head of a table. The delimiter is the one of comma, semicolon and tab that the head has most of.
    ///
    /// `file` is shown in errors. Lines before the head that are empty are skipped; a head may begin with `#`, as numpy writes it.
    pub fn parse(text: &'t str, file: &str) -> Result<Self, TableError> {
        let error = |line, what: String| TableError { file: file.to_owned(), line, what };
        let (mut rest, mut lines_before) = (text.trim_start_matches('\u{feff}'), 0);
        let head = loop {
            let (line, after) = rest.split_once('\n').unwrap_or((rest, ""));
            lines_before += 1;
            rest = after;
            if !line.trim().is_empty() {
                break line.trim().trim_start_matches('#').trim_start();
            }
            if after.is_empty() {
                return Err(error(None, "it is empty: a head that names its columns is needed".to_owned()));
            }
        };
        let count = |delimiter: u8| head.bytes().filter(|byte| *byte == delimiter).count();
        // Of equally many the last counts, so that a head of one column has commas.
        let delimiter = [b';', b'\t', b','].into_iter().max_by_key(|delimiter| count(*delimiter)).unwrap_or(b',');
        let names = reader(head, delimiter).into_records().next().and_then(Result::ok).unwrap_or_default();
        if names.len() > MAX_TABLE_COLUMNS {
            return Err(error(
                Some(lines_before),
                format!("the head has {} columns, and at most {MAX_TABLE_COLUMNS} are read", names.len()),
            ));
        }
        let columns: Vec<Column> = names
            .iter()
            .map(|name| Column { written: name.to_owned(), name: plain_name(name), taken: false })
            .collect();
        if columns.iter().all(|column| column.written.parse::<f64>().is_ok() || column.name.is_empty()) {
            let what = format!("it begins with numbers ({}): a head that names the columns is needed", quoted(head));
            return Err(error(Some(lines_before), what));
        }
        for (index, column) in columns.iter().enumerate().filter(|(_, column)| !column.name.is_empty()) {
            if columns[..index].iter().any(|earlier| earlier.name == column.name) {
                return Err(error(Some(lines_before), format!("the head names the column {} twice", column.written)));
            }
        }
        Ok(Self { file: file.to_owned(), delimiter, columns, body: rest, lines_before })
    }

    /// Name of the file, as errors show it.
    pub fn file(&self) -> &str {
        &self.file
    }

    /// The delimiter between cells.
    pub fn delimiter(&self) -> char {
        char::from(self.delimiter)
    }

    /// Names of the columns that nobody has taken, as the file writes them.
    pub fn ignored_columns(&self) -> Vec<String> {
        self.columns.iter().filter(|column| !column.taken).map(|column| column.written.clone()).collect()
    }

    /// The rows. Empty lines, and lines that begin with `#`, are left out. A row must have as many cells as the head.
    pub fn rows(&self) -> impl Iterator<Item = Result<Row<'_>, TableError>> {
        let records = reader(self.body, self.delimiter).into_records();
        let records = records.filter(|record| !record.as_ref().is_ok_and(is_empty));
        let mut counted = LineCount { body: self.body.as_bytes(), at: 0, line: self.lines_before + 1 };
        records.enumerate().map(move |(index, record)| {
            let cells = record.map_err(|error| self.error(None, error.to_string()))?;
            let line = counted.line_of(cells.position().map_or(0, |position| position.byte() as usize));
            if index >= MAX_TABLE_ROWS {
                return Err(self.error(Some(line), format!("more than {MAX_TABLE_ROWS} rows: split the walk")));
            }
            // A delimiter at the end of the line makes one empty cell more.
            let more = cells.len().saturating_sub(self.columns.len());
            let is_closed = more == 1 && cells.iter().next_back() == Some("");
            if cells.len() != self.columns.len() && !is_closed {
                let (found, needed) = (cells.len(), self.columns.len());
                return Err(self.error(Some(line), format!("{found} cells, and the head has {needed} columns")));
            }
            Ok(Row { line, file: &self.file, columns: &self.columns, cells })
        })
    }

    /// An error of this table.
    pub(super) fn error(&self, line: Option<u64>, what: String) -> TableError {
        TableError { file: self.file.clone(), line, what }
    }

    /// An error of this table that says which columns it has.
    pub(super) fn lacks(&self, what: &str) -> TableError {
        let found: Vec<&str> = self.columns.iter().map(|column| column.written.as_str()).collect();
        let found: String = found.join(", ").chars().take(4 * MAX_QUOTED_CHARACTERS).collect();
        self.error(None, format!("{what}; its columns are: {found}"))
    }

    /// Takes the column with one of these names; `None` if there is none. Two of them are an error.
    pub(super) fn take(&mut self, names: &[&str]) -> Result<Option<usize>, TableError> {
        self.take_where(names, &|name| names.contains(&name))
    }

    /// Takes a column of numbers with one of these names, alone or with a unit of `quantity` behind it.
    ///
    /// A name without unit has that of the quantity, if it has one; for an angle it is `angles`, and without that an error.
    pub(super) fn take_number(
        &mut self,
        names: &[&str],
        quantity: Quantity,
        angles: Option<AngleUnit>,
    ) -> Result<Option<NumberColumn>, TableError> {
        let unit_of = |name: &str| {
            names.iter().find_map(|base| match name.strip_prefix(base)? {
                "" => Some(None),
                suffix => quantity.factor(suffix.strip_prefix('_')?).map(Some),
            })
        };
        let Some(index) = self.take_where(names, &|name| unit_of(name).is_some())? else { return Ok(None) };
        let column = &self.columns[index];
        let stated = unit_of(&column.name).flatten();
        let Some(factor) = stated.or_else(|| quantity.factor_without_unit(angles)) else {
            let name = &column.name;
            let may_be: Vec<String> = quantity.advised().iter().map(|unit| format!("{name}_{unit}")).collect();
            let what = format!(
                "the column {} has no unit: name it {}{}",
                column.written,
                may_be.join(" or "),
                quantity.advice()
            );
            return Err(self.error(None, what));
        };
        Ok(Some(NumberColumn { index, factor }))
    }

    /// Takes all of several columns or none; some without the others are an error.
    pub(super) fn take_numbers<const N: usize>(
        &mut self,
        names: [&[&str]; N],
        quantity: Quantity,
        angles: Option<AngleUnit>,
    ) -> Result<Option<[NumberColumn; N]>, TableError> {
        let mut found = Vec::with_capacity(N);
        let mut missing = None;
        for names in names {
            match self.take_number(names, quantity, angles)? {
                Some(column) => found.push(column),
                None => missing = missing.or(names.first().copied()),
            }
        }
        match (<[NumberColumn; N]>::try_from(found), missing) {
            (Ok(columns), None) => Ok(Some(columns)),
            (Err(found), Some(name)) if !found.is_empty() => {
                Err(self
                    .lacks(&format!("the column {name} is missing beside {}", self.columns[found[0].index].written)))
            }
            _ => Ok(None),
        }
    }

    fn take_where(&mut self, names: &[&str], is_one: &dyn Fn(&str) -> bool) -> Result<Option<usize>, TableError> {
        let mut found = self.columns.iter().enumerate().filter(|(_, column)| is_one(&column.name));
        let Some((index, first)) = found.next() else { return Ok(None) };
        if let Some((_, second)) = found.next() {
            let (name, first, second) = (names.first().unwrap_or(&""), &first.written, &second.written);
            return Err(self.error(None, format!("both {first} and {second} can be the column {name}: leave one out")));
        }
        self.columns[index].taken = true;
        Ok(Some(index))
    }

    /// Name of a column, as the file writes it.
    pub(super) fn written(&self, index: usize) -> &str {
        self.columns.get(index).map_or("", |column| column.written.as_str())
    }

    /// Name of a column in lower case, with `_` between its parts.
    pub(super) fn name(&self, index: usize) -> &str {
        self.columns.get(index).map_or("", |column| column.name.as_str())
    }

    /// Takes the first column whose name `is_one` accepts.
    pub(super) fn take_first(&mut self, is_one: impl Fn(&str) -> bool) -> Option<usize> {
        let index = self.columns.iter().position(|column| is_one(&column.name))?;
        self.columns[index].taken = true;
        Some(index)
    }
}

impl Row<'_> {
    /// The text of a cell, without blanks around it.
    pub(super) fn text(&self, index: usize) -> &str {
        self.cells.get(index).unwrap_or_default()
    }

    /// A cell as a number in SI units, finite.
    pub(super) fn number(&self, column: NumberColumn) -> Result<f64, TableError> {
        let text = self.text(column.index);
        match text.parse::<f64>() {
            Ok(value) if (value * column.factor).is_finite() => Ok(settled(value * column.factor)),
            _ if text.contains(',') => Err(self.wrong(column.index, "is no number: write a decimal point")),
            _ => Err(self.wrong(column.index, "is no number")),
        }
    }

    /// The cells of several columns as numbers in SI units.
    pub(super) fn numbers<const N: usize>(&self, columns: [NumberColumn; N]) -> Result<[f64; N], TableError> {
        let mut numbers = [0.0; N];
        for (number, column) in numbers.iter_mut().zip(columns) {
            *number = self.number(column)?;
        }
        Ok(numbers)
    }

    /// A quaternion of four cells (x, y, z, w) as a rotation. One that is not of length 1 is refused.
    pub(super) fn quaternion(&self, columns: [NumberColumn; 4]) -> Result<DQuat, TableError> {
        let q = DQuat::from_array(self.numbers(columns)?);
        if (q.length() - 1.0).abs() > MAX_LENGTH_ERROR {
            let what = format!("the quaternion has the length {:.3}, and a rotation has 1", q.length());
            return Err(self.error(what));
        }
        Ok(q.normalize())
    }

    /// The cells of several columns as numbers in SI units; `None` if all of them are empty.
    pub(super) fn some_numbers<const N: usize>(
        &self,
        columns: [NumberColumn; N],
    ) -> Result<Option<[f64; N]>, TableError> {
        if columns.iter().all(|column| self.text(column.index).is_empty()) {
            Ok(None)
        } else {
            self.numbers(columns).map(Some)
        }
    }

    /// An error about a cell: its column, its text, and what is wrong with it.
    pub(super) fn wrong(&self, index: usize, what: &str) -> TableError {
        let column = self.columns.get(index).map_or("", |column| column.written.as_str());
        self.error(format!("{column} {}: it {what}", quoted(self.text(index))))
    }

    /// An error about this row.
    pub(super) fn error(&self, what: String) -> TableError {
        TableError { file: self.file.to_owned(), line: Some(self.line), what }
    }
}

/// Counts the lines up to a record. The reader itself gives the line where it began to look, before lines that it left out.
struct LineCount<'a> {
    body: &'a [u8],
    /// Up to here newlines are counted.
    at: usize,
    /// Number of the line there, from 1.
    line: u64,
}

impl LineCount<'_> {
    /// The line of the record that the reader began to look for at a byte, not before that of the call before.
    fn line_of(&mut self, began: usize) -> u64 {
        let mut start = began.clamp(self.at, self.body.len());
        loop {
            let left_out = match self.body[start..] {
                [b'\n' | b'\r', ..] => 1,
                [b'#', ref rest @ ..] => 1 + rest.iter().take_while(|byte| **byte != b'\n').count(),
                _ => break,
            };
            start += left_out;
        }
        self.line += self.body[self.at..start].iter().filter(|byte| **byte == b'\n').count() as u64;
        self.at = start;
        self.line
    }
}

fn reader(text: &str, delimiter: u8) -> csv::Reader<&[u8]> {
    ReaderBuilder::new()
        .has_headers(false)
        .flexible(true)
        .delimiter(delimiter)
        .trim(Trim::All)
        .comment(Some(b'#'))
        .from_reader(text.as_bytes())
}

/// Whether a row has nothing in it.
fn is_empty(record: &StringRecord) -> bool {
    record.iter().all(str::is_empty)
}

/// A name in lower case, with one `_` in place of blanks, brackets, slashes and hyphens.
fn plain_name(written: &str) -> String {
    let mut name = String::with_capacity(written.len());
    for c in written.trim().chars().filter(|c| *c != '^') {
        let c = if c.is_alphanumeric() || c == '%' { c.to_ascii_lowercase() } else { '_' };
        if c != '_' || !(name.is_empty() || name.ends_with('_')) {
            name.push(c);
        }
    }
    name.trim_end_matches('_').to_owned()
}

/// A text between quotes, without control characters and not longer than a line.
fn quoted(text: &str) -> String {
    let short: String = text.chars().take(MAX_QUOTED_CHARACTERS).collect();
    if short.len() < text.len() { format!("{short:?}…") } else { format!("{short:?}") }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        /// The oracle looks for the row's own text in the lines of the file.
        #[test]
        fn a_row_knows_its_line(parts in prop::collection::vec(0..5usize, 0..30), crlf: bool) {
            let ending = if crlf { "\r\n" } else { "\n" };
            let mut text = format!("# a,b{ending}");
            let mut number = 0;
            for part in parts {
                let line = match part {
                    0 => String::new(),
                    1 => "# a comment, with a comma".to_owned(),
                    2 => "  ".to_owned(),
                    3 => { number += 1; format!("\"row{number}\",1") }
                    _ => { number += 1; format!("row{number},1") }
                };
                text += &line;
                text += ending;
            }
            let table = Table::parse(&text, "file").expect("a head");
            let rows: Vec<Row> = table.rows().collect::<Result<_, _>>().expect("rows");
            prop_assert_eq!(rows.len(), number);
            for row in rows {
                let name = row.text(0);
                let is_own = |line: &str| line.split(',').next().is_some_and(|cell| cell.trim_matches('"') == name);
                let expected = text.lines().position(is_own).expect("in the text") as u64 + 1;
                prop_assert_eq!(row.line, expected, "{}: {}", name, text);
            }
        }

        #[test]
        fn no_text_makes_a_table_panic(text in "[a-z0-9,;\t\n\r\"#. \u{e9}\u{feff}]{0,200}") {
            if let Ok(table) = Table::parse(&text, "file") {
                for row in table.rows().map_while(Result::ok) {
                    prop_assert!(row.line as usize <= text.lines().count() + 1);
                }
            }
        }
    }
}
