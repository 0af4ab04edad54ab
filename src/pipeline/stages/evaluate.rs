//! Generated scenarios to metrics and the corpus: the files around [`Evaluation`]. Shards that workers have measured
//! are not measured again.

use super::mine::MineConfig;
use super::sample_folder::SampleManifest;
use crate::behavior::Behavior;
use crate::evaluate::{
    Distinguished, EvaluateConfig, Evaluation, EvaluationFiles, EvaluationSummary, MapFitRow, MeasuredShard, Measurer,
    Shard, ShardFigures, TrackPool, for_maps, left_out_by_sweep, map_fits, metric_docs,
};
use crate::files::remove_if_present;
use crate::generate::GenerateConfig;
use crate::pipeline::layout::{CORPUS, Layout, METRICS, METRICS_SUMMARY, PREDICTIONS, VERDICTS};
use crate::pipeline::{Result, Stage, StageContext, StageId, StageInput};
use crate::store::{
    CorpusNotes, CorpusWriter, SceneStore, read_binary, write_binary_atomically, write_json_atomically, write_metrics,
};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

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
    /// What generates the scenarios, and whether there are maps, where the pipeline does both itself.
    pub generated: Option<(&'a GenerateConfig, bool)>,
    /// Where the scenes, events and samples are.
    pub layout: &'a Layout,
}

impl Stage for Evaluate<'_> {
    fn id(&self) -> StageId {
        StageId::Evaluate
    }

    fn version(&self) -> u32 {
        10
    }

    fn check(&self) -> Result<()> {
        self.config.validate()?;
        match self.generated {
            Some((generate, has_maps)) => match generate.resolve(&self.mine.build()?) {
                Ok(resolved) => Ok(self.config.gates.check_generated(&resolved, has_maps)?),
                // Errors of the section itself are reported by its own stage.
                Err(_) => Ok(()),
            },
            None => Ok(()),
        }
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
        self.check()?;
        let path = |name: &str| context.root.join(name);
        let ready = self.ready(None)?;
        let EvaluationReady { store, samples, behaviors, maps, config } = &ready;
        maps.iter().filter_map(MapFitRow::caution).for_each(|caution| context.progress.warn(&caution));
        let distinguished = self.measure_all(&ready, context)?;
        let (predictions, verdicts) = (path(PREDICTIONS), path(VERDICTS));
        let files = EvaluationFiles { predictions: &predictions, verdicts: &verdicts, scratch: context.root };
        let mut evaluation = Evaluation::new(config, metric_docs(config, behaviors), distinguished, &files)?;
        evaluation.count_left_out(samples.shards.iter().flat_map(|shard| &shard.rejected), &samples.unselected);
        let mut corpus = CorpusWriter::create(&path(CORPUS), store)?;
        context.progress.start("decide", samples.n_scenarios, "scenarios");
        for idx in 0..samples.shards.len() {
            let figures = read_binary(&figures_path(context.root, idx), FIGURES_FORMAT)?;
            let kept = evaluation.add(MeasuredShard::new(self.read(&ready, idx)?, figures, config, store)?)?;
            kept.recordings.iter().try_for_each(|recorded| corpus.write_recording(recorded))?;
            corpus.write_scenarios(&kept.records)?;
            context.progress.advance(samples.shards[idx].n_scenarios);
        }
        context.progress.finish();
        let found = evaluation.finish()?;
        write_metrics(&path(METRICS), found.all_rows()?)?;
        corpus.write_metrics(found.rows_of_corpus()?)?;
        let (n_predicted_scenes, n_tracks_left_out) = (found.n_predicted_scenes, found.n_tracks_left_out);
        let summary = EvaluationSummary { maps: maps.clone(), ..found.remove_rows()? };
        corpus.finish(&self.notes(&summary))?;
        write_json_atomically(&path(METRICS_SUMMARY), &summary)?;
        (0..samples.shards.len()).try_for_each(|idx| remove_if_present(&figures_path(context.root, idx)))?;
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

/// The format of the files with figures of shards.
pub(in crate::pipeline) const FIGURES_FORMAT: &str = "figures.v2";

/// The file in the work folder `work` in which the stage looks for figures of shard `idx` from workers.
pub(in crate::pipeline) fn figures_path(work: &Path, idx: usize) -> PathBuf {
    work.join("figures").join(format!("figures-{idx:05}.bin"))
}

/// Everything that measuring and merging shards needs, read and checked.
pub(in crate::pipeline) struct EvaluationReady {
    store: SceneStore,
    /// The shards.
    pub(in crate::pipeline) samples: SampleManifest,
    behaviors: Vec<Box<dyn Behavior>>,
    /// How well the maps of places fit their recordings.
    pub(in crate::pipeline) maps: Vec<MapFitRow>,
    /// The section, with the places whose maps allow no check of departures.
    config: EvaluateConfig,
}

impl Evaluate<'_> {
    /// Reads and checks everything that measuring needs. Determines how well maps fit, unless that is known already.
    pub(in crate::pipeline) fn ready(&self, maps: Option<Vec<MapFitRow>>) -> Result<EvaluationReady> {
        self.check()?;
        let store = SceneStore::open(&self.layout.scenes)?;
        let maps = maps.map_or_else(|| map_fits(&store, &self.config.validity), Ok)?;
        Ok(EvaluationReady {
            samples: SampleManifest::read(&self.layout.samples)?,
            behaviors: self.mine.build()?,
            config: EvaluateConfig { validity: for_maps(&self.config.validity, &maps), ..self.config.clone() },
            store,
            maps,
        })
    }

    /// Measures every shard of which there are no figures, from workers or from before an interruption, and keeps the figures
    /// in files. Tells the tracks of all shards from recorded ones.
    fn measure_all(&self, ready: &EvaluationReady, context: &StageContext<'_>) -> Result<Distinguished> {
        let (mut measurer, mut tracks) = (None, TrackPool::default());
        context.progress.start("evaluate", ready.samples.n_scenarios, "scenarios");
        for idx in 0..ready.samples.shards.len() {
            let file = figures_path(context.root, idx);
            // A damaged file counts as missing.
            let figures: ShardFigures = match read_binary(&file, FIGURES_FORMAT) {
                Ok(figures) => figures,
                Err(_) => {
                    let measurer = match &mut measurer {
                        Some(measurer) => measurer,
                        none => none.insert(self.measurer(ready)?),
                    };
                    let figures = measurer.measure(&self.read(ready, idx)?)?;
                    fs_err::create_dir_all(file.parent().unwrap_or(context.root))?;
                    write_binary_atomically(&file, FIGURES_FORMAT, &figures)?;
                    figures
                }
            };
            figures.pool_tracks(&mut tracks);
            context.progress.advance(ready.samples.shards[idx].n_scenarios);
        }
        context.progress.finish();
        Ok(tracks.tell_apart())
    }

    /// What measures shards.
    pub(in crate::pipeline) fn measurer<'r>(&'r self, ready: &'r EvaluationReady) -> Result<Measurer<'r>> {
        let events = self.has_events.then_some(self.layout.events.as_path());
        Ok(Measurer::new(&ready.config, &ready.behaviors, &ready.store, events)?)
    }

    /// Reads shard `idx` of the samples.
    pub(in crate::pipeline) fn read<'r>(&self, ready: &'r EvaluationReady, idx: usize) -> Result<Shard<'r>> {
        let shard = &ready.samples.shards[idx];
        let records = SampleManifest::read_shard(&self.layout.samples, shard, &ready.store)?;
        Ok(Shard { sweep: &shard.sweep, n_evaluations: shard.n_evaluations, records })
    }

    /// What the corpus says of itself.
    fn notes(&self, summary: &EvaluationSummary) -> CorpusNotes {
        let mut notes = BTreeMap::from([
            ("pipeline".to_owned(), self.pipeline.to_owned()),
            ("made_by".to_owned(), format!("djinn {}", env!("CARGO_PKG_VERSION"))),
        ]);
        let cautions: Vec<String> = summary.maps.iter().filter_map(MapFitRow::caution).collect();
        if !cautions.is_empty() {
            notes.insert("maps".to_owned(), cautions.join(" "));
        }
        CorpusNotes { sources: BTreeMap::new(), notes, left_out: left_out_by_sweep(&summary.left_out) }
    }
}
