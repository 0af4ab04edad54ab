//! Generated scenarios to metrics and the corpus: the files around [`Evaluation`].

use super::generate::{SampleManifest, SampleSettings, read_requests};
use super::mine::MineConfig;
use super::rates::modeled_rates;
use crate::behavior::Behavior;
use crate::coverage::CoverageTally;
use crate::engine::shards::{Division, Gathering, Sharded, Shards};
use crate::engine::{Result, Stage, StageContext, StageInput, StageKind, Work};
use crate::evaluate::{
    EvaluateConfig, Evaluation, EvaluationFiles, EvaluationSummary, MapFitRow, MapFits, MeasuredShard, Measurer, Shard,
    ShardFigures, TrackPool, left_out_by_sweep, of_requests,
};
use crate::generate::{Aim, GenerateConfig};
use crate::metrics::MetricSettings;
use crate::nn::Compute;
use crate::pipeline::StageId;
use crate::pipeline::layout::{
    CORPUS, COVERAGE, EXPOSURE, Layout, METRICS, METRICS_SUMMARY, OCCURRENCES, TAGS, VERDICTS,
};
use crate::progress::Progress;
use crate::rates::RecordedTraffic;
use crate::store::{
    AIMS_AT_HARD_EVENTS, CorpusNotes, CorpusWriter, SceneStore, read_binary, read_recorded_traffic, read_table,
    stream_events, write_binary_atomically, write_json_atomically, write_table,
};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// The stage.
pub struct Evaluate<'a> {
    /// Its section.
    pub config: &'a EvaluateConfig,
    /// The definitions of the counted behaviors.
    pub mine: MineConfig,
    /// Name of the pipeline, for the corpus.
    pub pipeline: &'a str,
    /// Whether there are recorded events to compare scenarios with.
    pub has_events: bool,
    /// Whether there are rates of the model.
    pub has_modeled: bool,
    /// The configuration that generates the scenarios, if the pipeline does that itself.
    pub generated: Option<&'a GenerateConfig>,
    /// Where the scenes, events and samples are.
    pub layout: &'a Layout,
}

impl Stage for Evaluate<'_> {
    fn kind(&self) -> &'static StageKind {
        StageId::Evaluate.kind()
    }

    fn version(&self) -> u32 {
        27
    }

    fn check(&self) -> Result<()> {
        self.config.validate()?;
        match self.generated {
            Some(generate) => match generate.resolve(&self.mine.build()?) {
                Ok(resolved) => Ok(self.config.gates.check_generated(&resolved)?),
                // Errors of the section itself are reported by its own stage.
                Err(_) => Ok(()),
            },
            None => Ok(()),
        }
    }

    fn config(&self) -> anyhow::Result<Value> {
        let mut config = serde_json::to_value(self.config)?;
        config["behaviors"] = serde_json::to_value(&self.mine.behaviors)?;
        config["rates"] = serde_json::to_value(&self.mine.rates)?;
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
            if self.has_modeled {
                inputs.push(StageInput::made_by(StageId::Rates, "modeled", &self.layout.modeled));
            }
        }
        inputs
    }

    fn outputs(&self) -> &'static [&'static str] {
        &[CORPUS, METRICS, METRICS_SUMMARY, VERDICTS, COVERAGE]
    }

    fn work(&self) -> Work<'_> {
        Work::Sharded(self)
    }
}

/// Values that workers share instead of finding them one by one.
#[derive(Serialize, Deserialize)]
struct EvaluationPlan {
    /// How well the maps of places fit their recordings.
    maps: MapFits,
}

impl Sharded for Evaluate<'_> {
    fn plan(&self, _compute: &Compute, _progress: &dyn Progress) -> Result<Division> {
        let ready = self.ready(None)?;
        Division::new(ready.samples.shards.len(), &EvaluationPlan { maps: ready.maps })
    }

    /// Measures the shards of samples.
    fn make(&self, shards: &Shards<'_>, _compute: &Compute) -> Result<()> {
        let ready = self.ready(Some(shards.decisions()?))?;
        let mut measurer = self.measurer(&ready)?;
        shards.progress.start("evaluate", ready.samples.n_scenarios, "scenarios");
        let n_scenarios = |idx: usize| ready.samples.shards[idx].n_scenarios;
        shards.go_about(0..ready.samples.shards.len(), &n_scenarios, &|_| true, &mut |idx| {
            let figures = measurer.measure(&self.read(&ready, idx)?)?;
            shards.progress.advance(n_scenarios(idx));
            Ok((write_binary_atomically(&shards.file(idx), FIGURES_FORMAT, &figures)?, ()))
        })?;
        shards.progress.finish();
        Ok(())
    }

    /// Tests how well the tracks of all shards can be told from recorded ones, decides on every scenario, and writes
    /// the corpus.
    fn finish(&self, shards: &mut Gathering<'_>, context: &StageContext<'_>) -> Result<Value> {
        let ready = self.ready(Some(shards.decisions()?))?;
        let EvaluationReady { store, samples, behaviors, maps, .. } = &ready;
        let config = self.config;
        for idx in 0..samples.shards.len() {
            shards.look_up::<()>(idx)?;
        }
        shards.check_whole()?;
        maps.rows.iter().filter_map(MapFitRow::caution).for_each(|caution| context.progress.warn(&caution));
        let figures = |idx: usize| read_binary::<ShardFigures>(&shards.file(idx), FIGURES_FORMAT);
        let mut tracks = TrackPool::default();
        (0..samples.shards.len()).try_for_each(|idx| figures(idx).map(|figures| figures.pool_tracks(&mut tracks)))?;
        let path = |name: &str| context.root.join(name);
        let verdicts = path(VERDICTS);
        let files = EvaluationFiles { verdicts: &verdicts, scratch: context.root };
        let told = tracks.tell_apart(context.progress);
        let [exposure, occurrences] = [EXPOSURE, OCCURRENCES].map(|name| self.layout.events.with_file_name(name));
        let has_rates = self.has_events && exposure.exists() && occurrences.exists();
        let traffic = has_rates.then(|| read_recorded_traffic(&exposure, &occurrences)).transpose()?;
        let ids: Vec<&str> = behaviors.iter().map(|behavior| behavior.id()).collect();
        let modeled = match &traffic {
            Some(recorded) if self.has_modeled => modeled_rates(&self.layout.modeled, recorded, &ids)?,
            _ => None,
        };
        let evaluation = Evaluation::new(config, behaviors, told, &files)?;
        let coverage = self.recorded_coverage(&ready, traffic.as_ref())?;
        let mut evaluation = evaluation.with_rates_of(traffic, modeled).with_coverage_of(coverage);
        evaluation.count_rejected(samples.shards.iter().flat_map(|shard| &shard.rejected));
        let mut corpus = CorpusWriter::create(&path(CORPUS), store)?;
        context.progress.start("decide", samples.n_scenarios, "scenarios");
        for idx in 0..samples.shards.len() {
            let kept = evaluation.add(MeasuredShard::new(self.read(&ready, idx)?, figures(idx)?, store)?)?;
            kept.recordings.iter().try_for_each(|recorded| corpus.write_recording(recorded))?;
            corpus.write_scenarios(&kept.records)?;
            context.progress.advance(samples.shards[idx].n_scenarios);
        }
        context.progress.finish();
        let found = evaluation.finish()?;
        write_table(&path(METRICS), found.all_rows()?)?;
        corpus.write_metrics(found.rows_of_corpus()?)?;
        write_table(&path(COVERAGE), found.coverage.iter().cloned().map(Ok))?;
        let n_accepted_scenes = found.n_accepted_scenes;
        let mut summary = EvaluationSummary { maps: maps.rows.clone(), ..found.remove_rows()? };
        summary.gates.extend(of_requests(&config.gates, &read_requests(&self.layout.samples)?));
        corpus.finish(&self.notes(&summary)?)?;
        write_json_atomically(&path(METRICS_SUMMARY), &summary)?;
        Ok(json!({
            "n_scenarios": summary.n_scenarios,
            "n_verified": summary.n_verified,
            "n_new": summary.n_new,
            "n_valid": summary.n_valid,
            "n_accepted": summary.n_accepted,
            "n_accepted_scenes": n_accepted_scenes,
            "n_kept": summary.n_kept,
            "gates": summary.gates,
        }))
    }
}

/// The format of the files with figures of shards.
const FIGURES_FORMAT: &str = "figures.v2";

/// Everything that measuring and merging shards needs, read and checked.
struct EvaluationReady {
    store: SceneStore,
    samples: SampleManifest,
    behaviors: Vec<Box<dyn Behavior>>,
    /// How well the maps of places fit their recordings.
    maps: MapFits,
    settings: MetricSettings,
}

impl Evaluate<'_> {
    /// Reads and checks everything that measuring needs. Determines how well maps fit unless that is known already.
    fn ready(&self, plan: Option<EvaluationPlan>) -> Result<EvaluationReady> {
        self.check()?;
        let store = SceneStore::open_all(&self.layout.scene_folders())?;
        let maps = plan.map_or_else(|| MapFits::of(&store, &self.config.validity), |plan| Ok(plan.maps))?;
        Ok(EvaluationReady {
            samples: SampleManifest::read(&self.layout.samples)?,
            behaviors: self.mine.build()?,
            settings: maps.settings(&self.config.validity),
            store,
            maps,
        })
    }

    fn measurer<'r>(&'r self, ready: &'r EvaluationReady) -> Result<Measurer<'r>> {
        let events = self.has_events.then_some(self.layout.events.as_path());
        Ok(Measurer::new(&ready.settings, self.config.modes, &ready.behaviors, &ready.store, events)?)
    }

    /// Recorded events of each behavior by tags; empty without recorded events.
    fn recorded_coverage(&self, ready: &EvaluationReady, traffic: Option<&RecordedTraffic>) -> Result<CoverageTally> {
        let [tags, occurrences] = [TAGS, OCCURRENCES].map(|name| self.layout.events.with_file_name(name));
        let recordings = traffic.filter(|_| tags.exists()).map_or(&[][..], RecordedTraffic::recordings);
        let scenes = if recordings.is_empty() { Vec::new() } else { read_table(&tags)? };
        let behaviors: Vec<&str> = ready.behaviors.iter().map(|behavior| behavior.id()).collect();
        let buckets = self.mine.rates.iter().map(|bucket| (bucket.behavior.clone(), bucket.within.clone()));
        let mut tally = CoverageTally::new(&behaviors, &buckets.collect::<Vec<_>>(), recordings, scenes.into_iter());
        if !recordings.is_empty() {
            for event in stream_events(&occurrences)? {
                tally.add_recorded(&event?);
            }
        }
        Ok(tally)
    }

    /// Reads shard `idx` of the samples.
    fn read<'r>(&self, ready: &'r EvaluationReady, idx: usize) -> Result<Shard<'r>> {
        let shard = &ready.samples.shards[idx];
        let records = SampleManifest::read_shard(&self.layout.samples, shard, &ready.store)?;
        Ok(Shard { sweep: &shard.sweep, n_evaluations: shard.n_evaluations, records })
    }

    fn notes(&self, summary: &EvaluationSummary) -> Result<CorpusNotes> {
        let mut notes = BTreeMap::from([
            ("pipeline".to_owned(), self.pipeline.to_owned()),
            ("made_by".to_owned(), format!("djinn {}", env!("CARGO_PKG_VERSION"))),
        ]);
        let cautions: Vec<String> = summary.maps.iter().filter_map(MapFitRow::caution).collect();
        if !cautions.is_empty() {
            notes.insert("maps".to_owned(), cautions.join(" "));
        }
        let SampleSettings { mine, generate, .. } = SampleSettings::read(&self.layout.samples)?;
        let sweeps = generate.resolve(&mine.build()?)?.sweeps;
        let hard: Vec<&str> = sweeps.iter().filter(|s| s.aim == Aim::Hard).map(|s| s.name.as_str()).collect();
        if !hard.is_empty() {
            notes.insert(AIMS_AT_HARD_EVENTS.to_owned(), hard.join(", "));
        }
        let sources = self.config.terms.iter().map(|(dataset, terms)| (dataset.name().to_owned(), terms.clone()));
        Ok(CorpusNotes { sources: sources.collect(), notes, left_out: left_out_by_sweep(&summary.left_out) })
    }
}
