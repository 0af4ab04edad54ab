//! Unfinished work of versions that kept no lists: may it be resumed?
//!
//! They worked in the places of outputs. What they left is taken up if all of it has names that they gave; otherwise somebody
//! else may have put it there, and the user has to say.

use super::failure::{Failure, Result};
use crate::files::{Error, files_below};
use std::path::{Path, PathBuf};

/// Beginnings and endings of the names of files that unfinished stages are taken up from: of scenes, trainings and samples.
/// Other stages begin anew.
const KNOWN: [(&str, &str); 12] = [
    ("scenes-", ".arrow"),
    ("scenes-", ".json"),
    ("maps-", ".arrow"),
    ("state", ".safetensors"),
    ("model", ".safetensors"),
    ("statistics", ".jsonl"),
    ("plan", ".json"),
    ("settings", ".toml"),
    ("requests", ".json"),
    ("request-", ".json"),
    ("samples-", ".json"),
    ("samples-", ".parquet"),
];

/// The files of outputs that a version without lists left unfinished in `root`, relative to it.
///
/// # Errors
/// When there is anything that it may not have written.
pub(super) fn unfinished(root: &Path, outputs: &[&str]) -> Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for name in outputs {
        let place = root.join(name);
        if !place.is_dir() {
            if place.symlink_metadata().is_ok() {
                return Err(refusal(&place, vec![PathBuf::from(name)]));
            }
            continue;
        }
        let (known, unknown): (Vec<_>, Vec<_>) = files_below(&place)?.into_iter().partition(|file| is_known(file));
        if !unknown.is_empty() {
            return Err(refusal(&place, unknown));
        }
        files.extend(known.into_iter().map(|file| Path::new(name).join(file)));
    }
    Ok(files)
}

fn is_known(file: &Path) -> bool {
    let number = |name: &str, (start, end): &(&str, &str)| {
        let number = name.strip_prefix(start)?.strip_suffix(end)?;
        let is_number = |c: char| c.is_ascii_digit() || c == '-';
        // A request has files of its own, such as `request-00-round-00003.json`.
        let plain = number.replace("pool", "").replace("round", "");
        Some(if start.ends_with('-') { !number.is_empty() && plain.chars().all(is_number) } else { number.is_empty() })
    };
    let name = file.to_str().unwrap_or_default();
    KNOWN.iter().any(|known| number(name, known) == Some(true))
}

fn refusal(place: &Path, found: Vec<PathBuf>) -> Failure {
    Failure::from(Error::Foreign { path: place.to_owned(), found })
        .context("an older version of djinn left this stage unfinished, without a list of files")
        .with_hint("move or remove the folder, and run the same command again")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_ours_are_told_from_others() {
        let known = ["scenes-00012.arrow", "state.safetensors", "samples-00000.json", "request-00-round-00003.json"];
        let unknown =
            ["scenes-of-mine.json", "scenes-.json", "state-2.safetensors", "state.safetensors.partial", "x/plan.json"];
        assert!(known.iter().all(|name| is_known(Path::new(name))));
        assert!(!unknown.iter().any(|name| is_known(Path::new(name))));
    }
}
