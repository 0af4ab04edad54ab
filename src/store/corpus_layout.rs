//! The layout of a corpus folder: its tables, and the partitions of the large ones.
//!
//! Scenarios and their tracks are partitioned by behavior and place, recordings by place, in folders with Hive's names
//! (`behavior=cut_in/place=PIT`), so that DuckDB, polars and pyarrow skip files that a query does not need. A file
//! holds at most [`SCENES_PER_FILE`] scenarios or scenes; further ones go into the next file. Lanes (each map once) and
//! metric values (some twenty short rows a scenario, and aggregates without a place) are single files. The rows of a
//! file of `tracks` follow the order of the rows of the file of `scenarios` with the same number.

use super::schema::TableSchema;
use super::tables::{lane, metric, recording, scenario, track};
use crate::settings::named;
use serde::{Deserialize, Serialize};
use std::fmt::Write;

/// The value of `behavior` for scenarios without a requested behavior.
pub(crate) const NO_BEHAVIOR: &str = "none";
/// The value of `place` for a file without rows.
const NO_PLACE: &str = "none";
/// Words that readers take for truth values, numbers, times or missing values.
const WORDS: [&str; 8] = ["true", "false", "nan", "inf", "infinity", "epoch", "null", "nat"];
/// Hive's name for a missing value, which readers turn into one.
const MISSING: &str = "__HIVE_DEFAULT_PARTITION__";

/// The most scenarios, or recorded scenes, of a file. It bounds the size of files, which are uploaded and verified as a
/// whole, and the memory of their footers.
pub(crate) const SCENES_PER_FILE: usize = 16 * 1024;

/// The tables of a corpus.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum CorpusTable {
    /// Generated scenarios.
    Scenarios,
    /// Their states.
    Tracks,
    /// The states of the recorded scenes that they continue, each scene once.
    Recordings,
    /// The lanes of all maps.
    Lanes,
    /// Metric values.
    Metrics,
}

named! { CorpusTable {
    Scenarios = "scenarios", Tracks = "tracks", Recordings = "recordings", Lanes = "lanes", Metrics = "metrics",
} }

impl CorpusTable {
    /// Its columns.
    pub fn schema(self) -> TableSchema {
        match self {
            Self::Scenarios => scenario::schema(),
            Self::Tracks => track::schema(),
            Self::Recordings => recording::schema(),
            Self::Lanes => lane::schema(),
            Self::Metrics => metric::schema(),
        }
    }

    /// The columns of its files. Partition columns are only in the names of folders, because pyarrow and pandas take a
    /// column that is in both places for two of different types.
    pub(crate) fn file_schema(self) -> TableSchema {
        let mut schema = self.schema();
        schema.fields.retain(|field| !self.keys().contains(&field.name().as_str()));
        schema
    }

    /// The partition columns, outermost first; empty for a single file.
    pub const fn keys(self) -> &'static [&'static str] {
        match self {
            Self::Scenarios | Self::Tracks => &["behavior", "place"],
            Self::Recordings => &["place"],
            Self::Lanes | Self::Metrics => &[],
        }
    }

    /// The column whose value is the same in all rows of a scenario or a scene, which are in one file; `None` for a
    /// single file.
    pub(crate) const fn unit(self) -> Option<&'static str> {
        match self {
            Self::Scenarios | Self::Tracks => Some("scenario_id"),
            Self::Recordings => Some("scene_id"),
            Self::Lanes | Self::Metrics => None,
        }
    }

    /// File `number` of a partition, with `/` between folders.
    pub fn file(self, partition: &Partition, number: usize) -> String {
        let mut path = self.name().to_owned();
        if self.keys().is_empty() {
            return path + ".parquet";
        }
        for key in self.keys() {
            // Writing to a string cannot fail.
            let _ = write!(path, "/{key}={}", encoded(partition.value(key)));
        }
        format!("{path}/part-{number:05}.parquet")
    }

    /// The partition of a file without rows.
    pub(crate) fn partition_without_rows(self) -> Partition {
        self.partition(None, NO_PLACE)
    }

    /// The partition of this table for `behavior` and `place`.
    pub(crate) fn partition(self, behavior: Option<&str>, place: &str) -> Partition {
        let has = |key: &str| self.keys().contains(&key);
        Partition {
            behavior: has("behavior").then(|| behavior.unwrap_or(NO_BEHAVIOR).to_owned()),
            place: has("place").then(|| place.to_owned()),
        }
    }
}

/// The values that all rows of a file share.
#[derive(Debug, Clone, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Partition {
    /// The requested behavior, or `none`; missing if the table is not partitioned by it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub behavior: Option<String>,
    /// The place; missing if the table is not partitioned by it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub place: Option<String>,
}

impl Partition {
    /// Whether every reader takes its place for text. Readers guess the type of the values in folder names from all of
    /// these names: a corpus of place `001` alone would have the place 1, and one of place `2024-01-01` a day.
    pub(crate) fn has_place_in_words(&self) -> bool {
        let is_word = |place: &str| place.starts_with(char::is_alphabetic) && !WORDS.contains(&&*place.to_lowercase());
        self.place.as_deref().is_none_or(is_word)
    }

    /// The value of a partition column; empty if there is none.
    pub(crate) fn value(&self, key: &str) -> &str {
        let value = match key {
            "behavior" => &self.behavior,
            _ => &self.place,
        };
        value.as_deref().unwrap_or_default()
    }
}

/// A value as the name of a folder: every byte that is not an ASCII letter, digit, `_`, `-` or `.` becomes `%` and two
/// digits, which Hive, DuckDB, polars and pyarrow decode.
pub(super) fn encoded(value: &str) -> String {
    if value.is_empty() {
        return MISSING.to_owned();
    }
    let mut name = String::new();
    for byte in value.bytes() {
        if byte.is_ascii_alphanumeric() || b"_-.".contains(&byte) {
            name.push(char::from(byte));
        } else {
            let _ = write!(name, "%{byte:02X}");
        }
    }
    name
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_are_named_as_hive_names_them() {
        let file = |table: CorpusTable, behavior, place| table.file(&table.partition(behavior, place), 0);
        let cut_in = Some("cut_in");
        let found = file(CorpusTable::Scenarios, cut_in, "DR_CHN_Merging_ZS0");
        assert_eq!(found, "scenarios/behavior=cut_in/place=DR_CHN_Merging_ZS0/part-00000.parquet");
        assert_eq!(file(CorpusTable::Tracks, None, "PIT"), "tracks/behavior=none/place=PIT/part-00000.parquet");
        // An é is C3 A9 in UTF-8; a slash must not become a folder.
        let seen = file(CorpusTable::Recordings, cut_in, "Orléans N/S");
        assert_eq!(seen, "recordings/place=Orl%C3%A9ans%20N%2FS/part-00000.parquet");
        let shown = file(CorpusTable::Recordings, None, "");
        assert_eq!(shown, "recordings/place=__HIVE_DEFAULT_PARTITION__/part-00000.parquet");
        assert_eq!(file(CorpusTable::Lanes, cut_in, "PIT"), "lanes.parquet");
        for table in CorpusTable::ALL {
            assert_eq!(CorpusTable::from_name(table.name()), Some(table));
        }
    }
}
