//! The common part of the training stages. The recipe of a model holds the rest.

use super::training_scenes::check_folders;
use super::with_precision;
use crate::engine::{Failure, Result, Stage, StageContext, StageInput, StageKind, Whole, Work};
use crate::model::{ModelSpec, TrainedModel};
use crate::nn::{Checkpoint, Compute, Precision, read_checkpoint};
use crate::pipeline::StageId;
use crate::pipeline::config::TrainConfig;
use crate::pipeline::layout::Layout;
use crate::seed::Seed;
use crate::store::write_atomically;
use crate::train::{MODEL_FILE, OwnScenes, SceneChoice, TrainJob};
use candle_core::Device;
use serde::Serialize;
use serde_json::{Value, json};
use std::io::Write;
use std::path::{Path, PathBuf};

/// The sources of a model, beside the outputs of earlier stages.
#[derive(Debug, Clone, Copy, Default)]
pub struct Source<'a> {
    /// The checkpoint to use instead of training.
    pub checkpoint: Option<&'a Path>,
    /// Whether the checkpoint takes its scales of motion from the scenes.
    pub calibrates: bool,
    /// The checkpoint to start from.
    pub start_from: Option<&'a Path>,
    /// The scenes to train on.
    pub scenes: Option<SceneChoice<'a>>,
}

impl Source<'_> {
    /// Whether anything of the model comes from scenes.
    const fn learns(&self) -> bool {
        self.checkpoint.is_none() || self.calibrates
    }
}

/// Writes a checkpoint of the same weights with the scales of the chosen scenes, and returns its fingerprint.
pub(super) type Calibrate<S> = fn(&Checkpoint<S>, SceneChoice<'_>, &Layout, TrainJob<'_>) -> Result<String>;

/// How to make a model: the section of a training stage, and its use.
pub trait Recipe: Serialize {
    /// The description in its checkpoint.
    type Spec: ModelSpec;
    /// The stage.
    const STAGE: StageId;
    /// The version of the stage.
    const VERSION: u32;
    /// The stages whose outputs it learns from.
    const LEARNS_FROM: &'static [StageId];
    /// Takes a checkpoint to the motion of other scenes, for models whose sections have `calibrate`.
    const CALIBRATE: Option<Calibrate<Self::Spec>> = None;

    /// Its sources, including `own`.
    fn source<'a>(&'a self, own: OwnScenes<'a>) -> Source<'a>;

    /// The resolved section, if presets decide a part of it: presets change from version to version, and the resolved
    /// values count.
    fn resolved(&self) -> std::result::Result<Option<Value>, crate::train::Error>;

    /// The summary of a model that was trained elsewhere.
    fn about(spec: &Self::Spec) -> Value;

    /// Trains the model on `own` scenes, or others, and returns the summary of the result.
    fn train(&self, own: OwnScenes<'_>, layout: &Layout, job: TrainJob<'_>) -> Result<Value>;

    /// Whether a checkpoint of such a network belongs to this stage.
    fn check_kind(_spec: &Self::Spec) -> std::result::Result<(), &'static str> {
        Ok(())
    }

    /// Reads the checkpoint to start from.
    fn read_start(&self, device: &Device) -> Result<Option<Checkpoint<Self::Spec>>> {
        Ok(self
            .source(OwnScenes::default())
            .start_from
            .map(|path| read_checkpoint(&checkpoint_file(path), device))
            .transpose()?)
    }
}

/// The stage of a recipe.
pub struct Train<'a, R> {
    /// The recipe.
    pub recipe: &'a R,
    /// The scenes of the run that it may use.
    pub own: OwnScenes<'a>,
    /// Seed of everything random.
    pub seed: u64,
    /// The precision of matrix products.
    pub precision: Precision,
    /// Where the outputs of earlier stages are.
    pub layout: &'a Layout,
}

impl<R: Recipe> Stage for Train<'_, R> {
    fn kind(&self) -> &'static StageKind {
        R::STAGE.kind()
    }

    fn version(&self) -> u32 {
        R::VERSION
    }

    fn check(&self) -> Result<()> {
        self.recipe.resolved()?;
        let source = self.recipe.source(self.own);
        if let Some(choice) = source.scenes.filter(|_| source.learns()) {
            check_folders(choice, &self.layout.scenes)?;
        }
        // Missing ones are noticed among the inputs.
        if let Some(file) = source.start_from.map(checkpoint_file).filter(|file| file.exists()) {
            TrainedModel::<R::Spec>::read(&file, &Compute::cpu())?;
        }
        match source.checkpoint.map(checkpoint_file).filter(|file| file.exists()) {
            Some(file) => {
                let model = TrainedModel::<R::Spec>::read(&file, &Compute::cpu())?;
                R::check_kind(&model.spec).map_err(|what| {
                    Failure::input_message(format_args!("{}: {} {what}", R::STAGE.name(), file.display()))
                })
            }
            None => Ok(()),
        }
    }

    fn config(&self) -> anyhow::Result<Value> {
        let mut config = serde_json::to_value(self.recipe)?;
        config["seed"] = json!(self.seed);
        if let Some(resolved) = self.recipe.resolved()? {
            config["resolved"] = resolved;
        }
        let source = self.recipe.source(self.own);
        if source.learns() {
            config["own"] = json!(self.own);
        }
        Ok(with_precision(config, source.checkpoint.is_none().then_some(self.precision)))
    }

    fn inputs(&self) -> Vec<StageInput> {
        let source = self.recipe.source(self.own);
        let Source { checkpoint, start_from, scenes: choice, .. } = source;
        let checkpoint = checkpoint.map(|path| StageInput::external("checkpoint", &checkpoint_file(path)));
        if !source.learns() {
            return checkpoint.into_iter().collect();
        }
        let is_read = |stage: &&StageId| match stage {
            StageId::Ingest => choice.is_none_or(|choice| choice.own_weight > 0.0),
            // Scales are those of scenes.
            _ => checkpoint.is_none(),
        };
        let made = R::LEARNS_FROM
            .iter()
            .filter(is_read)
            .filter_map(|stage| stage.output(self.layout).map(|(name, path)| StageInput::made_by(*stage, name, path)));
        let more = choice.map_or(&[][..], |choice| choice.data).iter().enumerate();
        let more = more.map(|(i, more)| StageInput::made_by(StageId::Ingest, &format!("data.{i}"), &more.scenes));
        let start = start_from.map(|path| StageInput::external("start_from", &checkpoint_file(path)));
        made.chain(more).chain(start).chain(checkpoint.clone()).collect()
    }

    fn work(&self) -> Work<'_> {
        Work::Whole(self)
    }
}

impl<R: Recipe> Whole for Train<'_, R> {
    fn run(&self, context: &StageContext<'_>) -> Result<Value> {
        let StageContext { compute, progress, .. } = *context;
        let dir = context.root.join(R::STAGE.kind().outputs[0]);
        let job = TrainJob { seed: Seed(self.seed), dir: &dir, compute, progress, time: None };
        let source = self.recipe.source(self.own);
        let Some(path) = source.checkpoint.map(checkpoint_file) else {
            return self.recipe.train(self.own, self.layout, job);
        };
        fs_err::create_dir_all(&dir)?;
        let trained = TrainedModel::<R::Spec>::read(&path, compute)?;
        let mut summary = R::about(&trained.spec);
        summary["trained"] = json!(false);
        let calibrated = match (R::CALIBRATE, source.scenes) {
            (Some(calibrate), Some(choice)) if source.calibrates => {
                Some(calibrate(&read_checkpoint(&path, &compute.device)?, choice, self.layout, job)?)
            }
            _ => None,
        };
        if calibrated.is_none() {
            let bytes = fs_err::read(&path)?;
            write_atomically::<std::io::Error>(&dir.join(MODEL_FILE), |file| file.write_all(&bytes))?;
        }
        summary["fingerprint"] = json!(calibrated.unwrap_or(trained.fingerprint));
        Ok(summary)
    }
}

/// The scenes that the models of a pipeline learn from, section by section.
pub(super) fn scenes_learned_from(train: &TrainConfig) -> Vec<SceneChoice<'_>> {
    fn of<'a, R: Recipe>(recipe: Option<&'a R>, own: OwnScenes<'a>) -> Option<SceneChoice<'a>> {
        let source = recipe?.source(own);
        source.scenes.filter(|_| source.learns())
    }
    let (TrainConfig { denoiser, distill, classifier, baseline, .. }, own) = (train, train.own_scenes());
    let choices = [
        of(denoiser.as_ref(), own),
        of(distill.as_ref(), own),
        of(classifier.as_ref(), own),
        of(baseline.as_ref(), own),
    ];
    choices.into_iter().flatten().collect()
}

/// The file of a checkpoint that is given by its file or by the folder of the model.
pub(in crate::pipeline) fn checkpoint_file(path: &Path) -> PathBuf {
    if path.is_dir() { path.join(MODEL_FILE) } else { path.to_owned() }
}
