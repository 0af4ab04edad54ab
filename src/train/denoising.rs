//! Training the denoiser: the paper's loss over p(𝒪), p_train and the recorded scenes.

use super::{DenoiserTraining, Error, TrainTask};
use crate::diffusion::{Denoiser, NoiseSource, rows_like};
use crate::model::SceneDenoiser;
use crate::scene::{ObservationMask, Scene};
use crate::seed::{Seed, SeededRng};
use crate::tensor::{Collator, FutureValidity, MaskSampler, SceneBatch, SceneView};
use candle_core::{Device, Tensor};
use std::collections::BTreeMap;

/// Scenes by index, such as a store's.
pub trait SceneDataset: Sync {
    /// Number of scenes.
    fn len(&self) -> usize;

    /// Whether there are none.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The scene of this index.
    ///
    /// # Errors
    /// When it cannot be read.
    fn scene(&self, idx: usize) -> Result<Scene, Box<dyn std::error::Error + Send + Sync>>;
}

/// The noise levels at which held-out losses are given: from finest detail to the choice of a maneuver.
const EVALUATION_SIGMAS: [f64; 4] = [0.05, 0.2, 0.8, 3.0];

/// Training of a `SceneDenoiser` on the scenes of a dataset.
pub struct DenoisingTask<'a> {
    /// The denoiser with trainable parameters.
    pub denoiser: &'a SceneDenoiser,
    /// The same parameters without gradients, for evaluation.
    pub frozen: &'a SceneDenoiser,
    /// Settings.
    pub training: &'a DenoiserTraining,
    /// How scenes become batches.
    pub collator: &'a Collator,
    /// The scenes.
    pub dataset: &'a dyn SceneDataset,
    /// Indices of the scenes to train on.
    pub train: &'a [usize],
    /// Indices of the held-out scenes to evaluate on.
    pub held_out: &'a [usize],
    /// Draws masks.
    pub masks: &'a MaskSampler,
    /// Seed of every draw.
    pub seed: Seed,
    /// Where tensors live.
    pub device: &'a Device,
}

/// A scene with the draws of a training step.
struct Drawn {
    scene: Scene,
    ego_idx: usize,
    mask: ObservationMask,
}

impl DenoisingTask<'_> {
    /// Which scenes make the batch of `step`: consecutive entries of a shuffle that each epoch has its own of.
    fn batch_indices(&self, step: u64) -> Vec<usize> {
        let (n, batch_size) = (self.train.len() as u64, self.training.batch_size as u64);
        let mut shuffle: Option<(u64, Vec<usize>)> = None;
        (step * batch_size..(step + 1) * batch_size)
            .map(|position| {
                let (epoch, at) = (position / n, (position % n) as usize);
                let order = match &shuffle {
                    Some((of_epoch, order)) if *of_epoch == epoch => order,
                    _ => {
                        let mut order = self.train.to_vec();
                        self.seed.derive("epoch", &[epoch]).rng().shuffle(&mut order);
                        &shuffle.insert((epoch, order)).1
                    }
                };
                order[at]
            })
            .collect()
    }

    fn draw(&self, scene_idx: usize, rng: &mut SeededRng) -> Result<Drawn, Error> {
        let scene = self.dataset.scene(scene_idx).map_err(Error::Scene)?;
        let ego_idx = draw_ego(&scene, rng);
        let mask = self.masks.sample(&scene, ego_idx, rng);
        Ok(Drawn { scene, ego_idx, mask })
    }

    fn collate(&self, drawn: &[Drawn]) -> Result<SceneBatch, Error> {
        let views: Vec<SceneView<'_>> =
            drawn.iter().map(|d| SceneView { scene: &d.scene, ego_idx: d.ego_idx, mask: &d.mask }).collect();
        Ok(self.collator.collate(&views, FutureValidity::Recorded, self.device)?)
    }

    /// λ(σ) |D(x0 + σ ε; σ) - x0|², averaged over the valid latent scalars of the batch; one σ a row.
    fn weighted_error(
        &self,
        denoiser: &SceneDenoiser,
        batch: &SceneBatch,
        sigmas: &[f64],
        noise: &mut NoiseSource,
    ) -> Result<Tensor, Error> {
        let latent = batch.latent.unsqueeze(3)?;
        let weight: Vec<f64> =
            sigmas.iter().map(|s| denoiser.edm().loss_weight(self.training.loss_weight, *s)).collect();
        let sigma_rows = rows_like(sigmas.to_vec(), &batch.x0)?;
        let noise = noise.draw_like(&batch.x0)?.broadcast_mul(&sigma_rows)?;
        let x = (&batch.x0 + noise)?.broadcast_mul(&latent)?;
        let x0_hat = denoiser.bind(batch, 1)?.denoise(&x, &sigma_rows.flatten_all()?)?;
        let error = (x0_hat - &batch.x0)?.broadcast_mul(&latent)?;
        let mut squared = error.sqr()?;
        if self.training.path_loss > 0.0
            && let Some(path) = batch.unit_path()?
        {
            let path_error = path.matmul(&error)?.broadcast_mul(&latent)?;
            squared = (squared + (path_error.sqr()? * self.training.path_loss)?)?;
        }
        let weighted = squared.broadcast_mul(&rows_like(weight, &batch.x0)?)?;
        let n_latent = (latent.sum_all()? * self.collator.normalizer.state_dim as f64)?.maximum(1.0)?;
        Ok(weighted.sum_all()?.div(&n_latent)?)
    }
}

impl TrainTask for DenoisingTask<'_> {
    fn loss(&self, step: u64) -> Result<Tensor, Error> {
        let indices = self.batch_indices(step);
        let seeds: Vec<Seed> = (0..indices.len() as u64).map(|row| self.seed.derive("row", &[step, row])).collect();
        let mut rngs: Vec<SeededRng> = seeds.iter().map(|seed| seed.derive("draws", &[]).rng()).collect();
        let drawn: Vec<Drawn> =
            indices.iter().zip(&mut rngs).map(|(idx, rng)| self.draw(*idx, rng)).collect::<Result<_, _>>()?;
        let sigmas: Vec<f64> = rngs.iter_mut().map(|rng| self.training.noise.draw(rng)).collect();
        let batch = self.collate(&drawn)?;
        self.weighted_error(self.denoiser, &batch, &sigmas, &mut NoiseSource::new(seeds))
    }

    fn evaluate(&self) -> Result<BTreeMap<String, f64>, Error> {
        let mut sums = [0.0; EVALUATION_SIGMAS.len()];
        let chunks: Vec<&[usize]> = self.held_out.chunks(self.training.batch_size).collect();
        for chunk in &chunks {
            let drawn: Vec<Drawn> = chunk
                .iter()
                .map(|idx| {
                    let scene = self.dataset.scene(*idx).map_err(Error::Scene)?;
                    let mask = ObservationMask::predictive(scene.tracks.len(), scene.n_timesteps, scene.n_history);
                    Ok(Drawn { ego_idx: scene.ego_idx, mask, scene })
                })
                .collect::<Result<_, Error>>()?;
            let batch = self.collate(&drawn)?;
            for (sum, sigma) in sums.iter_mut().zip(EVALUATION_SIGMAS) {
                let seeds = chunk.iter().map(|idx| self.seed.derive("evaluation", &[*idx as u64])).collect();
                let sigmas = vec![sigma; chunk.len()];
                let loss = self.weighted_error(self.frozen, &batch, &sigmas, &mut NoiseSource::new(seeds))?;
                *sum += f64::from(loss.to_scalar::<f32>()?) * chunk.len() as f64;
            }
        }
        let n = self.held_out.len().max(1) as f64;
        let named = |(sigma, sum): (f64, f64)| (format!("held_out_loss_at_sigma_{sigma}"), sum / n);
        Ok(EVALUATION_SIGMAS.into_iter().zip(sums).map(named).collect())
    }
}

/// The ego agent of a training step: the recording's focal agent where it has one, else a random motorized agent that
/// is tracked throughout, else the scene's own choice.
fn draw_ego(scene: &Scene, rng: &mut SeededRng) -> usize {
    use crate::scene::{Dataset, TrackRole};
    let is_labeled = scene.ego().role == TrackRole::Focal && scene.source.dataset != Dataset::Interaction;
    let eligible: Vec<usize> = (0..scene.tracks.len())
        .filter(|idx| {
            let track = &scene.tracks[*idx];
            track.class.is_motorized() && track.trajectory.n_valid() == scene.n_timesteps
        })
        .collect();
    if is_labeled || eligible.is_empty() { scene.ego_idx } else { eligible[rng.below(eligible.len())] }
}
