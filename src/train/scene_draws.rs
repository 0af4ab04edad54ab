//! Draws the batch of a training step: scenes, ego agents and masks. All models of scenes share it.

use super::Error;
use super::degraded::degraded;
use crate::guidance::{ContextRow, SceneContext};
use crate::scene::{ObservationMask, Roles, Scene};
use crate::seed::{Seed, SeededRng};
use crate::tensor::{Collator, FutureValidity, MaskSampler, SceneBatch, SceneView};
use candle_core::{Device, Tensor};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

/// Scenes by index, such as a store's.
pub trait SceneDataset: Sync {
    /// The scene of this index.
    fn scene(&self, idx: usize) -> Result<Scene, Box<dyn std::error::Error + Send + Sync>>;
}

/// Draws batches of training scenes, and collates held-out ones.
pub struct SceneDraws<'a> {
    /// How scenes become batches.
    pub collator: &'a Collator,
    /// The scenes.
    pub dataset: &'a dyn SceneDataset,
    /// The scenes to train on.
    pub train: &'a [WeightedGroups],
    /// Indices of the held-out scenes to evaluate on.
    pub held_out: &'a [usize],
    /// Draws masks.
    pub masks: &'a MaskSampler,
    /// Scenes of a batch.
    pub batch_size: usize,
    /// Whether batches come with the context of objectives.
    pub with_context: bool,
    /// Seed of every draw.
    pub seed: Seed,
    /// Where tensors live.
    pub device: &'a Device,
    /// The cache from step to step; empty at first.
    pub ahead: Prefetched,
}

/// Scenes to train on, by index, in groups with equal weight.
#[derive(Debug, Clone, PartialEq)]
pub struct WeightedGroups {
    /// How often one of them is drawn, relative to other sources.
    pub weight: f64,
    /// The groups; none of them is empty.
    pub groups: Vec<Vec<usize>>,
}

impl WeightedGroups {
    /// One group of scenes.
    pub fn single(scenes: Vec<usize>) -> Self {
        Self { weight: 1.0, groups: vec![scenes] }
    }
}

/// Changes the scene of this index.
type SceneChange<'a> = &'a dyn Fn(usize, Scene) -> Scene;

/// Batches made in advance, which does not change results.
#[derive(Default)]
pub struct Prefetched {
    /// The last epoch of each group and its shuffle.
    shuffles: Mutex<BTreeMap<usize, Shuffle>>,
    batch: Mutex<Option<(u64, DrawnBatch)>>,
}

/// An epoch of a group, and the order of its scenes.
type Shuffle = (u64, Arc<[usize]>);

/// The batch of a training step, or of an evaluation.
pub struct DrawnBatch {
    /// The scenes.
    pub batch: SceneBatch,
    /// The context of objectives, if requested.
    pub context: Option<SceneContext>,
    /// The seed of each row.
    pub seeds: Vec<Seed>,
    /// The generator of each row, after the draws for its scene.
    pub rngs: Vec<SeededRng>,
}

/// A scene with the draws of a training step.
struct Drawn {
    scene: Scene,
    ego_idx: usize,
    mask: ObservationMask,
}

impl SceneDraws<'_> {
    /// The batch of `step`: the one that [`prepare`](Self::prepare) made, or a new one.
    pub fn training_batch(&self, step: u64) -> Result<DrawnBatch, Error> {
        let kept = self.ahead.batch.lock().unwrap_or_else(PoisonError::into_inner).take();
        kept.filter(|(of_step, _)| *of_step == step).map_or_else(|| self.draw_rows(step), |(_, batch)| Ok(batch))
    }

    /// Makes the batch of `step` in advance.
    pub fn prepare(&self, step: u64) -> Result<(), Error> {
        let batch = self.draw_rows(step)?;
        *self.ahead.batch.lock().unwrap_or_else(PoisonError::into_inner) = Some((step, batch));
        Ok(())
    }

    fn draw_rows(&self, step: u64) -> Result<DrawnBatch, Error> {
        let indices = self.batch_indices(step);
        let seeds: Vec<Seed> = (0..indices.len()).map(|row| self.seed.derive("row", &[step, row as u64])).collect();
        let mut rngs: Vec<SeededRng> = seeds.iter().map(|seed| seed.derive("draws", &[]).rng()).collect();
        let drawn = indices.par_iter().zip(&mut rngs).map(|(idx, rng)| self.draw(*idx, rng));
        let drawn: Vec<Drawn> = drawn.collect::<Result<_, _>>()?;
        self.collate(&drawn, seeds, rngs)
    }

    /// The scenes of these indices after `change`, with their histories observed, each around its own ego agent.
    fn held_out_batch(&self, indices: &[usize], change: SceneChange<'_>) -> Result<DrawnBatch, Error> {
        let predictive = |idx: &usize| {
            let scene = change(*idx, self.dataset.scene(*idx).map_err(Error::Scene)?);
            let mask = ObservationMask::predictive(scene.tracks.len(), scene.n_timesteps, scene.n_history);
            Ok(Drawn { ego_idx: scene.ego_idx, mask, scene })
        };
        let drawn = indices.iter().map(predictive).collect::<Result<Vec<_>, Error>>()?;
        let seeds: Vec<Seed> = indices.iter().map(|idx| self.seed.derive("evaluation", &[*idx as u64])).collect();
        let rngs = seeds.iter().map(|seed| seed.rng()).collect();
        self.collate(&drawn, seeds, rngs)
    }

    /// The means of `n` scalar figures over batches of held-out scenes, weighted by their number of scenes and degraded
    /// like training scenes. The seeds of a batch are the same whenever it is evaluated.
    pub fn held_out_means(
        &self,
        n: usize,
        figures: impl Fn(&DrawnBatch) -> Result<Vec<Tensor>, Error>,
    ) -> Result<Vec<f64>, Error> {
        let seen = |idx: usize, scene| self.seen(scene, &mut self.seed.derive("degraded", &[idx as u64]).rng());
        self.changed_means(self.held_out, n, &seen, figures)
    }

    /// [`Self::held_out_means`] over these held-out scenes as recorded, after `change`.
    pub fn changed_means(
        &self,
        scenes: &[usize],
        n: usize,
        change: SceneChange<'_>,
        figures: impl Fn(&DrawnBatch) -> Result<Vec<Tensor>, Error>,
    ) -> Result<Vec<f64>, Error> {
        let mut sums = vec![0.0; n];
        for chunk in scenes.chunks(self.batch_size) {
            for (sum, figure) in sums.iter_mut().zip(figures(&self.held_out_batch(chunk, change)?)?) {
                *sum += f64::from(figure.to_scalar::<f32>()?) * chunk.len() as f64;
            }
        }
        let n_scenes = scenes.len().max(1) as f64;
        Ok(sums.into_iter().map(|sum| sum / n_scenes).collect())
    }

    /// The scenes of the batch of `step`.
    pub(super) fn batch_indices(&self, step: u64) -> Vec<usize> {
        let batch_size = self.batch_size as u64;
        (step * batch_size..(step + 1) * batch_size).filter_map(|position| self.scene_at(position)).collect()
    }

    /// The scene at a position of the training. Sources alternate as evenly as their weights allow (of the first n
    /// positions, a source with the share w has ⌊n w⌋, and the others divide the rest likewise), their groups take
    /// turns, and each group yields consecutive entries of a shuffle, a new one for each of its epochs.
    fn scene_at(&self, position: u64) -> Option<usize> {
        let (last, others) = self.train.split_last()?;
        let (mut place, mut first_group) = (position, 0);
        let mut rest: f64 = self.train.iter().map(|source| source.weight).sum();
        for source in others {
            let share = source.weight / rest;
            let before = (place as f64 * share).floor() as u64;
            if ((place + 1) as f64 * share).floor() as u64 > before {
                return Some(self.member_of(&source.groups, first_group, before));
            }
            place -= before;
            rest -= source.weight;
            first_group += source.groups.len();
        }
        Some(self.member_of(&last.groups, first_group, place))
    }

    /// The member whose turn it is in some groups, the first of which has the number `first_group`.
    fn member_of(&self, groups: &[Vec<usize>], first_group: usize, turn: u64) -> usize {
        let (group, turn) = ((turn % groups.len() as u64) as usize, turn / groups.len() as u64);
        let n = groups[group].len() as u64;
        self.shuffle_of(first_group + group, &groups[group], turn / n)[(turn % n) as usize]
    }

    /// The scenes of a group, in the order of one of its epochs. Groups are numbered through all sources.
    fn shuffle_of(&self, group: usize, scenes: &[usize], epoch: u64) -> Arc<[usize]> {
        let mut shuffles = self.ahead.shuffles.lock().unwrap_or_else(PoisonError::into_inner);
        match shuffles.get(&group) {
            Some((of_epoch, order)) if *of_epoch == epoch => order.clone(),
            _ => {
                let mut order = scenes.to_vec();
                let seed = match group {
                    0 => self.seed.derive("epoch", &[epoch]),
                    _ => self.seed.derive("epoch of group", &[group as u64, epoch]),
                };
                seed.rng().shuffle(&mut order);
                let order: Arc<[usize]> = order.into();
                shuffles.insert(group, (epoch, order.clone()));
                order
            }
        }
    }

    fn draw(&self, scene_idx: usize, rng: &mut SeededRng) -> Result<Drawn, Error> {
        let scene = self.dataset.scene(scene_idx).map_err(Error::Scene)?;
        let ego_idx = draw_ego(&scene, rng);
        let scene = self.seen(scene, rng);
        let mask = self.masks.sample(&scene, ego_idx, rng);
        Ok(Drawn { scene, ego_idx, mask })
    }

    /// The scene as a network in training sees it; the paper's network sees all as in the paper.
    fn seen(&self, scene: Scene, rng: &mut SeededRng) -> Scene {
        if self.collator.sight.is_some() { degraded(scene, rng) } else { scene }
    }

    fn collate(&self, drawn: &[Drawn], seeds: Vec<Seed>, rngs: Vec<SeededRng>) -> Result<DrawnBatch, Error> {
        let views: Vec<SceneView<'_>> =
            drawn.iter().map(|d| SceneView { scene: &d.scene, ego_idx: d.ego_idx, mask: &d.mask }).collect();
        // Networks that see surroundings get the same inputs as in sampling; the paper's are trained as in the paper.
        let validity = if self.collator.sight.is_some() { FutureValidity::Continued } else { FutureValidity::Recorded };
        let batch = self.collator.collate(&views, validity, self.device)?;
        let context = match self.with_context {
            true => {
                let rows =
                    drawn.iter().map(|d| ContextRow { scene: &d.scene, ego_idx: d.ego_idx, roles: Roles::none() });
                Some(SceneContext::new(&batch, &rows.collect::<Vec<_>>())?)
            }
            false => None,
        };
        Ok(DrawnBatch { batch, context, seeds, rngs })
    }
}

/// The ego agent of a training step: the recording's focal agent if it has one, else a random motorized agent that is
/// tracked throughout, else the scene's own.
fn draw_ego(scene: &Scene, rng: &mut SeededRng) -> usize {
    use crate::scene::TrackRole;
    let is_labeled = scene.ego().role == TrackRole::Focal && scene.source.dataset.facts().has_chosen_focal;
    let eligible: Vec<usize> = (0..scene.tracks.len())
        .filter(|idx| {
            let track = &scene.tracks[*idx];
            track.class.is_motorized() && track.trajectory.n_valid() == scene.n_timesteps
        })
        .collect();
    if is_labeled || eligible.is_empty() { scene.ego_idx } else { eligible[rng.below(eligible.len())] }
}
