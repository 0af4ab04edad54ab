//! Parts of a report that are only tables and charts.
//!
//! A new part of the report needs no HTML of its own: it is pushed to [`ReportModel::more`](super::ReportModel::more).

use super::model::Chart;

/// A part of the page with an entry in the table of contents.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PlainSection {
    /// Its name in addresses, unique on the page: lower-case letters, digits and hyphens.
    pub id: String,
    /// Its title.
    pub title: String,
    /// How to read it; empty for nothing.
    pub note: String,
    /// Its tables.
    pub tables: Vec<PlainTable>,
    /// Its charts.
    pub charts: Vec<Chart>,
}

/// A table of text.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PlainTable {
    /// Its title.
    pub caption: String,
    /// The headings; the first column names the row.
    pub columns: Vec<String>,
    /// The rows, each with a cell for each column.
    pub rows: Vec<PlainRow>,
}

/// A row of text.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PlainRow {
    /// The cell of each column. Cells that begin with a digit or a sign are set as numbers.
    pub cells: Vec<String>,
    /// Whether it is the reference for other rows, such as the recording.
    pub is_reference: bool,
}

impl PlainTable {
    /// A table without rows.
    pub fn new(caption: impl Into<String>, columns: &[&str]) -> Self {
        let columns = columns.iter().map(|column| (*column).to_owned()).collect();
        Self { caption: caption.into(), columns, rows: Vec::new() }
    }

    /// Adds a row.
    pub fn push(&mut self, cells: Vec<String>) {
        self.rows.push(PlainRow { cells, is_reference: false });
    }
}
