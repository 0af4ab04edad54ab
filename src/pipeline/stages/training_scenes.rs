//! Which scenes of a store does a model train on, and which are held out?

use crate::pipeline::{Failure, Result as StageResult};
use crate::scene::{Scene, Split};
use crate::store::{SceneIndexEntry, SceneStore};
use crate::train::{SceneDataset, TrainOutcome, TrainingData};
use serde_json::{Value, json};

/// Where the store has no `val` split, every so many-th scene is held out.
const HOLD_OUT_EVERY: usize = 20;

impl SceneDataset for SceneStore {
    fn len(&self) -> usize {
        Self::len(self)
    }

    fn scene(&self, idx: usize) -> Result<Scene, Box<dyn std::error::Error + Send + Sync>> {
        Ok(Self::scene(self, idx)?)
    }
}

/// Scenes by index, in the store's order.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct TrainingScenes {
    /// To train on.
    pub(super) train: Vec<usize>,
    /// Held out.
    pub(super) held_out: Vec<usize>,
}

impl TrainingScenes {
    /// Trains on the given splits (none: `train`, or everything unsplit where there is no such split) and places (none:
    /// all), and holds out the `val` scenes of these places.
    pub(super) fn new(index: &[SceneIndexEntry], splits: &[Split], places: &[String]) -> Self {
        let here = |entry: &SceneIndexEntry| places.is_empty() || places.contains(&entry.place);
        let of = |wanted: &dyn Fn(Split) -> bool| -> Vec<usize> {
            let chosen = index.iter().enumerate().filter(|(_, entry)| here(entry) && wanted(entry.split));
            chosen.map(|(idx, _)| idx).collect()
        };
        let mut train = of(&|split| splits.contains(&split));
        if splits.is_empty() {
            let default =
                if index.iter().any(|entry| entry.split == Split::Train) { Split::Train } else { Split::Unsplit };
            train = of(&|split| split == default);
        }
        let mut held_out = of(&|split| split == Split::Val && !splits.contains(&split));
        if held_out.is_empty() && train.len() >= HOLD_OUT_EVERY {
            (held_out, train) = {
                let held = |position: usize| position % HOLD_OUT_EVERY == HOLD_OUT_EVERY - 1;
                let part = |wanted: bool| {
                    train.iter().enumerate().filter(move |(at, _)| held(*at) == wanted).map(|(_, idx)| *idx).collect()
                };
                (part(true), part(false))
            };
        }
        Self { train, held_out }
    }
}

/// The scenes of `store` that the `section` trains on and those held out. Left out, `state_dim` is that of the dataset.
pub(super) fn training_data<'a>(
    store: &'a SceneStore,
    (splits, places): (&[Split], &[String]),
    state_dim: Option<usize>,
    section: &str,
) -> StageResult<TrainingData<'a>> {
    let TrainingScenes { train, held_out } = TrainingScenes::new(store.index(), splits, places);
    let Some(first) = train.first() else {
        return Err(Failure::input_message(format_args!("no scene is of the splits and places of {section}")));
    };
    // Where headings are derived from the positions, so are those of samples.
    let default_state_dim = if store.index()[*first].dataset.facts().has_headings { 3 } else { 2 };
    let mut names: Vec<&str> = train.iter().map(|idx| store.index()[*idx].place.as_str()).collect();
    let of_scenes = names.clone();
    names.sort_unstable();
    names.dedup();
    let places = of_scenes.iter().map(|name| names.partition_point(|other| other < name)).collect();
    Ok(TrainingData {
        places,
        state_dim: state_dim.unwrap_or(default_state_dim),
        fingerprint: store.fingerprint().to_owned(),
        dataset: store,
        train,
        held_out,
    })
}

/// What a training stage says of itself, beside what is particular to it.
pub(super) fn training_summary<S>(data: &TrainingData<'_>, steps: u64, outcome: &TrainOutcome<S>) -> Value {
    json!({
        "fingerprint": outcome.fingerprint,
        "steps": steps,
        "trained": true,
        "n_parameters": outcome.n_parameters,
        "n_train_scenes": data.train.len(),
        "n_held_out_scenes": data.held_out.len(),
        "last_evaluation": outcome.statistics.iter().rev().find(|line| !line.evaluation.is_empty()),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Dataset;
    use crate::scene::SceneId;

    fn index(splits: &[(Split, &str)]) -> Vec<SceneIndexEntry> {
        let entry = |(idx, (split, place)): (usize, &(Split, &str))| SceneIndexEntry {
            id: SceneId(format!("interaction/{}/{place}/{idx}", split.name())),
            dataset: Dataset::Interaction,
            split: *split,
            place: (*place).to_owned(),
            n_agents: 3,
            n_timesteps: 40,
        };
        splits.iter().enumerate().map(entry).collect()
    }

    #[test]
    fn train_and_val_are_kept_apart_and_places_are_honored() {
        let index = index(&[(Split::Train, "A"), (Split::Val, "A"), (Split::Train, "B"), (Split::Test, "A")]);
        let all = TrainingScenes::new(&index, &[], &[]);
        assert_eq!((all.train, all.held_out), (vec![0, 2], vec![1]));
        let only_a = TrainingScenes::new(&index, &[], &["A".to_owned()]);
        assert_eq!((only_a.train, only_a.held_out), (vec![0], vec![1]));
        let on_val = TrainingScenes::new(&index, &[Split::Train, Split::Val], &[]);
        assert_eq!((on_val.train, on_val.held_out), (vec![0, 1, 2], vec![]));
    }

    #[test]
    fn unsplit_scenes_hold_out_a_twentieth() {
        let index = index(&[(Split::Unsplit, "A"); 40]);
        let selection = TrainingScenes::new(&index, &[], &[]);
        assert_eq!(selection.held_out, vec![19, 39]);
        assert_eq!(selection.train.len(), 38);
    }
}
