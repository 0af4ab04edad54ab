//! The only reader and writer of our own files: scene stores, event tables, sample shards, corpora.
//!
//! Recorded scenes are Arrow files that are mapped into memory ([`SceneStore`]); everything else is Parquet. Every
//! column has a unit, a frame and a description ([`TableSchema`], published in `schemas/`). Equal content gives equal
//! bytes. A file under its final name is complete; the manifest of a folder is written last.
//!
//! A corpus is Hive-partitioned: values in folder names are not columns of the files, and `corpus_scan` adds them back.
//! `corpus_sink` bounds memory over all partitions and makes the bytes independent of the order in which rows arrive. A
//! batch of scenes is decoded when one of its scenes is read, and few stay decoded.

mod atomic;
mod binary;
mod corpus_card;
mod corpus_layout;
mod corpus_manifest;
mod corpus_reader;
mod corpus_scan;
mod corpus_sink;
mod corpus_writer;
mod drives;
mod error;
mod event_summary;
mod events;
mod fingerprint;
mod ipc_file;
mod maps;
mod parquet_file;
mod planned;
mod row_file;
mod samples;
mod scene_index;
mod scene_manifest;
mod scene_set;
mod scene_store;
mod scene_writer;
mod schema;
mod spool;
mod tables;
#[cfg(test)]
pub(crate) mod testing;

pub use crate::files::{AtomicFile, FileStamp, remove_if_present, write_atomically};
pub use atomic::{read_if_whole, read_json, read_record, write_json_atomically, write_record};
pub use binary::{read_binary, write_binary_atomically};
pub(crate) use corpus_card::{CARD_FILE, card};
pub(crate) use corpus_layout::NO_BEHAVIOR;
#[cfg(test)]
pub(crate) use corpus_layout::SCENES_PER_FILE;
pub use corpus_layout::{CorpusTable, Partition};
pub(crate) use corpus_manifest::AIMS_AT_HARD_EVENTS;
pub use corpus_manifest::{CorpusManifest, CorpusNotes, FileEntry, PartitionCount, TableEntry};
pub use corpus_reader::CorpusReader;
pub(crate) use corpus_scan::{CorpusChunk, CorpusScan, united, widened};
pub(crate) use corpus_sink::{CorpusSink, partitioned, taken};
pub use corpus_writer::CorpusWriter;
pub use drives::{DrivenWriter, write_drives};
pub use error::{Error, Result};
pub use event_summary::{EventSummary, ParameterSummary, QUANTILES, summarize_events};
pub use events::{EventWriter, read_events, stream_events};
pub(crate) use fingerprint::{Fingerprint, fingerprint, shortened};
pub use maps::MapSource;
pub use planned::{Planned, read_planned};
pub use row_file::{TableRow, TableWriter, read_recorded_traffic, read_table, stream_table, write_table};
pub use samples::{Difference, differences, read_samples, sample_ids, write_samples};
pub use scene_index::{SceneIndex, SceneIndexEntry};
pub use scene_manifest::{MapsEntry, SceneManifest, ShardEntry, ShardSidecar};
pub use scene_set::SceneSet;
pub use scene_store::SceneStore;
pub use scene_writer::SceneWriter;
pub(crate) use schema::unit_of_name;
pub use schema::{OpenColumns, SCHEMA_KEY, TableSchema};
pub use spool::{Spool, Spooled};
pub(crate) use tables::assessment::{columns_of as assessment_columns, fields as assessment_fields};
pub(crate) use tables::columns::Columns;
pub use tables::scene_tracks::as_stored;
