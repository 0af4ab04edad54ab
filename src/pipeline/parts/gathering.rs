//! Which shards have the workers finished, and what does the message say of the others?

use super::PartFile;
use super::folder::PartsFolder;
use super::tries::Tries;
use crate::pipeline::{Failure, Result};
use std::path::Path;

/// The most shards that a message names.
const SHOWN: usize = 5;

/// The shards of a plan that were examined so far.
pub(super) struct Gathering<'a, S> {
    parts: &'a PartsFolder,
    found: Vec<(usize, S)>,
    missing: Vec<String>,
    given_up: Vec<String>,
    n_shards: usize,
}

impl<'a, S: PartFile> Gathering<'a, S> {
    /// Starts with none of the `n_shards` shards examined.
    pub(super) fn new(parts: &'a PartsFolder, n_shards: usize) -> Self {
        Self { parts, found: Vec::new(), missing: Vec::new(), given_up: Vec::new(), n_shards }
    }

    /// Shard `idx`, if it is finished and undamaged; otherwise notes that it is missing.
    ///
    /// # Errors
    /// Those of the file system.
    pub(super) fn look_up(&mut self, idx: usize) -> Result<Option<S>> {
        if let Some(finished) = self.parts.verified::<S>(idx)? {
            return Ok(Some(finished.shard));
        }
        let (name, tries) = (self.parts.shard_name(idx), Tries::of(self.parts, idx));
        match tries.are_over() {
            true => self.given_up.push(format!("{name} ({})", tries.describe())),
            false => self.missing.push(name),
        }
        Ok(None)
    }

    /// Where the shards are.
    pub(super) fn dir(&self) -> &Path {
        self.parts.dir()
    }

    /// Adds shards that the plan did not know of.
    pub(super) fn expect_more(&mut self, n_shards: usize) {
        self.n_shards += n_shards;
    }

    /// Adds shard `idx` to those to be published.
    pub(super) fn take(&mut self, idx: usize, shard: S) {
        self.found.push((idx, shard));
    }

    /// The shards to be published, with their indices, and the number of shards in the plan.
    pub(super) fn found(self) -> (Vec<(usize, S)>, usize) {
        (self.found, self.n_shards)
    }

    /// The shards to be published, if none is missing.
    ///
    /// # Errors
    /// When shards are missing: [`Blame::Later`](crate::pipeline::Blame::Later) while they may still come, a fault once all of them are
    /// given up.
    pub(super) fn whole(self) -> Result<Vec<(usize, S)>> {
        let Self { parts, found, missing, given_up, n_shards } = self;
        let given_up_text = few(&given_up);
        match (missing.is_empty(), given_up.is_empty()) {
            (true, true) => Ok(found),
            (true, false) => {
                let message = format!("{} of {n_shards} shards were given up: {given_up_text}", given_up.len());
                Err(Failure::fault(anyhow::anyhow!(message)).with_hint(format!(
                    "find the cause in {}, fix it, remove the marks *.try-* there, and run workers again",
                    parts.dir().display()
                )))
            }
            (false, none_given_up) => {
                let more = match none_given_up {
                    true => String::new(),
                    false => format!("; {} more were given up: {given_up_text}", given_up.len()),
                };
                let (n_missing, names) = (missing.len(), few(&missing));
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
