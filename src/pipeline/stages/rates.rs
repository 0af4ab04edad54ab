//! Held-out scenes and a model to rates of what recordings hardly show.

use super::closed_loops::ClosedLoops;
use super::mine::MineConfig;
use crate::engine::{Result, Stage, StageContext, StageInput, StageKind, Whole, Work};
use crate::generate::Futures;
use crate::pipeline::StageId;
use crate::pipeline::layout::{EXPOSURE, MODELED, MODELED_RATES, MODELED_SUMMARY, OCCURRENCES};
use crate::rates::{Calibration, ModeledRates, ModeledTraffic, RecordedTraffic};
use crate::simulate::{LoopFigures, Modeling, RatesConfig};
use crate::store::{
    SceneStore, read_binary, read_recorded_traffic, write_binary_atomically, write_json_atomically, write_table,
};
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
    /// Where its loops begin, and what drives them.
    pub loops: ClosedLoops<'a>,
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
        9
    }

    fn check(&self) -> Result<()> {
        let config = self.config;
        self.loops.check("rates", config.validate(), |dt_s, future_s| config.check(dt_s, future_s))
    }

    fn config(&self) -> anyhow::Result<Value> {
        let mut config = self.loops.config(self.config)?;
        config["mine"] = serde_json::to_value(&self.mine)?;
        Ok(config)
    }

    fn inputs(&self) -> Vec<StageInput> {
        let events = StageInput::made_by(StageId::Mine, "events", &self.loops.layout.events);
        self.loops.inputs().into_iter().chain([events]).collect()
    }

    fn work(&self) -> Work<'_> {
        Work::Whole(self)
    }
}

impl Whole for Rates<'_> {
    fn run(&self, context: &StageContext<'_>) -> Result<Value> {
        let behaviors = self.mine.build()?;
        let [exposure, occurrences] = [EXPOSURE, OCCURRENCES].map(|name| self.loops.layout.events.with_file_name(name));
        let recorded = read_recorded_traffic(&exposure, &occurrences)?;
        let store = SceneStore::open(&self.loops.layout.scenes)?;
        let positions = self.loops.starts(&store)?;
        let model = self.loops.model(context)?;
        let futures = Futures::new(&model, self.loops.seed, &context.compute.device)?;
        let modeling = Modeling { config: self.config, futures: &futures, store: &store, behaviors: &behaviors };
        let (traffic, figures) = modeling.run(&positions, context.progress)?;
        write_binary_atomically(&context.root.join(MODELED), FORMAT, &traffic)?;
        let ids: Vec<&str> = behaviors.iter().map(|behavior| behavior.id()).collect();
        let rates = ModeledRates::new(traffic, &recorded, &ids);
        write_table(&context.root.join(MODELED_RATES), rates.rates(&self.mine.buckets()).into_iter().map(Ok))?;
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
