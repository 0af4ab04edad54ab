//! Can the tracks of each sweep be told from those of the recordings that it continues, and by what?

use crate::metrics::distinguishability::{
    Auc, FeatureSet, Surroundings, TellingFeature, TrackFeatures, TrackPair, TwoSampleTest, features,
};
use crate::metrics::{Group, SeriesKey};
use crate::progress::Progress;
use crate::scene::{AgentClass, GuidanceLevel, Scene};
use crate::seed::Seed;
use crate::store::SceneSet;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// The most tracks of a series from which trees learn. More would take longer and narrow intervals little.
const MAX_TRACKS: usize = 2000;

/// The performance of a classifier that tells the tracks of a series from recorded ones.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DistinguishabilityRow {
    /// The series.
    pub group: Group,
    /// The sweep.
    pub sweep: String,
    /// The level of its guidance.
    #[serde(flatten)]
    pub level: GuidanceLevel,
    /// The place of the scenes; empty for all.
    pub place: String,
    /// The class of the agents; empty for all.
    pub class: String,
    /// The input of the classifier: a [`FeatureSet`], `half_seconds_moving` (`half_seconds` of tracks that move at
    /// present), or `whole_scenes` (all features of all tracks of a scene).
    pub features: String,
    /// Tracks of either kind in the series.
    pub n_tracks: u64,
    /// Probability that it picks the generated one of a recorded and a generated track (or scene).
    pub auc: f64,
    /// Lower end of the 95 % interval of `auc` over scenes.
    pub low: f64,
    /// Upper end of that interval.
    pub high: f64,
}

impl DistinguishabilityRow {
    /// The name of the set of all features.
    pub const ALL_FEATURES: &str = FeatureSet::All.name();

    /// The series.
    pub fn series(&self) -> SeriesKey {
        SeriesKey { group: self.group.clone(), sweep: self.sweep.clone(), level: self.level }
    }

    /// Whether it covers all places, classes and features.
    pub fn is_overall(&self) -> bool {
        self.place.is_empty() && self.class.is_empty() && self.features == Self::ALL_FEATURES
    }
}

/// A feature that gives the tracks of a series away.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TellingFeatureRow {
    /// The series.
    pub group: Group,
    /// The sweep.
    pub sweep: String,
    /// The level of its guidance.
    #[serde(flatten)]
    pub level: GuidanceLevel,
    /// The feature, such as `jerk_q90`.
    pub feature: String,
    /// Its unit.
    pub unit: String,
    /// By how much the AUC of all features falls if its values are shuffled among tracks.
    pub auc_drop: f64,
    /// The AUC of its values alone; below .5 if those of generated tracks are smaller.
    pub auc_alone: f64,
    /// Its median over recorded tracks.
    pub recorded_median: f64,
    /// Its median over generated tracks.
    pub generated_median: f64,
}

/// The features of the tracks of a cell.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct CellTracks {
    /// The judged tracks of the recording.
    recorded: Vec<(AgentClass, TrackFeatures)>,
    /// These tracks in each sample; `None` where one is not tracked to the end.
    samples: Vec<Vec<Option<TrackFeatures>>>,
}

impl CellTracks {
    /// The tracks of `samples`, which continue `recorded`.
    pub(super) fn of(recorded: &Scene, samples: &[Scene]) -> Self {
        let around = Surroundings::new(recorded);
        let judged: Vec<usize> = (0..recorded.tracks.len()).filter(|idx| around.is_judged(*idx)).collect();
        let of_sample = |sample: &Scene| {
            let around = Surroundings::new(sample);
            judged.iter().map(|idx| around.is_judged(*idx).then(|| around.features_of(*idx))).collect()
        };
        Self {
            recorded: judged.iter().map(|idx| (recorded.tracks[*idx].class, around.features_of(*idx))).collect(),
            samples: samples.iter().map(of_sample).collect(),
        }
    }

    /// The tracks of samples that continue no recording.
    pub(super) fn without_recording(self) -> Self {
        Self { recorded: Vec::new(), ..self }
    }

    fn sample(&self, idx: usize) -> impl Iterator<Item = &TrackFeatures> {
        self.samples.get(idx).into_iter().flatten().flatten()
    }
}

/// The cell that tracks belong to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct CellKey {
    pub(super) series: SeriesKey,
    pub(super) place: String,
    pub(super) scene_idx: usize,
}

struct PooledScene {
    place: String,
    classes: Vec<AgentClass>,
    pairs: Vec<TrackPair>,
}

/// The tracks of a series: those of the first sample of each scene, for as many scenes as [`MAX_TRACKS`] allows.
#[derive(Default)]
struct SeriesPool {
    seen: SceneSet,
    /// Keyed by a draw for each scene, so that the kept ones do not depend on order.
    scenes: BTreeMap<(u64, usize), PooledScene>,
    n_tracks: usize,
}

/// Gathers tracks of recordings and samples, series by series, in bounded memory.
#[derive(Default)]
pub struct TrackPool {
    series: Vec<(SeriesKey, SeriesPool)>,
}

impl TrackPool {
    /// Adds the tracks of a cell. Cells come in the order of the samples.
    pub(super) fn add(&mut self, CellKey { series, place, scene_idx }: &CellKey, tracks: &CellTracks) {
        let at = self.series.iter().position(|(known, _)| known == series).unwrap_or_else(|| {
            self.series.push((series.clone(), SeriesPool::default()));
            self.series.len() - 1
        });
        let pool = &mut self.series[at].1;
        if !pool.seen.insert(*scene_idx) {
            return;
        }
        let in_first = tracks.samples.first().into_iter().flatten();
        let both =
            tracks.recorded.iter().zip(in_first).filter_map(|(recorded, sample)| Some((recorded, sample.as_ref()?)));
        let (classes, pairs) = both
            .map(|((class, recorded), generated)| {
                let (recorded, generated) = (recorded.clone(), generated.clone());
                (*class, TrackPair { scene: *scene_idx, recorded, generated })
            })
            .unzip();
        let scene = PooledScene { place: place.clone(), classes, pairs };
        pool.n_tracks += scene.pairs.len();
        pool.scenes.insert((Seed(0).derive("scene to learn from", &[*scene_idx as u64]).0, *scene_idx), scene);
        while pool.n_tracks > MAX_TRACKS && pool.scenes.len() > 1 {
            pool.n_tracks -= pool.scenes.pop_last().map_or(0, |(_, dropped)| dropped.pairs.len());
        }
    }

    /// Trains a classifier for each series.
    pub fn tell_apart(self, progress: &dyn Progress) -> Distinguished {
        let of_series = |(key, pool): (SeriesKey, SeriesPool)| {
            let (mut pairs, mut places, mut classes) = (Vec::new(), Vec::new(), Vec::new());
            for scene in pool.scenes.into_values() {
                places.extend(scene.pairs.iter().map(|_| scene.place.clone()));
                classes.extend(scene.classes);
                pairs.extend(scene.pairs);
            }
            let test = TwoSampleTest::new(&pairs)?;
            let rows = rows(&key, &test, &pairs, &places, &classes);
            progress.advance(1);
            Some(TestedSeries { telling: telling(&key, &test), key, rows, test })
        };
        progress.start("tell apart", self.series.len() as u64, "series");
        let series = self.series.into_par_iter().filter_map(of_series).collect();
        progress.finish();
        Distinguished { series }
    }
}

struct TestedSeries {
    key: SeriesKey,
    rows: Vec<DistinguishabilityRow>,
    telling: Vec<TellingFeatureRow>,
    test: TwoSampleTest,
}

/// The results of the classifiers, and how recorded scenarios look to them. Series with too few tracks or scenes are
/// left out.
#[derive(Default)]
pub struct Distinguished {
    series: Vec<TestedSeries>,
}

impl Distinguished {
    /// The areas under the curves.
    pub(super) fn rows(&self) -> Vec<DistinguishabilityRow> {
        self.series.iter().flat_map(|series| series.rows.clone()).collect()
    }

    /// The features that give tracks away most.
    pub(super) fn telling(&self) -> Vec<TellingFeatureRow> {
        self.series.iter().flat_map(|series| series.telling.clone()).collect()
    }

    /// How recorded the sample with this number looks.
    pub(super) fn likeness(&self, cell: &CellKey, tracks: &CellTracks, sample: usize) -> Option<f64> {
        let series = self.series.iter().find(|series| series.key == cell.series)?;
        series.test.likeness(cell.scene_idx, tracks.sample(sample))
    }
}

fn rows(
    key: &SeriesKey,
    test: &TwoSampleTest,
    pairs: &[TrackPair],
    places: &[String],
    classes: &[AgentClass],
) -> Vec<DistinguishabilityRow> {
    let row = |place: &str, class: &str, features: &str, n_tracks: usize, Auc { value, interval: [low, high] }: Auc| {
        DistinguishabilityRow {
            group: key.group.clone(),
            sweep: key.sweep.clone(),
            level: key.level,
            place: place.to_owned(),
            class: class.to_owned(),
            features: features.to_owned(),
            n_tracks: n_tracks as u64,
            auc: value,
            low,
            high,
        }
    };
    let n = pairs.len();
    let mut rows = Vec::new();
    for found in &test.by_set {
        rows.push(row("", "", found.set.name(), n, found.tracks));
        let moving = found.moving.filter(|_| found.set == FeatureSet::HalfSeconds);
        rows.extend(moving.map(|(n, auc)| row("", "", "half_seconds_moving", n, auc)));
    }
    rows.extend(test.by_set[0].scenes.map(|auc| row("", "", "whole_scenes", n, auc)));
    let distinct: BTreeSet<&String> = places.iter().collect();
    if distinct.len() > 1 {
        for place in distinct {
            let found = test.of_part(pairs, |i| places[i] == *place);
            rows.extend(found.map(|(n, auc)| row(place, "", FeatureSet::All.name(), n, auc)));
        }
    }
    let of_class = |class: AgentClass| (class, classes.iter().filter(|own| **own == class).count());
    let counted = AgentClass::ALL.into_iter().map(of_class).filter(|(_, n_tracks)| (1..n).contains(n_tracks));
    for (class, _) in counted {
        let found = test.of_part(pairs, |i| classes[i] == class);
        rows.extend(found.map(|(n, auc)| row("", class.name(), FeatureSet::All.name(), n, auc)));
    }
    rows
}

fn telling(key: &SeriesKey, test: &TwoSampleTest) -> Vec<TellingFeatureRow> {
    let features = features();
    let row = |found: &TellingFeature| TellingFeatureRow {
        group: key.group.clone(),
        sweep: key.sweep.clone(),
        level: key.level,
        feature: features[found.feature].name.clone(),
        unit: features[found.feature].unit.to_owned(),
        auc_drop: found.drop,
        auc_alone: found.alone,
        recorded_median: found.medians[0],
        generated_median: found.medians[1],
    };
    test.telling.iter().map(row).collect()
}
