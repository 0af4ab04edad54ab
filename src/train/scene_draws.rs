//! Draws the batch of a training step: scenes, ego agents and masks. All models of scenes share it.

use super::{Error, LearnedEvent, LearnedEvents};
use crate::guidance::{ContextRow, SceneContext};
use crate::scene::{ObservationMask, Roles, Scene};
use crate::seed::{Seed, SeededRng};
use crate::tensor::{Collator, FutureValidity, MaskSampler, SceneBatch, SceneView, ToldEvent};
use candle_core::{Device, Tensor};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

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

/// Draws batches of training scenes, and collates held-out ones.
pub struct SceneDraws<'a> {
    /// How scenes become batches.
    pub collator: &'a Collator,
    /// The scenes.
    pub dataset: &'a dyn SceneDataset,
    /// The scenes to train on.
    pub train: &'a [WeightedGroups],
    /// The events that batches are conditioned on, if any.
    pub events: Option<&'a LearnedEvents>,
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

/// Scenes to train on, by index, in groups that count the same.
#[derive(Debug, Clone, PartialEq)]
pub struct WeightedGroups {
    /// How often one of them is drawn, relative to others.
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

/// Batches made in advance, which does not change results.
#[derive(Default)]
pub struct Prefetched {
    /// The last epoch of each group and its shuffle.
    shuffles: Mutex<BTreeMap<usize, Shuffle>>,
    /// The batch of a step.
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

/// The source of a row of a batch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Entry<'a> {
    /// A scene, by its index.
    Scene(usize),
    /// An event with its scene.
    Event(&'a LearnedEvent),
}

/// A scene with the draws of a training step.
struct Drawn {
    scene: Scene,
    ego_idx: usize,
    mask: ObservationMask,
    told: Option<ToldEvent>,
}

impl Drawn {
    /// A scene of which the history is observed.
    fn predictive(ego_idx: usize, scene: Scene, told: Option<ToldEvent>) -> Self {
        let mask = ObservationMask::predictive(scene.tracks.len(), scene.n_timesteps, scene.n_history);
        Self { scene, ego_idx, mask, told }
    }
}

/// Adds the scalar figures of a batch, which counts by its number of rows.
fn add_figures(sums: &mut [f64], n_rows: usize, figures: &[Tensor]) -> Result<(), Error> {
    for (sum, figure) in sums.iter_mut().zip(figures) {
        *sum += f64::from(figure.to_scalar::<f32>()?) * n_rows as f64;
    }
    Ok(())
}

impl SceneDraws<'_> {
    /// The batch of `step`: the one that [`prepare`](Self::prepare) made, or a new one.
    ///
    /// # Errors
    /// When a scene cannot be loaded.
    pub fn training_batch(&self, step: u64) -> Result<DrawnBatch, Error> {
        let kept = self.ahead.batch.lock().unwrap_or_else(PoisonError::into_inner).take();
        kept.filter(|(of_step, _)| *of_step == step).map_or_else(|| self.draw_rows(step), |(_, batch)| Ok(batch))
    }

    /// Makes the batch of `step` in advance.
    ///
    /// # Errors
    /// When a scene cannot be loaded.
    pub fn prepare(&self, step: u64) -> Result<(), Error> {
        let batch = self.draw_rows(step)?;
        *self.ahead.batch.lock().unwrap_or_else(PoisonError::into_inner) = Some((step, batch));
        Ok(())
    }

    fn draw_rows(&self, step: u64) -> Result<DrawnBatch, Error> {
        let entries = self.batch_entries(step);
        let seeds: Vec<Seed> = (0..entries.len()).map(|row| self.seed.derive("row", &[step, row as u64])).collect();
        let mut rngs: Vec<SeededRng> = seeds.iter().map(|seed| seed.derive("draws", &[]).rng()).collect();
        let drawn = entries.par_iter().zip(&mut rngs).map(|(entry, rng)| self.draw(*entry, rng));
        let drawn: Vec<Drawn> = drawn.collect::<Result<_, _>>()?;
        self.collate(&drawn, seeds, rngs)
    }

    /// The scenes of these indices after `change`, with their histories observed, each around its own ego agent.
    fn held_out_batch(&self, indices: &[usize], change: &dyn Fn(Scene) -> Scene) -> Result<DrawnBatch, Error> {
        let predictive = |idx: &usize| {
            let scene = change(self.dataset.scene(*idx).map_err(Error::Scene)?);
            Ok(Drawn::predictive(scene.ego_idx, scene, None))
        };
        let drawn = indices.iter().map(predictive).collect::<Result<Vec<_>, Error>>()?;
        let seeds: Vec<Seed> = indices.iter().map(|idx| self.seed.derive("evaluation", &[*idx as u64])).collect();
        let rngs = seeds.iter().map(|seed| seed.rng()).collect();
        self.collate(&drawn, seeds, rngs)
    }

    /// The means of `n` scalar figures over batches of held-out scenes, which count by their number of scenes. The
    /// seeds of a batch are the same whenever it is evaluated.
    ///
    /// # Errors
    /// When a scene cannot be loaded, or a figure cannot be computed.
    pub fn held_out_means(
        &self,
        n: usize,
        figures: impl Fn(&DrawnBatch) -> Result<Vec<Tensor>, Error>,
    ) -> Result<Vec<f64>, Error> {
        self.changed_means(self.held_out, n, &|scene| scene, figures)
    }

    /// [`Self::held_out_means`] over these held-out scenes after `change`.
    ///
    /// # Errors
    /// When a scene cannot be loaded, or a figure cannot be computed.
    pub fn changed_means(
        &self,
        scenes: &[usize],
        n: usize,
        change: &dyn Fn(Scene) -> Scene,
        figures: impl Fn(&DrawnBatch) -> Result<Vec<Tensor>, Error>,
    ) -> Result<Vec<f64>, Error> {
        let mut sums = vec![0.0; n];
        for chunk in scenes.chunks(self.batch_size) {
            add_figures(&mut sums, chunk.len(), &figures(&self.held_out_batch(chunk, change)?)?)?;
        }
        let n_scenes = scenes.len().max(1) as f64;
        Ok(sums.into_iter().map(|sum| sum / n_scenes).collect())
    }

    /// The means of `n` scalar figures over the scenes of held-out events, whose first agents are at the center. The
    /// events are shown with all of their values, or not at all; everything else is the same.
    ///
    /// # Errors
    /// When a scene cannot be loaded, or a figure cannot be computed.
    pub fn event_means(
        &self,
        is_told: bool,
        n: usize,
        figures: impl Fn(&DrawnBatch) -> Result<Vec<Tensor>, Error>,
    ) -> Result<Vec<f64>, Error> {
        let held_out = self.events.map_or(&[][..], |events| &events.held_out);
        let drawn = |event: &LearnedEvent| {
            let scene = self.dataset.scene(event.scene_idx).map_err(Error::Scene)?;
            let told = event.told(&scene)?;
            let ego_idx = told.agents.first().copied().unwrap_or(scene.ego_idx);
            Ok(Drawn::predictive(ego_idx, scene, is_told.then_some(told)))
        };
        let mut sums = vec![0.0; n];
        for (i, chunk) in held_out.chunks(self.batch_size).enumerate() {
            let first = i * self.batch_size;
            let seeds = (first..first + chunk.len()).map(|i| self.seed.derive("held-out event", &[i as u64]));
            let (seeds, rngs) = seeds.map(|seed| (seed, seed.rng())).unzip();
            let rows = chunk.iter().map(drawn).collect::<Result<Vec<_>, Error>>()?;
            add_figures(&mut sums, chunk.len(), &figures(&self.collate(&rows, seeds, rngs)?)?)?;
        }
        Ok(sums.into_iter().map(|sum| sum / held_out.len().max(1) as f64).collect())
    }

    /// The rows of the batch of `step`.
    pub(super) fn batch_entries(&self, step: u64) -> Vec<Entry<'_>> {
        let batch_size = self.batch_size as u64;
        (step * batch_size..(step + 1) * batch_size).filter_map(|position| self.entry_at(position)).collect()
    }

    /// The row at a position of the training: of the first n, ⌊n share⌋ are conditioned on events. Their behaviors take
    /// turns, and each yields consecutive entries of a shuffle.
    fn entry_at(&self, position: u64) -> Option<Entry<'_>> {
        let Some(events) = self.events else { return self.scene_at(position).map(Entry::Scene) };
        let n_told = |n: u64| (n as f64 * events.config.share).floor() as u64;
        let turn = n_told(position);
        if n_told(position + 1) == turn {
            return self.scene_at(position - turn).map(Entry::Scene);
        }
        let first_group = self.train.iter().map(|source| source.groups.len()).sum();
        Some(Entry::Event(&events.events[self.member_of(&events.by_behavior, first_group, turn)]))
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

    /// The member whose turn it is in some groups, of which the first has the number `first_group`.
    fn member_of(&self, groups: &[Vec<usize>], first_group: usize, turn: u64) -> usize {
        let (group, turn) = ((turn % groups.len() as u64) as usize, turn / groups.len() as u64);
        let n = groups[group].len() as u64;
        self.shuffle_of(first_group + group, &groups[group], turn / n)[(turn % n) as usize]
    }

    /// The scenes (or events) of a group, in the order of one of its epochs. Groups are numbered through all sources.
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

    fn draw(&self, entry: Entry<'_>, rng: &mut SeededRng) -> Result<Drawn, Error> {
        let (scene_idx, event) = match entry {
            Entry::Scene(scene_idx) => (scene_idx, None),
            Entry::Event(event) => (event.scene_idx, Some(event)),
        };
        let scene = self.dataset.scene(scene_idx).map_err(Error::Scene)?;
        let told = event.zip(self.events).map(|(event, events)| events.told_in_part(event, &scene, rng)).transpose()?;
        // As in sampling, the first agent of an event is at the center.
        let ego_idx = match told.as_ref().and_then(|told| told.agents.first()) {
            Some(first) => *first,
            None => draw_ego(&scene, rng),
        };
        let mask = self.masks.sample(&scene, ego_idx, rng);
        Ok(Drawn { scene, ego_idx, mask, told })
    }

    fn collate(&self, drawn: &[Drawn], seeds: Vec<Seed>, rngs: Vec<SeededRng>) -> Result<DrawnBatch, Error> {
        let views: Vec<SceneView<'_>> =
            drawn.iter().map(|d| SceneView { scene: &d.scene, ego_idx: d.ego_idx, mask: &d.mask }).collect();
        // Networks that see surroundings get the same inputs as in sampling; the paper's are trained as in the paper.
        let validity = if self.collator.sight.is_some() { FutureValidity::Continued } else { FutureValidity::Recorded };
        let mut batch = self.collator.collate(&views, validity, self.device)?;
        if let Some(events) = self.events {
            let told: Vec<Option<ToldEvent>> = drawn.iter().map(|d| d.told.clone()).collect();
            batch = batch.telling(&events.vocabulary, &told)?;
        }
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
