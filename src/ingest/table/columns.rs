//! The columns of a table that a mapping names, from CSV or Parquet.

use super::table_rows::{Passed, TableRows};
use crate::containment::contained;
use crate::ingest::error::Malformed;
use crate::ingest::parquet_columns::read_footer;
use std::collections::BTreeMap;
use std::sync::Arc;

/// The first bytes of Parquet files.
pub(super) const PARQUET: &[u8] = b"PAR1";

/// The kind of a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// The id of an agent; rows of nobody are passed over.
    Track,
    /// Rows without the number are passed over.
    Required,
    /// Blank cells are NaN.
    Number,
    Text,
    /// Text of a column that nobody named: types of agents, by the column's own name.
    Types,
}

/// The index of the column that holds types of agents by its name.
pub(super) fn types_among<T: AsRef<[u8]>>(names: impl IntoIterator<Item = T>) -> Option<usize> {
    const WHOSE: [&str; 7] = ["", "agent", "obj", "object", "v", "veh", "vehicle"];
    names.into_iter().position(|name| {
        let name = String::from_utf8_lossy(name.as_ref()).to_ascii_lowercase();
        let whose = ["type", "class", "cls", "category"].iter().find_map(|what| name.strip_suffix(what));
        whose.is_some_and(|whose| WHOSE.contains(&whose.trim_end_matches('_')))
    })
}

/// Texts, without duplicates.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Texts {
    pub(super) different: Vec<String>,
    pub(super) of_row: Vec<u32>,
    indices: BTreeMap<String, u32>,
}

impl Texts {
    /// Whether any row has this text.
    pub(super) fn has(&self, text: &str) -> bool {
        self.indices.contains_key(text)
    }

    fn push(&mut self, text: &str) {
        // Rows of a track are usually adjacent.
        let last = self.of_row.last().filter(|last| self.different[**last as usize] == text).copied();
        let index = last.or_else(|| self.indices.get(text).copied()).unwrap_or_else(|| {
            let index = self.different.len() as u32;
            self.different.push(text.to_owned());
            self.indices.insert(text.to_owned(), index);
            index
        });
        self.of_row.push(index);
    }
}

/// Some columns of a table.
#[derive(Debug, Default)]
pub(super) struct Table {
    pub(super) n_rows: usize,
    numbers: BTreeMap<String, Vec<f64>>,
    texts: BTreeMap<String, Texts>,
    /// A column of types that is not among the named ones.
    pub(super) types: Option<String>,
    /// The line of each row, or its number.
    lines: Vec<u64>,
    /// The unit of `lines`.
    pub(super) counted: &'static str,
    /// The names of all columns, for messages.
    names: Vec<String>,
    pub(super) passed: Passed,
}

impl Table {
    /// Reads the `wanted` columns that the table has.
    ///
    /// `lines` are those of the rows in the file, if they are a part of it.
    pub(super) fn read(bytes: &[u8], lines: &[u64], wanted: &[(&str, Kind)]) -> Result<Self, Malformed> {
        let table = &mut &*bytes;
        if !bytes.starts_with(PARQUET) {
            return Self::of(TableRows::of_csv(table, wanted)?, lines);
        }
        let read = || {
            let footer = read_footer(bytes, bytes.len() as u64)?.ok_or("the file is cut short")?;
            Self::of(TableRows::of_parquet(table, &Arc::new(footer), wanted)?, lines)
        };
        contained(read).unwrap_or_else(|| Err("the file is damaged beyond decoding".into()))
    }

    /// A column of numbers, if the table has it.
    pub(super) fn number(&self, name: Option<&str>) -> Option<&[f64]> {
        self.numbers.get(name?).map(Vec::as_slice)
    }

    /// A column of texts, if the table has it.
    pub(super) fn text(&self, name: Option<&str>) -> Option<&Texts> {
        self.texts.get(name?)
    }

    pub(super) fn place_of(&self, row: usize) -> String {
        self.lines.get(row).map_or_else(|| format!("row {row}"), |line| format!("{} {line}", self.counted))
    }

    /// The error that the table has none of these columns.
    pub(super) fn lacks(&self, missing: &[&str]) -> String {
        lacks(&self.names, missing)
    }

    fn of(mut rows: TableRows<'_>, lines: &[u64]) -> Result<Self, Malformed> {
        let mut numbers: Vec<Vec<f64>> = vec![Vec::new(); rows.columns.len()];
        let mut texts: Vec<Texts> = rows.columns.iter().map(|_| Texts::default()).collect();
        let mut table = Self { counted: rows.counted(), ..Self::default() };
        while rows.next()? {
            for (at, (_, kind)) in rows.columns.iter().enumerate() {
                match kind {
                    Kind::Required | Kind::Number => numbers[at].push(rows.number(at)),
                    Kind::Track | Kind::Text | Kind::Types => texts[at].push(&rows.text(at)),
                }
            }
            table.lines.push(lines.get(table.lines.len()).copied().unwrap_or(rows.place));
        }
        table.n_rows = table.lines.len();
        for ((name, kind), (numbers, texts)) in rows.columns.into_iter().zip(numbers.into_iter().zip(texts)) {
            match kind {
                Kind::Required | Kind::Number => drop(table.numbers.insert(name, numbers)),
                Kind::Track | Kind::Text | Kind::Types => {
                    table.types = table.types.or_else(|| (kind == Kind::Types).then(|| name.clone()));
                    table.texts.insert(name, texts);
                }
            }
        }
        Ok(Self { names: rows.names, passed: rows.passed, ..table })
    }
}

/// The error that a table with these columns has none of the missing ones.
pub(super) fn lacks(names: &[String], missing: &[&str]) -> String {
    const N_NAMED: usize = 40;
    const N_CHARS: usize = 40;
    if names.first().is_some_and(|first| first.starts_with(['{', '['])) {
        return format!("no column {}; this is JSON: convert it to CSV", missing.join(", "));
    }
    let short = |name: &String| match name.char_indices().nth(N_CHARS) {
        Some((end, _)) => format!("{}…", &name[..end]),
        None => name.clone(),
    };
    let found = names.iter().take(N_NAMED).map(short).collect::<Vec<_>>().join(", ");
    let more = match names.len().saturating_sub(N_NAMED) {
        0 => String::new(),
        n => format!(" and {n} more"),
    };
    let is_number = |name: &String| name.split(' ').any(|word| word.parse::<f64>().is_ok());
    let what_to_do = match names {
        [only] if only.contains([' ', '|']) => {
            "cells are separated by commas, semicolons or tabs, and the first line names them"
        }
        _ if names.iter().any(is_number) => "its first line must name them",
        _ => "name its columns in ingest.table.columns",
    };
    format!("no column {}; the table has {found}{more}: {what_to_do}", missing.join(", "))
}

/// The `wanted` columns of a table with these columns, that of types by its name, if there is one.
pub(super) fn with_types(wanted: &[(&str, Kind)], names: &[String]) -> Vec<(String, Kind)> {
    let name_of = |(name, kind): &(&str, Kind)| match kind {
        Kind::Types => Some((names[types_among(names)?].clone(), *kind)),
        _ => Some(((*name).to_owned(), *kind)),
    };
    wanted.iter().filter_map(name_of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use arrow::array::{ArrayRef, Float64Array, Int64Array, RecordBatch};
    use parquet::arrow::ArrowWriter;
    use std::sync::Arc;

    const WANTED: [(&str, Kind); 3] = [("id|who", Kind::Text), ("x|X", Kind::Number), ("nowhere", Kind::Number)];

    fn read(text: &str) -> Result<Table, String> {
        Table::read(text.as_bytes(), &[], &WANTED).map_err(|error| error.to_string())
    }

    #[test]
    fn tables_are_read_whatever_separates_their_cells() {
        for text in [
            "id,y,x\na,9,1.5\nb,9,\na,9,nan\n",
            "\u{feff}id;y;x\r\na;9;1.5\r\nb;9;\r\na;9;NaN",
            "id\ty\tx\n\"a\"\t9\t 1.5\nb\t9\t\na\t9\tnan",
            "id;y;x\na;9,0;1,5\nb;9;\na;9;nan",
            "id,y,x,who,X\na,9,1.5,,7\n,9,,b,\na,9,nan,,\n",
        ] {
            let table = read(text).unwrap();
            assert_eq!((table.n_rows, table.place_of(1)), (3, "line 3".to_owned()), "{text}");
            let ids = table.text(Some("id|who")).unwrap();
            let found = (ids.different.as_slice(), ids.of_row.as_slice());
            assert_eq!(found, (&["a".to_owned(), "b".to_owned()][..], &[0, 1, 0][..]));
            let x = table.number(Some("x|X")).unwrap();
            assert!(x[0] == 1.5 && x[1].is_nan() && x[2].is_nan(), "{x:?}");
            assert!(table.number(Some("nowhere")).is_none() && table.number(None).is_none());
        }
    }

    #[test]
    fn parquet_holds_the_same_with_gaps_and_names_of_numbers() {
        let columns: [(&str, ArrayRef); 5] = [
            ("id", Arc::new(Int64Array::from(vec![Some(7), None, Some(7)]))),
            ("who", Arc::new(Int64Array::from(vec![Some(8), None, None]))),
            ("x", Arc::new(Float64Array::from(vec![Some(1.5), None, None]))),
            ("X", Arc::new(Float64Array::from(vec![Some(9.0), Some(2.5), None]))),
            ("y", Arc::new(Float64Array::from(vec![9.0; 3]))),
        ];
        let batch = RecordBatch::try_from_iter(columns).unwrap();
        let mut bytes = Vec::new();
        let mut writer = ArrowWriter::try_new(&mut bytes, batch.schema(), None).unwrap();
        writer.write(&batch).unwrap();
        writer.close().unwrap();
        let table = Table::read(&bytes, &[], &WANTED).unwrap();
        let ids = table.text(Some("id|who")).unwrap();
        let found = (ids.different.as_slice(), ids.of_row.as_slice());
        assert_eq!(found, (&["7".to_owned(), String::new()][..], &[0, 1, 0][..]));
        let x = table.number(Some("x|X")).unwrap();
        assert!(x[..2] == [1.5, 2.5] && x[2].is_nan());
        assert!(table.lacks(&["z"]).contains("the table has id, who, x, X, y") && table.place_of(1) == "row 1");
        assert!(Table::read(&bytes[..bytes.len() - 9], &[], &WANTED).is_err());
    }

    #[test]
    fn what_is_wrong_with_a_header_is_said() {
        assert_eq!(read("id,x,x\n").unwrap_err(), "line 1: the column x appears twice");
        assert!(read("id,x\n").unwrap().lacks(&["y"]).starts_with("no column y; the table has id, x: name"));
        // A whole file without a line end.
        let found = read(&"[{name: \"é\",".repeat(5000)).unwrap().lacks(&["y"]);
        assert_eq!(found, "no column y; this is JSON: convert it to CSV");
        assert!(read("1.0,2\n1,2\n").unwrap().lacks(&["id"]).ends_with("its first line must name them"));
        assert!(read("0 1 2\n").unwrap().lacks(&["id"]).contains("separated by commas, semicolons or tabs"));
    }

    #[test]
    fn thousands_may_have_commas_where_points_are_decimal() {
        for (cell, expected) in [
            ("1,050.197", Some(1050.197)),
            ("-6,451,137.5", Some(-6_451_137.5)),
            ("1,118,846,979,700", Some(1_118_846_979_700.0)),
            // A decimal comma?
            ("1,050", None),
            ("1050,197.5", None),
            ("1,05.7", None),
            (",050.7", None),
        ] {
            let table = read(&format!("id,x\na,\"{cell}\"\n")).unwrap();
            let found = table.number(Some("x|X")).and_then(|x| x.first().copied());
            assert_eq!(found, expected, "{cell}");
        }
        assert_eq!(read("id;x\na;1,050.5\nb;1,05\n").unwrap().number(Some("x|X")), Some(&[1050.5, 1.05][..]));
    }
}
