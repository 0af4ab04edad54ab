//! The rows of a table one by one, from CSV or Parquet. Rows that cannot be read are counted and passed over.

use super::columns::{Kind, lacks, with_types};
use crate::ingest::csv_rows::Lines;
use crate::ingest::error::Malformed;
use crate::ingest::ids::whole_number;
use crate::ingest::parquet_columns::{Stream, columns_of};
use crate::ingest::quotes::{printable, split_quoted};
use crate::ingest::raw::{Finding, MAX_BAD_SHARE};
use arrow::array::{Array, StringArray};
use parquet::file::metadata::ParquetMetaData;
use std::borrow::Cow;
use std::io::BufRead;
use std::sync::Arc;

/// The longest text of a cell, bytes: names are shorter.
const MAX_TEXT_BYTES: usize = 1024;
/// Ids of nobody, as trackers and pandas write them.
const NOBODY: [&str; 5] = ["", "-1", "nan", "NaN", "None"];

pub(super) struct TableRows<'r> {
    source: Source<'r>,
    pub(super) names: Vec<String>,
    pub(super) columns: Vec<(String, Kind)>,
    /// The numbers of the last row by column.
    numbers: Vec<f64>,
    /// The line of the last row, or its number.
    pub(super) place: u64,
    pub(super) passed: Passed,
}

/// What was passed over.
#[derive(Debug, Clone, Default)]
pub(super) struct Passed {
    n_used: u64,
    pub(super) n_without_track: u64,
    n_bad: u64,
    first_bad: Option<String>,
}

enum Source<'r> {
    /// `places`: the indices of each of the columns in the table, by precedence.
    Text { lines: Lines<'r>, separator: u8, cells: csv::ByteRecord, places: Vec<Vec<usize>> },
    /// `cells`: some rows of the table, the first `n_done` of which were read, by column and precedence.
    Parquet { stream: Box<Stream<'r>>, cells: Vec<Vec<Cells>>, n_rows: usize, n_done: usize },
}

enum Cells {
    Numbers(Vec<f64>),
    Texts(StringArray),
}

impl<'r> TableRows<'r> {
    /// The rows of a table in CSV, with those of the `wanted` columns that it has.
    pub(super) fn of_csv(table: &'r mut dyn BufRead, wanted: &[(&str, Kind)]) -> Result<Self, Malformed> {
        let mut lines = Lines::new(table).with_quotes();
        let unreadable = |error: std::io::Error| Malformed::from(error.to_string());
        let (_, header) = lines.next().map_err(unreadable)?.ok_or("is empty")?;
        if header.starts_with(&[0xff, 0xfe]) || header.starts_with(&[0xfe, 0xff]) {
            return Err("is in UTF-16, expected UTF-8: save it in that encoding".into());
        }
        let separator = separator_of(header);
        let mut cells = csv::ByteRecord::new();
        split_quoted(header, separator, &mut cells)?;
        let names: Vec<String> = cells.iter().map(printable).collect();
        let (mut places, mut columns) = (Vec::new(), Vec::new());
        for (name, kind) in with_types(wanted, &names) {
            let mut found = Vec::new();
            for name in alternatives(&name, &names) {
                let mut same = names.iter().enumerate().filter(|(_, found)| *found == name).map(|(place, _)| place);
                found.extend(same.next());
                if same.next().is_some() {
                    return Err(format!("line 1: the column {name} appears twice").into());
                }
            }
            if !found.is_empty() {
                places.push(found);
                columns.push((name, kind));
            }
        }
        let source = Source::Text { lines, separator, cells, places };
        Ok(Self::new(source, names, columns, 1))
    }

    /// The rows of a table in Parquet with this footer.
    pub(super) fn of_parquet(
        table: &'r mut dyn BufRead,
        footer: &Arc<ParquetMetaData>,
        wanted: &[(&str, Kind)],
    ) -> Result<Self, Malformed> {
        let names = columns_of(footer)?;
        let columns: Vec<(String, Kind)> = with_types(wanted, &names)
            .into_iter()
            .filter(|(name, _)| alternatives(name, &names).next().is_some())
            .collect();
        let read: Vec<&str> = columns.iter().flat_map(|(name, _)| alternatives(name, &names)).collect();
        let stream = Box::new(Stream::of(table, footer, &read)?);
        let source = Source::Parquet { stream, cells: Vec::new(), n_rows: 0, n_done: 0 };
        // The first row is row 0.
        Ok(Self::new(source, names, columns, u64::MAX))
    }

    fn new(source: Source<'r>, names: Vec<String>, columns: Vec<(String, Kind)>, place: u64) -> Self {
        let numbers = vec![f64::NAN; columns.len()];
        Self { source, names, columns, numbers, place, passed: Passed::default() }
    }

    /// Goes to the next row that can be read; false at the end.
    pub(super) fn next(&mut self) -> Result<bool, Malformed> {
        while let Some(is_whole) = self.advance()? {
            match is_whole.and_then(|()| self.check()) {
                Ok(true) => {
                    self.passed.n_used += 1;
                    return Ok(true);
                }
                Ok(false) => self.passed.n_without_track += 1,
                Err(detail) => {
                    self.passed.n_bad += 1;
                    let place = format!("{} {}", self.counted(), self.place);
                    self.passed.first_bad.get_or_insert_with(|| format!("{place}: {detail}"));
                }
            }
        }
        Ok(false)
    }

    /// Goes to the next row; `None` at the end.
    fn advance(&mut self) -> Result<Option<Result<(), String>>, Malformed> {
        match &mut self.source {
            Source::Text { lines, separator, cells, .. } => loop {
                let Some((number, line)) = lines.next().map_err(|error| error.to_string())? else { return Ok(None) };
                if line.trim_ascii().is_empty() {
                    continue;
                }
                self.place = number;
                let split = split_quoted(line, *separator, cells).map_err(str::to_owned);
                let (n, expected, between) = (cells.len(), self.names.len(), char::from(*separator));
                let is_whole = split.and_then(|()| match n == expected {
                    true => Ok(()),
                    false => Err(format!("{n} cells, expected {expected} between {between:?}, as in the header")),
                });
                return Ok(Some(is_whole));
            },
            Source::Parquet { stream, cells, n_rows, n_done } => {
                while *n_done == *n_rows {
                    let Some(rows) = stream.next()? else { return Ok(None) };
                    let of_column = |name: &str, kind: Kind| match kind {
                        Kind::Required | Kind::Number => rows.float_or_nan(name).map(Cells::Numbers),
                        Kind::Track | Kind::Text | Kind::Types => rows.text_or_null(name).map(Cells::Texts),
                    };
                    let of_columns = |(names, kind): &(String, Kind)| {
                        alternatives(names, &self.names).map(|name| of_column(name, *kind)).collect()
                    };
                    *cells = self.columns.iter().map(of_columns).collect::<Result<_, _>>()?;
                    (*n_rows, *n_done) = (rows.n_rows(), 0);
                }
                *n_done += 1;
                self.place = self.place.wrapping_add(1);
                Ok(Some(Ok(())))
            }
        }
    }

    /// Reads the cells of the row; false if it is nobody's.
    fn check(&mut self) -> Result<bool, String> {
        for at in 0..self.columns.len() {
            let (name, kind) = &self.columns[at];
            if matches!(kind, Kind::Track | Kind::Text | Kind::Types) {
                let text = self.source.text(at).map_err(|found| format!("column {name} {found}"))?;
                if text.len() > MAX_TEXT_BYTES {
                    let n = text.len();
                    return Err(format!("column {name} has {n} bytes, expected a text of at most {MAX_TEXT_BYTES}"));
                }
                if *kind == Kind::Track && NOBODY.contains(&&*text) {
                    return Ok(false);
                }
                continue;
            }
            let number = self.source.number(at).map_err(|found| format!("column {name} {found}"))?;
            if *kind == Kind::Required && !number.is_finite() {
                let found = if number.is_nan() { "blank or NaN".to_owned() } else { number.to_string() };
                return Err(format!("column {name} is {found}, expected a number"));
            }
            self.numbers[at] = number;
        }
        Ok(true)
    }

    /// A number of the last row; NaN if the cell is blank.
    pub(super) fn number(&self, at: usize) -> f64 {
        self.numbers[at]
    }

    /// A text of the last row; whole numbers are written in one way.
    pub(super) fn text(&self, at: usize) -> Cow<'_, str> {
        self.source.text(at).unwrap_or_default()
    }

    /// The index of a column among those that are read.
    pub(super) fn index_of(&self, name: &str) -> Option<usize> {
        self.columns.iter().position(|(found, _)| found == name)
    }

    /// The approximate size of the last row in the columns that are read, bytes.
    pub(super) fn n_bytes(&self) -> u64 {
        (0..self.columns.len()).map(|at| self.source.n_bytes(at)).sum()
    }

    /// Writes the last row.
    pub(super) fn put(&self, to: &mut csv::Writer<Vec<u8>>) {
        let cell = |at: usize| match self.columns[at].1 {
            Kind::Required | Kind::Number if self.numbers[at].is_nan() => Cow::Borrowed(""),
            Kind::Required | Kind::Number => Cow::Owned(self.numbers[at].to_string()),
            Kind::Track | Kind::Text | Kind::Types => self.text(at),
        };
        // Writing to memory does not fail.
        let _ = to.write_record((0..self.columns.len()).map(|at| cell(at).into_owned()));
    }

    /// The unit of the places of rows.
    pub(super) const fn counted(&self) -> &'static str {
        match self.source {
            Source::Text { .. } => "line",
            Source::Parquet { .. } => "row",
        }
    }

    /// The error that the table has none of these columns.
    pub(super) fn lacks(&self, missing: &[&str]) -> String {
        lacks(&self.names, missing)
    }
}

impl Source<'_> {
    fn cell(&self, at: usize) -> &[u8] {
        match self {
            Source::Text { cells, places, .. } => first_of(places[at].iter().map(|place| &cells[*place])),
            Source::Parquet { cells, n_done, .. } => first_of(cells[at].iter().map(|cells| match cells {
                Cells::Texts(texts) if !texts.is_null(*n_done - 1) => texts.value(*n_done - 1).as_bytes().trim_ascii(),
                _ => b"",
            })),
        }
    }

    fn text(&self, at: usize) -> Result<Cow<'_, str>, String> {
        let cell = self.cell(at);
        let text = std::str::from_utf8(cell).map_err(|_| format!("is not in UTF-8: {}", printable(cell)))?;
        Ok(Cow::Borrowed(whole_number(text)))
    }

    fn number(&self, at: usize) -> Result<f64, String> {
        if let Source::Parquet { cells, n_done, .. } = self
            && let [Cells::Numbers(_), ..] = cells[at][..]
        {
            let mut numbers = cells[at].iter().filter_map(|cells| match cells {
                Cells::Numbers(numbers) => Some(numbers[*n_done - 1]),
                Cells::Texts(_) => None,
            });
            return Ok(numbers.find(|number| !number.is_nan()).unwrap_or(f64::NAN));
        }
        let cell = self.cell(at);
        let parsed = |text: &str| {
            // Where commas do not separate cells, one in a number is its decimal point.
            let has_commas = matches!(self, Source::Text { separator, .. } if *separator != b',');
            let with_comma = || has_commas.then(|| text.replacen(',', ".", 1).parse().ok())?;
            text.parse().ok().or_else(|| in_thousands(text)).or_else(with_comma)
        };
        let number = if cell.is_empty() { Some(f64::NAN) } else { std::str::from_utf8(cell).ok().and_then(parsed) };
        number.ok_or_else(|| {
            let point = if cell.contains(&b',') { " with a decimal point" } else { "" };
            format!("is \"{}\", expected a number{point}", printable(cell))
        })
    }

    fn n_bytes(&self, at: usize) -> u64 {
        const N_BYTES_OF_NUMBER: u64 = 8;
        match self {
            Source::Parquet { cells, .. } if matches!(cells[at][..], [Cells::Numbers(_), ..]) => N_BYTES_OF_NUMBER,
            _ => self.cell(at).len() as u64 + 1,
        }
    }
}

impl Passed {
    /// The reason to reject the table, if too many of its rows cannot be read.
    pub(super) fn fault(&self) -> Option<String> {
        let (n_bad, n) = (self.n_bad, self.n_bad + self.n_used);
        let first = self.first_bad.as_ref().filter(|_| n_bad as f64 > MAX_BAD_SHARE * n as f64)?;
        let others = if n > 1 { format!("; {n_bad} of {n} rows cannot be read") } else { String::new() };
        Some(format!("{first}{others}"))
    }

    pub(super) fn findings(&self, file: &str) -> Vec<Finding> {
        let nobody = "rows without an id (blank, nan or -1) are left out; others in columns of their own are read by \
                      ingest.table.columns.track = \"this|other\", and x, y, time likewise";
        let bad = self.first_bad.clone().unwrap_or_default();
        let of = |what, n: u64, detail: &str| (n > 0).then(|| Finding { what, n, detail: format!("{file}: {detail}") });
        let all = [of("rows_without_track", self.n_without_track, nobody), of("rows_left_out", self.n_bad, &bad)];
        all.into_iter().flatten().collect()
    }
}

/// The columns of a table with these `names` that a mapping means by `name`: those of its parts between `|` that the
/// table has, the first of which that is not blank counts.
pub(super) fn alternatives<'a>(name: &'a str, names: &'a [String]) -> impl Iterator<Item = &'a str> {
    let is_one = names.iter().any(|found| found == name);
    let parts = name.split(if is_one { '\0' } else { '|' }).map(str::trim);
    parts.filter(|part| names.iter().any(|found| found == part))
}

/// The first cell that is not blank.
fn first_of<'a>(mut cells: impl Iterator<Item = &'a [u8]>) -> &'a [u8] {
    cells.find(|cell| !cell.is_empty()).unwrap_or_default()
}

/// A number with commas between thousands, such as `1,050.197` from spreadsheets. A single comma without a point may be
/// that of a decimal fraction.
fn in_thousands(text: &str) -> Option<f64> {
    let (whole, fraction) = text.split_once('.').map_or((text, None), |(whole, fraction)| (whole, Some(fraction)));
    let mut groups = whole.strip_prefix('-').unwrap_or(whole).split(',');
    let is_number = |text: &str| text.bytes().all(|byte| byte.is_ascii_digit());
    let first = groups.next().filter(|first| (1..=3).contains(&first.len()) && is_number(first));
    let n_groups = groups.clone().count();
    let is_whole = first.is_some() && groups.all(|group| group.len() == 3 && is_number(group));
    let is_certain = n_groups > usize::from(fraction.is_none()) && fraction.is_none_or(is_number);
    (is_whole && is_certain).then(|| text.replace(',', "").parse().ok())?
}

/// The separator of cells, found in the header of a table.
fn separator_of(header: &[u8]) -> u8 {
    let count = |separator: &u8| header.iter().filter(|byte| *byte == separator).count();
    *b",;\t".iter().max_by_key(|separator| count(separator)).unwrap_or(&b',')
}
