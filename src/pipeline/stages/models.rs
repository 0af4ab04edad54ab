//! The trained models from which sweeps sample: which are needed, and where are they?

use super::train::checkpoint_file;
use crate::engine::Result;
use crate::generate::{Generator, Models, ResolvedSweep, ShardOutput};
use crate::model::{ModelSpec, TrainedClassifier, TrainedDenoiser, TrainedModel, TrainedSceneTransformer};
use crate::nn::Compute;
use crate::pipeline::StageId;
use crate::pipeline::layout::Layout;
use crate::progress::Progress;
use crate::simulate::roll_out_samples;
use crate::store::SceneStore;

/// The stages whose models `sweeps` need, with the denoiser's first.
pub(in crate::pipeline) fn needed_models(sweeps: &[ResolvedSweep]) -> Vec<StageId> {
    let any = |needs: fn(&ResolvedSweep) -> bool| sweeps.iter().any(needs);
    let needed = [
        (StageId::TrainDenoiser, true),
        (StageId::TrainDistill, any(ResolvedSweep::uses_distilled)),
        // Unguided sampling needs no classifier, except to rank pairs: it is used for that if some sweep is guided.
        (StageId::TrainClassifier, any(ResolvedSweep::needs_classifier)),
        (StageId::TrainBaseline, any(ResolvedSweep::uses_baseline)),
    ];
    needed.into_iter().filter(|(_, is_needed)| *is_needed).map(|(stage, _)| stage).collect()
}

/// The models of some sweeps.
pub(in crate::pipeline) struct LoadedModels {
    denoiser: TrainedDenoiser,
    distilled: Option<TrainedDenoiser>,
    classifiers: Vec<TrainedClassifier>,
    baseline: Option<TrainedSceneTransformer>,
}

impl LoadedModels {
    /// Reads the models that `sweeps` need.
    pub(in crate::pipeline) fn read(layout: &Layout, sweeps: &[ResolvedSweep], compute: &Compute) -> Result<Self> {
        let needed = needed_models(sweeps);
        let needs = |stage| needed.contains(&stage);
        fn read<S: ModelSpec>(dir: &std::path::Path, compute: &Compute) -> Result<TrainedModel<S>> {
            Ok(TrainedModel::read(&checkpoint_file(dir), compute)?)
        }
        Ok(Self {
            denoiser: read(&layout.denoiser, compute)?,
            distilled: needs(StageId::TrainDistill).then(|| read(&layout.distilled, compute)).transpose()?,
            classifiers: match needs(StageId::TrainClassifier) {
                true => vec![read(&layout.classifier, compute)?],
                false => Vec::new(),
            },
            baseline: needs(StageId::TrainBaseline).then(|| read(&layout.baseline, compute)).transpose()?,
        })
    }

    /// The models as generation takes them.
    pub(in crate::pipeline) fn borrowed(&self) -> Models<'_> {
        Models {
            denoiser: &self.denoiser,
            classifiers: &self.classifiers,
            distilled: self.distilled.as_ref(),
            baseline: self.baseline.as_ref(),
        }
    }

    /// The fingerprint of the model that a stage makes, if it was read.
    pub(in crate::pipeline) fn fingerprint(&self, stage: StageId) -> Option<String> {
        match stage {
            StageId::TrainDenoiser => Some(&self.denoiser.fingerprint),
            StageId::TrainDistill => self.distilled.as_ref().map(|model| &model.fingerprint),
            StageId::TrainClassifier => self.classifiers.first().map(|model| &model.fingerprint),
            StageId::TrainBaseline => self.baseline.as_ref().map(|model| &model.fingerprint),
            _ => None,
        }
        .cloned()
    }
}

/// Lets the scenarios of a shard go on in closed loops, by the model of their sweep, if the sweep asks for that.
pub(in crate::pipeline) fn roll_out(
    output: &mut ShardOutput,
    sweep: &ResolvedSweep,
    (generator, store): (&Generator<'_>, &SceneStore),
    progress: &dyn Progress,
) -> Result<()> {
    let Some(rollout) = &sweep.rollout else { return Ok(()) };
    let futures = generator.futures(sweep)?;
    Ok(roll_out_samples(output, rollout, generator.behavior(sweep), &futures, store, progress)?)
}
