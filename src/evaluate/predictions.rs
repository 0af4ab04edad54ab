//! Which samples become the predictions for a benchmark?

use super::cells::CellSamples;
use super::config::EvaluateConfig;
use super::error::Result;
use crate::files::clear;
use crate::metrics::{ModeFit, Modes, ModesOf};
use crate::scene::{Benchmark, Dataset, Scene};
use crate::store::{ArgoversePredictions, InteractionPredictions, SceneSet};
use std::path::Path;

/// The number of modes that benchmarks take.
const BENCHMARK_MODES: usize = 6;

/// The predictions for each requested dataset. A benchmark takes one answer per scene: the first unguided samples, in
/// the order of sweeps.
pub(super) struct Predictions {
    interaction: Option<InteractionPredictions>,
    argoverse: Vec<(Dataset, ArgoversePredictions)>,
    scenes: SceneSet,
    n_tracks_left_out: usize,
}

/// The modes of a cell as predictions for its scene: of the ego if the benchmark predicts one agent, otherwise of all
/// agents jointly. With no more samples than modes, these are the samples themselves. `None` for cells that are not
/// forecasts, among them closed loops, and for datasets that were not requested.
pub(super) fn of_cell(cell: &CellSamples<'_>, config: &EvaluateConfig) -> Option<Modes> {
    let first = &cell.records[0].scenario;
    let dataset = first.scene.source.dataset;
    let is_forecast = first.provenance.is_unguided() && first.provenance.ego_driver.is_none();
    if !is_forecast || !config.predictions.contains(&dataset) {
        return None;
    }
    let samples: Vec<Scene> = cell.records.iter().map(|record| record.scenario.scene.clone()).collect();
    let n_modes = config.modes.unwrap_or(BENCHMARK_MODES);
    if samples.len() <= n_modes {
        let probabilities = cell.probabilities().unwrap_or_else(|| vec![1.0; samples.len()]);
        let sum: f64 = probabilities.iter().sum();
        let probabilities = probabilities.into_iter().map(|probability| probability / sum).collect();
        return Some(Modes { samples, probabilities });
    }
    let of = match dataset.facts().benchmark {
        Some(Benchmark::ArgoverseFocal) => ModesOf::Ego,
        Some(Benchmark::InteractionJoint | Benchmark::ArgoverseWorlds) | None => ModesOf::Scene,
    };
    Some(ModeFit::new(&samples, &of.agents(&first.scene), n_modes, cell.mode_seed())?.modes())
}

impl Predictions {
    /// Begins the files in `dir`, and removes the remains of an interrupted attempt from it. Without requested datasets
    /// it writes and removes nothing.
    pub(super) fn create(dir: &Path, datasets: &[Dataset]) -> Result<Self> {
        if !datasets.is_empty() {
            clear(dir)?;
        }
        let mut predictions =
            Self { interaction: None, argoverse: Vec::new(), scenes: SceneSet::default(), n_tracks_left_out: 0 };
        for dataset in datasets {
            match dataset.facts().benchmark {
                None => {}
                Some(Benchmark::InteractionJoint) => predictions.interaction = Some(InteractionPredictions::new(dir)),
                Some(Benchmark::ArgoverseFocal | Benchmark::ArgoverseWorlds) => {
                    let path = dir.join(format!("{}.parquet", dataset.name()));
                    predictions.argoverse.push((*dataset, ArgoversePredictions::create(&path)?));
                }
            }
        }
        Ok(predictions)
    }

    /// Adds the modes of a scene with this position in its store, if it has none yet.
    pub(super) fn add(&mut self, recorded: &Scene, scene_idx: usize, modes: &Modes) -> Result<()> {
        if !self.scenes.insert(scene_idx) {
            return Ok(());
        }
        let dataset = recorded.source.dataset;
        self.n_tracks_left_out += match (dataset.facts().benchmark, &mut self.interaction) {
            (Some(Benchmark::InteractionJoint), Some(interaction)) => interaction.add(recorded, modes)?,
            _ => match self.argoverse.iter_mut().find(|(of, _)| *of == dataset) {
                Some((_, argoverse)) => argoverse.add(recorded, modes)?,
                None => 0,
            },
        };
        Ok(())
    }

    /// Renames the files to their final names. Returns the number of scenes, and of required tracks that had to be left
    /// out.
    pub(super) fn finish(self) -> Result<(usize, usize)> {
        if let Some(interaction) = self.interaction {
            interaction.finish()?;
        }
        for (_, argoverse) in self.argoverse {
            argoverse.finish()?;
        }
        Ok((self.scenes.len(), self.n_tracks_left_out))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::testing::{record, recorded};
    use crate::scene::GuidanceTag;

    #[test]
    fn a_folder_is_cleared_only_for_predictions() {
        let folder = tempfile::tempdir().unwrap();
        let own = folder.path().join("thesis.tex");
        fs_err::write(&own, "words").unwrap();
        assert!(Predictions::create(folder.path(), &[]).is_ok());
        assert!(
            Predictions::create(folder.path(), &[Dataset::Interaction]).is_err(),
            "it holds a file of somebody else"
        );
        assert!(own.exists());
    }

    #[test]
    fn only_forecasts_become_predictions() {
        let config = EvaluateConfig { predictions: vec![Dataset::Interaction], ..EvaluateConfig::default() };
        let is_predicted = |kind: &str, strength: f64, edit_tau: Option<f64>| {
            let mut record = record(strength, false, false, recorded());
            record.scenario.provenance.guidance.kind = kind.to_owned();
            record.scenario.provenance.edit_tau = edit_tau;
            let cell = CellSamples { records: vec![&record], with_references: false };
            of_cell(&cell, &config).is_some()
        };
        assert!(is_predicted(GuidanceTag::NONE, 0.0, None) && is_predicted(GuidanceTag::BASELINE, 0.0, None));
        assert!(!is_predicted("classifier:cut_in", 2.0, None));
        assert!(!is_predicted(GuidanceTag::NONE, 0.0, Some(0.4)), "it starts from an edited recording");
    }
}
