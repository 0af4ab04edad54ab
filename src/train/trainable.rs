//! A network under training, and its checkpoint, for every model.

use super::section::SceneTraining;
use super::training_data::TrainingData;
use super::{Balance, Error, FitOutcome, FitStatistics, Prefetched, SceneDraws, WeightedGroups};
use crate::model::ModelSpec;
use crate::nn::{Checkpoint, Compute, Params};
use crate::progress::Progress;
use crate::seed::Seed;
use crate::tensor::{Collator, MaskSampler};
use std::path::Path;

/// Name of the trained weights in a model's folder.
pub const MODEL_FILE: &str = "model.safetensors";

/// The environment of a training.
#[derive(Clone, Copy)]
pub struct TrainJob<'a> {
    /// Seed of everything random.
    pub seed: Seed,
    /// The folder of the model. An interrupted training in it is resumed.
    pub dir: &'a Path,
    /// The device and precision that networks compute on.
    pub compute: &'a Compute,
    /// Receives the progress.
    pub progress: &'a dyn Progress,
    /// The time that it is given; `None`: as much as it takes.
    pub time: Option<JobTime<'a>>,
}

/// The time that a training is given, by a clock of its caller.
#[derive(Clone, Copy)]
pub struct JobTime<'a> {
    /// Seconds since the process began with this training.
    pub clock_s: &'a dyn Fn() -> f64,
    /// The seconds after which training ends.
    pub until_s: f64,
}

impl JobTime<'_> {
    /// Seconds since the process began with this training.
    pub(super) fn elapsed_s(&self) -> f64 {
        (self.clock_s)()
    }
}

/// The result of training a model.
#[derive(Debug, Clone, PartialEq)]
pub struct TrainOutcome<S> {
    /// Fingerprint of the checkpoint.
    pub fingerprint: String,
    /// The description of the model.
    pub spec: S,
    /// Number of trained values.
    pub n_parameters: usize,
    /// Losses and evaluations.
    pub statistics: Vec<FitStatistics>,
}

/// Parameters, and two networks over them.
pub(super) struct Trainable<S: ModelSpec> {
    /// The parameters.
    pub(super) params: Params,
    /// The network, whose parameters take gradients.
    pub(super) network: S::Network,
    /// The network without gradients, for evaluations.
    pub(super) frozen: S::Network,
}

impl<S: ModelSpec> Trainable<S> {
    /// The network that `spec` describes, with the weights of `start` or else new ones.
    pub(super) fn new(spec: &S, start: Option<&Checkpoint<S>>, job: TrainJob<'_>) -> Result<Self, Error> {
        let mut params = Params::new(job.compute);
        let network = spec.build(&mut params, job.seed.derive("weights", &[]))?;
        if let Some(start) = start {
            params.load(&start.tensors)?;
        }
        let frozen = spec.build(&mut params.frozen(), job.seed)?;
        Ok(Self { params, network, frozen })
    }

    /// Writes the trained checkpoint.
    pub(super) fn finish(self, spec: S, outcome: FitOutcome, job: TrainJob<'_>) -> Result<TrainOutcome<S>, Error> {
        let fingerprint = spec.write(&self.params, &job.dir.join(MODEL_FILE))?;
        let n_parameters = self.params.n_parameters();
        Ok(TrainOutcome { fingerprint, spec, n_parameters, statistics: outcome.statistics })
    }
}

/// The scenes of a training, from which draws borrow.
pub(super) struct ScenesOfFit<'a> {
    data: &'a TrainingData<'a>,
    groups: Vec<WeightedGroups>,
    held_out: Vec<usize>,
    masks: MaskSampler,
    collator: Collator,
    batch_size: usize,
}

impl<'a> ScenesOfFit<'a> {
    pub(super) fn new(
        data: &'a TrainingData<'a>,
        training: &SceneTraining,
        balance: Balance,
        collator: Collator,
        seed: Seed,
    ) -> Result<Self, Error> {
        let no_task = || Error::Config("the weights of the training tasks are not valid".to_owned());
        Ok(Self {
            data,
            groups: data.groups(balance),
            held_out: data.chosen_held_out(training.n_eval_scenes, seed),
            masks: MaskSampler::new(&training.tasks).ok_or_else(no_task)?,
            collator,
            batch_size: training.batch_size,
        })
    }

    /// Draws batches; `with_context` adds the context of objectives.
    pub(super) fn draws<'b>(&'b self, with_context: bool, job: TrainJob<'b>) -> SceneDraws<'b> {
        SceneDraws {
            collator: &self.collator,
            dataset: self.data.dataset,
            train: &self.groups,
            held_out: &self.held_out,
            masks: &self.masks,
            batch_size: self.batch_size,
            with_context,
            seed: job.seed,
            device: &job.compute.device,
            ahead: Prefetched::default(),
        }
    }
}
