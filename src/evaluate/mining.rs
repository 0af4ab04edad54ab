//! Which behaviors do the recordings show, and how often? Counts mined events by behavior, split and place.

use crate::behavior::{ALL, BehaviorEntry, BehaviorEvent, EventLabel};
use crate::scene::SceneId;
use crate::store::SceneIndexEntry;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// What the miner found in the recordings.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct MiningSummary {
    /// The definition of each mined behavior.
    pub definitions: Vec<BehaviorDoc>,
    /// Counts by behavior, split and place.
    pub counts: Vec<BehaviorCount>,
}

/// The definition of a behavior.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct BehaviorDoc {
    /// Its name, such as `cut_in`.
    pub behavior: String,
    /// When it starts, when it is complete and what does not count.
    pub definition: String,
}

impl From<&BehaviorEntry> for BehaviorDoc {
    fn from(entry: &BehaviorEntry) -> Self {
        Self { behavior: entry.id.to_owned(), definition: entry.description.to_owned() }
    }
}

/// How often a behavior was found in one part of the recordings.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct BehaviorCount {
    /// Its name.
    pub behavior: String,
    /// The split.
    pub split: String,
    /// The place.
    pub place: String,
    /// Scenes searched.
    pub n_scenes: u64,
    /// Scenes with at least one positive event.
    pub n_scenes_with: u64,
    /// Positive events.
    pub n_positive: u64,
    /// Hard negatives.
    pub n_negative: u64,
}

/// Counts mined events of each behavior by split and place, without keeping them.
pub struct MiningTally<'a> {
    behaviors: Vec<&'a str>,
    /// Split and place of each scene that is searched.
    part_of: BTreeMap<&'a SceneId, Part<'a>>,
    n_scenes: BTreeMap<Part<'a>, u64>,
    /// Positive and negative events of a behavior in a part.
    labels: BTreeMap<(&'a str, Part<'a>), [u64; 2]>,
    /// Scenes with positive ones.
    with: BTreeMap<(&'a str, Part<'a>), BTreeSet<&'a SceneId>>,
    n_events: u64,
}

/// Split and place.
type Part<'a> = (&'a str, &'a str);

impl<'a> MiningTally<'a> {
    /// Starts without events of `behaviors` in the searched `scenes`.
    pub fn new(behaviors: &[&'a str], scenes: impl IntoIterator<Item = &'a SceneIndexEntry>) -> Self {
        let part = |scene: &'a SceneIndexEntry| (&scene.id, (scene.split.name(), scene.place.as_str()));
        let part_of: BTreeMap<_, _> = scenes.into_iter().map(part).collect();
        let mut n_scenes = BTreeMap::new();
        part_of.values().for_each(|part| *n_scenes.entry(*part).or_default() += 1);
        let behaviors = behaviors.to_vec();
        Self { behaviors, part_of, n_scenes, labels: BTreeMap::new(), with: BTreeMap::new(), n_events: 0 }
    }

    /// Counts an event. An event of another behavior, or of a scene that was not searched, counts only in the total.
    pub fn add(&mut self, event: &BehaviorEvent) {
        self.n_events += 1;
        let behavior = self.behaviors.iter().find(|behavior| **behavior == event.behavior);
        let (Some(behavior), Some((scene_id, part))) = (behavior, self.part_of.get_key_value(&event.scene_id)) else {
            return;
        };
        let is_positive = event.label == EventLabel::Positive;
        self.labels.entry((*behavior, *part)).or_default()[usize::from(!is_positive)] += 1;
        if is_positive {
            self.with.entry((*behavior, *part)).or_default().insert(*scene_id);
        }
    }

    /// Number of all events so far.
    pub const fn n_events(&self) -> u64 {
        self.n_events
    }

    /// The counts: one row for each behavior and part, even if nothing was found.
    pub fn finish(&self) -> MiningSummary {
        let row = |behavior: &'a str, (part, n_scenes): (&Part<'a>, &u64)| {
            let [n_positive, n_negative] = self.labels.get(&(behavior, *part)).copied().unwrap_or_default();
            BehaviorCount {
                behavior: behavior.to_owned(),
                split: part.0.to_owned(),
                place: part.1.to_owned(),
                n_scenes: *n_scenes,
                n_scenes_with: self.with.get(&(behavior, *part)).map_or(0, BTreeSet::len) as u64,
                n_positive,
                n_negative,
            }
        };
        let counts = self.behaviors.iter().flat_map(|behavior| self.n_scenes.iter().map(|part| row(behavior, part)));
        let known = ALL.iter().filter(|entry| self.behaviors.contains(&entry.id));
        MiningSummary { counts: counts.collect(), definitions: known.map(BehaviorDoc::from).collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Dataset, Split};

    fn entry(case: &str, split: Split) -> SceneIndexEntry {
        SceneIndexEntry {
            id: SceneId::from(case),
            dataset: Dataset::Interaction,
            split,
            place: "X".to_owned(),
            n_agents: 2,
            n_timesteps: 40,
        }
    }

    fn event(case: &str, label: EventLabel) -> BehaviorEvent {
        BehaviorEvent {
            behavior: "cut_in".to_owned(),
            scene_id: SceneId::from(case),
            label,
            roles: crate::scene::Roles::default(),
            start_timestep: 0,
            end_timestep: 0,
            parameters: BTreeMap::new(),
        }
    }

    #[test]
    fn events_are_counted_by_part_and_parts_without_any_are_listed() {
        let scenes = [entry("a", Split::Train), entry("b", Split::Train), entry("c", Split::Val)];
        let events = [
            event("a", EventLabel::Positive),
            event("a", EventLabel::Positive),
            event("b", EventLabel::Negative),
            event("elsewhere", EventLabel::Positive),
        ];
        let mut tally = MiningTally::new(&["cut_in"], &scenes);
        events.iter().for_each(|event| tally.add(event));
        assert_eq!(tally.n_events(), 4);
        let summary = tally.finish();
        let rows: Vec<_> = summary
            .counts
            .iter()
            .map(|c| (c.split.as_str(), c.n_scenes, c.n_scenes_with, c.n_positive, c.n_negative))
            .collect();
        assert_eq!(rows, [("train", 2, 1, 2, 1), ("val", 1, 0, 0, 0)]);
        assert_eq!(summary.definitions.len(), 1);
    }
}
