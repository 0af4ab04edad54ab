//! The fixed facts of a kind of stage, apart from its work ([`Stage`](super::Stage)), and its inputs by kind.

use std::fmt;
use std::path::{Path, PathBuf};

/// A kind of stage. Kinds are distinguished by their names.
#[derive(Debug)]
pub struct StageKind {
    /// The name in file names and messages.
    pub name: &'static str,
    /// The words of the command that runs the stage alone.
    pub command: &'static str,
    /// The section of a pipeline file that configures it.
    pub section: &'static str,
    /// The keys of the section that hold paths of inputs; `list.key` is in every item of a list.
    pub places: &'static [&'static str],
    /// Whether it trains a model, which may have cost hours: earlier ones are moved aside instead of removed.
    pub trains: bool,
    /// Whether it computes with networks, and so needs the device.
    pub computes: bool,
    /// The files and folders that it may write, by name within the output folder.
    pub outputs: &'static [&'static str],
    /// Whether readers of its outputs compare them with checksums, file by file.
    pub is_checked_by_readers: bool,
    /// The file names of its shards if several processes can make them at once; `None` if one process does all the
    /// work.
    pub shards: Option<ShardNames>,
}

impl StageKind {
    /// The name of a phase of its work, which begins with that of the stage.
    pub(super) fn phase(&self, phase: &str) -> String {
        let is_whole = self.command.split(' ').any(|word| word == phase);
        if is_whole { self.command.to_owned() } else { format!("{}: {phase}", self.command) }
    }
}

/// An input of a stage.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StageInput {
    /// Its name within the stage, such as `scenes`; unique there.
    pub name: String,
    /// Its path.
    pub path: PathBuf,
    /// The kind of stage that makes it; `None` for recordings and other files from outside.
    pub producer: Option<&'static StageKind>,
}

impl StageInput {
    /// An output of another stage.
    pub fn made_by(producer: impl Into<&'static StageKind>, name: &str, path: &Path) -> Self {
        Self { name: name.to_owned(), path: path.to_owned(), producer: Some(producer.into()) }
    }

    /// An input from outside.
    pub fn external(name: impl Into<String>, path: &Path) -> Self {
        Self { name: name.into(), path: path.to_owned(), producer: None }
    }
}

/// The names of the files that workers write ([`shards`](super::shards)).
#[derive(Debug, Clone, Copy)]
pub struct ShardNames {
    /// Prefix of the names of shards.
    pub shard: &'static str,
    /// Ending of the names of shards.
    pub ending: &'static str,
    /// Whether workers write a file with this name beside the shards.
    pub is_other: fn(&str) -> bool,
}

impl ShardNames {
    pub(super) fn shard_name(self, idx: usize) -> String {
        format!("{}-{idx:05}", self.shard)
    }
}

impl PartialEq for StageKind {
    fn eq(&self, other: &Self) -> bool {
        self.name == other.name
    }
}

impl Eq for StageKind {}

impl fmt::Display for StageKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)
    }
}
