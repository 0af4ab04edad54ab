//! The plan of a generation, decided before anything is sampled: scenes, pairs, shards.

use super::pairs::order_seed;
use super::{Cell, Error, Generator, ResolvedGeneration, ResolvedSweep};
use crate::behavior::{Behavior, Outcome};
use crate::scene::{Roles, SceneId, SituationKind, Split};
use crate::seed::Seed;
use crate::store::{SceneIndex, SceneIndexEntry};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// Everything that will be generated, in order.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// The shards; those of a sweep follow each other.
    pub shards: Vec<ShardPlan>,
    /// Sweeps with fewer suitable scenes than requested.
    pub shortfalls: Vec<Shortfall>,
}

/// A group of scenes of one sweep, generated and written together.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ShardPlan {
    /// Its place in the plan.
    pub idx: usize,
    /// Index of its sweep in the configuration.
    pub sweep_idx: usize,
    /// The cells to sample, each at every strength (or weight) of the sweep, as often as the sweep says. All strengths
    /// of a scene are in one shard.
    pub cells: Vec<Cell>,
    /// The number of the first sample of each cell: 0 except for requests, which return to their cells.
    pub first_sample: usize,
    /// By cell: the numbers of the templates that it is sampled with, each once. Empty: every cell has as many samples
    /// as the sweep says, whose templates come in turn.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub templates: Vec<Vec<usize>>,
}

/// A sweep for which there were too few scenes.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Shortfall {
    /// Name of the sweep.
    pub sweep: String,
    /// Scenes requested.
    pub n_wanted: usize,
    /// Scenes found.
    pub n_found: usize,
}

impl Plan {
    /// Total number of samples.
    pub fn n_samples(&self, config: &ResolvedGeneration) -> usize {
        self.shards.iter().map(|shard| shard.n_samples(config)).sum()
    }
}

impl ShardPlan {
    /// Number of samples.
    pub fn n_samples(&self, config: &ResolvedGeneration) -> usize {
        let sweep = &config.sweeps[self.sweep_idx];
        let of_cells: usize = (0..self.cells.len()).map(|at| self.n_samples_of(at, sweep.n_samples)).sum();
        of_cells * sweep.levels().len()
    }

    /// Number of samples at each level of the cell at this place, where the sweep says `usual`.
    pub(super) fn n_samples_of(&self, at: usize, usual: usize) -> usize {
        self.templates.get(at).map_or(usual, Vec::len)
    }
}

impl Generator<'_> {
    /// The plan for the scenes of `index`. The same configuration, models and scenes give the same plan, whatever the
    /// order of the scenes (except for their indices).
    ///
    /// # Errors
    /// When no scene fits a sweep, or a scene cannot be loaded.
    pub fn plan(&self, index: &SceneIndex) -> Result<Plan, Error> {
        self.plan_first(self.config.sweeps.len(), index)
    }

    /// The plan for the first `n_sweeps` sweeps: the later ones belong to requests, which plan round by round.
    pub fn plan_first(&self, n_sweeps: usize, index: &SceneIndex) -> Result<Plan, Error> {
        let mut plan = Plan { shards: Vec::new(), shortfalls: Vec::new() };
        let order = self.scenes_in_order(index, &|entry| entry.situation == SituationKind::Recorded);
        for (sweep_idx, sweep) in self.config.sweeps.iter().enumerate().take(n_sweeps) {
            let scenes: Vec<_> = match self.behavior(sweep) {
                Some(behavior) => {
                    let scenes = self.scenes_with_pairs(sweep, behavior, &order)?.into_iter();
                    scenes.map(|cells| cells.into_iter().map(|able| able.cell).collect()).collect()
                }
                None => order.iter().take(sweep.n_scenes).map(|scene| vec![scene.cell(Roles::default())]).collect(),
            };
            if scenes.is_empty() {
                return Err(self.no_scenes(format!("sweep {}", sweep.name), order.len()));
            }
            if scenes.len() < sweep.n_scenes {
                let (n_wanted, n_found) = (sweep.n_scenes, scenes.len());
                plan.shortfalls.push(Shortfall { sweep: sweep.name.clone(), n_wanted, n_found });
            }
            let mut scenes = scenes.into_iter().peekable();
            while scenes.peek().is_some() {
                let cells = scenes.by_ref().take(self.config.scenes_per_shard).flatten().collect();
                plan.shards.push(ShardPlan {
                    idx: plan.shards.len(),
                    sweep_idx,
                    cells,
                    first_sample: 0,
                    templates: Vec::new(),
                });
            }
        }
        Ok(plan)
    }

    /// The cells of a request of this name by its first sweep, scene by scene, among the possible scenes of the chosen
    /// splits and places.
    pub(super) fn cells_by_scene(
        &self,
        (name, sweep): (&str, &ResolvedSweep),
        index: &SceneIndex,
        is_possible: &dyn Fn(&SceneIndexEntry<'_>) -> bool,
    ) -> Result<Vec<Vec<AbleCell>>, Error> {
        let Some(behavior) = self.behavior(sweep) else { return Ok(Vec::new()) };
        let order = self.scenes_in_order(index, is_possible);
        let scenes = self.scenes_with_pairs(sweep, behavior, &order)?;
        if scenes.is_empty() { Err(self.no_scenes(format!("request {name}"), order.len())) } else { Ok(scenes) }
    }

    /// The possible scenes among [`held_out_in_order`].
    fn scenes_in_order<'i>(
        &self,
        index: &'i SceneIndex,
        is_possible: &dyn Fn(&SceneIndexEntry<'_>) -> bool,
    ) -> Vec<ListedScene<'i>> {
        let ResolvedGeneration { splits, places, learned, .. } = self.config;
        let in_order = held_out_in_order(index, (splits, places), learned, self.seed().0);
        let possible = in_order.into_iter().filter(|(_, entry)| is_possible(entry));
        possible.map(|(scene_idx, entry)| ListedScene { scene_idx, id: entry.id }).collect()
    }

    /// The cells of the scenes that a sweep with a behavior uses, scene by scene.
    fn scenes_with_pairs(
        &self,
        sweep: &ResolvedSweep,
        behavior: &dyn Behavior,
        order: &[ListedScene<'_>],
    ) -> Result<Vec<Vec<AbleCell>>, Error> {
        let mut found = Vec::new();
        // Scenes are examined in parallel, a batch at a time, and counted in order. On a GPU the classifier ranks one
        // scene after the other.
        let rank = |scene: &ListedScene<'_>| self.rank(sweep, behavior, scene);
        for batch in order.chunks(sweep.n_scenes.clamp(8, 64)) {
            let ranked: Vec<Option<Vec<AbleCell>>> = match self.device.is_cuda() {
                true => batch.iter().map(rank).collect::<Result<_, _>>()?,
                false => batch.par_iter().map(rank).collect::<Result<_, _>>()?,
            };
            found.extend(ranked.into_iter().flatten());
            if found.len() >= sweep.n_scenes {
                break;
            }
        }
        found.truncate(sweep.n_scenes);
        Ok(found)
    }

    /// The cells of a scene, for its best pairs; `None` where it has no possible one.
    fn rank(
        &self,
        sweep: &ResolvedSweep,
        behavior: &dyn Behavior,
        listed: &ListedScene<'_>,
    ) -> Result<Option<Vec<AbleCell>>, Error> {
        let scene_id = SceneId::from(listed.id);
        let scene = self.load(listed.scene_idx, &scene_id)?;
        let candidates = self.candidates(sweep, behavior, &scene)?;
        if candidates.is_empty() {
            return Ok(None);
        }
        let asked = candidates.into_iter().take(sweep.pairs.per_scene);
        let cells = asked.map(|pair| {
            let targets = self.targets(sweep, &scene_id, &pair);
            AbleCell { cell: Cell { targets, ..listed.cell(pair.roles) }, outcomes: pair.outcomes }
        });
        Ok(Some(cells.collect()))
    }

    /// The error that none of this many scenes fits a sweep or request.
    fn no_scenes(&self, of: String, n_considered: usize) -> Error {
        let hint = match n_considered {
            0 if self.config.splits.is_empty() && !self.config.learned.is_empty() => {
                ", for the models of the run learn from all others: nothing is held out; add recordings, or name \
                 splits in generate.splits to sample even scenes that were trained on"
            }
            0 => "; choose other generate.splits or generate.places",
            _ => ": no pair in them can show the behavior; add recordings, or raise pairs.max_distance_m",
        };
        Error::NoScenes { of, n_considered, hint }
    }
}

/// The positions of the scenes of the chosen splits and places: recorded ones first, then continued and populated ones,
/// each in a random order that depends on the seed and their ids alone. Unless splits are chosen, none of them is
/// `learned`: they are held out of the run's trainings.
pub fn held_out_in_order<'i>(
    index: &'i SceneIndex,
    (splits, places): (&[Split], &[String]),
    learned: &BTreeSet<usize>,
    seed: u64,
) -> Vec<(usize, SceneIndexEntry<'i>)> {
    let has_val = index.iter().any(|entry| entry.split == Split::Val);
    let default_split = if has_val { Split::Val } else { Split::Unsplit };
    let is_chosen = |idx: usize, entry: &SceneIndexEntry<'_>| match splits.is_empty() {
        true => entry.split == default_split && !learned.contains(&idx),
        false => splits.contains(&entry.split),
    };
    let is_here = |place: &str| places.is_empty() || places.iter().any(|chosen| chosen == place);
    let chosen = index.iter().enumerate().filter(|(idx, entry)| is_chosen(*idx, entry) && is_here(entry.place));
    let mut scenes: Vec<(u64, (usize, SceneIndexEntry<'i>))> =
        chosen.map(|(idx, entry)| (order_seed(Seed(seed), entry.id), (idx, entry))).collect();
    scenes.sort_by(|a, b| {
        let key = |(drawn, (_, entry)): &(u64, (usize, SceneIndexEntry<'i>))| (entry.situation, *drawn);
        key(a).cmp(&key(b)).then_with(|| a.1.1.id.cmp(b.1.1.id))
    });
    scenes.into_iter().map(|(_, scene)| scene).collect()
}

/// A cell with the outcomes that its pair can still reach.
pub(super) struct AbleCell {
    pub(super) cell: Cell,
    pub(super) outcomes: Vec<Outcome>,
}

/// A scene of the store.
#[derive(Clone, Copy)]
struct ListedScene<'a> {
    scene_idx: usize,
    id: &'a str,
}

impl ListedScene<'_> {
    fn cell(&self, roles: Roles) -> Cell {
        Cell { scene_idx: self.scene_idx, scene_id: SceneId::from(self.id), roles, targets: Vec::new() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Dataset;

    #[test]
    fn recorded_scenes_of_every_chosen_place_come_first() {
        let ids: Vec<String> = (0..24).map(|i| format!("table/val/X/{i}")).collect();
        let entries = ids.iter().enumerate().map(|(i, id)| SceneIndexEntry {
            id,
            dataset: Dataset::Table,
            split: Split::Val,
            place: ["A", "B", "C"][i % 3],
            n_agents: 2,
            situation: SituationKind::ALL[i / 3 % 3],
            n_timesteps: 40,
        });
        let index: SceneIndex = entries.collect();
        let places = ["A", "B"].map(str::to_owned);
        let order = held_out_in_order(&index, (&[], &places), &BTreeSet::from([0]), 7);
        assert!(order.is_sorted_by_key(|(_, entry)| entry.situation));
        // Two of three places, without the first scene, from which a model learned.
        let mut found: Vec<usize> = order.iter().map(|(scene_idx, _)| *scene_idx).collect();
        found.sort_unstable();
        assert_eq!(found, (1..24).filter(|i| i % 3 < 2).collect::<Vec<_>>());
    }
}
