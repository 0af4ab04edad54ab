//! Steers a batch beside its guidance: by resampling particles, and by optimizing the noise it starts from.

use super::guide::{Guided, rules_of_traffic};
use super::{Error, Generator};
use crate::diffusion::Denoiser;
use crate::guidance::{CleanPotential, ObjectiveConfig, ObjectiveSum, Particles, SceneContext};
use crate::seed::Seed;
use candle_core::Tensor;

impl<'a> Guided<'a> {
    /// The weighted sum of objectives for the rows of the batch.
    pub(super) const fn objectives<'o>(
        &self,
        objectives: &'o [ObjectiveConfig],
        context: &'o SceneContext,
    ) -> ObjectiveSum<'o>
    where
        'a: 'o,
    {
        ObjectiveSum { objectives, batch: self.repeated, context }
    }
}

impl Generator<'_> {
    /// The groups of particles of a batch; `None` if its samples stand alone. The draws of a group depend on the run's
    /// seed, the scene, the requested agents and the group's first sample alone.
    pub(super) fn particles<'a>(
        &self,
        guided: &Guided<'a>,
        objectives: &'a dyn CleanPotential,
    ) -> Option<Particles<'a>> {
        let config = guided.diffusion.particles.as_ref()?;
        let seeds = guided.cells.iter().flat_map(|(cell, _)| {
            let mut seed = self.scene_seed(cell);
            for (role, track) in cell.roles.iter() {
                seed = seed.derive_named(role, &track.0);
            }
            let firsts = guided.samples.clone().step_by(config.n);
            firsts.map(move |first| seed.derive("group", &[first as u64])).collect::<Vec<Seed>>()
        });
        Some(Particles::new(config, objectives, seeds.collect()))
    }

    /// The noise `z` (B, A, T, D), optimized if the sweep says so: by its objectives and the rules of traffic, through the
    /// steps of `denoiser` without guidance.
    pub(super) fn optimized(
        &self,
        guided: &Guided<'_>,
        denoiser: &dyn Denoiser,
        sigmas: &[f64],
        z: Tensor,
    ) -> Result<Tensor, Error> {
        let Some(config) = &guided.diffusion.noise_optimization else { return Ok(z) };
        let mut objectives = guided.diffusion.guidance.objectives.clone();
        if guided.diffusion.validity_strength != 0.0 {
            objectives.extend(rules_of_traffic(guided.sweep));
        }
        let context = guided.objective_context()?;
        Ok(config.optimize(sigmas, denoiser, &guided.objectives(&objectives, &context), &z)?)
    }
}
