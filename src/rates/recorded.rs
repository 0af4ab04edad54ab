//! The traffic that was recorded: exposure by recording, and events.

use super::tail::Level;
use super::{ExposureRow, RateMethod, RateRow, Within};
use crate::behavior::{BehaviorEntry, BehaviorEvent};
use crate::scene::{SceneId, Split};
use crate::statistics::{ClusteredRate, clustered_rate};
use std::collections::{BTreeMap, HashMap};

/// From so many events on, a rate is that of the events, and not extrapolated.
const ENOUGH_EVENTS: u64 = 3;

/// Recordings with the events that were counted in them.
#[derive(Debug, Clone, Default)]
pub struct RecordedTraffic {
    recordings: Vec<ExposureRow>,
    /// The cluster of each recording: the first of those that share moments.
    clusters: Vec<usize>,
    by_name: HashMap<String, usize>,
    events: BTreeMap<String, Vec<Counted>>,
}

/// An event that counts: its recording and its parameters, in the order of the behavior's, NaN where it has none.
#[derive(Debug, Clone)]
struct Counted {
    recording: usize,
    parameters: Box<[f64]>,
}

/// What rates are of.
#[derive(Debug, Clone, Copy)]
pub struct Asked<'a> {
    /// The place; `None` for all together.
    pub place: Option<&'a str>,
    /// The split; `None` for all together.
    pub split: Option<Split>,
    /// The behavior.
    pub behavior: &'a str,
    /// Its events that count.
    pub within: &'a Within,
}

impl RecordedTraffic {
    /// Traffic without events so far.
    pub fn new(recordings: Vec<ExposureRow>) -> Self {
        let by_name: HashMap<String, usize> =
            recordings.iter().enumerate().map(|(idx, row)| (row.recording.clone(), idx)).collect();
        let cluster = |(idx, row): (usize, &ExposureRow)| {
            row.shares_with.as_ref().and_then(|first| by_name.get(first)).copied().unwrap_or(idx)
        };
        let clusters = recordings.iter().enumerate().map(cluster).collect();
        Self { recordings, clusters, by_name, events: BTreeMap::new() }
    }

    /// Adds an event that counts. Events of scenes that are no part of the recordings are left out.
    pub fn add(&mut self, event: &BehaviorEvent) {
        let id = event.scene_id.0.as_str();
        let name = SceneId::window_of(id).map_or(id, |(recording, _)| recording);
        let (Some(recording), Some(entry)) = (self.by_name.get(name), BehaviorEntry::of(&event.behavior)) else {
            return;
        };
        let value = |name: &&str| event.parameters.get(*name).copied().unwrap_or(f64::NAN);
        let counted = Counted { recording: *recording, parameters: entry.parameters.iter().map(value).collect() };
        self.events.entry(event.behavior.clone()).or_default().push(counted);
    }

    /// The recordings.
    pub fn recordings(&self) -> &[ExposureRow] {
        &self.recordings
    }

    /// The traffic of some recordings.
    #[must_use]
    pub fn among(&self, is_wanted: impl Fn(&ExposureRow) -> bool) -> Self {
        let kept: Vec<usize> = (0..self.recordings.len()).filter(|idx| is_wanted(&self.recordings[*idx])).collect();
        let mut traffic = Self::new(kept.iter().map(|idx| self.recordings[*idx].clone()).collect());
        for (behavior, events) in &self.events {
            let of_kept = events.iter().filter_map(|event| {
                let recording = kept.binary_search(&event.recording).ok()?;
                Some(Counted { recording, parameters: event.parameters.clone() })
            });
            traffic.events.insert(behavior.clone(), of_kept.collect());
        }
        traffic
    }

    /// How often events were recorded; of a bucket of severe ones with hardly any, how often the tail of the others
    /// lets expect them. `None` if nothing was recorded there.
    pub fn rate(&self, asked: Asked<'_>) -> Option<RateRow> {
        let counts = self.counts(asked, self.found(asked).map(|(recording, _)| recording));
        let (per_hour, per_1000_km) = (counts.per_hour()?, counts.per_1000_km());
        let row = RateRow {
            place: asked.place.unwrap_or_default().to_owned(),
            split: asked.split.map_or("", Split::name).to_owned(),
            behavior: asked.behavior.to_owned(),
            within: asked.within.to_string(),
            n_events: counts.n_events(),
            n_recordings: counts.0.len() as u64,
            observed_h: counts.0.values().map(|(_, hours, _)| hours).sum(),
            motorized_km: counts.0.values().map(|(.., km)| km).sum(),
            rate_per_hour: per_hour.rate,
            per_hour: per_hour.interval,
            rate_per_1000_km: per_1000_km.map(|rate| rate.rate),
            per_1000_km: per_1000_km.map(|rate| rate.interval),
            dispersion: per_1000_km.unwrap_or(per_hour).dispersion,
            method: match (counts.n_events(), counts.0.len()) {
                (0, _) => RateMethod::NoneFound,
                (_, 1) => RateMethod::OneRecording,
                _ => RateMethod::OverRecordings,
            },
            note: None,
        };
        match Level::of(asked.within).filter(|_| row.n_events < ENOUGH_EVENTS) {
            Some(level) => Some(self.extrapolated(asked, &level, row)),
            None => Some(row),
        }
    }

    /// The row with the rate of a level that the tail of less severe events gives, or with the reason why it gives
    /// none.
    fn extrapolated(&self, asked: Asked<'_>, level: &Level, row: RateRow) -> RateRow {
        let all = Asked { within: &Within::default(), ..asked };
        let at = BehaviorEntry::of(asked.behavior)
            .and_then(|entry| entry.parameters.iter().position(|name| *name == level.parameter));
        let severity = |parameters: &[f64]| Some(level.severity_of(*parameters.get(at?)?)).filter(|x| !x.is_nan());
        let known: Vec<(usize, f64)> =
            self.found(all).filter_map(|(recording, parameters)| Some((recording, severity(parameters)?))).collect();
        let rates = || {
            let of_clusters = known.iter().map(|(recording, severity)| (self.clusters[*recording], *severity));
            let tail = level.tail(&of_clusters.collect::<Vec<_>>())?;
            let beyond = known.iter().filter(|(_, severity)| *severity > tail.threshold);
            let counts = self.counts(all, beyond.map(|(recording, _)| *recording));
            let of =
                |rate: Option<ClusteredRate>| rate.map(|rate| level.rate(&tail, counts.n_events(), rate)).transpose();
            let note = format!(
                "from {} events with {} beyond {:.3}",
                counts.n_events(),
                level.parameter,
                level.value_of(tail.threshold)
            );
            Ok::<_, &str>((of(counts.per_hour())?, of(counts.per_1000_km())?, note))
        };
        match rates() {
            Ok((Some((rate_per_hour, per_hour)), per_km, note)) => {
                let (rate_per_1000_km, per_1000_km) = per_km.unzip();
                let (method, note) = (RateMethod::Extrapolated, Some(note));
                RateRow { rate_per_hour, per_hour, rate_per_1000_km, per_1000_km, method, note, ..row }
            }
            Ok((None, ..)) => row,
            Err(why) => RateRow { note: Some(format!("not extrapolated: {why}")), ..row },
        }
    }

    /// Counts of events in these recordings, with all exposure that is asked for.
    fn counts(&self, asked: Asked<'_>, events: impl Iterator<Item = usize>) -> Counts {
        let mut counts: BTreeMap<usize, (u64, f64, f64)> = BTreeMap::new();
        for (idx, row) in self.recordings.iter().enumerate().filter(|(_, row)| asked.is_of(row)) {
            let (_, hours, km) = counts.entry(self.clusters[idx]).or_default();
            *hours += row.observed_h;
            *km += row.motorized_km();
        }
        events.for_each(|recording| counts.entry(self.clusters[recording]).or_default().0 += 1);
        Counts(counts)
    }

    /// Rates of these behaviors, each with buckets: over all places together and at each place, over all splits and in
    /// each.
    pub fn rates(&self, behaviors: &[&str], buckets: &[(String, Within)]) -> Vec<RateRow> {
        let mut parts: Vec<(&str, Split)> = self.recordings.iter().map(|row| (row.place.as_str(), row.split)).collect();
        parts.sort_unstable();
        parts.dedup();
        let mut places: Vec<&str> = parts.iter().map(|(place, _)| *place).collect();
        places.dedup();
        let one_split = |place: &str| parts.iter().filter(|(of, _)| *of == place).count() == 1;
        let everywhere = (places.len() > 1).then_some((None, None));
        let asked: Vec<(Option<&str>, Option<Split>)> = everywhere
            .into_iter()
            .chain(places.iter().map(|place| (Some(*place), None)))
            .chain(
                parts.iter().filter(|(place, _)| !one_split(place)).map(|(place, split)| (Some(*place), Some(*split))),
            )
            .collect();
        let all = Within::default();
        let mut rows = Vec::new();
        for behavior in behaviors {
            let own = buckets.iter().filter(|(of, _)| of == behavior).map(|(_, within)| within);
            for within in std::iter::once(&all).chain(own) {
                rows.extend(
                    asked.iter().filter_map(|(place, split)| {
                        self.rate(Asked { place: *place, split: *split, behavior, within })
                    }),
                );
            }
        }
        rows
    }

    /// The recordings of the events that are asked for, with their parameters.
    fn found<'a>(&'a self, asked: Asked<'a>) -> impl Iterator<Item = (usize, &'a [f64])> {
        let names = BehaviorEntry::of(asked.behavior).map_or(&[][..], |entry| entry.parameters);
        let events = self.events.get(asked.behavior).into_iter().flatten();
        events.filter_map(move |event| {
            let value = |name: &str| {
                let at = names.iter().position(|known| *known == name)?;
                Some(event.parameters[at]).filter(|value| !value.is_nan())
            };
            (asked.is_of(&self.recordings[event.recording]) && asked.within.holds(value))
                .then_some((event.recording, &*event.parameters))
        })
    }
}

/// Events, hours and kilometers of clusters of recordings.
struct Counts(BTreeMap<usize, (u64, f64, f64)>);

impl Counts {
    fn n_events(&self) -> u64 {
        self.0.values().map(|(n, ..)| n).sum()
    }

    fn per_hour(&self) -> Option<ClusteredRate> {
        clustered_rate(&self.0.values().map(|(n, hours, _)| (*n, *hours)).collect::<Vec<_>>())
    }

    fn per_1000_km(&self) -> Option<ClusteredRate> {
        clustered_rate(&self.0.values().map(|(n, _, km)| (*n, km / 1000.0)).collect::<Vec<_>>())
    }
}

impl Asked<'_> {
    fn is_of(&self, row: &ExposureRow) -> bool {
        self.place.is_none_or(|place| place == row.place) && self.split.is_none_or(|split| split == row.split)
    }
}
