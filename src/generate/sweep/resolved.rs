//! A sweep that can be sampled: complete, and without contradictions.

use super::{Aim, ClassifierScope};
use crate::behavior::BehaviorEntry;
use crate::diffusion::{Edm, SamplerConfig};
use crate::generate::{ClassifierFreeConfig, EditConfig, Error, ObserveConfig, PairSelectionConfig, SweepRollout};
use crate::guidance::{ClassifierPotential, GuidanceConfig, ObjectiveConfig};
use crate::model::Distillation;
use crate::scene::{GuidanceLevel, Scene};
use std::borrow::Cow;
use std::collections::BTreeSet;

/// A checked sweep. Only `GenerateConfig::resolve` makes one.
#[derive(Debug, Clone, PartialEq)]
pub struct ResolvedSweep {
    /// Its name. A sweep of a request is named `request/arm`, with the level if the arm has several: `tight/guided@10`.
    pub name: String,
    /// Scenes to continue, at least 1.
    pub n_scenes: usize,
    /// Samples of each scene (or pair) at each level.
    pub n_samples: usize,
    /// The requested behavior, if any.
    pub behavior: Option<String>,
    /// Which agents are to show it.
    pub pairs: PairSelectionConfig,
    /// Which events its guided samples aim at.
    pub aim: Aim,
    /// How scenarios go on in a closed loop; `None`: not at all.
    pub rollout: Option<SweepRollout>,
    /// Which states are observed.
    pub observe: ObserveConfig,
    /// The model, and how it is sampled.
    pub model: SweepModel,
}

/// Which model the samples of a sweep come from.
#[derive(Debug, Clone, PartialEq)]
pub enum SweepModel {
    /// The denoiser.
    Denoiser(Diffusion),
    /// The distilled denoiser.
    Distilled(Diffusion),
    /// Scene Transformer, in one pass.
    Baseline,
}

/// The guidance of samples.
#[derive(Debug, Clone, PartialEq)]
pub struct SweepGuidance {
    /// When guidance acts and how far it may go.
    pub gate: GuidanceConfig,
    /// Which agents the classifier of the behavior judges.
    pub classifier_scope: ClassifierScope,
    /// The classifier output to maximize.
    pub classifier_potential: ClassifierPotential,
    /// Objectives for the trajectories, in addition to a behavior or instead of one.
    pub objectives: Vec<ObjectiveConfig>,
}

/// How a denoiser is sampled.
#[derive(Debug, Clone, PartialEq)]
pub struct Diffusion {
    /// How noise becomes a sample.
    pub sampler: SamplerConfig,
    /// How strongly samples are kept apart and on the road, at every level. 0: not at all.
    pub validity_strength: f64,
    /// The levels of guidance at which each scene is sampled; at least one.
    pub levels: Vec<GuidanceLevel>,
    /// The guidance at strengths other than 0.
    pub guidance: SweepGuidance,
    /// States that samples lean toward.
    pub classifier_free: Option<ClassifierFreeConfig>,
    /// Edits of the recording that samples start from.
    pub edit: Option<EditConfig>,
    /// The parameters of the event for which the template of the requested agents is solved. Empty: there is no
    /// template.
    pub template: &'static [&'static str],
}

impl ResolvedSweep {
    /// How its denoiser is sampled; `None` for the baseline.
    pub const fn diffusion(&self) -> Option<&Diffusion> {
        match &self.model {
            SweepModel::Denoiser(diffusion) | SweepModel::Distilled(diffusion) => Some(diffusion),
            SweepModel::Baseline => None,
        }
    }

    /// Whether its samples come from the distilled denoiser.
    pub const fn uses_distilled(&self) -> bool {
        matches!(self.model, SweepModel::Distilled(_))
    }

    /// Whether its samples are joint futures of the baseline.
    pub const fn uses_baseline(&self) -> bool {
        matches!(self.model, SweepModel::Baseline)
    }

    /// The levels of guidance at which each scene is sampled.
    pub fn levels(&self) -> &[GuidanceLevel] {
        self.diffusion().map_or(&[GuidanceLevel::UNGUIDED], |diffusion| &diffusion.levels)
    }

    /// Whether the requested agents follow a template; it differs from sample to sample.
    pub fn uses_template(&self) -> bool {
        self.diffusion().is_some_and(|diffusion| !diffusion.template.is_empty())
    }

    /// The scene with as many timesteps as maneuvers of its agents may take: those of templates end in the closed loop.
    pub(in crate::generate) fn planned<'s>(&self, scene: &'s Scene) -> Cow<'s, Scene> {
        match &self.rollout {
            Some(rollout) if self.uses_template() && scene.has_future() => {
                Cow::Owned(scene.lasting(rollout.n_timesteps_planned(scene)))
            }
            _ => Cow::Borrowed(scene),
        }
    }

    /// Whether some of its samples are guided by the classifier of its behavior.
    pub fn needs_classifier(&self) -> bool {
        self.behavior.is_some()
            && self.diffusion().is_some_and(|diffusion| {
                diffusion.is_guided() && diffusion.guidance.classifier_scope != ClassifierScope::None
            })
    }

    /// The parameters of the event at which its template and the objectives of its guidance can aim.
    pub(in crate::generate) fn aims_at(&self) -> BTreeSet<&'static str> {
        let guided = self.diffusion().filter(|diffusion| diffusion.is_guided());
        let objectives = guided.into_iter().flat_map(|diffusion| &diffusion.guidance.objectives);
        let of_template = self.diffusion().map_or(&[][..], |diffusion| diffusion.template);
        objectives.flat_map(|objective| objective.objective().aims_at()).chain(of_template).copied().collect()
    }

    /// Whether the requested event is a collision.
    pub(in crate::generate) fn asks_for_collision(&self) -> bool {
        BehaviorEntry::is_collision(self.behavior.as_deref())
    }

    /// Evaluations of the network for one scenario at the most expensive level. Classifier-free guidance doubles them
    /// at weights that mix two estimates, the baseline needs one, and a closed loop as many for each further plan.
    pub fn n_evaluations(&self) -> u64 {
        self.diffusion().map_or(1, |diffusion| {
            let mixes = |level: &GuidanceLevel| ![0.0, 1.0].contains(&level.weight);
            let n_calls = if diffusion.levels.iter().any(mixes) { 2 } else { 1 };
            let n_replans = self.rollout.as_ref().map_or(0, SweepRollout::n_replans);
            diffusion.sampler.n_evaluations() as u64 * (n_calls + n_replans)
        })
    }

    /// Name of its sampler and number of steps, such as `heun-50`; the baseline takes one pass for all samples.
    pub fn sampler_name(&self) -> String {
        self.diffusion().map_or_else(|| "forward-1".to_owned(), |diffusion| diffusion.sampler.name())
    }

    /// Refuses noise levels for which the distilled denoiser was not trained; its answers there would be meaningless.
    /// Sweeps of other models pass.
    pub fn check_distillation(&self, distillation: &Distillation, edm: &Edm) -> Result<(), Error> {
        let SweepModel::Distilled(Diffusion { sampler, edit, .. }) = &self.model else { return Ok(()) };
        let asked = match edit {
            Some(edit) => edit.schedule(edm, sampler),
            None => sampler.schedule(edm, sampler.sigma_start(edm)),
        };
        let Distillation::Steps { sigmas } = distillation;
        match sigmas.ends_with(&asked) {
            true => Ok(()),
            false => Err(Error::Config(format!(
                "sweep {}: the distilled denoiser steps through the noise levels {sigmas:?}, the sweep through \
                 {asked:?}: give it the n_steps and grid of train.distill.method, and edits a tau that is one of these \
                 levels",
                self.name
            ))),
        }
    }
}

impl Diffusion {
    /// Whether some samples are guided.
    pub(in crate::generate) fn is_guided(&self) -> bool {
        self.levels.iter().any(|level| level.strength != 0.0)
    }
}
