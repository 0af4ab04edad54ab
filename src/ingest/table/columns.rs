//! The columns of a table that a mapping names, from CSV or Parquet.

use crate::ingest::error::Malformed;
use crate::ingest::parquet_columns::{Columns, Limits, columns_of, read_footer};
use crate::ingest::quotes::printable;
use std::collections::BTreeMap;

/// Limits of a Parquet file: ten hours of dense traffic have half as many rows.
const LIMITS: Limits = Limits { n_rows: 1 << 27, n_bytes: 4 << 30 };

/// The first bytes of Parquet files.
pub(super) const PARQUET: &[u8] = b"PAR1";

/// The kind of a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
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
        let whose = ["type", "class", "category"].iter().find_map(|what| name.strip_suffix(what));
        whose.is_some_and(|whose| WHOSE.contains(&whose.trim_end_matches('_')))
    })
}

/// Texts, without duplicates.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Texts {
    pub(super) different: Vec<String>,
    /// The index of the text of each row.
    pub(super) of_row: Vec<u32>,
    indices: BTreeMap<String, u32>,
}

impl Texts {
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
    /// The line of each row; empty if the table is not text.
    lines: Vec<u32>,
    /// The unit of `lines`.
    pub(super) counted: &'static str,
    /// The names of all columns, for messages.
    names: Vec<String>,
}

impl Table {
    /// Reads the `wanted` columns that the table has.
    ///
    /// `lines` are those of the rows in the file, if they are a part of it.
    pub(super) fn read(bytes: &[u8], lines: &[u64], wanted: &[(&str, Kind)]) -> Result<Self, Malformed> {
        match bytes {
            [] => Err("is empty".into()),
            [0xff, 0xfe, ..] | [0xfe, 0xff, ..] => Err("is in UTF-16, expected UTF-8: save it in that encoding".into()),
            _ if bytes.starts_with(PARQUET) => Self::of_parquet(bytes, wanted),
            _ => Self::of_csv(bytes, lines, wanted),
        }
    }

    /// A column of numbers, if the table has it.
    pub(super) fn number(&self, name: Option<&str>) -> Option<&[f64]> {
        self.numbers.get(name?).map(Vec::as_slice)
    }

    /// A column of texts, if the table has it.
    pub(super) fn text(&self, name: Option<&str>) -> Option<&Texts> {
        self.texts.get(name?)
    }

    /// Whether this text of a column is blank.
    pub(super) fn is_blank(&self, name: &str, text: u32) -> bool {
        self.text(Some(name)).is_none_or(|texts| texts.different[text as usize].is_empty())
    }

    /// The place of a row, for messages.
    pub(super) fn place_of(&self, row: usize) -> String {
        self.lines.get(row).map_or_else(|| format!("row {row}"), |line| format!("{} {line}", self.counted))
    }

    /// The error that the table has none of these columns.
    pub(super) fn lacks(&self, names: &[&str]) -> String {
        let (missing, found) = (names.join(", "), self.names.join(", "));
        format!("no column {missing}; the table has {found}: name its columns in ingest.table.columns")
    }

    fn of_csv(bytes: &[u8], lines: &[u64], wanted: &[(&str, Kind)]) -> Result<Self, Malformed> {
        let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
        let header = bytes.split(|byte| *byte == b'\n').next().unwrap_or_default();
        let separator = separator_of(header);
        let mut reader = csv_reader(separator).from_reader(bytes);
        let names: Vec<String> = reader.byte_headers()?.iter().map(printable).collect();
        let mut table = Self { names, counted: "line", ..Self::default() };
        let mut found = Vec::new();
        for (name, kind) in with_types(wanted, &table.names) {
            let mut places = table.names.iter().enumerate().filter(|(_, found)| **found == name);
            let Some((index, _)) = places.next() else { continue };
            if places.next().is_some() {
                return Err(format!("line 1: the column {name} appears twice").into());
            }
            found.push((index, name, kind));
        }
        let mut numbers: Vec<Vec<f64>> = vec![Vec::new(); found.len()];
        let mut texts: Vec<Texts> = found.iter().map(|_| Texts::default()).collect();
        let mut record = csv::ByteRecord::new();
        // The position of a row after CRLF is that of the LF.
        let n_behind = u64::from(header.ends_with(b"\r"));
        while reader.read_byte_record(&mut record)? {
            let own_line = || record.position().map_or(0, csv::Position::line) + n_behind;
            let line = lines.get(table.lines.len()).copied().unwrap_or_else(own_line);
            if record.len() != table.names.len() {
                let (n, expected) = (record.len(), table.names.len());
                let is_open = record.iter().any(|cell| cell.contains(&b'\n'));
                let quote = if is_open { "; a quote on it is closed on a later line, or never" } else { "" };
                let between = char::from(separator);
                let detail = format!("{n} cells, expected {expected} between {between:?}, as in the header{quote}");
                return Err(format!("line {line}: {detail}").into());
            }
            for (slot, (index, name, kind)) in found.iter().enumerate() {
                let cell = &record[*index];
                let text = std::str::from_utf8(cell)
                    .map_err(|_| format!("line {line}: column {name} is not in UTF-8: {}", printable(cell)))?;
                match kind {
                    Kind::Text | Kind::Types => texts[slot].push(text),
                    Kind::Number if text.is_empty() => numbers[slot].push(f64::NAN),
                    Kind::Number => numbers[slot].push(text.parse().map_err(|_| {
                        let point = if cell.contains(&b',') { " with a decimal point" } else { "" };
                        format!("line {line}: column {name} is \"{}\", expected a number{point}", printable(cell))
                    })?),
                }
            }
            table.lines.push(u32::try_from(line).unwrap_or(u32::MAX));
        }
        table.n_rows = table.lines.len();
        for ((_, name, kind), (numbers, texts)) in found.into_iter().zip(numbers.into_iter().zip(texts)) {
            match kind {
                Kind::Number => drop(table.numbers.insert(name, numbers)),
                Kind::Text | Kind::Types => {
                    table.types = table.types.or_else(|| (kind == Kind::Types).then(|| name.clone()));
                    table.texts.insert(name, texts);
                }
            }
        }
        Ok(table)
    }

    fn of_parquet(bytes: &[u8], wanted: &[(&str, Kind)]) -> Result<Self, Malformed> {
        let footer = read_footer(bytes, bytes.len() as u64)?.ok_or("the file is cut short")?;
        let wanted = with_types(wanted, &columns_of(&footer)?);
        let names: Vec<&str> = wanted.iter().map(|(name, _)| name.as_str()).collect();
        let columns = Columns::read(bytes, &names, &[], LIMITS)?;
        let mut table = Self { n_rows: columns.n_rows(), ..Self::default() };
        let missing = columns.missing(&names);
        for (name, kind) in wanted.iter().filter(|(name, _)| !missing.contains(&name.as_str())) {
            match kind {
                Kind::Number => drop(table.numbers.insert(name.clone(), columns.float_or_nan(name)?)),
                Kind::Text | Kind::Types => {
                    let mut texts = Texts::default();
                    columns.text_or_null(name)?.iter().for_each(|text| texts.push(text.unwrap_or_default().trim()));
                    table.texts.insert(name.clone(), texts);
                    table.types = table.types.or_else(|| (*kind == Kind::Types).then(|| name.clone()));
                }
            }
        }
        table.names = columns.into_names();
        Ok(table)
    }
}

/// The `wanted` columns of a table with these columns, that of types by its name, if there is one.
pub(super) fn with_types(wanted: &[(&str, Kind)], names: &[String]) -> Vec<(String, Kind)> {
    let name_of = |(name, kind): &(&str, Kind)| match kind {
        Kind::Types => Some((names[types_among(names)?].clone(), *kind)),
        _ => Some(((*name).to_owned(), *kind)),
    };
    wanted.iter().filter_map(name_of).collect()
}

/// The separator of cells, found in the header of a table.
pub(super) fn separator_of(header: &[u8]) -> u8 {
    let count = |separator: &u8| header.iter().filter(|byte| *byte == separator).count();
    *b",;\t".iter().max_by_key(|separator| count(separator)).unwrap_or(&b',')
}

/// Reads tables in CSV.
pub(super) fn csv_reader(separator: u8) -> csv::ReaderBuilder {
    let mut builder = csv::ReaderBuilder::new();
    builder.delimiter(separator).flexible(true).trim(csv::Trim::All).buffer_capacity(1 << 16);
    builder
}

#[cfg(test)]
mod tests {
    use super::*;
    use arrow::array::{ArrayRef, Float64Array, Int64Array, RecordBatch};
    use parquet::arrow::ArrowWriter;
    use std::sync::Arc;

    const WANTED: [(&str, Kind); 3] = [("id", Kind::Text), ("x", Kind::Number), ("nowhere", Kind::Number)];

    fn read(text: &str) -> Result<Table, String> {
        Table::read(text.as_bytes(), &[], &WANTED).map_err(|error| error.to_string())
    }

    #[test]
    fn tables_are_read_whatever_separates_their_cells() {
        for text in [
            "id,y,x\na,9,1.5\nb,9,\na,9,nan\n",
            "\u{feff}id;y;x\r\na;9;1.5\r\nb;9;\r\na;9;NaN",
            "id\ty\tx\n\"a\"\t9\t 1.5\nb\t9\t\na\t9\tnan",
        ] {
            let table = read(text).unwrap();
            assert_eq!((table.n_rows, table.place_of(1)), (3, "line 3".to_owned()), "{text}");
            let ids = table.text(Some("id")).unwrap();
            assert_eq!(
                (ids.different.as_slice(), ids.of_row.as_slice()),
                (&["a".to_owned(), "b".to_owned()][..], &[0, 1, 0][..])
            );
            let x = table.number(Some("x")).unwrap();
            assert!(x[0] == 1.5 && x[1].is_nan() && x[2].is_nan(), "{x:?}");
            assert!(table.number(Some("nowhere")).is_none() && table.number(None).is_none());
        }
    }

    #[test]
    fn parquet_holds_the_same_with_gaps_and_names_of_numbers() {
        let columns: [(&str, ArrayRef); 3] = [
            ("id", Arc::new(Int64Array::from(vec![Some(7), None, Some(7)]))),
            ("x", Arc::new(Float64Array::from(vec![Some(1.5), Some(2.5), None]))),
            ("y", Arc::new(Float64Array::from(vec![9.0; 3]))),
        ];
        let batch = RecordBatch::try_from_iter(columns).unwrap();
        let mut bytes = Vec::new();
        let mut writer = ArrowWriter::try_new(&mut bytes, batch.schema(), None).unwrap();
        writer.write(&batch).unwrap();
        writer.close().unwrap();
        let table = Table::read(&bytes, &[], &WANTED).unwrap();
        let ids = table.text(Some("id")).unwrap();
        assert_eq!(
            (ids.different.as_slice(), ids.of_row.as_slice()),
            (&["7".to_owned(), String::new()][..], &[0, 1, 0][..])
        );
        let x = table.number(Some("x")).unwrap();
        assert!(x[..2] == [1.5, 2.5] && x[2].is_nan());
        assert!(table.lacks(&["z"]).contains("the table has id, x, y") && table.place_of(1) == "row 1");
        assert!(Table::read(&bytes[..bytes.len() - 9], &[], &WANTED).is_err());
    }

    #[test]
    fn what_is_wrong_is_said_with_its_line() {
        for (text, expected) in [
            ("id,x\na,1\nb\n", "line 3: 1 cells, expected 2 between ',', as in the header"),
            ("id,x\na,1\nb,one\n", "line 3: column x is \"one\", expected a number"),
            ("id,x,x\n", "line 1: the column x appears twice"),
        ] {
            assert_eq!(read(text).unwrap_err(), expected);
        }
        assert!(read("id,x\n").unwrap().lacks(&["y"]).starts_with("no column y; the table has id, x: name"));
    }
}
