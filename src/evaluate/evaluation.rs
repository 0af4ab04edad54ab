//! Merges measured shards of scenarios into the results of an evaluation.

use super::bucket_rates::BucketRates;
use super::config::EvaluateConfig;
use super::distinguishability::{CellKey, Distinguished};
use super::error::Result;
use super::gates;
use super::measure::{MeasuredCell, MeasuredShard, metric_docs};
use super::measures::MetricDoc;
use super::metric_rows::{CellNames, FinishedRows, MetricRows};
use super::sampling::SamplingTally;
use super::summary::EvaluationSummary;
use super::validity::ValidityTable;
use super::verdicts::Verdicts;
use crate::behavior::Behavior;
use crate::coverage::{CoverageRow, CoverageTally};
use crate::generate::RejectedSample;
use crate::metrics::{Check, MetricRow};
use crate::rates::{Calibration, ModeledRates, RecordedTraffic};
use crate::scenario::{Assessment, ScenarioRecord, VerdictRow};
use crate::scene::{Scene, SceneId};
use crate::store::{self, TableWriter};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// The result of an evaluation. Its rows are in files until [`Evaluated::remove_rows`].
#[derive(Debug)]
pub struct Evaluated {
    /// The summary, to be read first.
    pub summary: EvaluationSummary,
    /// The number of recorded scenes that accepted scenarios continue.
    pub n_accepted_scenes: u64,
    /// Recorded and generated parts of the operational design domain.
    pub coverage: Vec<CoverageRow>,
    rows: FinishedRows,
}

impl Evaluated {
    /// All metric values: aggregates, then those of scenes, then those of scenarios.
    pub fn all_rows(&self) -> Result<impl Iterator<Item = store::Result<MetricRow>>> {
        Ok(self.aggregates().chain(self.rows.of_scenes()?).chain(self.rows.of_scenarios()?))
    }

    /// The metric values of a corpus with all scenarios: aggregates, then those of scenarios.
    pub fn rows_of_corpus(&self) -> Result<impl Iterator<Item = store::Result<MetricRow>>> {
        Ok(self.aggregates().chain(self.rows.of_scenarios()?))
    }

    /// Removes the files of the rows. Returns the summary.
    pub fn remove_rows(self) -> Result<EvaluationSummary> {
        self.rows.remove()?;
        Ok(self.summary)
    }

    fn aggregates(&self) -> impl Iterator<Item = store::Result<MetricRow>> {
        self.summary.aggregates.iter().cloned().map(Ok)
    }
}

/// The part of a shard that becomes the corpus.
pub struct KeptScenarios {
    /// The scenarios, judged, in their order.
    pub records: Vec<ScenarioRecord>,
    /// The recordings that they continue, each once, in the order of the scenarios.
    pub recordings: Vec<Scene>,
}

/// Where an evaluation writes.
pub struct EvaluationFiles<'a> {
    /// The table of verdicts.
    pub verdicts: &'a Path,
    /// The folder for the files of metric rows.
    pub scratch: &'a Path,
}

/// Merges measured shards and decides on their scenarios. Its memory does not grow with scenarios, except for the paths
/// of accepted ones, which recognize near-duplicates, and the names of their scenes.
pub struct Evaluation<'a> {
    config: &'a EvaluateConfig,
    docs: Vec<MetricDoc>,
    verdicts: Verdicts<'a>,
    verdict_table: TableWriter<VerdictRow>,
    validity: ValidityTable,
    rows: MetricRows,
    sampling: SamplingTally,
    distinguished: Distinguished,
    rates: Option<BucketRates>,
    coverage: CoverageTally,
    calibration: Option<Vec<Calibration>>,
    /// The recorded scenes that accepted scenarios continue.
    accepted_scenes: BTreeSet<SceneId>,
}

impl<'a> Evaluation<'a> {
    /// Begins an evaluation of events of these behaviors, of shards whose tracks have been classified.
    pub fn new(
        config: &'a EvaluateConfig,
        behaviors: &'a [Box<dyn Behavior>],
        distinguished: Distinguished,
        files: &EvaluationFiles<'_>,
    ) -> Result<Self> {
        let docs = metric_docs(config, behaviors);
        Ok(Self {
            distinguished,
            rows: MetricRows::create(docs.clone(), files.scratch)?,
            docs,
            verdicts: Verdicts::new(config, behaviors),
            verdict_table: TableWriter::create(files.verdicts)?,
            validity: ValidityTable::default(),
            sampling: SamplingTally::default(),
            rates: None,
            coverage: CoverageTally::default(),
            calibration: None,
            accepted_scenes: BTreeSet::new(),
            config,
        })
    }

    /// Says of each scenario how often events like its were recorded, or are modeled.
    #[must_use]
    pub fn with_rates_of(self, traffic: Option<RecordedTraffic>, modeled: Option<ModeledRates>) -> Self {
        let calibration = modeled.as_ref().map(|modeled| modeled.calibrations().to_vec());
        Self { rates: traffic.map(|traffic| BucketRates::new(traffic, modeled)), calibration, ..self }
    }

    /// Counts scenarios beside what was recorded.
    #[must_use]
    pub fn with_coverage_of(self, recorded: CoverageTally) -> Self {
        Self { coverage: recorded, ..self }
    }

    /// Counts the losses of generation: samples without a scenario.
    pub fn count_rejected<'r>(&mut self, rejected: impl Iterator<Item = &'r RejectedSample>) {
        rejected.for_each(|rejected| self.verdicts.count_rejected(rejected));
    }

    /// Adds the next shard and returns the part to keep. Shards must come in the order of the samples, because the
    /// first of several near-duplicates is accepted.
    pub fn add(&mut self, shard: MeasuredShard) -> Result<KeptScenarios> {
        let MeasuredShard { n_evaluations, records, cells } = shard;
        let mut assessments: BTreeMap<String, (Assessment, Vec<Check>)> = BTreeMap::new();
        let mut recordings: BTreeMap<SceneId, Scene> = BTreeMap::new();
        for cell in cells {
            let MeasuredCell { key, recorded, scenario_ids, sampled, mut figures, not_checked } = cell;
            let CellKey { series, place, scene_idx } = &key;
            for (idx, assessment) in figures.assessments.iter_mut().enumerate() {
                assessment.recorded_likeness = self.distinguished.likeness(&key, &figures.tracks, idx);
            }
            self.sampling.add(series, (place, *scene_idx), &sampled, n_evaluations);
            let judged = (figures.references_judged.as_ref(), figures.assessments.as_slice());
            self.validity.add((series, place), judged, &not_checked);
            let scenario_ids = scenario_ids.as_slice();
            self.rows.add(&CellNames { series, place, scene_id: &recorded.id, scenario_ids }, &figures)?;
            let judged = figures.assessments.into_iter().map(|assessment| (assessment, not_checked.clone()));
            assessments.extend(scenario_ids.iter().cloned().zip(judged));
            recordings.entry(recorded.id.clone()).or_insert(recorded);
        }
        let mut kept = Vec::new();
        for mut record in records {
            let (assessment, not_checked) = assessments.remove(&record.scenario.id).unzip();
            let rate = self.rates.as_mut().and_then(|rates| rates.of(&record));
            record.assessment = assessment.map(|assessment| Assessment { rate, ..assessment });
            let verdict = self.verdicts.decide(&mut record, not_checked.as_deref().unwrap_or_default());
            let is_accepted = record.assessment.as_ref().is_some_and(|assessment| assessment.accepted);
            if let Some(event) = record.main_event() {
                self.coverage.add_scenario(&record.scenario.scene, event, is_accepted);
            }
            if is_accepted {
                self.accepted_scenes.insert(record.scenario.provenance.scene_id.clone());
            }
            kept.extend(verdict.kept.then_some(record));
            self.verdict_table.push(verdict)?;
        }
        let scene_ids = kept.iter().map(|record| &record.scenario.provenance.scene_id);
        let recordings = scene_ids.filter_map(|scene_id| recordings.remove(scene_id)).collect();
        Ok(KeptScenarios { records: kept, recordings })
    }

    /// Closes the tables, checks the gates, and renames the file of verdicts to its final name.
    pub fn finish(self) -> Result<Evaluated> {
        self.verdict_table.finish()?;
        let rows = self.rows.finish()?;
        let ((acceptance, left_out), sampling) = (self.verdicts.finish(), self.sampling.finish());
        let mut summary = EvaluationSummary {
            n_scenarios: acceptance.iter().map(|row| row.n_scenarios).sum(),
            n_verified: acceptance.iter().map(|row| row.n_verified).sum(),
            n_new: sampling.iter().map(|row| row.n_new).sum(),
            n_valid: acceptance.iter().map(|row| row.n_valid).sum(),
            n_accepted: acceptance.iter().map(|row| row.n_accepted).sum(),
            n_kept: acceptance.iter().map(|row| row.n_kept).sum(),
            gates: Vec::new(),
            sampling,
            docs: self.docs,
            aggregates: rows.aggregates()?,
            acceptance,
            left_out,
            validity: self.validity.finish(),
            distinguishability: self.distinguished.rows(),
            telling_features: self.distinguished.telling(),
            maps: Vec::new(),
            calibration: self.calibration,
        };
        summary.gates = gates::check(&self.config.gates, &summary);
        let n_accepted_scenes = self.accepted_scenes.len() as u64;
        Ok(Evaluated { summary, rows, n_accepted_scenes, coverage: self.coverage.rows() })
    }
}
