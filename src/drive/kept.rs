//! Drives of an interrupted attempt, kept beside its output folder so that they are not driven again.

use super::drives::Drives;
use super::{DriveConfig, Error, Origin, Result};
use crate::files::{self, keep_list, listed, remove_listed};
use crate::generate::Futures;
use crate::scenario::EgoChoice;
use crate::store::{self, CorpusReader, read_binary, write_binary_atomically};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// The file that tells of what the drives are, and its format.
const PARTS: &str = "parts.v1";

/// Drives by scenario, each a file.
pub(super) struct Kept {
    dir: PathBuf,
    /// The format of the files, which distinguishes the program, corpus, model and settings of the drives.
    format: String,
    n_found: AtomicUsize,
    /// Whether the folder is new and nothing has been kept in it.
    is_unused: AtomicBool,
}

impl Kept {
    /// Drives for the folder `out`, whose lock must be held, that depend only on these named parts. Returns the names
    /// of those that have changed since an interrupted attempt, whose drives then count for nothing.
    pub(super) fn begin<'p>(out: &Path, parts: &[(&'p str, String)]) -> Result<(Self, Vec<&'p str>)> {
        let mut name = out.file_name().unwrap_or_default().to_owned();
        name.push(".drives");
        let dir = out.with_file_name(name);
        let is_unused = AtomicBool::new(!dir.exists());
        if !dir.exists() {
            fs_err::create_dir(&dir)?;
            keep_list(&dir)?;
        } else if listed(&dir)?.is_none() {
            return Err(files::Error::Exists { path: dir }.into());
        }
        let hashes: Vec<String> =
            parts.iter().map(|(_, part)| blake3::hash(part.as_bytes()).to_hex().to_string()).collect();
        let path = dir.join(PARTS);
        let earlier: Option<Vec<String>> = read_binary(&path, PARTS).ok();
        let is_other = |i: usize| earlier.as_ref().is_some_and(|earlier| earlier.get(i) != Some(&hashes[i]));
        let others: Vec<&str> = (0..parts.len()).filter(|i| is_other(*i)).map(|i| parts[i].0).collect();
        if earlier.is_none() || !others.is_empty() {
            write_binary_atomically(&path, PARTS, &hashes)?;
        }
        let format = format!("drives.{}", blake3::hash(hashes.concat().as_bytes()).to_hex());
        Ok((Self { dir, format, n_found: AtomicUsize::new(0), is_unused }, others))
    }

    /// The drives of a scenario, if it was driven before.
    pub(super) fn get(&self, scenario_id: &str) -> Result<Option<Drives>> {
        match read_binary(&self.path(scenario_id), &self.format) {
            Ok(drives) => {
                self.n_found.fetch_add(1, Ordering::Relaxed);
                Ok(Some(drives))
            }
            Err(store::Error::SchemaVersion { .. } | store::Error::Corrupt { .. }) => Ok(None),
            Err(store::Error::Io(error)) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(error.into()),
        }
    }

    pub(super) fn put(&self, scenario_id: &str, drives: &Drives) -> Result<()> {
        self.is_unused.store(false, Ordering::Relaxed);
        Ok(write_binary_atomically(&self.path(scenario_id), &self.format, drives).map(drop)?)
    }

    /// The number of scenarios that were driven before.
    pub(super) fn n_found(&self) -> usize {
        self.n_found.load(Ordering::Relaxed)
    }

    /// Removes the kept drives, once the output is in its place.
    pub(super) fn remove(&self) -> Result<()> {
        let ours = listed(&self.dir)?.unwrap_or_default();
        remove_listed(&self.dir, &ours).map(drop).map_err(Error::from)
    }

    fn path(&self, scenario_id: &str) -> PathBuf {
        // Ids of a foreign corpus may be no names of files.
        self.dir.join(blake3::hash(scenario_id.as_bytes()).to_hex().as_str())
    }
}

impl Drop for Kept {
    /// A drive that was refused leaves nothing behind.
    fn drop(&mut self) {
        if self.is_unused.load(Ordering::Relaxed) {
            drop(self.remove());
        }
    }
}

/// Everything that drives depend on, except what a planner does beside the files that its command names.
pub(super) fn parts(
    (reader, of_scenes): (&CorpusReader, &str),
    from: &Origin<'_>,
    ego: &EgoChoice,
    config: &DriveConfig,
    futures: &Futures<'_>,
) -> Result<[(&'static str, String); 5]> {
    let from = if let Origin::State(world) = from { Some(world) } else { None };
    // The number of simultaneous drives changes nothing, and what is counted of them neither.
    let own = DriveConfig { n_workers: 0, rates: false, split: None, program: String::new(), ..config.clone() };
    Ok([
        ("the files of the planner", config.ego.files_hash()?),
        ("the settings", format!("{own:?} {ego:?} {from:?} {}", futures.seed())),
        ("the model", futures.fingerprint().to_owned()),
        ("the corpus", format!("{:?} {of_scenes}", reader.manifest())),
        ("the program", config.program.clone()),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::NamedDriver;
    use crate::simulate::testing::{model, record, situation};
    use crate::simulate::{Others, RolloutConfig, named, roll_out};

    #[test]
    fn drives_come_back_to_the_last_digit_unless_they_are_those_of_something_else() {
        let (dir, model, situation) = (tempfile::tempdir().unwrap(), model(), situation(&record()));
        let (out, futures) = (dir.path().join("out"), Futures::new(&model, 1, &candle_core::Device::Cpu).unwrap());
        let config = RolloutConfig { horizon_s: 0.5, ..RolloutConfig::default() };
        let (others, driver) = (Others::Sampled(&futures), &mut named(NamedDriver::ConstantVelocity));
        let driven = roll_out(&situation, situation.start(1), driver.as_mut(), &others, &config, Some(0)).unwrap();
        let begin = |planner: &str| {
            let parts = [("planner", planner.to_owned()), ("corpus", "c".to_owned())];
            let (kept, others) = Kept::begin(&out, &parts).unwrap();
            (kept, others.concat())
        };
        let (kept, others) = begin("a");
        assert_eq!(others, "");
        assert!(kept.get("x/1").unwrap().is_none());
        kept.put("x/1", &Drives { all: vec![("idm".to_owned(), driven.clone())], margin: None }).unwrap();
        let (kept, others) = begin("a");
        let Drives { all: again, margin } = kept.get("x/1").unwrap().unwrap();
        assert_eq!(others, "");
        assert_eq!((format!("{:?}", again[0].1), margin, kept.n_found()), (format!("{driven:?}"), None, 1));
        let (other, others) = begin("b");
        assert!(other.get("x/1").unwrap().is_none() && others == "planner");
        kept.remove().unwrap();
        assert_eq!(fs_err::read_dir(dir.path()).unwrap().count(), 0);
        // A foreign file there stays.
        fs_err::create_dir(dir.path().join("out.drives")).unwrap();
        assert!(Kept::begin(&out, &[]).is_err());
    }
}
