//! How often was a shard tried? Each try leaves a mark beside the shard, so that an input that crashes the program is
//! given up eventually.
//!
//! A mark is made before the work and removed after it. Marks that stay belong to tries that failed or died; a failed
//! try writes its reason into the mark.

use crate::engine::clock::utc_now;
use crate::engine::{Failure, Result};
use crate::store::{read_json, write_json_atomically};
use serde::{Deserialize, Serialize};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

/// After this many failures with a reason, a shard would fail again.
pub(super) const MAX_FAILED: usize = 3;
/// More tries that died without a reason are allowed, since they may have been killed from outside.
pub(super) const MAX_TRIES: usize = 10;

/// A worker in its last try is presumed dead after this long.
const LONG: Duration = Duration::from_secs(600);

/// The content of a mark.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Try {
    pub(super) worker: String,
    /// When it began, UTC.
    pub(super) started: String,
    /// Why it failed; `None` if it is at work or died.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) failed: Option<String>,
}

/// The marks of a shard.
#[derive(Debug, Default)]
pub(super) struct Tries {
    pub(super) n_tries: usize,
    /// The reasons of failed tries.
    pub(super) failed: Vec<String>,
    /// Age of the youngest mark without a reason.
    pub(super) age: Option<Duration>,
}

impl Tries {
    /// The tries of a shard with these marks.
    pub(super) fn of(marks: impl Iterator<Item = PathBuf>) -> Self {
        let mut tries = Self::default();
        for path in marks {
            let Ok(metadata) = fs_err::metadata(&path) else { continue };
            tries.n_tries += 1;
            // The process may not have written the mark yet, or died while doing so.
            match read_json::<Try>(&path).ok().and_then(|mark| mark.failed) {
                Some(failed) => tries.failed.push(failed),
                None => {
                    let modified = metadata.modified().unwrap_or(SystemTime::UNIX_EPOCH);
                    let age = SystemTime::now().duration_since(modified).unwrap_or_default();
                    tries.age = Some(tries.age.map_or(age, |other| other.min(age)));
                }
            }
        }
        tries
    }

    /// Whether nobody will try again.
    pub(super) fn are_over(&self) -> bool {
        self.failed.len() >= MAX_FAILED || self.n_tries >= MAX_TRIES
    }

    /// Whether the shard is given up and probably no worker is at work on it.
    pub(super) fn are_hopeless(&self) -> bool {
        self.failed.len() >= MAX_FAILED || (self.n_tries >= MAX_TRIES && self.age.is_none_or(|age| age > LONG))
    }

    /// The result of the tries, in words.
    pub(super) fn describe(&self) -> String {
        match self.failed.last() {
            Some(why) => format!("failed {} times, last: {why}", self.failed.len()),
            None => format!("{} workers died in it, or are still at work on it", self.n_tries),
        }
    }
}

/// Marks the beginning of a try of the shard with these marks; `None` if it is given up. Returns the mark.
pub(super) fn begin(marks: impl Iterator<Item = PathBuf> + Clone, worker: &str) -> Result<Option<PathBuf>> {
    if Tries::of(marks.clone()).are_over() {
        return Ok(None);
    }
    let mark = Try { worker: worker.to_owned(), started: utc_now(), failed: None };
    let text = serde_json::to_vec(&mark).map_err(Failure::fault)?;
    for path in marks {
        // Two workers that begin at once get two numbers.
        match fs_err::File::options().write(true).create_new(true).open(&path) {
            Ok(mut file) => {
                file.write_all(&text)?;
                return Ok(Some(path));
            }
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
            Err(error) => return Err(error.into()),
        }
    }
    Ok(None)
}

/// Writes the reason of a failed try into its mark.
pub(super) fn fail(path: &Path, worker: &str, why: &str) -> Result<()> {
    let mark = Try { worker: worker.to_owned(), started: utc_now(), failed: Some(why.to_owned()) };
    write_json_atomically(path, &mark)?;
    Ok(())
}

/// Whether `name` is that of a try at the shard named `shard`.
pub(super) fn is_try_of(name: &str, shard: &str) -> bool {
    let number = name.strip_prefix(shard).and_then(|rest| rest.strip_prefix(".try-"));
    number.and_then(|number| number.parse().ok()).is_some_and(|number: usize| (1..=MAX_TRIES).contains(&number))
}
