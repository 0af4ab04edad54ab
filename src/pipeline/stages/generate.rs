//! Recorded histories and models to generated scenarios, shard by shard; finished shards survive an interruption.

use super::mine::MineConfig;
use super::models::{LoadedModels, needed_models};
use super::request_rounds::Fulfilment;
use super::sample_folder::{SampleFolder, SampleSettings, SampleSidecar, SampledWith};
use super::with_precision;
use crate::diffusion::Edm;
use crate::evaluate::{for_maps, map_fits};
use crate::generate::{
    self, GenerateConfig, Generator, Plan, Pool, RequestSummary, ResolvedGeneration, ShardPlan, Shortfall,
};
use crate::metrics::{DUPLICATE_DISTANCE_M, MetricSettings, ValidityConfig};
use crate::nn::{Compute, Precision};
use crate::pipeline::layout::{Layout, SAMPLES};
use crate::pipeline::{Failure, Result, Stage, StageContext, StageId, StageInput};
use crate::progress::Progress;
use crate::store::{SceneStore, read_json};
use crate::train::DistillTrainingConfig;
use serde_json::{Value, json};

/// The stage.
pub struct Generate<'a> {
    /// Its section.
    pub config: &'a GenerateConfig,
    /// How products of networks are rounded.
    pub precision: Precision,
    /// The definitions of the behaviors that scenarios are checked for.
    pub mine: MineConfig,
    /// The settings of metrics in selections and limits, as in the evaluation.
    pub metric_settings: MetricSettings,
    /// Scenarios of a request whose agents move nearer to an accepted one than this are near-duplicates, as in the evaluation, meters.
    pub duplicate_distance_m: f64,
    /// The behavior that the pipeline's classifier is trained for, where the pipeline trains one.
    pub classified_behavior: Option<&'a str>,
    /// How the pipeline distills its denoiser, where it does so itself.
    pub distill: Option<&'a DistillTrainingConfig>,
    /// Where the scenes and models are.
    pub layout: &'a Layout,
}

impl Stage for Generate<'_> {
    fn id(&self) -> StageId {
        StageId::Generate
    }

    fn version(&self) -> u32 {
        9
    }

    fn check(&self) -> Result<()> {
        let resolved = self.resolve()?;
        self.metric_settings.validate().map_err(|why| Failure::input_message(format_args!("evaluate.{why}")))?;
        // The denoiser's own constants may not be known yet. Sweeps and distillation see the same ones here; they are checked again when
        // both models are there.
        let edm = Edm::default();
        let distillation = self.distill.filter(|config| config.checkpoint.is_none());
        let distillation = distillation.map(|config| config.method.distillation(&edm));
        for sweep in &resolved.sweeps {
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
        if !self.config.requests.is_empty() && self.duplicate_distance_m != DUPLICATE_DISTANCE_M {
            config["duplicate_distance_m"] = json!(self.duplicate_distance_m);
        }
        Ok(with_precision(config, Some(self.precision)))
    }

    fn inputs(&self) -> Vec<StageInput> {
        // A section that cannot work needs nothing more: it has been refused.
        let needed = self.resolve().map(|resolved| needed_models(&resolved.sweeps)).unwrap_or_default();
        let made =
            |stage: StageId| stage.output(self.layout).map(|(name, path)| StageInput::made_by(stage, name, path));
        let scenes = StageInput::made_by(StageId::Ingest, "scenes", &self.layout.scenes);
        let priors = self.config.requests.iter().filter_map(|request| {
            Some(StageInput::external(format!("prior of {}", request.name), request.prior.as_deref()?))
        });
        std::iter::once(scenes).chain(needed.into_iter().filter_map(made)).chain(priors).collect()
    }

    fn run(&self, context: &StageContext<'_>) -> Result<Value> {
        self.with_ready(context.compute, |ready| self.generate(ready, context))
    }
}

/// Everything that planning and sampling shards needs, read and checked.
pub(in crate::pipeline) struct Ready<'a> {
    /// The resolved section, which includes the sweeps of requests.
    pub(in crate::pipeline) resolved: &'a ResolvedGeneration,
    store: &'a SceneStore,
    models: &'a LoadedModels,
    /// Samples shards, and finds the buckets of scenarios for requests.
    pub(in crate::pipeline) generator: Generator<'a>,
    /// The settings by which it judges, if they are not the default ones.
    metric_settings: Option<MetricSettings>,
}

impl Ready<'_> {
    /// The plan of the sweeps.
    pub(in crate::pipeline) fn plan(&self, progress: &dyn Progress) -> Result<Plan> {
        progress.start("plan", 0, "sweeps");
        let plan = self.generator.plan_first(self.resolved.n_sweeps, self.store.index())?;
        progress.finish();
        Ok(plan)
    }

    /// The cells of each request.
    pub(in crate::pipeline) fn pools(&self) -> Result<Vec<Pool>> {
        let pool = |request| Ok(self.generator.pool(request, self.store.index())?);
        self.resolved.requests.iter().map(pool).collect()
    }

    /// Samples a shard and writes its table into `folder`.
    pub(in crate::pipeline) fn sample(
        &self,
        shard: &ShardPlan,
        folder: &SampleFolder,
        progress: &dyn Progress,
    ) -> Result<SampleSidecar> {
        let output = self.generator.generate(shard, progress)?;
        let sweep = &self.resolved.sweeps[shard.sweep_idx];
        folder.write_table(shard.idx, (&sweep.name, sweep.n_evaluations()), output, None)
    }
}

impl Generate<'_> {
    /// Reads and checks everything that sampling needs, and calls `work` with it.
    pub(in crate::pipeline) fn with_ready<R>(
        &self,
        compute: &Compute,
        work: impl FnOnce(&Ready<'_>) -> Result<R>,
    ) -> Result<R> {
        let resolved = self.resolve()?;
        let store = SceneStore::open(&self.layout.scenes)?;
        let models = LoadedModels::read(self.layout, &resolved.sweeps, compute)?;
        let behaviors = self.mine.build()?;
        let load = |idx: usize| Ok(store.scene(idx)?);
        let settings = self.settings_for_maps(&store)?;
        let metric_settings = Some(settings.clone()).filter(differs_from_default);
        let generator = Generator::new(&resolved, models.borrowed(), &behaviors, &load, settings, &compute.device)?;
        work(&Ready { resolved: &resolved, store: &store, models: &models, generator, metric_settings })
    }

    fn generate(&self, ready: &Ready<'_>, context: &StageContext<'_>) -> Result<Value> {
        let Ready { resolved, store, models, generator, metric_settings } = ready;
        let folder = SampleFolder::open_for_writing(&context.root.join(SAMPLES))?;
        let (mine, generate) = (self.mine.clone(), self.config.clone());
        let metric_settings = metric_settings.clone();
        folder.write_settings(&SampleSettings { mine, generate, metric_settings })?;
        let plan = match folder.plan()? {
            Some(plan) => plan,
            None => {
                let plan = ready.plan(context.progress)?;
                folder.write_plan(&plan)?;
                plan
            }
        };
        for shortfall in &plan.shortfalls {
            let Shortfall { sweep, n_wanted, n_found } = shortfall;
            context.progress.warn(&format!("sweep {sweep}: {n_wanted} scenes requested, {n_found} suitable"));
        }
        let mut shards = generate_shards(ready, &plan, &folder, context)?;
        let fulfilment = Fulfilment { generator, resolved, store, folder: &folder, context };
        let (of_requests, requests) = fulfilment.all(plan.shards.len())?;
        shards.extend(of_requests);
        let manifest = folder.write_manifest(
            shards,
            SampledWith {
                scenes: store.fingerprint().to_owned(),
                denoiser: models.fingerprint(StageId::TrainDenoiser).unwrap_or_default(),
                classifier: models.fingerprint(StageId::TrainClassifier),
                distilled: models.fingerprint(StageId::TrainDistill),
                baseline: models.fingerprint(StageId::TrainBaseline),
                shortfalls: plan.shortfalls,
            },
        )?;
        if manifest.n_rejected > 0 {
            let message = format!("{} samples had non-finite values and were rejected", manifest.n_rejected);
            context.progress.warn(&message);
        }
        Ok(json!({
            "n_scenarios": manifest.n_scenarios,
            "n_verified": manifest.n_verified,
            "n_rejected": manifest.n_rejected,
            "n_wanted": requests.iter().map(|request| request.n_wanted).sum::<u64>(),
            "n_accepted": requests.iter().map(|request| request.n_accepted).sum::<u64>(),
        }))
    }

    /// The settings of metrics that decide what is generated: all of them if samples are selected or accepted by a metric
    /// that depends on them, else the places without a road, for the rules of traffic.
    fn judging_settings(&self) -> MetricSettings {
        if self.config.selects_by(|id| self.metric_settings.decide(id)) {
            return self.metric_settings.clone();
        }
        let places_without_road = self.metric_settings.validity.places_without_road.clone();
        let validity = ValidityConfig { places_without_road, ..ValidityConfig::default() };
        MetricSettings { validity, ..MetricSettings::default() }
    }

    /// The same, as the evaluation uses them: departures are judged only where maps allow it.
    fn settings_for_maps(&self, store: &SceneStore) -> Result<MetricSettings> {
        let settings = self.judging_settings();
        let validity = for_maps(&settings.validity, &map_fits(store, &settings.validity)?);
        Ok(MetricSettings { validity, ..settings })
    }

    /// The pairs of each request, with the buckets that they can still reach; `None` before scenes and models exist.
    ///
    /// # Errors
    /// When no pair can fulfill a request, or scenes and models cannot be read.
    pub(in crate::pipeline) fn pools(&self, compute: &Compute) -> Result<Option<Vec<Pool>>> {
        if self.resolve()?.requests.is_empty() || self.inputs().iter().any(|input| !input.path.exists()) {
            return Ok(None);
        }
        self.with_ready(compute, |Ready { resolved, generator, store, .. }| {
            let pools = resolved.requests.iter().map(|request| generator.pool(request, store.index()));
            Ok(Some(pools.collect::<std::result::Result<_, _>>()?))
        })
    }

    /// The resolved section, which includes the sweeps of requests.
    pub(in crate::pipeline) fn resolve(&self) -> Result<ResolvedGeneration> {
        let mut resolved = self.config.resolve(&self.mine.build()?)?;
        for request in &mut resolved.requests {
            request.duplicate_distance_m = self.duplicate_distance_m;
            let Some(path) = request.config.prior.clone() else { continue };
            let earlier = read_json::<Vec<RequestSummary>>(&path).map_err(|error| {
                Failure::input(error).with_hint("prior is the file samples/requests.json of a run with requests")
            })?;
            let section = format!("generate.requests.{}", request.idx);
            request.learn(&earlier).map_err(|issue| Failure::input(issue.within(&section)))?;
        }
        Ok(resolved)
    }
}

fn differs_from_default(settings: &MetricSettings) -> bool {
    *settings != MetricSettings::default()
}

/// Generates the shards of the plan, which belong to the configured sweeps.
fn generate_shards(
    ready: &Ready<'_>,
    plan: &Plan,
    folder: &SampleFolder,
    context: &StageContext<'_>,
) -> Result<Vec<SampleSidecar>> {
    let resolved = ready.resolved;
    let mut done = Vec::new();
    let mut n_verified = vec![0; resolved.n_sweeps];
    if plan.shards.is_empty() {
        return Ok(done);
    }
    context.progress.start("generate", plan.n_samples(resolved) as u64, "samples");
    for shard in &plan.shards {
        let n_samples = shard.n_samples(resolved) as u64;
        if !shard.is_wanted(resolved, n_verified[shard.sweep_idx]) {
            context.progress.advance(n_samples);
            continue;
        }
        let sidecar = match folder.finished(shard.idx)? {
            Some(sidecar) => {
                context.progress.advance(n_samples);
                sidecar
            }
            None => {
                let sidecar = ready.sample(shard, folder, context.progress)?;
                folder.write_sidecar(shard.idx, &sidecar)?;
                sidecar
            }
        };
        n_verified[shard.sweep_idx] += sidecar.n_verified as usize;
        done.push(sidecar);
    }
    context.progress.note(&format!("{} verified", n_verified.iter().sum::<usize>()));
    context.progress.finish();
    Ok(done)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::MapId;
    use crate::store::testing::{map, scene};
    use crate::store::{SceneWriter, SceneWriterOptions};

    #[test]
    fn departures_are_judged_and_mended_only_where_the_evaluation_judges_them() {
        let maps = [(MapId::from("PIT"), map(1, 9))];
        let scenes: Vec<_> = (0..5).map(|seed| scene(seed, Some((&maps[0].0, &maps[0].1)))).collect();
        let dir = tempfile::tempdir().unwrap();
        let mut writer = SceneWriter::create(dir.path(), SceneWriterOptions::default()).unwrap();
        writer.write_batch(&scenes, &maps, Some(0), &json!(0)).unwrap();
        writer.finish(&json!({ "rejects": {} })).unwrap();
        let store = SceneStore::open(dir.path()).unwrap();
        let of_evaluation =
            for_maps(&ValidityConfig::default(), &map_fits(&store, &ValidityConfig::default()).unwrap());
        assert!(of_evaluation.places_without_road.contains("PIT"), "its map is at random");

        let settings_with = |limits: &str, validity: &ValidityConfig| {
            let text = format!(
                "[[arms]]\nname = 'a'\n[[requests]]\nname = 'r'\nbehavior = 'cut_in'\nper_bucket = 1\narms = ['a']\n\
                 buckets = {{ gap_m = [0, 5] }}\nbudget = {{ n_samples = 9 }}\nlimits = {{ {limits} }}"
            );
            let stage = Generate {
                config: &toml::from_str(&text).unwrap(),
                precision: Precision::default(),
                mine: MineConfig::default(),
                metric_settings: MetricSettings { validity: validity.clone(), ..MetricSettings::default() },
                duplicate_distance_m: DUPLICATE_DISTANCE_M,
                classified_behavior: None,
                distill: None,
                layout: &Layout::below(dir.path()),
            };
            stage.settings_for_maps(&store).unwrap()
        };
        let strict = ValidityConfig { offroad_slack_m: 0.25, ..ValidityConfig::default() };
        let settings_with = |limits: &str| settings_with(limits, &strict);
        let judged = settings_with("validity_rate = 1.0").validity;
        assert_eq!((judged.offroad_slack_m, &judged.places_without_road), (0.25, &of_evaluation.places_without_road));
        // Limits that do not depend on validity: the rules of traffic know of the maps alone.
        assert_eq!(settings_with("collision_rate = 0.0").validity, of_evaluation);
    }
}
