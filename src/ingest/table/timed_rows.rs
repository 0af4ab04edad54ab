//! The rows of a table one by one, and those of its parts.

use super::columns::{csv_reader, separator_of};
use super::mapping::TableMapping;
use super::rows::wanted;
use crate::ingest::raw::{Part, RawUnit, Reject};
use std::io::{BufRead, Read};
use std::sync::Arc;

/// The rows of a part.
pub(super) struct Gathered<'a> {
    pub(super) part: &'a Part,
    text: csv::Writer<Vec<u8>>,
    lines: Vec<u64>,
}

impl Gathered<'_> {
    /// The unit, which is otherwise as that of the table.
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
    reader: csv::Reader<Box<dyn Read + 'r>>,
    mapping: &'r TableMapping,
    separator: u8,
    names: csv::ByteRecord,
    record: csv::ByteRecord,
    /// Where the columns are that are read, and that of the time.
    columns: Vec<usize>,
    time: usize,
    track: usize,
    n_behind: u64,
}

impl<'r> TimedRows<'r> {
    /// `None` if the table is not one that may be cut.
    pub(super) fn of(table: &'r mut dyn BufRead, mapping: &'r TableMapping) -> Option<Self> {
        let mut header = Vec::new();
        Read::take(&mut *table, 1 << 16).read_until(b'\n', &mut header).ok()?;
        let header = header.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&header).to_vec();
        let (separator, n_behind) = (separator_of(&header), u64::from(header.ends_with(b"\r\n")));
        let whole: Box<dyn Read + 'r> = Box::new(std::io::Cursor::new(header).chain(table));
        let mut reader = csv_reader(separator).from_reader(whole);
        let names = reader.byte_headers().ok()?.clone();
        let mut columns = Vec::new();
        for (name, _) in wanted(&mapping.columns) {
            let mut places = names.iter().enumerate().filter(|(_, found)| *found == name.as_bytes());
            match (places.next(), places.next()) {
                (Some((index, _)), None) => columns.push(index),
                // It is in the table of tracks.
                (None, _) if mapping.track_files.is_some() => {}
                _ => return None,
            }
        }
        columns.sort_unstable();
        columns.dedup();
        let time = mapping.columns.time.as_ref().or(mapping.columns.frame.as_ref())?;
        let place_of = |name: &String| names.iter().position(|found| found == name.as_bytes());
        let (time, track) = (place_of(time)?, place_of(&mapping.columns.track)?);
        Some(Self { reader, mapping, separator, names, record: csv::ByteRecord::new(), columns, time, track, n_behind })
    }

    /// The time of the next row, seconds; `Some(None)` at the end, and `None` if the row is not as it should be.
    #[expect(clippy::option_option, reason = "an end is no fault")]
    pub(super) fn next(&mut self) -> Option<Option<f64>> {
        if !self.reader.read_byte_record(&mut self.record).ok()? {
            return Some(None);
        }
        if self.record.len() != self.names.len() {
            return None;
        }
        let value: f64 = std::str::from_utf8(&self.record[self.time]).ok()?.parse().ok()?;
        value.is_finite().then(|| Some(self.mapping.seconds_of(value)))
    }

    /// The track of the last row.
    pub(super) fn track(&self) -> Option<&str> {
        std::str::from_utf8(&self.record[self.track]).ok()
    }

    /// The bytes of the last row in the columns that are read.
    pub(super) fn n_bytes(&self) -> u64 {
        self.columns.iter().map(|column| self.record[*column].len() as u64 + 1).sum()
    }

    /// An empty part.
    pub(super) fn gather<'p>(&self, part: &'p Part) -> Gathered<'p> {
        let text = csv::WriterBuilder::new().delimiter(self.separator).flexible(true).from_writer(Vec::new());
        let mut gathered = Gathered { part, text, lines: Vec::new() };
        self.write(&self.names, &mut gathered);
        gathered
    }

    /// Puts the last row to the others of a part.
    pub(super) fn put(&self, to: &mut Gathered<'_>) {
        self.write(&self.record, to);
        to.lines.push(self.record.position().map_or(0, csv::Position::line) + self.n_behind);
    }

    fn write(&self, record: &csv::ByteRecord, to: &mut Gathered<'_>) {
        // Writing to memory does not fail.
        let _ = to.text.write_record(self.columns.iter().map(|column| &record[*column]));
    }
}
