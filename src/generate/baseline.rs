//! Sweeps of the baseline: its joint futures as samples, the most likely first.

use super::conditioning::Conditioned;
use super::{Error, Generator, ResolvedSweep};
use crate::model::TrainedSceneTransformer;
use crate::scene::Scene;
use crate::tensor::{FutureValidity, SceneView};
use candle_core::Tensor;
use std::ops::Range;

impl<'g> Generator<'g> {
    pub(super) fn baseline(&self, sweep: &ResolvedSweep) -> Result<&'g TrainedSceneTransformer, Error> {
        self.models.baseline.ok_or_else(|| {
            let why = "model = \"baseline\" needs a trained baseline; add a section [train.baseline]";
            Error::Config(format!("sweep {}: {why}", sweep.name))
        })
    }

    /// Refuses a baseline that has too few futures, or that was trained on a different kind of scenes than the
    /// denoiser.
    pub(super) fn check_baseline(&self, sweep: &ResolvedSweep) -> Result<(), Error> {
        if !sweep.uses_baseline() {
            return Ok(());
        }
        let baseline = self.baseline(sweep)?;
        let refuse = |why: String| Err(Error::Config(format!("sweep {}: {why}", sweep.name)));
        let (own, denoiser) = (&baseline.spec, self.spec());
        let n_modes = own.network.n_modes;
        if sweep.n_samples > n_modes {
            let n_samples = sweep.n_samples;
            return refuse(format!("n_samples is {n_samples}, but the baseline has {n_modes} joint futures"));
        }
        let is_alike = (own.n_history, own.n_timesteps) == (denoiser.n_history, denoiser.n_timesteps)
            && (own.dt_s - denoiser.dt_s).abs() < 1e-6;
        if !is_alike {
            return refuse("the baseline and the denoiser were trained on scenes with different timesteps".to_owned());
        }
        Ok(())
    }

    /// The futures with these numbers, counted from the most likely, for each of the given scenes, with their
    /// probabilities: all of the first scene, then all of the next.
    pub(super) fn predict(
        &self,
        sweep: &ResolvedSweep,
        given: &[&Conditioned],
        samples: Range<usize>,
    ) -> Result<Vec<(Scene, f64)>, Error> {
        let baseline = self.baseline(sweep)?;
        let views: Vec<SceneView<'_>> = given.iter().map(|given| given.view()).collect();
        let batch = baseline.spec.collator().collate(&views, FutureValidity::Everything, self.device)?;
        let futures = baseline.network.forward(&batch)?;
        let (n_modes, n_samples) = (baseline.network.n_modes(), samples.len());
        let mut rows = Vec::new();
        let mut probabilities = Vec::new();
        for (row, ranked) in futures.ranked()?.into_iter().enumerate() {
            for (mode, probability) in ranked.into_iter().skip(samples.start).take(n_samples) {
                rows.push((row * n_modes + mode) as u32);
                probabilities.push(probability);
            }
        }
        let x0 = futures.x0.index_select(&Tensor::new(rows, self.device)?, 0)?;
        let sources: Vec<&Scene> =
            given.iter().flat_map(|given| std::iter::repeat_n(&given.scene, n_samples)).collect();
        let scenes = batch.repeated(n_samples)?.decode_scenes(&x0, &sources)?;
        Ok(scenes.into_iter().zip(probabilities).collect())
    }
}
