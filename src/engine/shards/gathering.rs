//! Collects the finished shards, and reports the missing ones.

use super::folder::ShardFolder;
use crate::engine::{Failure, Result};
use serde::de::DeserializeOwned;
use std::path::{Path, PathBuf};

/// The most shards that a message names.
const SHOWN: usize = 5;

/// The shards of a plan, as far as they were examined.
pub struct Gathering<'a> {
    folder: &'a ShardFolder,
    missing: Vec<String>,
    given_up: Vec<String>,
    n_shards: usize,
}

impl<'a> Gathering<'a> {
    /// Starts with none of the shards examined.
    pub(crate) fn new(folder: &'a ShardFolder) -> Self {
        Self { folder, missing: Vec::new(), given_up: Vec::new(), n_shards: folder.n_planned() }
    }

    /// The decisions made before any shard.
    pub fn decisions<P: DeserializeOwned>(&self) -> Result<P> {
        self.folder.decisions()
    }

    /// The facts about shard `idx`, if it is finished and undamaged; otherwise notes that it is missing.
    pub fn look_up<S: DeserializeOwned>(&mut self, idx: usize) -> Result<Option<S>> {
        if let Some(finished) = self.folder.verified::<S>(idx)? {
            return Ok(Some(finished.facts));
        }
        let (name, tries) = (self.folder.shard_name(idx), self.folder.tries(idx));
        match tries.are_over() {
            true => self.given_up.push(format!("{name} ({})", tries.describe())),
            false => self.missing.push(name),
        }
        Ok(None)
    }

    /// The folder of the shards.
    pub fn dir(&self) -> &Path {
        self.folder.dir()
    }

    /// The path of the file of shard `idx`.
    pub fn file(&self, idx: usize) -> PathBuf {
        self.dir().join(self.folder.file_name(idx))
    }

    /// Adds shards that were not in the plan.
    pub fn expect_more(&mut self, n_shards: usize) {
        self.n_shards += n_shards;
    }

    /// Fails if one of the examined shards is missing.
    ///
    /// # Errors
    /// When shards are missing: [`Blame::Later`](crate::engine::Blame::Later) while they may still come, a fault once
    /// all of them are given up.
    pub fn check_whole(&self) -> Result<()> {
        let Self { folder, missing, given_up, n_shards } = self;
        let given_up_text = few(given_up);
        match (missing.is_empty(), given_up.is_empty()) {
            (true, true) => Ok(()),
            (true, false) => {
                let message = format!("{} of {n_shards} shards were given up: {given_up_text}", given_up.len());
                Err(Failure::fault(anyhow::anyhow!(message)).with_hint(format!(
                    "find the cause in {}, fix it, remove the marks *.try-* there, and run workers again",
                    folder.dir().display()
                )))
            }
            (false, none_given_up) => {
                let more = match none_given_up {
                    true => String::new(),
                    false => format!("; {} more were given up: {given_up_text}", given_up.len()),
                };
                let (n_missing, names) = (missing.len(), few(missing));
                Err(Failure::later(format_args!("{n_missing} of {n_shards} shards are missing: {names}{more}"))
                    .with_hint("run workers until no shard is missing, then seal again"))
            }
        }
    }
}

/// The first few names, and how many more there are.
fn few(names: &[String]) -> String {
    let shown = names.iter().take(SHOWN).cloned().collect::<Vec<_>>().join(", ");
    let n_more = names.len().saturating_sub(SHOWN);
    if n_more == 0 { shown } else { format!("{shown} and {n_more} more") }
}
