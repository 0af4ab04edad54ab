//! Which behaviors do the recordings show, and how often? Counts mined events by behavior, split and place.

use crate::behavior::{ALL, BehaviorEntry, BehaviorEvent, EventLabel};
use crate::store::SceneIndexEntry;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The miner's findings in the recordings.
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
    /// When an event starts, when it is complete and what does not count.
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

/// Counts mined events of each behavior by split and place, scene by scene, without keeping either.
pub struct MiningTally<'a> {
    behaviors: Vec<&'a str>,
    n_scenes: BTreeMap<Part<'a>, u64>,
    counts: BTreeMap<(&'a str, Part<'a>), Counts>,
    n_events: u64,
}

/// Split and place.
type Part<'a> = (&'a str, &'a str);

/// The number of events of a behavior in a part.
#[derive(Debug, Clone, Copy, Default)]
struct Counts {
    n_scenes_with: u64,
    n_positive: u64,
    n_negative: u64,
}

impl<'a> MiningTally<'a> {
    /// Starts without scenes, for `behaviors`.
    pub fn new(behaviors: &[&'a str]) -> Self {
        Self { behaviors: behaviors.to_vec(), n_scenes: BTreeMap::new(), counts: BTreeMap::new(), n_events: 0 }
    }

    /// Counts a scene with all events found in it. Events of other behaviors count only in the total.
    pub fn add(&mut self, scene: SceneIndexEntry<'a>, events: &[BehaviorEvent]) {
        let part = (scene.split.name(), scene.place);
        *self.n_scenes.entry(part).or_default() += 1;
        self.n_events += events.len() as u64;
        for behavior in &self.behaviors {
            let count = |label| {
                let counted = |event: &&BehaviorEvent| event.behavior == *behavior && event.label == label;
                events.iter().filter(counted).count() as u64
            };
            let [n_positive, n_negative] = [EventLabel::Positive, EventLabel::Negative].map(count);
            if n_positive + n_negative > 0 {
                let counts = self.counts.entry((*behavior, part)).or_default();
                counts.n_scenes_with += u64::from(n_positive > 0);
                counts.n_positive += n_positive;
                counts.n_negative += n_negative;
            }
        }
    }

    /// Number of all events so far, with those that classifiers learn as counterexamples.
    pub const fn n_events(&self) -> u64 {
        self.n_events
    }

    /// How much was found so far, in words.
    pub fn words(&self) -> String {
        let of = |n: fn(&Counts) -> u64| self.counts.values().map(n).sum::<u64>();
        format!("{} events and {} counterexamples", of(|counts| counts.n_positive), of(|counts| counts.n_negative))
    }

    /// The counts: one row for each behavior and part, even if nothing was found.
    pub fn finish(&self) -> MiningSummary {
        let row = |behavior: &'a str, (part, n_scenes): (&Part<'a>, &u64)| {
            let counts = self.counts.get(&(behavior, *part)).copied().unwrap_or_default();
            BehaviorCount {
                behavior: behavior.to_owned(),
                split: part.0.to_owned(),
                place: part.1.to_owned(),
                n_scenes: *n_scenes,
                n_scenes_with: counts.n_scenes_with,
                n_positive: counts.n_positive,
                n_negative: counts.n_negative,
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
    use crate::scene::{Dataset, SceneId, SituationKind, Split};

    fn entry(id: &'static str, split: Split) -> SceneIndexEntry<'static> {
        SceneIndexEntry {
            id,
            dataset: Dataset::Interaction,
            split,
            place: "X",
            n_agents: 2,
            situation: SituationKind::Recorded,
            n_timesteps: 40,
        }
    }

    fn event(behavior: &str, label: EventLabel) -> BehaviorEvent {
        BehaviorEvent { label, ..crate::store::testing::event(&SceneId::from("any"), behavior, &[]) }
    }

    #[test]
    fn events_are_counted_by_part_and_parts_without_any_are_listed() {
        let mut tally = MiningTally::new(&["cut_in"]);
        let [positive, negative] = [EventLabel::Positive, EventLabel::Negative];
        tally.add(entry("a", Split::Train), &[event("cut_in", positive), event("cut_in", positive)]);
        tally.add(entry("b", Split::Train), &[event("cut_in", negative), event("another", positive)]);
        tally.add(entry("c", Split::Val), &[]);
        assert_eq!((tally.n_events(), tally.words().as_str()), (4, "2 events and 1 counterexamples"));
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
