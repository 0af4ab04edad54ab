//! What stages of closed loops have in common: the held-out scenes that loops begin with, and the model.

use super::held_out::learned;
use super::train::{checkpoint_file, scenes_learned_from};
use super::with_precision;
use crate::engine::{Failure, Result, StageContext, StageInput};
use crate::generate::held_out_in_order;
use crate::ingest::{IngestConfig, usual_horizon};
use crate::model::TrainedDenoiser;
use crate::nn::Precision;
use crate::pipeline::StageId;
use crate::pipeline::config::PipelineConfig;
use crate::pipeline::layout::Layout;
use crate::scene::{INGESTED_DT_S, Split};
use crate::settings::{self, Issue};
use crate::store::SceneStore;
use crate::train::SceneChoice;
use serde::Serialize;
use serde_json::{Value, json};

/// Everything that loops of a stage depend on beside its section.
pub struct ClosedLoops<'a> {
    pub(super) seed: u64,
    precision: Precision,
    /// The splits and places of the generation; none: what is held out, everywhere.
    splits: &'a [Split],
    places: &'a [String],
    /// How scenes were cut.
    pub(super) ingest: Option<&'a IngestConfig>,
    /// Whether there is a distilled model, which samples in fewer evaluations.
    distilled: bool,
    /// The scenes that models of the pipeline learn from: no loop begins with one of them.
    learns_from: Vec<SceneChoice<'a>>,
    /// Where everything is.
    pub(super) layout: &'a Layout,
}

impl<'a> ClosedLoops<'a> {
    pub(super) fn new(config: &'a PipelineConfig, layout: &'a Layout) -> Self {
        let PipelineConfig { run, ingest, train, generate, .. } = config;
        Self {
            seed: run.seed,
            precision: run.precision,
            splits: generate.as_ref().map_or(&[], |generate| &generate.splits),
            places: generate.as_ref().map_or(&[], |generate| &generate.places),
            ingest: ingest.as_ref(),
            distilled: train.distill.is_some() || (train.denoiser.is_none() && layout.distilled.exists()),
            learns_from: scenes_learned_from(train),
            layout,
        }
    }

    /// Refuses a section that is not valid, or whose times do not fit the timestep and the horizon of the scenes.
    pub(super) fn check(
        &self,
        section: &str,
        is_valid: settings::Result,
        fits: impl FnOnce(f64, f64) -> settings::Result,
    ) -> Result<()> {
        let told = |issue: Issue| Failure::input(issue.within(section));
        is_valid.map_err(told)?;
        let Some(horizon) = self.ingest.and_then(|ingest| usual_horizon(ingest).ok()) else { return Ok(()) };
        fits(INGESTED_DT_S, horizon.n_future as f64 * INGESTED_DT_S).map_err(told)
    }

    /// The section with what else decides.
    pub(super) fn config(&self, section: &impl Serialize) -> anyhow::Result<Value> {
        let mut config = serde_json::to_value(section)?;
        config["seed"] = json!(self.seed);
        config["splits"] = json!(self.splits);
        config["places"] = json!(self.places);
        config["learns_from"] = serde_json::to_value(&self.learns_from)?;
        Ok(with_precision(config, Some(self.precision)))
    }

    /// The scenes and the model.
    pub(super) fn inputs(&self) -> Vec<StageInput> {
        let maker = if self.distilled { StageId::TrainDistill } else { StageId::TrainDenoiser };
        let model = maker.output(self.layout).map(|(name, path)| StageInput::made_by(maker, name, path));
        std::iter::once(StageInput::made_by(StageId::Ingest, "scenes", &self.layout.scenes)).chain(model).collect()
    }

    /// The scenes that loops begin with, in their order.
    pub(super) fn starts(&self, store: &SceneStore) -> Result<Vec<usize>> {
        let learned = learned(&self.learns_from, store)?;
        let order = held_out_in_order(store.index(), (self.splits, self.places), &learned, self.seed);
        if order.is_empty() {
            return Err(Failure::input_message("no scene is held out for a closed loop to begin with")
                .with_hint("add recordings, or name splits and places in [generate]"));
        }
        Ok(order.into_iter().map(|(position, _)| position).collect())
    }

    pub(super) fn model(&self, context: &StageContext<'_>) -> Result<TrainedDenoiser> {
        let folder = if self.distilled { &self.layout.distilled } else { &self.layout.denoiser };
        Ok(TrainedDenoiser::read(&checkpoint_file(folder), context.compute)?)
    }
}
