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
    TrainOutcome, train_denoiser,
};
use serde_json::{Value, json};
use std::path::Path;

impl Recipe for DenoiserTrainingConfig {
    type Spec = DenoiserSpec;
    const STAGE: StageId = StageId::TrainDenoiser;
    const VERSION: u32 = 10;
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
        let watch = Stopwatch::start();
        let scenes = OpenedScenes::open(self.mixture(own), &layout.scenes, job.progress)?;
        let start = self.read_start(&job.compute.device)?;
        let state_dim = self.state_dim.or_else(|| start.as_ref().map(|start| start.metadata.normalizer.state_dim));
        let training = self.resolve()?;
        let data = scenes.training_data(state_dim, training.network.geometry.is_some())?;
        let Some(within) = &training.within else {
            let outcome = train_denoiser(&training, &data, start.as_ref(), job)?;
            return Ok(training_summary(&data, outcome.spec.steps, &outcome));
        };
        let clock_s = || watch.elapsed_s();
        let begun = match start.as_ref().zip(self.start_from.as_deref()) {
            Some((checkpoint, path)) => Some(Begun::new(checkpoint, path, &scenes, within.seconds, job)?),
            None => None,
        };
        let until_s = within.seconds - begun.as_ref().map_or(0.0, |begun| AGAIN * begun.loops.seconds);
        let time = Some(JobTime { clock_s: &clock_s, until_s });
        let mut outcome = train_denoiser(&training, &data, start.as_ref(), TrainJob { time, ..job })?;
        let loops = match begun.filter(|begun| outcome.spec != begun.checkpoint.metadata) {
            Some(begun) => {
                let trained = TrainedDenoiser::read(&job.dir.join(MODEL_FILE), job.compute)?;
                let ended = begun.loops.again(&trained, &scenes, job)?;
                begun.stays_if_better_than(&ended, &mut outcome, job)?
            }
            None => Value::Null,
        };
        let mut summary = training_summary(&data, outcome.spec.steps, &outcome);
        summary["chosen"] = json!(read_json::<Chosen>(&job.dir.join(CHOSEN_FILE))?);
        summary["won"] = json!(won(&outcome.statistics));
        summary["valid_closed_loops"] = loops;
        summary["minutes"] = json!(clock_s() / 60.0);
        Ok(summary)
    }
}

/// The time for loops of what is trained, relative to those of the checkpoint: the processor may have more to do.
const AGAIN: f64 = 1.2;
/// Name of the file with the closed loops of the checkpoint that a training starts from.
const LOOPS_FILE: &str = "loops.json";

/// The checkpoint that a training starts from, and its closed loops.
struct Begun<'a> {
    checkpoint: &'a Checkpoint<DenoiserSpec>,
    loops: ValidLoops,
}

impl<'a> Begun<'a> {
    /// Drives loops with the checkpoint at `path`, unless an interrupted training did.
    fn new(
        checkpoint: &'a Checkpoint<DenoiserSpec>,
        path: &Path,
        scenes: &OpenedScenes,
        within_s: f64,
        job: TrainJob<'_>,
    ) -> Result<Self> {
        let file = job.dir.join(LOOPS_FILE);
        if file.exists() {
            return Ok(Self { checkpoint, loops: read_json(&file)? });
        }
        let model = TrainedDenoiser::read(&checkpoint_file(path), job.compute)?;
        let loops = ValidLoops::of_start(&model, scenes, within_s, job)?;
        fs_err::create_dir_all(job.dir)?;
        write_json_atomically(&file, &loops)?;
        Ok(Self { checkpoint, loops })
    }

    /// Puts the checkpoint in place of what was trained if loops have become worse. Returns the parts of both that are
    /// valid.
    fn stays_if_better_than(
        &self,
        ended: &ValidLoops,
        outcome: &mut TrainOutcome<DenoiserSpec>,
        job: TrainJob<'_>,
    ) -> Result<Value> {
        let [before, after] = [&self.loops, ended].map(ValidLoops::valid_share);
        if self.loops.are_better_than(ended) {
            let percent = |share: f64| format!("{:.0} %", 100.0 * share);
            job.progress.warn(&format!(
                "the denoiser stays as it was: after training {} of the time of closed loops are valid, {} before; \
                 give it more time, or scenes of other runs",
                percent(after),
                percent(before)
            ));
            let Checkpoint { tensors, metadata, .. } = self.checkpoint;
            outcome.fingerprint = write_checkpoint(&job.dir.join(MODEL_FILE), tensors, metadata)?;
            outcome.spec = metadata.clone();
        }
        Ok(json!({ "before": before, "after": after, "loops": ended.n_loops() }))
    }
}

/// The scene error, meters, after so many minutes and steps, of each evaluation.
fn won(statistics: &[FitStatistics]) -> Vec<Value> {
    let evaluated = statistics.iter().filter_map(|line| Some((line, line.evaluation.get(SCENE_ERROR)?)));
    evaluated
        .map(|(line, error_m)| json!({ "minutes": line.minutes, "steps": line.step, "scene_error_m": error_m }))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nn::{Compute, read_checkpoint};
    use crate::progress::Heard;
    use crate::seed::Seed;

    #[test]
    fn a_checkpoint_whose_loops_are_better_takes_the_place_of_what_was_trained() {
        let compute = Compute::cpu();
        let read = |path: &Path| read_checkpoint::<DenoiserSpec>(path, &compute.device).unwrap();
        let (bundled, first) =
            (read(Path::new("pipelines/models/geometric.safetensors")), tempfile::tempdir().unwrap());
        let path = first.path().join(MODEL_FILE);
        write_checkpoint(&path, &bundled.tensors, &bundled.metadata).unwrap();
        let checkpoint = read(&path);
        let began = Begun { checkpoint: &checkpoint, loops: ValidLoops::made(&[9, 9, 9, 5]) };
        for (ended, stays) in [([0, 8, 3, 5], true), ([9, 9, 9, 0], false)] {
            let (dir, heard) = (tempfile::tempdir().unwrap(), Heard::default());
            let job = TrainJob { seed: Seed(1), dir: dir.path(), compute: &compute, progress: &heard, time: None };
            let file = dir.path().join(MODEL_FILE);
            let spec = DenoiserSpec { steps: 7, ..checkpoint.metadata.clone() };
            let fingerprint = write_checkpoint(&file, &checkpoint.tensors, &spec).unwrap();
            let trained = TrainOutcome { fingerprint, spec, n_parameters: 1, statistics: Vec::new() };
            let mut outcome = trained.clone();
            let loops = began.stays_if_better_than(&ValidLoops::made(&ended), &mut outcome, job).unwrap();
            assert_eq!((loops["before"].as_f64(), loops["loops"].as_u64()), (Some(32.0 / 36.0), Some(4)));
            let expected = if stays { &checkpoint.fingerprint } else { &trained.fingerprint };
            assert_eq!(&read(&file).fingerprint, expected);
            assert_eq!((&outcome.fingerprint, outcome.spec == checkpoint.metadata), (expected, stays));
            let warnings = heard.take();
            assert!(warnings.len() == usize::from(stays) && warnings.iter().all(|text| text.contains("44 %")));
        }
    }
}
