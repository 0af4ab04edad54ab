//! From shards of scenarios to everything that is said of them.

use super::cells::{CellFigures, CellSamples, into_cells};
use super::config::EvaluateConfig;
use super::error::{Error, Result};
use super::gates::GateResult;
use super::judge::Judge;
use super::map_fits::MapFitRow;
use super::measures::{Measures, MetricDoc};
use super::metric_rows::MetricRows;
use super::predictions::Predictions;
use super::realism::{RealismRow, RealismTable};
use super::sampling::{SamplingRow, SamplingTally};
use super::validity::{ValidityRow, ValidityTable};
use super::verdicts::{AcceptanceRow, LeftOutRow, Verdicts};
use crate::behavior::{Behavior, BehaviorEvent};
use crate::generate::RejectedSample;
use crate::metrics::{Check, Judged};
use crate::scene::{Roles, Scene, SceneId};
use crate::store::{Assessment, MetricRow, ScenarioRecord, SceneStore, VerdictRow};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// The metrics that a person asks for first: the content of `metrics.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EvaluationSummary {
    /// Number of generated scenarios.
    pub n_scenarios: u64,
    /// How many of them show the requested behavior.
    pub n_verified: u64,
    /// How many of the verified ones the recording does not hold already.
    pub n_new: u64,
    /// How many pass every check of validity.
    #[serde(default)]
    pub n_valid: u64,
    /// How many are accepted: verified, valid and no near-duplicates.
    #[serde(default)]
    pub n_accepted: u64,
    /// How many scenarios the corpus has.
    pub n_kept: u64,
    /// The gates.
    pub gates: Vec<GateResult>,
    /// Requested and generated scenarios, by sweep, place and strength.
    pub sampling: Vec<SamplingRow>,
    /// What the metrics mean.
    pub docs: Vec<MetricDoc>,
    /// Means over scenes: of all places together, then of each.
    pub aggregates: Vec<MetricRow>,
    /// How far the motion of whole sweeps is from that of the recording.
    pub realism: Vec<RealismRow>,
    /// The verdicts on the scenarios of each sweep at each strength.
    #[serde(default)]
    pub acceptance: Vec<AcceptanceRow>,
    /// Why samples are not accepted, or not even scenarios.
    #[serde(default)]
    pub left_out: Vec<LeftOutRow>,
    /// How many scenarios, and how many of the recordings they continue, fail which check.
    #[serde(default)]
    pub validity: Vec<ValidityRow>,
    /// At which places the map allows to judge departures from the road.
    #[serde(default)]
    pub maps: Vec<MapFitRow>,
}

/// The result of an evaluation.
#[derive(Debug, PartialEq)]
pub struct Evaluated {
    /// What is read first.
    pub summary: EvaluationSummary,
    /// The values of every metric for every scene and scenario.
    pub rows: MetricRows,
    /// What was decided on every scenario, in their order.
    pub verdicts: Vec<VerdictRow>,
    /// The scenarios of the corpus, by their ids.
    pub kept: BTreeSet<String>,
    /// Scenes with predictions for benchmarks.
    pub n_predicted_scenes: usize,
    /// Tracks that a benchmark asks for and that could not be predicted.
    pub n_tracks_left_out: usize,
}

impl Evaluated {
    /// All metric values: aggregates, then those of scenes, then those of scenarios.
    pub fn all_rows(&self) -> impl Iterator<Item = MetricRow> + '_ {
        let aggregates = self.summary.aggregates.iter().cloned();
        aggregates.chain(self.rows.of_scenes()).chain(self.rows.of_scenarios(|_| true))
    }

    /// The metric values of the corpus: aggregates, then those of its scenarios.
    pub fn rows_of_corpus(&self) -> impl Iterator<Item = MetricRow> + '_ {
        let aggregates = self.summary.aggregates.iter().cloned();
        aggregates.chain(self.rows.of_scenarios(|id| self.kept.contains(id)))
    }
}

/// Scenarios of one sweep that were generated together.
pub struct Shard<'a> {
    /// The sweep.
    pub sweep: &'a str,
    /// Calls of the denoiser for one sample.
    pub n_evaluations: u64,
    /// The scenarios, in order.
    pub records: Vec<ScenarioRecord>,
}

/// What of a shard becomes part of the corpus.
pub struct KeptScenarios {
    /// The scenarios, judged, in their order.
    pub records: Vec<ScenarioRecord>,
    /// The recordings that they continue, each once, in the order of the scenarios.
    pub recordings: Vec<Scene>,
}

/// Measures and decides on scenarios that come shard by shard.
pub struct Evaluation<'a> {
    config: &'a EvaluateConfig,
    store: &'a SceneStore,
    measures: Measures<'a>,
    judge: Judge<'a>,
    verdicts: Verdicts<'a>,
    validity: ValidityTable,
    rows: MetricRows,
    realism: RealismTable,
    sampling: SamplingTally,
    predictions: Predictions,
    kept: BTreeSet<String>,
}

impl<'a> Evaluation<'a> {
    /// Begins an evaluation of scenarios that continue scenes of `store`. Novelty is measured against the positive
    /// `recorded_events`. Predictions for benchmarks are written into the folder `predictions`, if any are asked for.
    ///
    /// # Errors
    /// When scenes cannot be read, or the folder must not be written into.
    pub fn new(
        config: &'a EvaluateConfig,
        behaviors: &'a [Box<dyn Behavior>],
        store: &'a SceneStore,
        recorded_events: &[BehaviorEvent],
        predictions: &Path,
    ) -> Result<Self> {
        let measures = Measures::new(config, behaviors);
        Ok(Self {
            rows: MetricRows::new(measures.docs()),
            measures,
            judge: Judge::new(config, store, recorded_events)?,
            verdicts: Verdicts::new(config),
            validity: ValidityTable::default(),
            realism: RealismTable::default(),
            sampling: SamplingTally::new(config.validity.places_without_road.clone()),
            predictions: Predictions::create(predictions, &config.predictions)?,
            kept: BTreeSet::new(),
            config,
            store,
        })
    }

    /// Counts what generation left out: samples without a scenario, and by sweep and reason those that its selection
    /// rejected.
    pub fn count_left_out<'r>(
        &mut self,
        rejected: impl Iterator<Item = &'r RejectedSample>,
        unselected: &BTreeMap<String, BTreeMap<String, u64>>,
    ) {
        rejected.for_each(|rejected| self.verdicts.count_rejected(rejected));
        for (sweep, reasons) in unselected {
            reasons.iter().for_each(|(reason, n)| self.verdicts.count_unselected(sweep, reason, *n));
        }
    }

    /// Evaluates the next shard and gives back what of it is kept. Shards must come in the order of the samples: of
    /// near-duplicates the first is accepted.
    ///
    /// # Errors
    /// When a scene is missing or damaged, or predictions cannot be written.
    pub fn add(&mut self, Shard { sweep, n_evaluations, mut records }: Shard<'_>) -> Result<KeptScenarios> {
        let mut assessments: BTreeMap<String, Assessment> = BTreeMap::new();
        let mut recordings: BTreeMap<SceneId, Scene> = BTreeMap::new();
        let mut not_checked: BTreeMap<String, Vec<Check>> = BTreeMap::new();
        for (cell, recorded, mut figures) in self.measure(&records)? {
            let left_out = Judged::future_of(&recorded, Roles::none()).not_checked(&self.config.validity);
            cell.records.iter().for_each(|record| self.sampling.add(record, &recorded, n_evaluations));
            self.realism.add(sweep, &cell, &figures.motion);
            figures.prediction.iter().try_for_each(|modes| self.predictions.add(&recorded, modes))?;
            let references = figures.references_judged.take();
            self.validity.add(sweep, (&cell, &recorded), (references.as_ref(), &figures.assessments), &left_out);
            let ids = cell.records.iter().map(|record| record.scenario.id.clone());
            not_checked.extend(ids.clone().map(|id| (id, left_out.clone())));
            assessments.extend(ids.zip(std::mem::take(&mut figures.assessments)));
            self.rows.add(sweep, &cell, &recorded, figures);
            recordings.entry(recorded.id.clone()).or_insert(recorded);
        }
        for record in &mut records {
            record.assessment = assessments.remove(&record.scenario.id);
        }
        records.retain_mut(|record| {
            self.verdicts.decide(record, not_checked.get(&record.scenario.id).map_or(&[], Vec::as_slice))
        });
        self.kept.extend(records.iter().map(|record| record.scenario.id.clone()));
        let scene_ids = records.iter().map(|record| &record.scenario.provenance.scene_id);
        let recordings = scene_ids.filter_map(|scene_id| recordings.remove(scene_id)).collect();
        Ok(KeptScenarios { records, recordings })
    }

    /// Closes the tables, judges the gates, and gives the files of predictions their names.
    ///
    /// # Errors
    /// When predictions cannot be written.
    pub fn finish(self) -> Result<Evaluated> {
        let (n_predicted_scenes, n_tracks_left_out) = self.predictions.finish()?;
        let (acceptance, left_out, verdicts) = self.verdicts.finish();
        let (aggregates, sampling) = (self.rows.aggregates(), self.sampling.finish());
        let mut summary = EvaluationSummary {
            n_scenarios: acceptance.iter().map(|row| row.n_scenarios).sum(),
            n_verified: acceptance.iter().map(|row| row.n_verified).sum(),
            n_new: sampling.iter().map(|row| row.n_new).sum(),
            n_valid: acceptance.iter().map(|row| row.n_valid).sum(),
            n_accepted: acceptance.iter().map(|row| row.n_accepted).sum(),
            n_kept: self.kept.len() as u64,
            gates: Vec::new(),
            sampling,
            docs: self.measures.docs(),
            aggregates,
            realism: self.realism.finish(),
            acceptance,
            left_out,
            validity: self.validity.finish(),
            maps: Vec::new(),
        };
        summary.gates = self.config.gates.check(&summary);
        let (rows, kept) = (self.rows, self.kept);
        Ok(Evaluated { summary, rows, verdicts, kept, n_predicted_scenes, n_tracks_left_out })
    }

    /// Measures the cells of a shard in parallel, and gives them back in order.
    fn measure<'r>(&self, records: &'r [ScenarioRecord]) -> Result<Vec<(CellSamples<'r>, Scene, CellFigures)>> {
        // The files of predictions cannot be shared between threads.
        let Self { config, store, measures, judge, .. } = self;
        into_cells(records)
            .into_par_iter()
            .map(|cell| {
                let scene_id = &cell.records[0].scenario.provenance.scene_id;
                let idx = store.position(scene_id).ok_or_else(|| Error::UnknownScene(scene_id.clone()))?;
                let recorded = store.scene(idx)?;
                let figures = cell.evaluate(&recorded, measures, judge, config);
                Ok((cell, recorded, figures))
            })
            .collect()
    }
}
