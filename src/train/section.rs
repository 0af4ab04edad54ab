//! The settings that the sections of `[train]` share: the scenes, and the schedule.
//!
//! Sections are flat tables. Macros define their types, because serde loses the places of errors in flattened tables.

use super::{Error, FitConfig};
use crate::scene::Split;
use crate::settings::Issue;
use crate::tensor::TaskWeights;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The type of a setting with its own default; other settings are an `Option` that a preset fills.
pub(super) type Own<T> = T;

/// The settings of every training on scenes, beside its network and loss.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SceneTraining {
    /// How often each observation task is drawn.
    pub tasks: TaskWeights,
    /// Scenes a step.
    pub batch_size: usize,
    /// Held-out scenes of each evaluation during training.
    pub n_eval_scenes: usize,
    /// The loop.
    pub fit: FitConfig,
}

impl Default for SceneTraining {
    fn default() -> Self {
        Self { tasks: TaskWeights::default(), batch_size: 8, n_eval_scenes: 48, fit: FitConfig::default() }
    }
}

/// Ingested scenes of another run, to train on as well: those of `train`, or all unsplit ones.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MoreScenes {
    /// The folder of the scenes, such as `output/argoverse/main/scenes`.
    pub scenes: PathBuf,
    /// How often a scene is drawn, relative to those of the run itself (`own_weight`) and of other entries.
    #[serde(default = "one")]
    #[schemars(extend("exclusiveMinimum" = 0, "maximum" = 1_000_000))]
    pub weight: f64,
}

const fn one() -> f64 {
    1.0
}

/// Which of the run's own scenes models train on.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct OwnScenes<'a> {
    /// Splits; empty: `train`, or all unsplit scenes if there is no such split.
    pub splits: &'a [Split],
    /// Places; empty: all.
    pub places: &'a [String],
}

/// Which scenes a section trains on.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct SceneChoice<'a> {
    /// The section.
    pub section: &'static str,
    /// The run's own scenes.
    pub own: OwnScenes<'a>,
    /// Their weight; 0 for none of them.
    pub own_weight: f64,
    /// Scenes of other runs.
    pub data: &'a [MoreScenes],
}

/// Fails if there are no scenes to draw from.
pub(super) fn check_weights(own_weight: Option<f64>, data: &[MoreScenes]) -> Result<(), Issue> {
    match own_weight == Some(0.0) && data.is_empty() {
        true => Err(Issue::new("own_weight", "is 0, expected a positive number, or scenes of other runs in `data`")),
        false => Ok(()),
    }
}

/// Fails if there is no checkpoint to calibrate.
pub(super) fn check_calibrates(calibrate: bool, checkpoint: Option<&Path>) -> Result<(), Issue> {
    match calibrate && checkpoint.is_none() {
        true => {
            Err(Issue::new("calibrate", "goes with `checkpoint`: a training takes the scales of its scenes anyway"))
        }
        false => Ok(()),
    }
}

/// The value of the section, or else of its preset.
pub(super) fn or<T>(said: impl Into<Option<T>>, otherwise: T) -> T {
    said.into().unwrap_or(otherwise)
}

/// Fails if no task is ever drawn.
pub(super) fn check_tasks(section: &str, tasks: &TaskWeights) -> Result<(), Error> {
    match tasks.probabilities() {
        Some(_) => Ok(()),
        None => Err(Error::Config(format!(
            "{section}.tasks are not valid weights, expected numbers of at least 0, one of them positive"
        ))),
    }
}

/// Defines the type of a section: its own settings, and those of every training.
macro_rules! training_section {
    ($(#[$meta:meta])* pub struct $name:ident in $section:literal, each $value:ident { $($own:tt)* }) => {
        $(#[$meta])*
        #[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
        #[serde(deny_unknown_fields, default)]
        pub struct $name {
            $($own)*
            /// Optimizer steps in all.
            #[schemars(range(min = 1, max = 1_000_000_000))]
            pub steps: $value<u64>,
            /// Examples per step: scenes, or the classifier's pairs, half of them positive.
            #[schemars(range(min = 1, max = 16_384))]
            pub batch_size: $value<usize>,
            /// Steps between evaluations; the state is saved twice as often, unless a setting says otherwise.
            #[schemars(range(min = 1, max = 1_000_000_000))]
            pub evaluate_every: $value<u64>,
            /// A trained checkpoint to use instead of training.
            pub checkpoint: Option<std::path::PathBuf>,
        }

        impl $name {
            /// Its place in a pipeline file.
            pub const SECTION: &'static str = $section;

            /// The schedule of `base` with the section's settings over it.
            fn schedule(&self, base: &FitConfig) -> FitConfig {
                use crate::train::section::or;
                let evaluate_every = or(self.evaluate_every, base.evaluate_every);
                FitConfig {
                    steps: or(self.steps, base.steps),
                    evaluate_every,
                    save_every: (evaluate_every / 2).max(1),
                    ..base.clone()
                }
            }

            /// Rejects numbers beyond their ranges.
            fn check_ranges(&self) -> Result<(), Error> {
                crate::settings::check_ranges(self).map_err(Self::refusal)
            }

            fn refusal(issue: crate::settings::Issue) -> Error {
                Error::Config(issue.within(Self::SECTION).to_string())
            }
        }
    };
}

/// A section with the settings of every training on scenes.
macro_rules! scene_training_section {
    ($(#[$meta:meta])* pub struct $name:ident in $section:literal, each $value:ident { $($own:tt)* }) => {
        crate::train::section::training_section! {
            $(#[$meta])*
            pub struct $name in $section, each $value {
                $($own)*
                /// How often each observation task is drawn; `{ predictive = 1.0, goal_conditioned = 0.0, … }` trains
                /// for prediction alone.
                pub tasks: $value<TaskWeights>,
                /// Ingested scenes of other runs to train on as well, each with a weight.
                #[serde(skip_serializing_if = "Vec::is_empty")]
                pub data: Vec<crate::train::MoreScenes>,
                /// How often one of the run's own scenes is drawn relative to those of `data` (default 1); 0: never.
                #[serde(skip_serializing_if = "Option::is_none")]
                #[schemars(range(min = 0.0, max = 1e6))]
                pub own_weight: Option<f64>,
                /// Take the scales of motion from the scenes instead of from `checkpoint`, so that samples move as
                /// these recordings do. Nothing is trained: it takes a second.
                #[serde(skip_serializing_if = "std::ops::Not::not")]
                pub calibrate: bool,
            }
        }

        impl $name {
            /// The scenes it trains on.
            pub fn scene_choice<'a>(&'a self, own: crate::train::OwnScenes<'a>) -> crate::train::SceneChoice<'a> {
                crate::train::SceneChoice {
                    section: Self::SECTION,
                    own,
                    own_weight: self.own_weight.unwrap_or(1.0),
                    data: &self.data,
                }
            }

            /// The settings of `base` with the section's settings over them.
            fn scene_training(&self, base: &SceneTraining) -> Result<SceneTraining, Error> {
                use crate::train::section::{check_calibrates, check_tasks, check_weights, or};
                let tasks = or(self.tasks, base.tasks);
                check_tasks(Self::SECTION, &tasks)?;
                check_weights(self.own_weight, &self.data).map_err(Self::refusal)?;
                check_calibrates(self.calibrate, self.checkpoint.as_deref()).map_err(Self::refusal)?;
                Ok(SceneTraining {
                    tasks,
                    batch_size: or(self.batch_size, base.batch_size),
                    n_eval_scenes: base.n_eval_scenes,
                    fit: self.schedule(&base.fit),
                })
            }
        }
    };
}

pub(super) use {scene_training_section, training_section};
