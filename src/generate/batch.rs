//! How does a batch become samples? Its cells are denoised together, or predicted by the baseline, and decoded.

use super::conditioning::{Conditioned, Wanted, noisy_guide, without_wanted_velocities};
use super::guide::Guided;
use super::{Cell, ClassifierFreeConfig, Diffusion, Error, Generator, ResolvedSweep};
use crate::diffusion::{Denoiser, NoiseSource, Step};
use crate::guidance::{ClassifierFreeDenoiser, ForwardDenoiser, MaskChange, RememberingDenoiser};
use crate::progress::Progress;
use crate::scene::{GuidanceLevel, Scene, UnfitScene};
use crate::tensor::{FutureValidity, LeastProgress, SceneBatch, SceneView};
use candle_core::Tensor;
use std::ops::Range;

/// The cells of one batch with their conditioning, and the samples of each.
pub(super) struct Batch<'a> {
    pub(super) sweep: &'a ResolvedSweep,
    pub(super) cells: Vec<(&'a Cell, &'a Conditioned)>,
    pub(super) samples: Range<usize>,
}

/// The results of a batch at one level: of all samples of its first cell, then of all of the next.
pub(super) type Draws = Vec<Result<Draw, UnfitScene>>;

/// The result of one sample.
#[derive(Debug, Clone)]
pub(super) struct Draw {
    pub(super) scene: Scene,
    /// Its probability, where it has one.
    pub(super) probability: Option<f64>,
}

impl Generator<'_> {
    /// The samples of a batch at each of these strengths or weights.
    pub(super) fn sample(
        &self,
        batch: &Batch<'_>,
        levels: &[GuidanceLevel],
        progress: &dyn Progress,
    ) -> Result<Vec<Draws>, Error> {
        match batch.sweep.diffusion() {
            Some(diffusion) => self.sample_denoiser(batch, diffusion, levels, progress),
            None => levels.iter().map(|_| self.sample_baseline(batch, progress)).collect(),
        }
    }

    fn sample_baseline(&self, batch: &Batch<'_>, progress: &dyn Progress) -> Result<Draws, Error> {
        let given: Vec<&Conditioned> = batch.cells.iter().map(|(_, given)| *given).collect();
        let predicted = self.predict(batch.sweep, &given, batch.samples.clone())?;
        progress.advance(predicted.len() as u64);
        let draw = |(scene, probability)| Ok(Draw { scene: checked(scene)?, probability: Some(probability) });
        Ok(predicted.into_iter().map(draw).collect())
    }

    fn sample_denoiser(
        &self,
        batch: &Batch<'_>,
        diffusion: &Diffusion,
        levels: &[GuidanceLevel],
        progress: &dyn Progress,
    ) -> Result<Vec<Draws>, Error> {
        let agents: Vec<(usize, usize)> = batch.cells.iter().map(|(_, given)| given.agents).collect();
        let views: Vec<SceneView<'_>> = batch.cells.iter().map(|(_, given)| given.view()).collect();
        let tensors = self.collator.collate(&views, FutureValidity::Everything, self.device)?;
        let n_samples = batch.samples.len();
        let denoiser = self.denoiser(batch.sweep)?;
        let bound = denoiser.network.bind(&tensors, n_samples)?;
        let remembering = RememberingDenoiser::new(&bound);
        // Comparing states would wait for a GPU.
        let shares = levels.len() > 1 && self.device.is_cpu();
        let bound: &dyn Denoiser = if shares { &remembering } else { &bound };
        let (own, tensors) = (&tensors, tensors.repeated(n_samples)?);
        let cells: Vec<(&Cell, &Scene)> = batch.cells.iter().map(|(cell, given)| (*cell, &given.scene)).collect();
        let guided_at = |level: GuidanceLevel| Guided {
            sweep: batch.sweep,
            diffusion,
            level,
            cells: &cells,
            agents: &agents,
            batch: own,
            repeated: &tensors,
            samples: batch.samples.clone(),
            places_without_road: &self.metric_settings.map_gaps.places,
        };
        let given: Vec<&Scene> = batch.cells.iter().map(|(_, given)| &given.scene).collect();
        let least = LeastProgress::new(own, &given, n_samples)?;
        let sources: Vec<&Scene> =
            batch.cells.iter().flat_map(|(_, given)| std::iter::repeat_n(&given.scene, n_samples)).collect();
        let at_level = |level: &GuidanceLevel| {
            let guided = guided_at(*level);
            let denoise = |denoiser: &dyn Denoiser| self.denoise(&guided, denoiser, progress);
            let forward = |inner: &dyn Denoiser| match &least {
                Some(least) => self.guided(&guided, &ForwardDenoiser { inner, batch: &tensors, least }, denoise),
                None => self.guided(&guided, inner, denoise),
            };
            let x = match diffusion.classifier_free.as_ref().filter(|_| level.weight != 0.0) {
                Some(config) => {
                    let extended = self.wanted_states(config, batch, own)?;
                    let change = MaskChange::new(&tensors, &extended)?;
                    let conditional = denoiser.network.bind(&extended, 1)?;
                    let (conditional, change, weight) = (&conditional, &change, level.weight);
                    forward(&ClassifierFreeDenoiser { unconditional: bound, conditional, change, weight })?
                }
                None => forward(bound)?,
            };
            remembering.begin_again();
            let scenes = tensors.decode_scenes(&x, &sources)?;
            progress.advance(scenes.len() as u64);
            let draw = |scene| Ok(Draw { scene: checked(scene)?, probability: None });
            Ok(scenes.into_iter().map(draw).collect())
        };
        levels.iter().map(at_level).collect()
    }

    /// The samples of a batch, one a row, with their target states observed as well.
    fn wanted_states(
        &self,
        config: &ClassifierFreeConfig,
        batch: &Batch<'_>,
        base: &SceneBatch,
    ) -> Result<SceneBatch, Error> {
        let mut wanted = Vec::new();
        for (row, (cell, given)) in batch.cells.iter().enumerate() {
            let of_cell = self.wanted_of_cell(config, (*cell, *given), batch.samples.clone(), (base, row))?;
            wanted.extend(of_cell.into_iter().map(|wanted| (wanted, given.agents.0)));
        }
        let views: Vec<SceneView<'_>> = wanted
            .iter()
            .map(|(Wanted { scene, mask }, ego_idx)| SceneView { scene, ego_idx: *ego_idx, mask })
            .collect();
        let extended = self.collator.collate(&views, FutureValidity::Everything, self.device)?;
        match config.mask_velocity {
            true => without_wanted_velocities(&extended, &base.repeated(batch.samples.len())?),
            false => Ok(extended),
        }
    }

    /// Diffused states (B, A, T, D) of all samples of a batch.
    fn denoise(&self, guided: &Guided<'_>, denoiser: &dyn Denoiser, progress: &dyn Progress) -> Result<Tensor, Error> {
        // A sample's noise depends on the run's seed, the scene and the sample alone: all strengths of a scene start
        // from the same noise, whatever the batches and shards.
        let seeds = guided.cells.iter().flat_map(|(cell, _)| {
            let scene_seed = self.seed().derive_named("noise", &cell.scene_id.0);
            guided.samples.clone().map(move |sample_idx| scene_seed.derive("sample", &[sample_idx as u64]))
        });
        let mut noise = NoiseSource::new(seeds.collect());
        let like = &guided.repeated.x0;
        let mut observer = |step: &Step<'_>| progress.note(&format!("step {} of {}", step.step_idx + 1, step.n_steps));
        let edm = &self.spec().edm;
        let Diffusion { sampler, edit, .. } = guided.diffusion;
        if let Some(edit) = edit.as_ref().filter(|edit| edit.keeps_guide(edm)) {
            let x = noisy_guide(edit, like, &mut noise)?;
            return Ok(sampler.integrate(&edit.schedule(edm, sampler), denoiser, x, &mut observer)?);
        }
        Ok(sampler.sample(edm, denoiser, &like.dims()[1..], like, &mut noise, &mut observer)?)
    }
}

/// The scene, if all of its states are finite.
fn checked(scene: Scene) -> Result<Scene, UnfitScene> {
    for track in &scene.tracks {
        if let Some((timestep, _)) = track.trajectory.valid().find(|(_, state)| !state.is_finite()) {
            return Err(UnfitScene(format!("track {} is not finite at timestep {timestep}", track.id)));
        }
    }
    Ok(scene)
}
