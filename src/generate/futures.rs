//! Samples one unguided future of a scene at a time, for closed loops.

use super::batch::Batch;
use super::conditioning::Conditioned;
use super::{Cell, Error, GenerateConfig, Generator, Models, ResolvedGeneration, ResolvedSweep, SweepModel};
use crate::metrics::MetricSettings;
use crate::model::{Distillation, TrainedDenoiser};
use crate::progress::Silent;
use crate::scene::{GuidanceLevel, ObservationMask, Roles, Scene, UnfitScene};
use crate::tensor::Collator;
use candle_core::Device;
use serde_json::json;
use std::sync::Arc;

/// Samples futures of scenes, one scene at a time: kept apart and on the road as samples of sweeps are, but not guided.
/// A scene is denoised alone, because matrix products of several rows round differently.
pub struct Futures<'a> {
    model: &'a TrainedDenoiser,
    config: ResolvedGeneration,
    metric_settings: MetricSettings,
    device: &'a Device,
    collator: Arc<Collator>,
}

/// A scene to be continued.
#[derive(Debug, Clone, Copy)]
pub struct Continued<'a> {
    /// The scene, with as many timesteps as the model has.
    pub scene: &'a Scene,
    /// The observed states. Agents without a state at present stay away.
    pub mask: &'a ObservationMask,
    /// The agent at the origin of the model's frame.
    pub center_idx: usize,
    /// Names the stream of noise, together with `step`. Within it, noise belongs to the index of an agent.
    pub name: &'a str,
    /// See `name`.
    pub step: usize,
}

impl<'a> Futures<'a> {
    /// Futures by `model`: a distilled one takes the steps that it was distilled for, any other ten steps of
    /// DPM-Solver++.
    ///
    /// # Errors
    /// When the model cannot be sampled in this way.
    pub fn new(model: &'a TrainedDenoiser, seed: u64, device: &'a Device) -> Result<Self, Error> {
        let sampler = match &model.spec.distillation {
            Some(Distillation::Steps { sigmas }) => {
                let n_steps = sigmas.len().saturating_sub(1);
                let last = sigmas.get(n_steps.saturating_sub(1));
                let grid = json!({ "sigma_max": sigmas.first(), "sigma_min": last });
                json!({ "kind": "euler", "n_steps": n_steps, "grid": grid })
            }
            None => json!({ "kind": "dpmpp_2m", "n_steps": 10, "grid": { "sigma_max": 30.0, "sigma_min": 0.05 } }),
        };
        let kind = if model.spec.distillation.is_some() { "distilled" } else { "denoiser" };
        let sweep = json!({ "name": "futures", "model": kind, "sampler": sampler, "n_scenes": 1, "n_samples": 1 });
        let config: GenerateConfig = serde_json::from_value(json!({ "seed": seed, "sweeps": [sweep] }))
            .map_err(|error| Error::Config(error.to_string()))?;
        let config = config.resolve(&[])?;
        let (metric_settings, collator) = (MetricSettings::default(), Arc::new(model.spec.sampling_collator()));
        let futures = Self { model, config, metric_settings, device, collator };
        futures.generator(&|_| Err("futures load no scenes".into())).check_all()?;
        Ok(futures)
    }

    /// Timesteps that the model observes.
    pub const fn n_history(&self) -> usize {
        self.model.spec.n_history
    }

    /// Timesteps that it observes and generates.
    pub const fn n_timesteps(&self) -> usize {
        self.model.spec.n_timesteps
    }

    /// Time between them, seconds.
    pub const fn dt_s(&self) -> f64 {
        self.model.spec.dt_s
    }

    /// The seed of everything random.
    pub const fn seed(&self) -> u64 {
        self.config.seed
    }

    /// Hash of the model's file.
    pub fn fingerprint(&self) -> &str {
        &self.model.fingerprint
    }

    /// A future of everybody; the inner error tells why there is none, such as states that are not finite.
    pub fn sample(&self, asked: &Continued<'_>) -> Result<Result<Scene, UnfitScene>, Error> {
        let sampled = self.several(asked, 1)?.pop();
        Ok(sampled.unwrap_or_else(|| Err(UnfitScene("has no agent to continue".to_owned()))))
    }

    /// `n` futures, each with a stream of noise of its own: those of this step and the next ones.
    pub fn several(&self, asked: &Continued<'_>, n: usize) -> Result<Vec<Result<Scene, UnfitScene>>, Error> {
        let loader = |_| Err("futures load no scenes".into());
        let generator = self.generator(&loader);
        let Some(sweep) = self.config.sweeps.first() else { return Err(Error::Config("no sweep".to_owned())) };
        let scene_id = asked.name.into();
        let cell = Cell { scene_idx: 0, scene_id, roles: Roles::default(), targets: Vec::new() };
        let given = Conditioned::new(asked.scene.clone(), asked.mask.clone(), asked.center_idx);
        let batch = Batch { sweep, cells: vec![(&cell, &given)], samples: asked.step..asked.step + n };
        let drawn = generator.sample(&batch, &[GuidanceLevel::UNGUIDED], &Silent)?;
        Ok(drawn.into_iter().flatten().map(|draw| draw.map(|draw| draw.scene)).collect())
    }

    fn generator<'b>(&'b self, scenes: &'b super::SceneLoader<'b>) -> Generator<'b> {
        Generator {
            config: &self.config,
            models: Models { denoiser: self.model, classifiers: &[], distilled: Some(self.model), baseline: None },
            behaviors: &[],
            scenes,
            metric_settings: self.metric_settings.clone(),
            device: self.device,
            collator: self.collator.clone(),
        }
    }
}

impl<'a> Generator<'a> {
    /// Futures by the denoiser of a sweep, sampled as the sweep is but for its guidance.
    ///
    /// # Errors
    /// When there is no such model, or it cannot be sampled in this way.
    pub fn futures(&self, sweep: &ResolvedSweep) -> Result<Futures<'a>, Error> {
        let (metric_settings, collator) = (self.metric_settings.clone(), Arc::clone(&self.collator));
        let own = Futures::new(self.denoiser(sweep)?, self.config.seed, self.device)?;
        let mut futures = Futures { metric_settings, collator, ..own };
        for plain in &mut futures.config.sweeps {
            if let (SweepModel::Denoiser(plain) | SweepModel::Distilled(plain), Some(own)) =
                (&mut plain.model, sweep.diffusion())
            {
                (plain.sampler, plain.validity_strength) = (own.sampler, own.validity_strength);
            }
        }
        Ok(futures)
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::denoiser;
    use super::*;
    use crate::guidance::testing::scene;

    #[test]
    fn a_future_depends_on_seed_name_and_step_alone_and_noise_belongs_to_the_agent() {
        let model = denoiser(0);
        let futures = Futures::new(&model, 3, &Device::Cpu).unwrap();
        let scene = scene(0);
        let mask = ObservationMask::predictive(scene.tracks.len(), scene.n_timesteps, scene.n_history);
        let sampled = |futures: &Futures<'_>, name: &str, step: usize| {
            futures.sample(&Continued { scene: &scene, mask: &mask, center_idx: 0, name, step }).unwrap().unwrap()
        };
        let first = sampled(&futures, "a", 10);
        assert_eq!(first, sampled(&futures, "a", 10));
        assert!(first != sampled(&futures, "a", 15) && first != sampled(&futures, "b", 10));
        assert!(first != sampled(&Futures::new(&model, 4, &Device::Cpu).unwrap(), "a", 10));
        assert_eq!((first.n_timesteps, futures.seed()), (scene.n_timesteps, 3));
        let model = denoiser(1);
        let broken = Futures::new(&model, 3, &Device::Cpu).unwrap();
        let asked = Continued { scene: &scene, mask: &mask, center_idx: 0, name: "a", step: 10 };
        assert!(broken.sample(&asked).unwrap().unwrap_err().0.contains("not finite"));
    }
}
