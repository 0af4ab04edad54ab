//! The rows of a table with their times, and those of its parts.

use super::columns::Kind;
use super::mapping::{Plane, TableColumns, TableMapping};
use super::owners::Seen;
use super::rows::wanted;
use super::table_rows::TableRows;
use crate::ingest::error::Malformed;
use crate::ingest::raw::{Part, RawUnit, Reject};
use parquet::file::metadata::ParquetMetaData;
use std::borrow::Cow;
use std::io::BufRead;
use std::sync::Arc;

/// The most bytes of a part: nothing shorter in time can be cut from its table.
const MAX_PART_BYTES: u64 = 1 << 30;

/// The rows of a part.
pub(super) struct Gathered<'a> {
    pub(super) part: &'a Part,
    text: csv::Writer<Vec<u8>>,
    n_bytes: u64,
    lines: Vec<u64>,
}

impl Gathered<'_> {
    /// The unit of the part, in other respects like that of the table.
    pub(super) fn unit(self, table: &RawUnit) -> Result<RawUnit, Reject> {
        let (first, last) = (self.part.windows.start, self.part.windows.end - 1);
        let windows = format!("windows {first} to {last}");
        if self.lines.is_empty() {
            return Err(table.reject("empty_window", format!("{windows}: nobody is tracked")));
        }
        if self.n_bytes > MAX_PART_BYTES {
            let n_mib = MAX_PART_BYTES >> 20;
            return Err(table.reject("too_large", format!("{windows}: more than {n_mib} MiB of rows in a few minutes")));
        }
        let unreadable = |error: &dyn std::fmt::Display| table.reject("unreadable", error);
        let bytes = self.text.into_inner().map_err(|error| unreadable(&error))?;
        Ok(RawUnit { bytes, lines: self.lines, part: Some(Arc::new(self.part.clone())), ..table.clone() })
    }
}

/// The rows of a table with their times, one after the other.
pub(super) struct TimedRows<'r> {
    pub(super) rows: TableRows<'r>,
    mapping: &'r TableMapping,
    plane: Plane,
    time: usize,
    position: [usize; 2],
    size: Option<[usize; 2]>,
    class: Option<usize>,
    track: usize,
    /// The columns that distinguish recordings of one file.
    key: Vec<usize>,
}

impl<'r> TimedRows<'r> {
    /// The rows of a table; `footer` is that of a table in Parquet.
    pub(super) fn of(
        table: &'r mut dyn BufRead,
        footer: Option<&Arc<ParquetMetaData>>,
        mapping: &'r TableMapping,
    ) -> Result<Self, (&'static str, String)> {
        let all = wanted(&mapping.columns);
        let rows = match footer {
            None => TableRows::of_csv(table, &all),
            Some(footer) => TableRows::of_parquet(table, footer, &all),
        };
        let rows = rows.map_err(|error| ("bad_table", error.to_string()))?;
        let TableColumns { time, frame, track, x, y, length, width, class, recording, place, .. } = &mapping.columns;
        let is_missing = |(name, kind): &&(&str, Kind)| {
            let may_miss = mapping.track_files.is_some() && !mapping.columns.is_of_rows(name);
            *kind != Kind::Types && !may_miss && rows.index_of(name).is_none()
        };
        let missing: Vec<&str> = all.iter().filter(is_missing).map(|(name, _)| *name).collect();
        if !missing.is_empty() {
            return Err(("missing_column", rows.lacks(&missing)));
        }
        let place_of = |name: Option<&String>| rows.index_of(name?);
        let found = |name: Option<&String>| place_of(name).unwrap_or_default();
        let (time, track) = (found(time.as_ref().or(frame.as_ref())), found(Some(track)));
        let position = [x, y].map(|name| found(Some(name)));
        let size = place_of(length.as_ref()).zip(place_of(width.as_ref())).map(<[usize; 2]>::from);
        let key = [recording, place].into_iter().filter_map(|name| place_of(name.as_ref())).collect();
        let class = place_of(class.as_ref());
        Ok(Self { rows, mapping, plane: mapping.plane(), time, position, size, class, track, key })
    }

    /// The time of the next row, seconds; `None` at the end.
    pub(super) fn next(&mut self) -> Result<Option<f64>, Malformed> {
        Ok(self.rows.next()?.then(|| self.mapping.seconds_of(self.rows.number(self.time))))
    }

    /// The agent of the last row.
    pub(super) fn seen(&self, time_s: f64) -> Seen {
        let position = self.plane.at(self.position.map(|at| self.rows.number(at)));
        let size = self.size.map(|size| size.map(|at| self.rows.number(at) * self.mapping.length_unit_m));
        let class = self.class.and_then(|at| self.mapping.class_of(&self.rows.text(at)));
        Seen::new(time_s, position, size, class)
    }

    /// The track of the last row.
    pub(super) fn track(&self) -> Cow<'_, str> {
        self.rows.text(self.track)
    }

    /// Writes the values that distinguish the recording of the last row from others of the file into `key`.
    pub(super) fn key(&self, key: &mut String) {
        key.clear();
        for at in &self.key {
            key.push_str(&self.rows.text(*at));
            key.push('\0');
        }
    }

    /// An empty part.
    pub(super) fn gather<'p>(&self, part: &'p Part) -> Gathered<'p> {
        let mut text = csv::WriterBuilder::new().flexible(true).from_writer(Vec::new());
        // Writing to memory does not fail.
        let _ = text.write_record(self.rows.columns.iter().map(|(name, _)| name));
        Gathered { part, text, n_bytes: 0, lines: Vec::new() }
    }

    /// Adds the last row to a part.
    pub(super) fn put(&self, to: &mut Gathered<'_>) {
        to.n_bytes += self.rows.n_bytes();
        if to.n_bytes <= MAX_PART_BYTES {
            self.rows.put(&mut to.text);
            to.lines.push(self.rows.place);
        }
    }
}
