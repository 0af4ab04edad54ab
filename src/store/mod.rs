//! The only reader and writer of our own files: what is in a scene store, an event table, a sample shard, a corpus?

mod atomic;
mod error;
mod records;
mod stub;

pub use atomic::{
    AtomicFile, FileStamp, PARTIAL_SUFFIX, read_json, remove_if_present, remove_partials, write_atomically,
    write_json_atomically,
};
pub use error::{Error, Result};
pub use records::{MetricRow, ScenarioRecord};
pub use stub::*;
