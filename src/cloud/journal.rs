//! The journal of a push, which an interrupted push leaves.
//!
//! Before a push writes or removes anything outside of the folders for unfinished work, it lists in an object of its
//! own what it is about to do: the journal. It removes the journal last. The journal tells which objects belong
//! together:
//!
//! - Until all outputs are written, the old state counts. An output that was replaced, or is new, is as if it were
//!   missing; the stage whose record names it finds its outputs damaged and runs again.
//! - Then the journal is replaced by one that holds the new records of stages. From that moment the new state counts:
//!   the records are those of the journal, and objects to be removed are as if they were gone.
//!
//! So a record is never beside outputs that are not its own. Either way, djinn wrote the objects that the journal
//! names, so the next push may replace or remove them. New objects in `*.partial/` and `*.parts/` always count: they
//! are written in the order in which they appeared on disk, so that every state of the bucket was a state of the disk.

use super::bucket::{Bucket, Object};
use super::error::Result;
use crate::files::stays_below;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Its name.
pub(super) const JOURNAL: &str = ".djinn-push.json";

/// The changes that a push is about to make.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Journal {
    /// The outputs that it writes, with the tag of the present object; `None` if there is none that counts.
    pub(super) writes: BTreeMap<String, Option<String>>,
    /// Objects that it removes then.
    pub(super) removes: BTreeSet<String>,
    /// The content of the records, once all outputs are written.
    pub(super) records: Option<BTreeMap<String, String>>,
}

impl Journal {
    /// The journal in a folder, if there is one.
    ///
    /// # Errors
    /// If the store cannot be reached or refuses. A damaged journal counts as none, and so does one that leads
    /// elsewhere: it is written as a whole.
    pub(super) fn of(bucket: &Bucket) -> Result<Option<Self>> {
        let found: Option<Self> = bucket.read(JOURNAL)?.and_then(|bytes| serde_json::from_slice(&bytes).ok());
        Ok(found.filter(Self::stays_below))
    }

    fn stays_below(&self) -> bool {
        let records = self.records.iter().flat_map(BTreeMap::keys);
        self.writes.keys().chain(&self.removes).chain(records).all(|name| stays_below(name))
    }

    /// Saves it in the folder.
    pub(super) fn keep(&self, bucket: &Bucket) -> Result<()> {
        bucket.write(JOURNAL, serde_json::to_string(self).unwrap_or_default().as_bytes()).map(drop)
    }

    /// Whether an object counts.
    pub(super) fn counts(&self, object: &Object) -> bool {
        match self.records.is_some() {
            true => !self.removes.contains(&object.name),
            false if is_unfinished_work(&object.name) => true,
            false => self.writes.get(&object.name).is_none_or(|tag| tag.as_ref() == Some(&object.etag)),
        }
    }
}

/// Whether an object lies in a folder for unfinished work.
pub(super) fn is_unfinished_work(name: &str) -> bool {
    is_work(name) || is_part(name)
}

/// Whether it belongs to a stage at work, which only one process knows.
pub(super) fn is_work(name: &str) -> bool {
    name.split_once('/').is_some_and(|(folder, _)| folder.ends_with(".partial"))
}

/// Whether it belongs to a stage in parts, which many processes share.
pub(super) fn is_part(name: &str) -> bool {
    name.split_once('/').is_some_and(|(folder, _)| folder.ends_with(".parts"))
}
