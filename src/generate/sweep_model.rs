//! Which model does a sweep sample from, and what can it not ask of it?

use super::{Error, GenerateConfig, SweepConfig};
use crate::diffusion::{Edm, SamplerConfig};
use crate::model::Distillation;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Which model the samples of a sweep come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SweepModel {
    /// The denoiser: samples are independent draws, as many as wanted.
    #[default]
    Denoiser,
    /// The denoiser of `[train.distill]`, in few evaluations: with `sampler = { kind = "euler" }` and the `n_steps` and `grid` of
    /// `train.distill.method`, or `{ kind = "consistency", sigma_max = 24, levels = [4.0] }` for a consistency model.
    Distilled,
    /// Scene Transformer of `[train.baseline]`: samples are its joint futures, the likeliest first, with their probabilities.
    Baseline,
}

impl SweepConfig {
    /// Whether its samples are of the distilled denoiser.
    pub fn uses_distilled(&self) -> bool {
        self.model == SweepModel::Distilled
    }

    /// Whether its samples are joint futures of the baseline.
    pub fn uses_baseline(&self) -> bool {
        self.model == SweepModel::Baseline
    }

    /// Says what the model cannot do, sampled in this way.
    pub(super) fn check_model(&self, sampler: &SamplerConfig) -> Result<(), String> {
        let beyond = [
            (self.is_guided(), "strengths other than 0"),
            (!self.objectives.is_empty(), "objectives"),
            (self.validity_strength.is_some_and(|strength| strength != 0.0), "validity_strength"),
            (self.classifier_free.is_some(), "classifier_free"),
            (self.edit.is_some(), "edit"),
        ];
        match (self.model, sampler) {
            (SweepModel::Denoiser, SamplerConfig::Consistency(_)) => {
                return Err(
                    "sampler.kind = \"consistency\" makes blurred samples of an ordinary denoiser; use it with \
                            model = \"distilled\""
                        .to_owned(),
                );
            }
            (SweepModel::Distilled, SamplerConfig::Heun(_) | SamplerConfig::Dpmpp2m(_)) => {
                return Err("a distilled denoiser does not answer with a mean, which other samplers take for one: what they make is far too \
                            wide; give the sweep sampler = { kind = \"euler\", n_steps = 2, grid = … } as in train.distill.method, or \
                            { kind = \"consistency\", sigma_max = 24, levels = [4.0] } for a consistency model"
                    .to_owned());
            }
            _ => {}
        }
        if self.uses_distilled() && self.guides_through_network() {
            return Err("objective_guidance.gradient = \"through_network\" supposes the mean that a distilled denoiser does not \
                        give; use \"clean\""
                .to_owned());
        }
        match beyond.iter().find(|(is_asked, _)| self.uses_baseline() && *is_asked) {
            Some((_, what)) => Err(format!(
                "model = \"baseline\" cannot be combined with {what}: Scene Transformer predicts in one pass, in which nothing \
                 can be guided; use a sweep of the denoiser"
            )),
            None => Ok(()),
        }
    }

    /// Refuses noise levels that the distilled denoiser was not made for: what it answers there means something else. Sweeps of
    /// other models are not looked at.
    ///
    /// # Errors
    /// When there are such.
    pub fn check_distillation(
        &self,
        config: &GenerateConfig,
        distillation: &Distillation,
        edm: &Edm,
    ) -> Result<(), Error> {
        if !self.uses_distilled() {
            return Ok(());
        }
        let sampler = self.sampler(config);
        let asked = match &self.edit {
            Some(edit) => edit.schedule(edm, sampler),
            None => sampler.schedule(edm, sampler.sigma_start(edm)),
        };
        let refuse = |why: String| Err(Error::Config(format!("sweep {}: {why}", self.name)));
        match (distillation, sampler) {
            (Distillation::Steps { sigmas }, SamplerConfig::Euler(_)) if !sigmas.ends_with(&asked) => refuse(format!(
                "the distilled denoiser steps through the noise levels {sigmas:?}, the sweep through {asked:?}: give it the n_steps and \
                 grid of train.distill.method, and edits a tau that is one of these levels"
            )),
            (Distillation::Steps { sigmas }, SamplerConfig::Consistency(_)) => refuse(format!(
                "the denoiser was distilled to Euler's steps through {sigmas:?}: give the sweep sampler = {{ kind = \"euler\" }} with the \
                 n_steps and grid of train.distill.method"
            )),
            (Distillation::Consistency, SamplerConfig::Euler(_)) => refuse(
                "the denoiser was distilled to a consistency model: give the sweep sampler = { kind = \"consistency\", sigma_max = 24, \
                 levels = [4.0] }"
                    .to_owned(),
            ),
            _ => Ok(()),
        }
    }
}
