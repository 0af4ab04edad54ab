//! Counts recorded time, recorded events and scenarios by tags and behavior.

use super::row::CoverageRow;
use super::tags::{Tag, TaggedScene, Tags};
use crate::behavior::BehaviorEvent;
use crate::rates::{ExposureRow, Within};
use crate::scene::{Scene, SceneId};
use crate::statistics::clustered_rate;
use std::collections::{BTreeMap, HashMap};

/// What is counted: a behavior, and the ranges of its parameters.
type Asked = (String, Within);

/// Counts; recordings first, then scenarios.
#[derive(Debug, Default)]
pub struct CoverageTally {
    /// Behaviors, each with all of its events and then with those of each bucket.
    asked: Vec<Asked>,
    /// Hours by tags and cluster of recordings.
    hours: BTreeMap<(Tags, usize), f64>,
    /// Recorded events by position in `asked`, tags and cluster.
    recorded: BTreeMap<(usize, Tags, usize), u64>,
    /// Verified and accepted scenarios by position in `asked` and tags.
    made: BTreeMap<(usize, Tags), [u64; 2]>,
    /// The tags of each recorded scene, and its cluster.
    scenes: HashMap<SceneId, (Tags, usize)>,
}

impl CoverageTally {
    /// A tally of these behaviors and buckets of theirs, with the time that recordings show.
    pub fn new(
        behaviors: &[&str],
        buckets: &[(String, Within)],
        recordings: &[ExposureRow],
        scenes: impl Iterator<Item = TaggedScene>,
    ) -> Self {
        let mut tally = Self::default();
        for behavior in behaviors {
            let own = buckets.iter().filter(|(of, _)| of == behavior).cloned();
            tally.asked.extend(std::iter::once(((*behavior).to_owned(), Within::default())).chain(own));
        }
        // Recordings that share moments are one.
        let first = |row: &ExposureRow| row.shares_with.clone().unwrap_or_else(|| row.recording.clone());
        let mut clusters: HashMap<String, usize> = HashMap::new();
        let mut of_recording: HashMap<&str, usize> = HashMap::new();
        for row in recordings {
            let next = clusters.len();
            of_recording.insert(&row.recording, *clusters.entry(first(row)).or_insert(next));
        }
        for TaggedScene { scene_id, tags, observed_h, .. } in scenes {
            let recording = SceneId::window_of(&scene_id.0).map_or(scene_id.0.as_str(), |(recording, _)| recording);
            if let Some(cluster) = of_recording.get(recording).copied() {
                *tally.hours.entry((tags, cluster)).or_default() += observed_h;
                tally.scenes.insert(scene_id, (tags, cluster));
            }
        }
        tally
    }

    /// Counts a recorded event, of which there must be one a happening.
    pub fn add_recorded(&mut self, event: &BehaviorEvent) {
        let Some((tags, cluster)) = self.scenes.get(&event.scene_id).copied() else { return };
        for asked in self.of(event) {
            *self.recorded.entry((asked, tags, cluster)).or_default() += 1;
        }
    }

    /// Counts a scenario with the event that was asked for.
    pub fn add_scenario(&mut self, scene: &Scene, event: &BehaviorEvent, is_accepted: bool) {
        let tags = Tags::of(scene);
        for asked in self.of(event) {
            let [n_generated, n_accepted] = self.made.entry((asked, tags)).or_default();
            *n_generated += 1;
            *n_accepted += u64::from(is_accepted);
        }
    }

    /// The positions of what is asked for that the event is.
    fn of(&self, event: &BehaviorEvent) -> Vec<usize> {
        let is = |(_, (behavior, within)): &(usize, &Asked)| {
            *behavior == event.behavior && within.holds(|name| event.parameters.get(name).copied())
        };
        self.asked.iter().enumerate().filter(is).map(|(idx, _)| idx).collect()
    }

    /// The rows of any surroundings, of those with each tag, and of those with any two of different attributes, as far
    /// as they were recorded or made.
    pub fn rows(&self) -> Vec<CoverageRow> {
        let all: Vec<Tag> = Tag::all().collect();
        let pairs = all.iter().flat_map(|a| {
            let others = all.iter().filter(move |b| a < *b && a.attribute() != b.attribute());
            others.map(move |b| [Some(*a), Some(*b)])
        });
        let alone = all.iter().map(|tag| [Some(*tag), None]);
        std::iter::once([None, None]).chain(alone).chain(pairs).flat_map(|tags| self.rows_of(tags)).collect()
    }

    /// The rows of surroundings with these tags.
    fn rows_of(&self, tags: [Option<Tag>; 2]) -> Vec<CoverageRow> {
        let has = |of: Tags| tags.into_iter().flatten().all(|tag| of.has(tag));
        let mut hours: BTreeMap<usize, f64> = BTreeMap::new();
        for ((_, cluster), h) in self.hours.iter().filter(|((of, _), _)| has(*of)) {
            *hours.entry(*cluster).or_default() += h;
        }
        let mut recorded: BTreeMap<(usize, usize), u64> = BTreeMap::new();
        for ((asked, _, cluster), n) in self.recorded.iter().filter(|((_, of, _), _)| has(*of)) {
            *recorded.entry((*asked, *cluster)).or_default() += n;
        }
        let mut made: BTreeMap<usize, [u64; 2]> = BTreeMap::new();
        for ((asked, _), n) in self.made.iter().filter(|((_, of), _)| has(*of)) {
            let sum = made.entry(*asked).or_default();
            *sum = [sum[0] + n[0], sum[1] + n[1]];
        }
        let row = |(idx, (behavior, within)): (usize, &Asked)| {
            let n = |cluster: &usize| recorded.get(&(idx, *cluster)).copied().unwrap_or_default();
            let counts: Vec<(u64, f64)> = hours.iter().map(|(cluster, hours)| (n(cluster), *hours)).collect();
            let rate = clustered_rate(&counts);
            let [n_generated, n_accepted] = made.get(&idx).copied().unwrap_or_default();
            CoverageRow {
                tags,
                behavior: behavior.clone(),
                within: within.to_string(),
                observed_h: hours.values().sum(),
                n_recorded: counts.iter().map(|(n, _)| n).sum(),
                rate_per_hour: rate.map(|rate| rate.rate),
                per_hour: rate.map(|rate| rate.interval),
                n_generated,
                n_accepted,
            }
        };
        let is_known = |row: &CoverageRow| row.observed_h > 0.0 || row.n_generated > 0;
        self.asked.iter().enumerate().map(row).filter(is_known).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::behavior::EventLabel;
    use crate::coverage::{CellState, shares};
    use crate::scene::testing::{Drive, scene};
    use crate::scene::{Dataset, Split};

    /// A recording of 1 h, which begins anew or shows what another one shows.
    fn recording(name: &str, shares_with: Option<&str>) -> ExposureRow {
        ExposureRow {
            dataset: Dataset::Interaction,
            place: "A".to_owned(),
            split: Split::Train,
            recording: name.to_owned(),
            shares_with: shares_with.map(str::to_owned),
            n_scenes: 1,
            observed_h: 1.0,
            class_h: [0.0; 7],
            class_km: [0.0; 7],
        }
    }

    fn event(scene_id: &str, gap_m: f64) -> BehaviorEvent {
        let scene = Scene { id: scene_id.into(), ..scene(&[Drive::straight(0.0, 0.0, 0.0, 5.0)]) };
        BehaviorEvent::new(("cut_in", &["ego"]), &scene, EventLabel::Positive, &[0], 0..=1).with("gap_m", gap_m)
    }

    #[test]
    fn every_cell_has_its_time_its_events_and_its_scenarios() {
        let slow = scene(&[Drive::straight(0.0, 0.0, 0.0, 5.0)]);
        let fast = scene(&[Drive::straight(0.0, 0.0, 0.0, 20.0)]);
        let tagged = |id: &str, scene: &Scene, observed_h: f64| TaggedScene {
            scene_id: id.into(),
            place: "A".to_owned(),
            split: Split::Train,
            tags: Tags::of(scene),
            observed_h,
        };
        let scenes = [tagged("a", &slow, 1.0), tagged("b", &slow, 1.0), tagged("c", &fast, 0.5)];
        let close = Within([("gap_m".to_owned(), [0.0, 5.0])].into());
        let buckets = [("cut_in".to_owned(), close)];
        let recordings = [recording("a", None), recording("b", Some("a")), recording("c", None)];
        let mut tally = CoverageTally::new(&["cut_in", "cut_out"], &buckets, &recordings, scenes.into_iter());
        for (scene, gap_m) in [("a", 3.0), ("a", 8.0), ("b", 8.0), ("elsewhere", 3.0)] {
            tally.add_recorded(&event(scene, gap_m));
        }
        tally.add_scenario(&slow, &event("a", 8.0), true);
        tally.add_scenario(&fast, &event("c", 3.0), false);

        let rows = tally.rows();
        let cell = |tags: [Option<&str>; 2], behavior: &str, within: &str| {
            let tags = tags.map(|tag| tag.map(|tag| tag.parse::<Tag>().unwrap()));
            let is = |row: &&CoverageRow| row.tags == tags && row.behavior == behavior && row.within == within;
            rows.iter()
                .find(is)
                .map(|row| (row.observed_h, row.n_recorded, row.n_generated, row.n_accepted, row.state()))
        };
        let (slow, fast, alone) = (Some("speed:15_to_30_km_h"), Some("speed:above_60_km_h"), Some("lanes:1"));
        use CellState::{Covered, Missing, NeverRecorded};
        for (tags, behavior, within, expected) in [
            ([None, None], "cut_in", "", (2.5, 3, 2, 1, Covered)),
            ([None, None], "cut_in", "gap_m 0..5", (2.5, 1, 1, 0, Missing)),
            ([None, None], "cut_out", "", (2.5, 0, 0, 0, NeverRecorded)),
            ([slow, None], "cut_in", "", (2.0, 3, 1, 1, Covered)),
            ([slow, None], "cut_in", "gap_m 0..5", (2.0, 1, 0, 0, Missing)),
            ([fast, None], "cut_in", "gap_m 0..5", (0.5, 0, 1, 0, NeverRecorded)),
            ([alone, slow], "cut_in", "", (2.0, 3, 1, 1, Covered)),
        ] {
            assert_eq!(cell(tags, behavior, within), Some(expected), "{tags:?} {behavior} {within}");
        }
        assert_eq!(cell([Some("lanes:2"), None], "cut_in", ""), None, "neither recorded nor made");
        // One recording, for the second shows the first again: 3 events in 2 h, as if they were independent.
        let slow = rows.iter().find(|row| row.n_tags() == 1 && row.observed_h == 2.0 && row.n_recorded == 3).unwrap();
        let interval = slow.per_hour.unwrap();
        assert_eq!(slow.rate_per_hour, Some(1.5));
        assert!((interval.low - 0.3093).abs() < 1e-3 && (interval.high - 4.3837).abs() < 1e-3, "{interval:?}");
        // Of five tags with recorded events, all events: 5 covered of 5; those with a gap below 5 m: 0 of 5.
        let [single, pairs] = shares(&rows);
        assert_eq!((single.n_covered, single.n_recorded, pairs.n_covered, pairs.n_recorded), (5, 10, 10, 20));
    }
}
