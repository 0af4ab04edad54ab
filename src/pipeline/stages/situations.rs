//! Held-out scenes and a model to situations that nobody recorded.

use super::held_out::learned;
use super::train::checkpoint_file;
use super::with_precision;
use crate::engine::{Failure, Result, Stage, StageContext, StageInput, StageKind, Whole, Work};
use crate::evaluate::{for_maps, map_fits};
use crate::generate::{Futures, held_out_in_order};
use crate::ingest::{IngestConfig, usual_horizon};
use crate::metrics::ValidityConfig;
use crate::model::TrainedDenoiser;
use crate::nn::Precision;
use crate::pipeline::StageId;
use crate::pipeline::layout::{Layout, SITUATIONS};
use crate::scene::{INGESTED_DT_S, Split};
use crate::settings::Issue;
use crate::simulate::{NewScenes, SituationsConfig};
use crate::store::{SceneStore, SceneWriter};
use crate::train::SceneChoice;
use serde_json::{Value, json};

/// The stage.
pub struct Situations<'a> {
    /// Its section.
    pub config: &'a SituationsConfig,
    /// The seed of the run.
    pub seed: u64,
    /// The precision of matrix products.
    pub precision: Precision,
    /// The splits and places of the generation; none: what is held out, everywhere.
    pub splits: &'a [Split],
    /// See `splits`.
    pub places: &'a [String],
    /// What is valid in a loop, as in the evaluation.
    pub validity: ValidityConfig,
    /// How scenes are chosen and framed; `None`: as by default.
    pub ingest: Option<&'a IngestConfig>,
    /// Whether the pipeline has a distilled model, which samples in fewer evaluations.
    pub distilled: bool,
    /// The scenes that models of the pipeline learn from: no loop begins with one of them.
    pub learns_from: Vec<SceneChoice<'a>>,
    /// Where the scenes and models are.
    pub layout: &'a Layout,
}

impl Situations<'_> {
    fn model(&self) -> StageId {
        if self.distilled { StageId::TrainDistill } else { StageId::TrainDenoiser }
    }
}

impl Stage for Situations<'_> {
    fn kind(&self) -> &'static StageKind {
        StageId::Situations.kind()
    }

    fn version(&self) -> u32 {
        1
    }

    fn check(&self) -> Result<()> {
        let told = |issue: Issue| Failure::input(issue.within("situations"));
        self.config.validate().map_err(told)?;
        let Some(horizon) = self.ingest.and_then(|ingest| usual_horizon(ingest).ok()) else { return Ok(()) };
        self.config.check(INGESTED_DT_S, horizon.n_future as f64 * INGESTED_DT_S).map_err(told)
    }

    fn config(&self) -> anyhow::Result<Value> {
        let mut config = serde_json::to_value(self.config)?;
        config["seed"] = json!(self.seed);
        config["splits"] = json!(self.splits);
        config["places"] = json!(self.places);
        config["validity"] = serde_json::to_value(&self.validity)?;
        config["learns_from"] = serde_json::to_value(&self.learns_from)?;
        if let Some(IngestConfig { max_agents, map_radius_m, .. }) = self.ingest {
            config["scenes"] = json!([max_agents, map_radius_m]);
        }
        Ok(with_precision(config, Some(self.precision)))
    }

    fn inputs(&self) -> Vec<StageInput> {
        let model = self.model().output(self.layout);
        let model = model.map(|(name, path)| StageInput::made_by(self.model(), name, path));
        std::iter::once(StageInput::made_by(StageId::Ingest, "scenes", &self.layout.scenes)).chain(model).collect()
    }

    fn work(&self) -> Work<'_> {
        Work::Whole(self)
    }
}

impl Whole for Situations<'_> {
    fn run(&self, context: &StageContext<'_>) -> Result<Value> {
        let store = SceneStore::open(&self.layout.scenes)?;
        let learned = learned(&self.learns_from, &store)?;
        let order = held_out_in_order(store.index(), (self.splits, self.places), &learned, self.seed);
        let positions: Vec<usize> = order.into_iter().map(|(position, _)| position).collect();
        if positions.is_empty() {
            return Err(Failure::input_message("no scene is held out for a closed loop to go on from")
                .with_hint("add recordings, or name splits and places in [generate]"));
        }
        let folder = if self.distilled { &self.layout.distilled } else { &self.layout.denoiser };
        let model = TrainedDenoiser::read(&checkpoint_file(folder), context.compute)?;
        let futures = Futures::new(&model, self.seed, &context.compute.device)?;
        let validity = for_maps(&self.validity, &map_fits(&store, &self.validity)?);
        let dataset = store.index().get(positions[0]).dataset;
        let as_usual = IngestConfig { seed: self.seed, ..IngestConfig::new(dataset, Vec::new()) };
        let ingest = self.ingest.map_or(as_usual, |ingest| IngestConfig { seed: self.seed, ..ingest.clone() });
        let (mut writer, finished) = SceneWriter::resume(&context.root.join(SITUATIONS))?;
        let (mut n_batches, report) = finished.map_or((0, json!(null)), |shard| (shard.units_done, shard.report));
        let counts = serde_json::from_value(report).unwrap_or_default();
        let (config, validity, ingest) = (self.config, &validity, &ingest);
        let new = NewScenes { config, futures: &futures, store: &store, validity, ingest };
        let counts = new.make(&positions, counts, context.progress, &mut |scenes, maps, counts| {
            n_batches += 1;
            Ok(writer.write_batch(scenes, maps, Some(n_batches), &json!(counts))?)
        })?;
        let counts = serde_json::to_value(counts).map_err(anyhow::Error::from)?;
        writer.finish(&counts)?;
        Ok(counts)
    }
}
