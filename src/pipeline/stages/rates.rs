//! Held-out scenes and a model to rates of what recordings hardly show.

use super::held_out::learned;
use super::mine::MineConfig;
use super::train::checkpoint_file;
use super::with_precision;
use crate::engine::{Failure, Result, Stage, StageContext, StageInput, StageKind, Whole, Work};
use crate::generate::{Futures, held_out_in_order};
use crate::ingest::{IngestConfig, usual_horizon};
use crate::model::TrainedDenoiser;
use crate::nn::Precision;
use crate::pipeline::StageId;
use crate::pipeline::layout::{EXPOSURE, Layout, MODELED, MODELED_RATES, MODELED_SUMMARY, OCCURRENCES};
use crate::rates::{Calibration, ModeledRates, ModeledTraffic, RecordedTraffic};
use crate::scene::{INGESTED_DT_S, Split};
use crate::settings::Issue;
use crate::simulate::{LoopFigures, Modeling, RatesConfig};
use crate::store::{
    SceneStore, read_binary, read_recorded_traffic, write_binary_atomically, write_json_atomically, write_rates,
};
use crate::train::SceneChoice;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::path::Path;

/// The format of the file with the events of loops.
const FORMAT: &str = "modeled.v1";

/// The stage.
pub struct Rates<'a> {
    /// Its section.
    pub config: &'a RatesConfig,
    /// The behaviors and buckets.
    pub mine: MineConfig,
    /// The seed of the run.
    pub seed: u64,
    /// The precision of matrix products.
    pub precision: Precision,
    /// The splits and places of the generation; none: what is held out, everywhere.
    pub splits: &'a [Split],
    /// See `splits`.
    pub places: &'a [String],
    /// How scenes were cut.
    pub ingest: Option<&'a IngestConfig>,
    /// Whether the pipeline has a distilled model, which samples in fewer evaluations.
    pub distilled: bool,
    /// The scenes that models of the pipeline learn from: no loop begins with one of them.
    pub learns_from: Vec<SceneChoice<'a>>,
    /// Where the scenes, events and models are.
    pub layout: &'a Layout,
}

/// The file `modeled.json`.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct ModeledSummary {
    /// Figures of the loops.
    #[serde(flatten)]
    pub figures: LoopFigures,
    /// Modeled against recorded rates.
    pub calibration: Vec<Calibration>,
}

impl Rates<'_> {
    fn model(&self) -> StageId {
        if self.distilled { StageId::TrainDistill } else { StageId::TrainDenoiser }
    }
}

/// The rates of the model in the file `modeled`, compared with recorded ones; `None` if there are none.
pub(super) fn modeled_rates(
    modeled: &Path,
    recorded: &RecordedTraffic,
    behaviors: &[&str],
) -> Result<Option<ModeledRates>> {
    if !modeled.exists() {
        return Ok(None);
    }
    let traffic: ModeledTraffic = read_binary(modeled, FORMAT)?;
    Ok(Some(ModeledRates::new(traffic, recorded, behaviors)))
}

impl Stage for Rates<'_> {
    fn kind(&self) -> &'static StageKind {
        StageId::Rates.kind()
    }

    fn version(&self) -> u32 {
        1
    }

    fn check(&self) -> Result<()> {
        let told = |issue: Issue| Failure::input(issue.within("rates"));
        self.config.validate().map_err(told)?;
        let Some(horizon) = self.ingest.and_then(|ingest| usual_horizon(ingest).ok()) else { return Ok(()) };
        self.config.check(INGESTED_DT_S, horizon.n_future as f64 * INGESTED_DT_S).map_err(told)
    }

    fn config(&self) -> anyhow::Result<Value> {
        let mut config = serde_json::to_value(self.config)?;
        config["seed"] = json!(self.seed);
        config["splits"] = json!(self.splits);
        config["places"] = json!(self.places);
        config["mine"] = serde_json::to_value(&self.mine)?;
        config["learns_from"] = serde_json::to_value(&self.learns_from)?;
        Ok(with_precision(config, Some(self.precision)))
    }

    fn inputs(&self) -> Vec<StageInput> {
        let model = self.model().output(self.layout);
        let model = model.map(|(name, path)| StageInput::made_by(self.model(), name, path));
        let inputs = [
            StageInput::made_by(StageId::Ingest, "scenes", &self.layout.scenes),
            StageInput::made_by(StageId::Mine, "events", &self.layout.events),
        ];
        inputs.into_iter().chain(model).collect()
    }

    fn work(&self) -> Work<'_> {
        Work::Whole(self)
    }
}

impl Whole for Rates<'_> {
    fn run(&self, context: &StageContext<'_>) -> Result<Value> {
        let behaviors = self.mine.build()?;
        let [exposure, occurrences] = [EXPOSURE, OCCURRENCES].map(|name| self.layout.events.with_file_name(name));
        let recorded = read_recorded_traffic(&exposure, &occurrences)?;
        let store = SceneStore::open(&self.layout.scenes)?;
        let learned = learned(&self.learns_from, &store)?;
        let order = held_out_in_order(store.index(), (self.splits, self.places), &learned, self.seed);
        let positions: Vec<usize> = order.into_iter().map(|(position, _)| position).collect();
        if positions.is_empty() {
            return Err(Failure::input_message("no scene is held out for a closed loop to begin with")
                .with_hint("add recordings, or name splits and places in [generate]"));
        }
        let folder = if self.distilled { &self.layout.distilled } else { &self.layout.denoiser };
        let model = TrainedDenoiser::read(&checkpoint_file(folder), context.compute)?;
        let futures = Futures::new(&model, self.seed, &context.compute.device)?;
        let modeling = Modeling { config: self.config, futures: &futures, store: &store, behaviors: &behaviors };
        let (traffic, figures) = modeling.run(&positions, context.progress)?;
        write_binary_atomically(&context.root.join(MODELED), FORMAT, &traffic)?;
        let ids: Vec<&str> = behaviors.iter().map(|behavior| behavior.id()).collect();
        let rates = ModeledRates::new(traffic, &recorded, &ids);
        write_rates(&context.root.join(MODELED_RATES), rates.rates(&self.mine.buckets()))?;
        let calibration = rates.calibrations().to_vec();
        let judged = calibration.iter().filter(|one| one.is_judged());
        let [n_judged, n_met] = [judged.clone().count(), judged.filter(|one| one.is_met()).count()];
        let counts = json!({
            "n_loops": figures.n_loops,
            "n_futures": figures.n_futures,
            "n_compared": n_judged,
            "n_agree": n_met,
        });
        write_json_atomically(&context.root.join(MODELED_SUMMARY), &ModeledSummary { figures, calibration })?;
        Ok(counts)
    }
}
