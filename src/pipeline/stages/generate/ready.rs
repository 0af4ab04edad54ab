//! Everything that planning and sampling shards needs, read and checked.

use super::sample_folder::{SampledWith, write_table};
use super::{Generate, SampleSidecar};
use crate::engine::Result;
use crate::generate::{Generator, Plan, Pool, ResolvedGeneration, ShardOutput, ShardPlan};
use crate::metrics::MetricSettings;
use crate::nn::Compute;
use crate::pipeline::StageId;
use crate::pipeline::stages::{LoadedModels, roll_out};
use crate::progress::Progress;
use crate::store::SceneStore;
use std::path::Path;

/// Scenes, models and settings for sampling.
pub(super) struct Ready<'a> {
    /// The resolved section, which includes the sweeps of requests.
    pub(super) resolved: &'a ResolvedGeneration,
    store: &'a SceneStore,
    models: &'a LoadedModels,
    /// Samples shards, and finds the buckets of scenarios for requests.
    pub(super) generator: Generator<'a>,
    /// The settings of the metrics that judge samples.
    pub(super) metric_settings: MetricSettings,
}

impl Generate<'_> {
    /// Reads and checks everything that sampling needs, and calls `work` with it. The settings of metrics depend on how
    /// well all maps fit, unless that is known already.
    pub(super) fn with_ready<R>(
        &self,
        compute: &Compute,
        metric_settings: Option<MetricSettings>,
        work: impl FnOnce(&Ready<'_>) -> Result<R>,
    ) -> Result<R> {
        let resolved = self.resolve()?;
        let store = SceneStore::open(&self.layout.scenes)?;
        let models = LoadedModels::read(self.layout, &resolved.sweeps, compute)?;
        let behaviors = self.mine.build()?;
        let load = |idx: usize| Ok(store.scene(idx)?);
        let metric_settings = metric_settings.map_or_else(|| self.settings_for_maps(&store), Ok)?;
        let settings = metric_settings.clone();
        let generator = Generator::new(&resolved, models.borrowed(), &behaviors, &load, settings, &compute.device)?;
        work(&Ready { resolved: &resolved, store: &store, models: &models, generator, metric_settings })
    }
}

impl Ready<'_> {
    /// The plan of the sweeps.
    pub(super) fn plan(&self, progress: &dyn Progress) -> Result<Plan> {
        progress.start("plan", 0, "sweeps");
        let plan = self.generator.plan_first(self.resolved.n_sweeps, self.store.index())?;
        progress.finish();
        Ok(plan)
    }

    /// The cells of each request.
    pub(super) fn pools(&self) -> Result<Vec<Pool>> {
        let pool = |request| Ok(self.generator.pool(request, self.store.index())?);
        self.resolved.requests.iter().map(pool).collect()
    }

    /// The models and settings with which the shards of the plan are sampled.
    pub(super) fn sampled_with(&self, plan: &Plan) -> SampledWith {
        let models = self.models;
        SampledWith {
            scenes: self.store.fingerprint().to_owned(),
            denoiser: models.fingerprint(StageId::TrainDenoiser).unwrap_or_default(),
            classifier: models.fingerprint(StageId::TrainClassifier),
            distilled: models.fingerprint(StageId::TrainDistill),
            baseline: models.fingerprint(StageId::TrainBaseline),
            shortfalls: plan.shortfalls.clone(),
        }
    }

    /// Samples a shard and writes its table into the folder `dir`.
    pub(super) fn sample(&self, shard: &ShardPlan, dir: &Path, progress: &dyn Progress) -> Result<SampleSidecar> {
        self.write(shard, dir, self.generate(shard, progress)?)
    }

    /// The scenarios of a shard, which go on in closed loops if the sweep asks for that.
    pub(super) fn generate(&self, shard: &ShardPlan, progress: &dyn Progress) -> Result<ShardOutput> {
        let mut output = self.generator.generate(shard, progress)?;
        let sweep = &self.resolved.sweeps[shard.sweep_idx];
        roll_out(&mut output, sweep, (&self.generator, self.store), progress)?;
        Ok(output)
    }

    /// Writes the table of a shard into the folder `dir`.
    pub(super) fn write(&self, shard: &ShardPlan, dir: &Path, output: ShardOutput) -> Result<SampleSidecar> {
        let sweep = &self.resolved.sweeps[shard.sweep_idx];
        write_table(dir, shard.idx, (&sweep.name, sweep.n_evaluations()), output)
    }
}
