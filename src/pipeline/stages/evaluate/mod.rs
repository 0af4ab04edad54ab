//! Generated scenarios to metrics and the corpus: how good are they, and do they pass?

mod cells;
mod config;
mod gates;
mod judge;
mod measures;
mod predictions;
mod realism;
mod table;
mod validity;
mod verdicts;
#[cfg(test)]
mod verdicts_tests;

pub use config::{EvaluateConfig, GatesConfig, Keep};
pub use gates::GateResult;

use super::mine::MineConfig;
use super::sample_folder::SampleManifest;
use crate::behavior::{BehaviorEvent, EventLabel};
use crate::pipeline::layout::{CORPUS, Layout, METRICS, METRICS_SUMMARY, PREDICTIONS, VERDICTS};
use crate::pipeline::{Failure, Result, Stage, StageContext, StageId, StageInput};
use crate::report::{AcceptanceRow, LeftOutRow, MetricDoc, RealismRow, SamplingRow, SamplingTally, ValidityRow};
use crate::scene::{Scene, SceneId};
use crate::store::{
    Assessment, CorpusNotes, CorpusWriter, MetricRow, ScenarioRecord, SceneStore, read_events, write_json_atomically,
    write_metrics, write_verdicts,
};
use cells::{CellFigures, into_cells};
use judge::Judge;
use measures::Measures;
use predictions::Predictions;
use rayon::prelude::*;
use realism::RealismTable;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use table::MetricTable;
use validity::ValidityTable;
use verdicts::Verdicts;

/// The metrics that a person asks for first: the content of `metrics.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EvaluationSummary {
    /// Number of generated scenarios.
    pub n_scenarios: u64,
    /// How many of them hold the behavior that was asked for.
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
    /// What was asked and what came out, by sweep, place and strength.
    pub sampling: Vec<SamplingRow>,
    /// What the metrics mean.
    pub docs: Vec<MetricDoc>,
    /// Means over scenes: of all places together, then of each.
    pub aggregates: Vec<MetricRow>,
    /// How far the motion of whole sweeps is from that of the recording.
    pub realism: Vec<RealismRow>,
    /// What became of the scenarios of each sweep at each strength.
    #[serde(default)]
    pub acceptance: Vec<AcceptanceRow>,
    /// Why samples are not accepted, or not even scenarios.
    #[serde(default)]
    pub left_out: Vec<LeftOutRow>,
    /// How many scenarios, and how many of the recordings they continue, fail which check.
    #[serde(default)]
    pub validity: Vec<ValidityRow>,
}

/// The stage.
pub struct Evaluate<'a> {
    /// Its section.
    pub config: &'a EvaluateConfig,
    /// The definitions of the behaviors that are counted.
    pub mine: MineConfig,
    /// Name of the pipeline, for the corpus.
    pub pipeline: &'a str,
    /// Whether there are recorded events to compare scenarios with.
    pub has_events: bool,
    /// Where the scenes, events and samples are.
    pub layout: &'a Layout,
}

impl Stage for Evaluate<'_> {
    fn id(&self) -> StageId {
        StageId::Evaluate
    }

    fn version(&self) -> u32 {
        4
    }

    fn check(&self) -> Result<()> {
        self.config.validate()
    }

    fn config(&self) -> anyhow::Result<Value> {
        let mut config = serde_json::to_value(self.config)?;
        config["behaviors"] = serde_json::to_value(&self.mine.behaviors)?;
        config["pipeline"] = json!(self.pipeline);
        Ok(config)
    }

    fn inputs(&self) -> Vec<StageInput> {
        let mut inputs = vec![
            StageInput::made_by(StageId::Ingest, "scenes", &self.layout.scenes),
            StageInput::made_by(StageId::Generate, "samples", &self.layout.samples),
        ];
        if self.has_events {
            inputs.push(StageInput::made_by(StageId::Mine, "events", &self.layout.events));
        }
        inputs
    }

    fn outputs(&self) -> &'static [&'static str] {
        match self.config.predictions.is_empty() {
            true => &[CORPUS, METRICS, METRICS_SUMMARY, VERDICTS],
            false => &[CORPUS, METRICS, METRICS_SUMMARY, VERDICTS, PREDICTIONS],
        }
    }

    fn run(&self, context: &StageContext<'_>) -> Result<Value> {
        self.config.validate()?;
        let behaviors = self.mine.build()?;
        let measures = Measures::new(self.config, &behaviors);
        let store = SceneStore::open(&self.layout.scenes)?;
        let samples = SampleManifest::read(&self.layout.samples)?;
        let is_positive = |event: &BehaviorEvent| event.label == EventLabel::Positive;
        let recorded_events = match self.has_events {
            true => read_events(&self.layout.events, is_positive)?,
            false => Vec::new(),
        };
        let judge = Judge::new(self.config, &store, &recorded_events)?;
        let mut verdicts = Verdicts::new(self.config, &samples);
        let mut validity = ValidityTable::default();
        let mut table = MetricTable::new(measures.docs());
        let mut realism = RealismTable::default();
        let mut predictions = Predictions::create(&context.root.join(PREDICTIONS), &self.config.predictions)?;
        let mut sampling = SamplingTally::default();
        let mut corpus = CorpusWriter::create(&context.root.join(CORPUS), &store)?;
        let mut kept_ids = BTreeSet::new();
        context.progress.start("evaluate", samples.n_scenarios, "scenarios");
        for shard in &samples.shards {
            let mut records = SampleManifest::read_shard(&self.layout.samples, shard, &store)?;
            let mut assessments: BTreeMap<String, Assessment> = BTreeMap::new();
            let mut recordings: BTreeMap<SceneId, Scene> = BTreeMap::new();
            for (cell, recorded, mut figures) in evaluate_shard(&records, &store, &measures, &judge, self.config)? {
                cell.records.iter().for_each(|record| sampling.add(record, &recorded, shard.n_evaluations));
                realism.add(&shard.sweep, &cell, &figures.motion);
                figures.prediction.iter().try_for_each(|modes| predictions.add(&recorded, modes))?;
                let references = figures.references_judged.take();
                validity.add(&shard.sweep, (&cell, &recorded), references.as_ref(), &figures.assessments);
                let ids = cell.records.iter().map(|record| record.scenario.id.clone());
                assessments.extend(ids.zip(std::mem::take(&mut figures.assessments)));
                table.add(&shard.sweep, &cell, &recorded, figures);
                recordings.entry(recorded.id.clone()).or_insert(recorded);
            }
            for record in &mut records {
                record.assessment = assessments.remove(&record.scenario.id);
            }
            let n_records = records.len() as u64;
            let mut kept: Vec<ScenarioRecord> = Vec::new();
            for mut record in records {
                if verdicts.decide(&mut record) {
                    kept.push(record);
                }
            }
            // The corpus takes each recording once, in the order of the scenarios.
            for recorded in kept.iter().filter_map(|record| recordings.get(&record.scenario.provenance.scene_id)) {
                corpus.write_recording(recorded)?;
            }
            corpus.write_scenarios(&kept)?;
            kept_ids.extend(kept.into_iter().map(|record| record.scenario.id));
            context.progress.advance(n_records);
        }
        context.progress.finish();
        let (aggregates, sampling) = (table.aggregates(), sampling.finish());
        let (n_predicted_scenes, n_tracks_left_out) = predictions.finish()?;
        write_verdicts(&context.root.join(VERDICTS), verdicts.decided())?;
        let (acceptance, left_out) = verdicts.finish();
        let notes = self.notes(&left_out);
        self.write_tables(context, corpus, (&table, &aggregates), &kept_ids, &notes)?;
        let summary = EvaluationSummary {
            n_scenarios: samples.n_scenarios,
            n_verified: samples.n_verified,
            n_new: sampling.iter().map(|row| row.n_new).sum(),
            n_valid: acceptance.iter().map(|row| row.n_valid).sum(),
            n_accepted: acceptance.iter().map(|row| row.n_accepted).sum(),
            n_kept: kept_ids.len() as u64,
            gates: gates::check(&self.config.gates, &sampling, &acceptance, &aggregates),
            sampling,
            docs: measures.docs(),
            aggregates,
            realism: realism.finish(),
            acceptance,
            left_out,
            validity: validity.finish(),
        };
        write_json_atomically(&context.root.join(METRICS_SUMMARY), &summary)?;
        Ok(json!({
            "n_scenarios": summary.n_scenarios,
            "n_verified": summary.n_verified,
            "n_new": summary.n_new,
            "n_valid": summary.n_valid,
            "n_accepted": summary.n_accepted,
            "n_kept": summary.n_kept,
            "predictions": { "n_scenes": n_predicted_scenes, "n_tracks_left_out": n_tracks_left_out },
            "gates": summary.gates,
        }))
    }
}

impl Evaluate<'_> {
    /// Writes every row to the metric table of the run, and the aggregates and the rows of kept scenarios to the corpus.
    fn write_tables(
        &self,
        context: &StageContext<'_>,
        mut corpus: CorpusWriter<'_>,
        (table, aggregates): (&MetricTable, &[MetricRow]),
        kept_ids: &BTreeSet<String>,
        notes: &CorpusNotes,
    ) -> Result<()> {
        let all = [aggregates, &table.of_scenes(), table.of_scenarios()].concat();
        write_metrics(&context.root.join(METRICS), &all)?;
        let is_kept = |row: &&MetricRow| row.scenario_id.as_ref().is_some_and(|id| kept_ids.contains(id));
        corpus.write_metrics(aggregates)?;
        corpus.write_metrics(&table.of_scenarios().iter().filter(is_kept).cloned().collect::<Vec<_>>())?;
        corpus.finish(notes)?;
        Ok(())
    }

    /// What the corpus says of itself.
    fn notes(&self, left_out: &[LeftOutRow]) -> CorpusNotes {
        let notes = BTreeMap::from([
            ("pipeline".to_owned(), self.pipeline.to_owned()),
            ("made_by".to_owned(), format!("djinn {}", env!("CARGO_PKG_VERSION"))),
        ]);
        CorpusNotes { sources: BTreeMap::new(), notes, left_out: Verdicts::left_out_by_sweep(left_out) }
    }
}

/// Measures the cells of a shard in parallel, and gives them back in order.
fn evaluate_shard<'r>(
    records: &'r [ScenarioRecord],
    store: &SceneStore,
    measures: &Measures<'_>,
    judge: &Judge<'_>,
    config: &EvaluateConfig,
) -> Result<Vec<(cells::Cell<'r>, Scene, CellFigures)>> {
    into_cells(records)
        .into_par_iter()
        .map(|cell| {
            let scene_id = &cell.records[0].scenario.provenance.scene_id;
            let idx = store.position(scene_id).ok_or_else(|| {
                Failure::input_message(format_args!("scene {scene_id} of the samples is not among the scenes"))
                    .with_hint("give the scenes that the samples were generated from")
            })?;
            let recorded = store.scene(idx)?;
            let figures = cell.evaluate(&recorded, measures, judge, config);
            Ok((cell, recorded, figures))
        })
        .collect()
}
