//! Scenes to a denoiser.

use super::train::{Calibrate, Recipe, Source, checkpoint_file};
use super::train_loops::ValidLoops;
use super::training_scenes::{OpenedScenes, calibrate, training_summary};
use crate::engine::{Result, Stopwatch};
use crate::model::{DenoiserSpec, TrainedDenoiser};
use crate::nn::{Checkpoint, write_checkpoint};
use crate::pipeline::StageId;
use crate::pipeline::layout::Layout;
use crate::store::{read_json, write_json_atomically};
use crate::train::{
    CHOSEN_FILE, Chosen, DenoiserTrainingConfig, FitStatistics, JobTime, MODEL_FILE, OwnScenes, SCENE_ERROR, TrainJob,
    TrainOutcome, TrainingData, Within, train_denoiser,
};
use serde_json::{Value, json};
use std::path::Path;

impl Recipe for DenoiserTrainingConfig {
    type Spec = DenoiserSpec;
    const STAGE: StageId = StageId::TrainDenoiser;
    const VERSION: u32 = 9;
    const LEARNS_FROM: &'static [StageId] = &[StageId::Ingest];
    const CALIBRATE: Option<Calibrate<DenoiserSpec>> = Some(calibrate);

    fn source<'a>(&'a self, own: OwnScenes<'a>) -> Source<'a> {
        Source {
            checkpoint: self.checkpoint.as_deref(),
            calibrates: self.calibrate,
            start_from: self.start_from.as_deref(),
            scenes: Some(self.mixture(own)),
        }
    }

    fn check_kind(spec: &DenoiserSpec) -> std::result::Result<(), &'static str> {
        match spec.distillation {
            None => Ok(()),
            Some(_) => Err("is a distilled denoiser, which [train.distill] takes"),
        }
    }

    fn resolved(&self) -> std::result::Result<Option<Value>, crate::train::Error> {
        Ok(Some(json!(self.resolve()?)))
    }

    fn about(spec: &DenoiserSpec) -> Value {
        json!({ "steps": spec.steps })
    }

    fn train(&self, own: OwnScenes<'_>, layout: &Layout, job: TrainJob<'_>) -> Result<Value> {
        let scenes = OpenedScenes::open(self.mixture(own), &layout.scenes, job.progress)?;
        let start = self.read_start(&job.compute.device)?;
        let state_dim = self.state_dim.or_else(|| start.as_ref().map(|start| start.metadata.normalizer.state_dim));
        let training = self.resolve()?;
        let data = scenes.training_data(state_dim, training.network.geometry.is_some())?;
        if let Some(within) = &training.within {
            let train = |job: TrainJob<'_>| train_denoiser(&training, &data, start.as_ref(), job);
            return in_time(within, start.as_ref().zip(self.start_from.as_deref()), (&scenes, &data), &train, job);
        }
        let outcome = train_denoiser(&training, &data, start.as_ref(), job)?;
        Ok(training_summary(&data, outcome.spec.steps, &outcome))
    }
}

/// Name of the file with the closed loops of the checkpoint that a training starts from.
const LOOPS_FILE: &str = "loops.json";

type TrainAs<'a> = dyn Fn(TrainJob<'_>) -> std::result::Result<TrainOutcome<DenoiserSpec>, crate::train::Error> + 'a;

/// Trains for the time that is given, and keeps the checkpoint that it started from if closed loops have become less
/// valid.
fn in_time(
    within: &Within,
    start: Option<(&Checkpoint<DenoiserSpec>, &Path)>,
    (scenes, data): (&OpenedScenes, &TrainingData<'_>),
    train: &TrainAs<'_>,
    job: TrainJob<'_>,
) -> Result<Value> {
    let watch = Stopwatch::start();
    let clock_s = || watch.elapsed_s();
    let loops_file = job.dir.join(LOOPS_FILE);
    let began = match start {
        Some(_) if loops_file.exists() => Some(read_json::<ValidLoops>(&loops_file)?),
        Some((_, path)) => {
            let model = TrainedDenoiser::read(&checkpoint_file(path), job.compute)?;
            let mut loops = ValidLoops::of(&model, scenes, within.seconds, job)?;
            loops.seconds = clock_s();
            fs_err::create_dir_all(job.dir)?;
            write_json_atomically(&loops_file, &loops)?;
            Some(loops)
        }
        None => None,
    };
    let until_s = within.seconds - began.as_ref().map_or(0.0, |loops| loops.seconds);
    let mut outcome = train(TrainJob { time: Some(JobTime { clock_s: &clock_s, until_s }), ..job })?;
    let model_file = job.dir.join(MODEL_FILE);
    let mut loops = Value::Null;
    if let Some(((start, _), began)) = start.zip(began).filter(|((start, _), _)| outcome.spec != start.metadata) {
        let ended = ValidLoops::of(&TrainedDenoiser::read(&model_file, job.compute)?, scenes, within.seconds, job)?;
        let [before, after] = [&began, &ended].map(ValidLoops::valid_share);
        loops = json!({ "before": before, "after": after });
        if began.are_better_than(&ended) {
            let percent = |share: f64| format!("{:.0} %", 100.0 * share);
            job.progress.warn(&format!(
                "the denoiser stays as it was: after training {} of the time of closed loops are valid, {} before; \
                 give it more time, or scenes of other runs",
                percent(after),
                percent(before)
            ));
            outcome.fingerprint = write_checkpoint(&model_file, &start.tensors, &start.metadata)?;
            outcome.spec = start.metadata.clone();
        }
    }
    let mut summary = training_summary(data, outcome.spec.steps, &outcome);
    summary["chosen"] = json!(read_json::<Chosen>(&job.dir.join(CHOSEN_FILE))?);
    summary["won"] = json!(won(&outcome.statistics));
    summary["valid_closed_loops"] = loops;
    summary["minutes"] = json!(clock_s() / 60.0);
    Ok(summary)
}

/// The scene error, meters, after so many minutes and steps, of each evaluation.
fn won(statistics: &[FitStatistics]) -> Vec<Value> {
    let evaluated = statistics.iter().filter_map(|line| Some((line, line.evaluation.get(SCENE_ERROR)?)));
    evaluated
        .map(|(line, error_m)| json!({ "minutes": line.minutes, "steps": line.step, "scene_error_m": error_m }))
        .collect()
}
