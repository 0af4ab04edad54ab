//! Recorded histories and models to generated scenarios, shard by shard; finished shards survive an interruption.

#[cfg(test)]
mod held_out_tests;
mod ready;
mod rounds;
mod sample_folder;
mod sharded;
#[cfg(test)]
mod tests;

pub(in crate::pipeline) use sample_folder::{FoundShard, find_shard, is_round_file, shard_name};
pub use sample_folder::{SampleManifest, SampleSettings, SampleSidecar, SampledWith, read_requests};

use super::mine::MineConfig;
use super::models::needed_models;
use super::with_precision;
use crate::diffusion::Edm;
use crate::engine::{Failure, Result, Stage, StageInput, StageKind, Work};
use crate::evaluate::MapFits;
use crate::generate::{self, GenerateConfig, Pool, ResolvedGeneration};
use crate::ingest::Horizon;
use crate::metrics::{DUPLICATE_DISTANCE_M, MetricSettings};
use crate::nn::{Compute, Precision};
use crate::pipeline::StageId;
use crate::pipeline::layout::Layout;
use crate::scene::INGESTED_DT_S;
use crate::settings::Issue;
use crate::store::SceneStore;
use crate::train::{DistillTrainingConfig, SceneChoice};
use serde_json::{Value, json};
use std::path::Path;

/// The stage.
pub struct Generate<'a> {
    /// Its section.
    pub config: &'a GenerateConfig,
    /// The precision of matrix products.
    pub precision: Precision,
    /// The definitions of the behaviors by which scenarios are verified.
    pub mine: MineConfig,
    /// The settings of metrics in selections and limits, as in the evaluation.
    pub metric_settings: MetricSettings,
    /// Scenarios whose agents move closer to another than this are near-duplicates, as in the evaluation, meters.
    pub duplicate_distance_m: f64,
    /// Whether the evaluation keeps near-duplicates of sweeps.
    pub keeps_duplicates: bool,
    /// The behavior that the pipeline's classifier is trained for, if it trains one.
    pub classified_behavior: Option<&'a str>,
    /// The distillation of the pipeline's denoiser, if it does that itself.
    pub distill: Option<&'a DistillTrainingConfig>,
    /// The timesteps of scenes that the pipeline ingests itself.
    pub horizon: Option<Horizon>,
    /// The scenes that models of the pipeline learn from: none of them is sampled as held out.
    pub learns_from: Vec<SceneChoice<'a>>,
    /// Whether requests may begin from situations that nobody recorded.
    pub has_situations: bool,
    /// Where the scenes and models are.
    pub layout: &'a Layout,
}

impl Stage for Generate<'_> {
    fn kind(&self) -> &'static StageKind {
        StageId::Generate.kind()
    }

    fn version(&self) -> u32 {
        35
    }

    fn check(&self) -> Result<()> {
        let resolved = self.resolve()?;
        self.metric_settings.validate().map_err(|why| Failure::input_message(format_args!("evaluate.{why}")))?;
        // The denoiser's own constants may not be known yet. Sweeps and distillation see the same ones here; they are
        // checked again once both models exist.
        let edm = Edm::default();
        let distillation = self.distill.filter(|config| config.checkpoint.is_none());
        let distillation = distillation.map(|config| config.method.distillation(&edm));
        for sweep in &resolved.sweeps {
            if let (Some(rollout), Some(horizon)) = (&sweep.rollout, self.horizon) {
                let checked = rollout.check(INGESTED_DT_S, horizon.n_future as f64 * INGESTED_DT_S);
                let told = |issue: Issue| format!("sweep {}: {}", sweep.name, issue.within("rollout"));
                checked.map_err(|issue| Failure::input_message(told(issue)))?;
            }
            if let Some(distillation) = &distillation {
                sweep.check_distillation(distillation, &edm)?;
            }
            let Some(behavior) = sweep.behavior.as_deref() else { continue };
            if sweep.needs_classifier() && self.classified_behavior.is_some_and(|classified| classified != behavior) {
                let (sweep, behavior) = (sweep.name.clone(), behavior.to_owned());
                return Err(generate::Error::NoClassifier { sweep, behavior }.into());
            }
        }
        Ok(())
    }

    fn config(&self) -> anyhow::Result<Value> {
        let mut config = serde_json::to_value(self.config)?;
        config["behaviors"] = serde_json::to_value(&self.mine.behaviors)?;
        let settings = self.judging_settings();
        if differs_from_default(&settings) {
            config["metric_settings"] = serde_json::to_value(settings)?;
        }
        let has_templates = self.config.sweeps.iter().any(|sweep| sweep.template);
        if has_templates && self.keeps_duplicates {
            config["keeps_duplicates"] = json!(true);
        }
        if (has_templates || !self.config.requests.is_empty()) && self.duplicate_distance_m != DUPLICATE_DISTANCE_M {
            config["duplicate_distance_m"] = json!(self.duplicate_distance_m);
        }
        config["learns_from"] = serde_json::to_value(&self.learns_from)?;
        Ok(with_precision(config, Some(self.precision)))
    }

    fn inputs(&self) -> Vec<StageInput> {
        // An invalid section needs no models: it has been rejected.
        let needed = self.resolve().map(|resolved| needed_models(&resolved.sweeps)).unwrap_or_default();
        let made =
            |stage: StageId| stage.output(self.layout).map(|(name, path)| StageInput::made_by(stage, name, path));
        let scenes = StageInput::made_by(StageId::Ingest, "scenes", &self.layout.scenes);
        let situations = StageInput::made_by(StageId::Situations, "situations", &self.layout.situations);
        let scenes = [Some(scenes), Some(situations).filter(|_| self.has_situations)].into_iter().flatten();
        scenes.chain(needed.into_iter().filter_map(made)).collect()
    }

    fn work(&self) -> Work<'_> {
        Work::Sharded(self)
    }
}

impl Generate<'_> {
    /// The settings of metrics that decide what is generated: the defaults unless samples are accepted by a metric that
    /// depends on settings.
    fn judging_settings(&self) -> MetricSettings {
        if self.judges_samples() { self.metric_settings.clone() } else { MetricSettings::default() }
    }

    /// Whether samples are accepted by a metric that depends on settings.
    fn judges_samples(&self) -> bool {
        self.config.limits_any(|id| self.metric_settings.decide(id))
    }

    /// The recorded scenes, and the situations that nobody recorded.
    fn open_scenes(&self) -> crate::store::Result<SceneStore> {
        let situations = self.has_situations.then_some(self.layout.situations.as_path());
        let folders: Vec<&Path> = std::iter::once(self.layout.scenes.as_path()).chain(situations).collect();
        SceneStore::open_all(&folders)
    }

    /// [`Self::judging_settings`] as in the evaluation: departures are judged only where maps allow it.
    fn settings_for_maps(&self, store: &SceneStore) -> Result<MetricSettings> {
        let settings = self.judging_settings();
        let fits = if self.judges_samples() { MapFits::of } else { MapFits::of_maps_alone };
        Ok(fits(store, &settings.validity)?.settings(&settings.validity))
    }

    /// The pairs of each request, with the buckets that they can still reach; `None` before scenes and models exist.
    pub(in crate::pipeline) fn pools(&self, compute: &Compute) -> Result<Option<Vec<Pool>>> {
        if self.resolve()?.requests.is_empty() || self.inputs().iter().any(|input| !input.path.exists()) {
            return Ok(None);
        }
        self.with_ready(compute, None, |ready| ready.pools().map(Some))
    }

    /// The resolved section, which includes the sweeps of requests.
    pub(in crate::pipeline) fn resolve(&self) -> Result<ResolvedGeneration> {
        let mut resolved = self.config.resolve(&self.mine.build()?)?;
        resolved.duplicate_distance_m = if self.keeps_duplicates { 0.0 } else { self.duplicate_distance_m };
        for request in &mut resolved.requests {
            request.duplicate_distance_m = self.duplicate_distance_m;
        }
        Ok(resolved)
    }
}

fn differs_from_default(settings: &MetricSettings) -> bool {
    *settings != MetricSettings::default()
}
