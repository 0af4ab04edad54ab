//! What does a stage leave behind so that the next run knows whether to redo it?
//!
//! `<stage>.started.json` is written before a stage touches its outputs and `<stage>.done.json` after they are whole.
//! Both hold what the fingerprint was made from, so that a later run can say what changed.

use super::fingerprint::{PathFingerprint, fingerprint_path, fingerprint_value};
use super::stage::{Stage, StageId};
use crate::store::write_json_atomically;
use anyhow::Result;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// What a stage was run on and, once it is done, what came of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StageRecord {
    /// Which stage.
    pub stage: StageId,
    /// The version of its code.
    pub version: u32,
    /// Its section.
    pub config: Value,
    /// What it read, by name.
    pub inputs: BTreeMap<String, InputRecord>,
    /// Hash of all of the above.
    pub fingerprint: String,
    /// What it wrote, by name within the output folder; empty until it is done.
    #[serde(default)]
    pub outputs: BTreeMap<String, PathFingerprint>,
    /// What it says of its work; null until it is done.
    #[serde(default)]
    pub summary: Value,
}

/// Something a stage read.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum InputRecord {
    /// The outputs of another stage, with that stage's fingerprint.
    Stage {
        /// The stage that made it.
        producer: StageId,
        /// Its fingerprint.
        fingerprint: String,
    },
    /// A file or folder from outside.
    Path {
        /// Where it was, as given.
        path: PathBuf,
        /// What it held.
        content: PathFingerprint,
    },
}

impl InputRecord {
    /// What distinguishes the contents; a path alone does not.
    fn identity(&self) -> &str {
        match self {
            Self::Stage { fingerprint, .. } => fingerprint,
            Self::Path { content, .. } => &content.hash,
        }
    }
}

impl StageRecord {
    /// The record of a stage about to run on `inputs`.
    pub fn expected(stage: &dyn Stage, inputs: BTreeMap<String, InputRecord>) -> Result<Self> {
        let config = stage.config()?;
        let identities: BTreeMap<&str, &str> =
            inputs.iter().map(|(name, input)| (name.as_str(), input.identity())).collect();
        let fingerprint = fingerprint_value(&(stage.id(), stage.version(), &config, identities))?;
        Ok(Self {
            stage: stage.id(),
            version: stage.version(),
            config,
            inputs,
            fingerprint,
            outputs: BTreeMap::new(),
            summary: Value::Null,
        })
    }

    /// The record of the finished stage in `root`, if there is one that can be read.
    pub fn done(root: &Path, stage: StageId) -> Option<Self> {
        read(&done_path(root, stage))
    }

    /// The record of the unfinished stage in `root`, if there is one that can be read.
    pub fn started(root: &Path, stage: StageId) -> Option<Self> {
        read(&started_path(root, stage))
    }

    /// Announces that the stage begins to write.
    pub fn write_started(&self, root: &Path) -> Result<()> {
        write_json_atomically(&started_path(root, self.stage), self)?;
        Ok(())
    }

    /// Declares the stage done, after all its outputs are whole.
    pub fn write_done(mut self, root: &Path, outputs: &[&str], summary: Value) -> Result<Self> {
        for name in outputs {
            self.outputs.insert((*name).to_owned(), fingerprint_path(&root.join(name))?);
        }
        self.summary = summary;
        write_json_atomically(&done_path(root, self.stage), &self)?;
        remove(&started_path(root, self.stage))?;
        Ok(self)
    }

    /// The first output that is no longer as it was written.
    pub fn damaged_output(&self, root: &Path) -> Option<&str> {
        let intact =
            |name: &str, written: &PathFingerprint| fingerprint_path(&root.join(name)).is_ok_and(|now| now == *written);
        self.outputs.iter().find(|(name, written)| !intact(name, written)).map(|(name, _)| name.as_str())
    }

    /// What differs from `earlier`, in a few words: versions, keys of the section, inputs.
    pub fn changes_since(&self, earlier: &Self) -> String {
        let mut changes = Vec::new();
        if self.version != earlier.version {
            changes.push(format!("stage version {} -> {}", earlier.version, self.version));
        }
        changed_keys(self.stage.section(), &earlier.config, &self.config, &mut changes);
        let names: std::collections::BTreeSet<&String> = self.inputs.keys().chain(earlier.inputs.keys()).collect();
        for name in names {
            if self.inputs.get(name).map(InputRecord::identity) != earlier.inputs.get(name).map(InputRecord::identity) {
                changes.push(format!("input {name}"));
            }
        }
        let n_more = changes.len().saturating_sub(3);
        changes.truncate(3);
        let more = if n_more > 0 { format!(" and {n_more} more") } else { String::new() };
        format!("changed: {}{more}", changes.join(", "))
    }
}

/// Removes the records and the outputs of a stage; the done record first, so that a kill halfway leaves no false claim.
pub(super) fn discard(root: &Path, stage: StageId, outputs: &[&str]) -> Result<()> {
    remove(&done_path(root, stage))?;
    for name in outputs {
        remove(&root.join(name))?;
    }
    remove(&started_path(root, stage))
}

/// Removes the announcement of a stage that is done: a kill right after its last file leaves it behind.
pub(super) fn forget_started(root: &Path, stage: StageId) -> Result<()> {
    remove(&started_path(root, stage))
}

fn done_path(root: &Path, stage: StageId) -> PathBuf {
    root.join(format!("{stage}.done.json"))
}

fn started_path(root: &Path, stage: StageId) -> PathBuf {
    root.join(format!("{stage}.started.json"))
}

/// A record that is missing or cannot be read (from another version of the program, say) means: not done.
fn read(path: &Path) -> Option<StageRecord> {
    serde_json::from_slice(&fs_err::read(path).ok()?).ok()
}

fn remove(path: &Path) -> Result<()> {
    let removed = match fs_err::symlink_metadata(path) {
        Ok(metadata) if metadata.is_dir() => fs_err::remove_dir_all(path),
        Ok(_) => fs_err::remove_file(path),
        Err(error) => Err(error),
    };
    match removed {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(error.into()),
        _ => Ok(()),
    }
}

fn changed_keys(path: &str, earlier: &Value, now: &Value, changes: &mut Vec<String>) {
    match (earlier, now) {
        (Value::Object(earlier), Value::Object(now)) => {
            let keys: std::collections::BTreeSet<&String> = earlier.keys().chain(now.keys()).collect();
            for key in keys {
                let value = |object: &serde_json::Map<String, Value>| object.get(key).cloned().unwrap_or(Value::Null);
                changed_keys(&format!("{path}.{key}"), &value(earlier), &value(now), changes);
            }
        }
        (earlier, now) if earlier == now => {}
        (earlier, now) if earlier.to_string().len() + now.to_string().len() < 40 => {
            changes.push(format!("{path} {earlier} -> {now}"));
        }
        _ => changes.push(path.to_owned()),
    }
}
