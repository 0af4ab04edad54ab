//! The rows of a table one by one, and those of its parts.

use super::columns::{Kind, csv_reader, separator_of, with_types};
use super::mapping::{TableColumns, TableMapping};
use super::rows::wanted;
use crate::geometry::Vec2;
use crate::ingest::parquet_columns::{Stream, columns_of};
use crate::ingest::quotes::printable;
use crate::ingest::raw::{Part, RawUnit, Reject};
use arrow::array::{Array, StringArray};
use parquet::file::metadata::ParquetMetaData;
use std::borrow::Cow;
use std::collections::BTreeSet;
use std::io::{BufRead, Read};
use std::sync::Arc;

/// The rows of a part.
pub(super) struct Gathered<'a> {
    pub(super) part: &'a Part,
    text: csv::Writer<Vec<u8>>,
    lines: Vec<u64>,
}

impl Gathered<'_> {
    /// The unit of the part, in other respects like that of the table.
    pub(super) fn unit(self, table: &RawUnit) -> Result<RawUnit, Reject> {
        let (first, last) = (self.part.windows.start, self.part.windows.end - 1);
        if self.lines.is_empty() {
            return Err(table.reject("empty_window", format!("windows {first} to {last}: nobody is tracked")));
        }
        let unreadable = |error: &dyn std::fmt::Display| table.reject("unreadable", error);
        let bytes = self.text.into_inner().map_err(|error| unreadable(&error))?;
        Ok(RawUnit { bytes, lines: self.lines, part: Some(Arc::new(self.part.clone())), ..table.clone() })
    }
}

/// The rows of a table with their times, one after the other.
pub(super) struct TimedRows<'r> {
    source: Source<'r>,
    mapping: &'r TableMapping,
    separator: u8,
    /// The columns to read.
    columns: Vec<(String, Kind)>,
    /// The indices among them of the time, the track, and the columns that distinguish recordings of one file.
    time: usize,
    position: [usize; 2],
    track: usize,
    key: Vec<usize>,
    /// The line of the last row, or its number.
    place: u64,
}

enum Source<'r> {
    /// `places`: the index of each of the columns in the table.
    Text {
        reader: csv::Reader<Box<dyn Read + 'r>>,
        record: csv::ByteRecord,
        places: Vec<usize>,
        n_cells: usize,
        n_behind: u64,
    },
    /// `cells`: some rows of the table, the first `n_done` of which were read.
    Parquet { stream: Stream<'r>, cells: Vec<Cells>, n_rows: usize, n_done: usize },
}

/// The cells of one column.
enum Cells {
    Numbers(Vec<f64>),
    Texts(StringArray),
}

impl<'r> TimedRows<'r> {
    /// `None` if the table cannot be cut. `footer` is that of a table in Parquet.
    pub(super) fn of(
        table: &'r mut dyn BufRead,
        footer: Option<&Arc<ParquetMetaData>>,
        mapping: &'r TableMapping,
    ) -> Option<Self> {
        let mut all = wanted(&mapping.columns);
        let mut seen = BTreeSet::new();
        all.retain(|(name, _)| seen.insert(*name));
        let (source, separator, columns) = match footer {
            None => Source::text(table, &all)?,
            Some(footer) => {
                let all = with_types(&all, &columns_of(footer).ok()?);
                let names: Vec<&str> = all.iter().map(|(name, _)| name.as_str()).collect();
                let stream = Stream::of(table, footer, &names).ok()?;
                let columns = all.iter().filter(|(name, _)| stream.names().contains(name)).cloned().collect();
                (Source::Parquet { stream, cells: Vec::new(), n_rows: 0, n_done: 0 }, b',', columns)
            }
        };
        // Other columns are in the table of tracks.
        let is_there = |(name, kind): &(&str, Kind)| {
            *kind == Kind::Types || columns.iter().any(|(found, _): &(String, Kind)| found == name)
        };
        if mapping.track_files.is_none() && !all.iter().all(is_there) {
            return None;
        }
        let TableColumns { time, frame, track, x, y, recording, place, .. } = &mapping.columns;
        let place_of = |name: &String| columns.iter().position(|(found, _)| found == name);
        let (time, track) = (place_of(time.as_ref().or(frame.as_ref())?)?, place_of(track)?);
        let position = [place_of(x)?, place_of(y)?];
        let key = [recording, place].into_iter().flatten().map(place_of).collect::<Option<Vec<usize>>>()?;
        // The first row is row 0.
        Some(Self { source, mapping, separator, columns, time, position, track, key, place: u64::MAX })
    }

    /// The time of the next row, seconds; `Some(None)` at the end, and `None` if the row is malformed.
    #[expect(clippy::option_option, reason = "an end is no fault")]
    pub(super) fn next(&mut self) -> Option<Option<f64>> {
        match &mut self.source {
            Source::Text { reader, record, n_cells, n_behind, .. } => {
                if !reader.read_byte_record(record).ok()? {
                    return Some(None);
                }
                if record.len() != *n_cells {
                    return None;
                }
                self.place = record.position().map_or(0, csv::Position::line) + *n_behind;
            }
            Source::Parquet { stream, cells, n_rows, n_done } => {
                while *n_done == *n_rows {
                    let Some(rows) = stream.next().ok()? else { return Some(None) };
                    let of_column = |(name, kind): &(String, Kind)| match kind {
                        Kind::Number => Some(Cells::Numbers(rows.float_or_nan(name).ok()?)),
                        Kind::Text | Kind::Types => Some(Cells::Texts(rows.text_or_null(name).ok()?)),
                    };
                    *cells = self.columns.iter().map(of_column).collect::<Option<_>>()?;
                    (*n_rows, *n_done) = (rows.n_rows(), 0);
                }
                *n_done += 1;
                self.place = self.place.wrapping_add(1);
            }
        }
        self.number(self.time).map(|time| Some(self.mapping.seconds_of(time)))
    }

    /// A finite number in the last row.
    fn number(&self, at: usize) -> Option<f64> {
        let number = match &self.source {
            Source::Text { .. } => self.cell(at)?.parse().ok()?,
            Source::Parquet { cells, n_done, .. } => match &cells[at] {
                Cells::Numbers(numbers) => numbers[*n_done - 1],
                Cells::Texts(_) => return None,
            },
        };
        number.is_finite().then_some(number)
    }

    /// The position of the agent of the last row, meters; NaN if it cannot be read, which is reported with the part.
    pub(super) fn position(&self) -> Vec2 {
        let [x, y] = self.position.map(|at| self.number(at).unwrap_or(f64::NAN));
        Vec2::new(x, y) * self.mapping.length_unit_m
    }

    /// A cell of the last row.
    fn cell(&self, at: usize) -> Option<Cow<'_, str>> {
        match &self.source {
            Source::Text { record, places, .. } => std::str::from_utf8(&record[places[at]]).ok().map(Cow::Borrowed),
            Source::Parquet { cells, n_done, .. } => Some(match &cells[at] {
                Cells::Numbers(numbers) if numbers[*n_done - 1].is_nan() => Cow::Borrowed(""),
                Cells::Numbers(numbers) => Cow::Owned(numbers[*n_done - 1].to_string()),
                Cells::Texts(texts) if texts.is_null(*n_done - 1) => Cow::Borrowed(""),
                Cells::Texts(texts) => Cow::Borrowed(texts.value(*n_done - 1).trim()),
            }),
        }
    }

    /// The track of the last row.
    pub(super) fn track(&self) -> Option<Cow<'_, str>> {
        self.cell(self.track)
    }

    /// Writes the values that distinguish the recording of the last row from others of the file into `key`.
    pub(super) fn key(&self, key: &mut String) -> Option<()> {
        key.clear();
        for at in &self.key {
            key.push_str(&self.cell(*at)?);
            key.push('\0');
        }
        Some(())
    }

    /// The approximate size of the last row in the columns that are read, bytes.
    pub(super) fn n_bytes(&self) -> u64 {
        match &self.source {
            Source::Text { record, places, .. } => places.iter().map(|place| record[*place].len() as u64 + 1).sum(),
            Source::Parquet { cells, .. } => cells.len() as u64 * 8,
        }
    }

    /// An empty part.
    pub(super) fn gather<'p>(&self, part: &'p Part) -> Gathered<'p> {
        let text = csv::WriterBuilder::new().delimiter(self.separator).flexible(true).from_writer(Vec::new());
        let mut gathered = Gathered { part, text, lines: Vec::new() };
        // Writing to memory does not fail.
        let _ = gathered.text.write_record(self.columns.iter().map(|(name, _)| name));
        gathered
    }

    /// Adds the last row to a part.
    pub(super) fn put(&self, to: &mut Gathered<'_>) {
        let _ = match &self.source {
            Source::Text { record, places, .. } => to.text.write_record(places.iter().map(|place| &record[*place])),
            Source::Parquet { cells, .. } => {
                let cell = |at| self.cell(at).map(Cow::into_owned).unwrap_or_default();
                to.text.write_record((0..cells.len()).map(cell))
            }
        };
        to.lines.push(self.place);
    }

    /// The unit of the places of rows.
    pub(super) const fn counted(&self) -> &'static str {
        match self.source {
            Source::Text { .. } => "line",
            Source::Parquet { .. } => "row",
        }
    }
}

impl<'r> Source<'r> {
    /// The rows of a table in CSV with its separator and the `wanted` columns that it has.
    #[expect(clippy::type_complexity, reason = "the three are apart again at once")]
    fn text(table: &'r mut dyn BufRead, wanted: &[(&str, Kind)]) -> Option<(Self, u8, Vec<(String, Kind)>)> {
        let mut header = Vec::new();
        Read::take(&mut *table, 1 << 16).read_until(b'\n', &mut header).ok()?;
        let header = header.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&header).to_vec();
        let (separator, n_behind) = (separator_of(&header), u64::from(header.ends_with(b"\r\n")));
        let whole: Box<dyn Read + 'r> = Box::new(std::io::Cursor::new(header).chain(table));
        let mut reader = csv_reader(separator).from_reader(whole);
        let names = reader.byte_headers().ok()?.clone();
        let names_as_text: Vec<String> = names.iter().map(printable).collect();
        let (mut places, mut columns) = (Vec::new(), Vec::new());
        for (name, kind) in with_types(wanted, &names_as_text) {
            let mut found = names_as_text.iter().enumerate().filter(|(_, found)| **found == name);
            match (found.next(), found.next()) {
                (Some((place, _)), None) => {
                    places.push(place);
                    columns.push((name, kind));
                }
                (None, _) => {}
                _ => return None,
            }
        }
        let record = csv::ByteRecord::new();
        Some((Self::Text { reader, record, places, n_cells: names.len(), n_behind }, separator, columns))
    }
}
