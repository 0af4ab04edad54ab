//! Which scenes, seen by whom and with which states hidden, make the batch of a training step? The same for every model of
//! scenes.

use super::Error;
use crate::scene::{ObservationMask, Scene};
use crate::seed::{Seed, SeededRng};
use crate::tensor::{Collator, FutureValidity, MaskSampler, SceneBatch, SceneView};
use candle_core::Device;

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

/// Draws batches of training scenes, and takes held-out ones as they are.
pub struct SceneDraws<'a> {
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
    /// Scenes of a batch.
    pub batch_size: usize,
    /// Seed of every draw.
    pub seed: Seed,
    /// Where tensors live.
    pub device: &'a Device,
}

/// The batch of a training step.
pub struct DrawnBatch {
    /// The scenes.
    pub batch: SceneBatch,
    /// The seed of each row.
    pub seeds: Vec<Seed>,
    /// The generator of each row, after what was drawn for its scene.
    pub rngs: Vec<SeededRng>,
}

/// A scene with the draws of a training step.
struct Drawn {
    scene: Scene,
    ego_idx: usize,
    mask: ObservationMask,
}

impl SceneDraws<'_> {
    /// The batch of `step`.
    ///
    /// # Errors
    /// When a scene cannot be loaded.
    pub fn training_batch(&self, step: u64) -> Result<DrawnBatch, Error> {
        let indices = self.batch_indices(step);
        let seeds: Vec<Seed> = (0..indices.len() as u64).map(|row| self.seed.derive("row", &[step, row])).collect();
        let mut rngs: Vec<SeededRng> = seeds.iter().map(|seed| seed.derive("draws", &[]).rng()).collect();
        let drawn: Vec<Drawn> =
            indices.iter().zip(&mut rngs).map(|(idx, rng)| self.draw(*idx, rng)).collect::<Result<_, _>>()?;
        Ok(DrawnBatch { batch: self.collate(&drawn)?, seeds, rngs })
    }

    /// The held-out scenes, a batch at a time.
    pub fn held_out_chunks(&self) -> impl Iterator<Item = &[usize]> {
        self.held_out.chunks(self.batch_size)
    }

    /// The scenes of these indices with their histories observed, each around its own ego agent.
    ///
    /// # Errors
    /// When a scene cannot be loaded.
    pub fn predictive_batch(&self, indices: &[usize]) -> Result<SceneBatch, Error> {
        let predictive = |idx: &usize| {
            let scene = self.dataset.scene(*idx).map_err(Error::Scene)?;
            let mask = ObservationMask::predictive(scene.tracks.len(), scene.n_timesteps, scene.n_history);
            Ok(Drawn { ego_idx: scene.ego_idx, mask, scene })
        };
        self.collate(&indices.iter().map(predictive).collect::<Result<Vec<_>, Error>>()?)
    }

    /// Which scenes make the batch of `step`: consecutive entries of a shuffle that each epoch has its own of.
    fn batch_indices(&self, step: u64) -> Vec<usize> {
        let (n, batch_size) = (self.train.len() as u64, self.batch_size as u64);
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
