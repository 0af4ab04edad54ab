//! Everything that planning and sampling shards needs, read and checked.

use super::sample_folder::{SampledWith, write_table};
use super::{Generate, SampleSidecar};
use crate::engine::{Failure, Result};
use crate::generate::{Generator, Plan, Pool, ResolvedGeneration, ShardOutput, ShardPlan};
use crate::metrics::MetricSettings;
use crate::nn::Compute;
use crate::pipeline::StageId;
use crate::pipeline::stages::held_out::learned;
use crate::pipeline::stages::{LoadedModels, roll_out};
use crate::progress::Progress;
use crate::scene::{Scene, Split};
use crate::store::SceneStore;
use std::collections::BTreeSet;
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
    /// Reads and checks everything that sampling needs, and calls `work` with it. Where the settings of metrics are not
    /// known yet, a plan is to be made: they depend on how well all maps fit, and it on what models learn from.
    pub(super) fn with_ready<R>(
        &self,
        compute: &Compute,
        metric_settings: Option<MetricSettings>,
        work: impl FnOnce(&Ready<'_>) -> Result<R>,
    ) -> Result<R> {
        let mut resolved = self.resolve()?;
        let store = self.open_scenes()?;
        if metric_settings.is_none() {
            resolved.learned = learned(&self.learns_from, &SceneStore::open(&self.layout.scenes)?)?;
        }
        let models = LoadedModels::read(self.layout, &resolved.sweeps, compute)?;
        let behaviors = self.mine.build()?;
        let load = |idx: usize| Ok(self.scene_of(&store, idx)?);
        let metric_settings = metric_settings.map_or_else(|| self.settings_for_maps(&store), Ok)?;
        let settings = metric_settings.clone();
        let generator = Generator::new(&resolved, models.borrowed(), &behaviors, &load, settings, &compute.device)?;
        work(&Ready { resolved: &resolved, store: &store, models: &models, generator, metric_settings })
    }
}

impl Generate<'_> {
    /// A scene as it is sampled: unsplit ones that a run with trainings samples unasked are held out of these.
    pub(super) fn scene_of(&self, store: &SceneStore, idx: usize) -> crate::store::Result<Scene> {
        let mut scene = store.scene(idx)?;
        let is_divided = self.config.splits.is_empty() && !self.learns_from.is_empty();
        if is_divided && scene.source.split == Split::Unsplit {
            scene.source.split = Split::Val;
        }
        Ok(scene)
    }
}

impl Ready<'_> {
    pub(super) fn plan(&self, progress: &dyn Progress) -> Result<Plan> {
        progress.start("plan", 0, "sweeps");
        let plan = self.generator.plan_first(self.resolved.n_sweeps, self.store.index())?;
        progress.finish();
        Ok(plan)
    }

    /// The cells of each request.
    ///
    /// # Errors
    /// When no situation can fulfill any request, and there are no sweeps.
    pub(super) fn pools(&self) -> Result<Vec<Pool>> {
        let pool = |request| Ok(self.generator.pool(request, self.store.index())?);
        let pools: Vec<Pool> = self.resolved.requests.iter().map(pool).collect::<Result<_>>()?;
        let unmet: Vec<&str> = pools.iter().filter_map(|pool| pool.unmet.as_deref()).collect();
        if self.resolved.n_sweeps == 0 && !pools.is_empty() && unmet.len() == pools.len() {
            return Err(Failure::input_message(format_args!("nothing can be generated: {}", unmet.join("; "))));
        }
        Ok(pools)
    }

    /// Warns of what cannot be fulfilled, before anything is sampled.
    pub(super) fn warn_of_infeasible(&self, pools: &[Pool], progress: &dyn Progress) {
        for (request, pool) in self.resolved.requests.iter().zip(pools) {
            if let Some(why) = &pool.unmet {
                progress.warn(&format!("{why}. The other requests are fulfilled"));
                continue;
            }
            let unreached = (0..request.buckets.len()).filter(|bucket| pool.n_feasible(*bucket) == 0);
            let unreached: Vec<String> = unreached.map(|bucket| request.buckets.ranges(bucket)).collect();
            if !unreached.is_empty() {
                let (name, n) = (&pool.request, unreached.len());
                progress.warn(&format!("request {name}: no pair can reach {n} buckets: {}", unreached.join("; ")));
            }
        }
    }

    /// The models and settings with which the shards of the plan are sampled.
    pub(super) fn sampled_with(&self, plan: &Plan, pools: &[Pool]) -> SampledWith {
        let models = self.models;
        let of_sweeps = plan.shards.iter().flat_map(|shard| &shard.cells);
        let cells = of_sweeps.chain(pools.iter().flat_map(|pool| &pool.cells));
        let scenes: BTreeSet<usize> = cells.map(|cell| cell.scene_idx).collect();
        SampledWith {
            scenes: self.store.fingerprint().to_owned(),
            denoiser: models.fingerprint(StageId::TrainDenoiser).unwrap_or_default(),
            classifier: models.fingerprint(StageId::TrainClassifier),
            distilled: models.fingerprint(StageId::TrainDistill),
            baseline: models.fingerprint(StageId::TrainBaseline),
            shortfalls: plan.shortfalls.clone(),
            n_learned: scenes.intersection(&self.resolved.learned).count(),
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
