//! The driver under test, by name or command.

use super::Result;
use crate::generate::NamedDriver;
use std::path::Path;

/// The driver of the ego.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum EgoDriver {
    /// One that has a name.
    Named(NamedDriver),
    /// A planner: a command that speaks the protocol.
    External(String),
}

impl EgoDriver {
    /// The driver with this name; any other text is a command.
    pub fn from_name(name: &str) -> Self {
        let named = NamedDriver::ALL.into_iter().find(|driver| driver.name() == name);
        named.map_or_else(|| Self::External(name.to_owned()), Self::Named)
    }

    /// A hash of the files that the command of a planner names: existing ones among its words, also within the folders
    /// among them, but those that it writes by `>`. What these files read themselves is not known.
    pub(super) fn files_hash(&self) -> Result<String> {
        let command = if let Self::External(command) = self { command.as_str() } else { "" };
        let ends_word = |c: char| c.is_whitespace() || "'\"`;&|<>()=".contains(c);
        let words = command.split('>').enumerate().flat_map(|(i, part)| {
            let words = part.split(ends_word).filter(|word| !word.is_empty());
            words.skip(usize::from(i > 0))
        });
        let words: Vec<&Path> = words.map(Path::new).collect();
        let mut hasher = blake3::Hasher::new();
        for folder in words.iter().copied().filter(|word| word.is_dir()).chain([Path::new("")]) {
            for path in words.iter().map(|word| folder.join(word)).filter(|path| path.is_file()) {
                hasher.update(path.as_os_str().as_encoded_bytes());
                hasher.update_reader(fs_err::File::open(&path)?)?;
            }
        }
        Ok(hasher.finalize().to_hex().to_string())
    }

    /// The name, or the command.
    pub fn name(&self) -> &str {
        match self {
            Self::Named(driver) => driver.name(),
            Self::External(command) => command,
        }
    }

    pub(super) fn name_in_tables(&self) -> &str {
        match self {
            Self::External(_) => "planner",
            named => named.name(),
        }
    }
}
