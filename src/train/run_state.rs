//! The files of a training: the state that it resumes from, and the statistics.

use super::{Error, FitConfig, FitStatistics};
use crate::files::write_atomically;
use crate::nn::{Adam, Ema, Params, checksum, read_checkpoint, write_checkpoint};
use candle_core::Tensor;
use fs_err as fs;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};

/// The position of a run.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Position {
    pub(super) step: u64,
    pub(super) ema_updates: u64,
    /// Sum of the losses since the last line of statistics.
    pub(super) loss_sum: f64,
    /// Sum of the gradients' norms since then.
    pub(super) norm_sum: f64,
    /// All lines of statistics up to here.
    pub(super) statistics: Vec<FitStatistics>,
    /// The step of the best evaluation, and how bad that was; its weights are in the state.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) best: Option<(u64, f64)>,
    /// The time spent on it, seconds; 0 for a training that is not given time.
    #[serde(default, skip_serializing_if = "is_default")]
    pub(super) elapsed_s: f64,
    /// The duration of its last evaluation, seconds; 0 for a training that is not given time.
    #[serde(default, skip_serializing_if = "is_default")]
    pub(super) evaluation_s: f64,
    /// The steps that it takes in all, where it was given time and changed its plan.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) planned: Option<u64>,
    /// Hash of the rest of the state, including its tensors; `None` before they are saved.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) checksum: Option<String>,
}

fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

impl Position {
    /// This position, sealed with the tensors of its state.
    fn sealed(&self, tensors: &BTreeMap<String, Tensor>) -> Result<Self, Error> {
        let unsealed = Self { checksum: None, ..self.clone() };
        let checksum = checksum(tensors, &unsealed).map_err(std::io::Error::from)?;
        Ok(Self { checksum: Some(checksum), ..unsealed })
    }
}

/// The state of a run between steps.
pub(super) struct Run {
    dir: PathBuf,
    pub(super) adam: Adam,
    pub(super) ema: Option<Ema>,
    /// The weights of the best evaluation; empty if none is kept.
    pub(super) best: BTreeMap<String, Tensor>,
    pub(super) position: Position,
}

impl Run {
    pub(super) fn state_path(dir: &Path) -> PathBuf {
        dir.join("state.safetensors")
    }

    /// The state in `dir`, which is loaded into `params`, or that of a new run.
    pub(super) fn open(config: &FitConfig, params: &mut Params, dir: &Path) -> Result<Self, Error> {
        let (adam, position) = (Adam::default(), Position::default());
        let mut run = Self { dir: dir.to_owned(), adam, ema: None, best: BTreeMap::new(), position };
        let path = Self::state_path(dir);
        fs::create_dir_all(dir)?;
        let mut averages = BTreeMap::new();
        if path.exists() {
            let checkpoint = read_checkpoint::<Position>(&path, params.device())?;
            let position = checkpoint.metadata;
            if position != position.sealed(&checkpoint.tensors)? {
                return Err(Error::DamagedState { path });
            }
            let part = |prefix: &str| -> BTreeMap<String, Tensor> {
                let named = checkpoint.tensors.iter();
                named.filter_map(|(name, t)| Some((name.strip_prefix(prefix)?.to_owned(), t.clone()))).collect()
            };
            params.load(&part("params."))?;
            run.adam.load(params, &part("adam."))?;
            averages = part("ema.");
            run.best = part("best.");
            run.position = position;
        }
        if config.ema_decay > 0.0 {
            run.ema = Some(match averages.is_empty() {
                true => Ema::new(config.ema_decay, params)?,
                false => Ema::resume(config.ema_decay, run.position.ema_updates, averages),
            });
        }
        if !run.position.statistics.is_empty() {
            run.write_statistics()?;
        }
        Ok(run)
    }

    /// Writes the lines for people and reports. The file is small and always complete; nothing resumes from it.
    pub(super) fn write_statistics(&self) -> Result<(), Error> {
        let mut text = Vec::new();
        for line in &self.position.statistics {
            serde_json::to_writer(&mut text, line).map_err(std::io::Error::from)?;
            text.push(b'\n');
        }
        write_atomically::<Error>(&self.dir.join("statistics.jsonl"), |file| Ok(file.write_all(&text)?))?;
        Ok(())
    }

    pub(super) fn save(&self, params: &Params) -> Result<(), Error> {
        let mut tensors = BTreeMap::new();
        let mut put = |prefix: &str, part: BTreeMap<String, Tensor>| {
            tensors.extend(part.into_iter().map(|(name, tensor)| (format!("{prefix}.{name}"), tensor)));
        };
        put("params", params.tensors());
        put("adam", self.adam.state()?);
        if let Some(ema) = &self.ema {
            put("ema", ema.tensors().clone());
        }
        put("best", self.best.clone());
        write_checkpoint(&Self::state_path(&self.dir), &tensors, &self.position.sealed(&tensors)?)?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nn::{Compute, Init};
    use crate::seed::Seed;

    fn params() -> Params {
        let mut params = Params::new(&Compute::cpu());
        params.get_or_init("x", &[3, 5], Init::KaimingUniform { fan_in: 1 }, Seed(1)).unwrap();
        params
    }

    #[test]
    fn a_state_is_resumed_as_it_was_saved_or_not_at_all() {
        let dir = tempfile::tempdir().unwrap();
        let config = FitConfig { ema_decay: 0.9, ..FitConfig::default() };
        let mut run = Run::open(&config, &mut params(), dir.path()).unwrap();
        let line = FitStatistics {
            step: 5,
            loss: Some(0.1),
            gradient_norm: Some(1e9),
            evaluation: BTreeMap::new(),
            minutes: None,
            planned: None,
        };
        run.position = Position {
            step: 7,
            ema_updates: 7,
            loss_sum: 0.5,
            norm_sum: 1e-300,
            statistics: vec![line],
            best: Some((5, 0.25)),
            elapsed_s: 1.5,
            evaluation_s: 0.25,
            planned: Some(9),
            checksum: None,
        };
        run.save(&params()).unwrap();
        let open = || Run::open(&config, &mut params(), dir.path());
        let resumed = open().unwrap().position;
        assert_eq!(Position { checksum: None, ..resumed }, run.position);

        let path = Run::state_path(dir.path());
        let whole = fs::read(&path).unwrap();
        for at in 0..whole.len() {
            let mut damaged = whole.clone();
            damaged[at] ^= 1;
            fs::write(&path, &damaged).unwrap();
            assert!(open().is_err(), "the byte at {at} of {}", whole.len());
        }
        let mut damaged = whole;
        *damaged.last_mut().unwrap() ^= 1;
        fs::write(&path, &damaged).unwrap();
        let said = open().err().unwrap().to_string();
        assert!(said.contains("state.safetensors has changed since it was saved"), "{said}");
    }
}
