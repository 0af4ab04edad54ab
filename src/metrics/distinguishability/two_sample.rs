//! The two-sample test: boosted trees learn to tell generated from recorded tracks, and are tested on unseen scenes.

use super::auc::{Auc, Scored, area, area_with_interval};
use super::boosting::BoostedTrees;
use super::features::{FeatureSet, TrackFeatures, features};
use crate::quantile::quantile;
use crate::seed::Seed;
use rayon::prelude::*;

/// Parts into which scenes are divided; each is judged by trees fitted to the others.
const N_FOLDS: usize = 5;
/// The fewest tracks for a meaningful test.
pub const MIN_TRACKS: usize = 50;
/// The number of features that are tested for their share in the result, the most telling ones first.
const N_TRIED: usize = 22;
/// Features that are named.
const N_NAMED: usize = 5;
/// Agents slower than this at present count as standing, m/s.
const MOVING_MPS: f64 = 1.0;

/// The features of one track in its recorded future and in a generated one.
#[derive(Debug, Clone, PartialEq)]
pub struct TrackPair {
    /// The number of its scene: pairs of a scene have the same one.
    pub scene: usize,
    /// Features of the recorded future.
    pub recorded: TrackFeatures,
    /// Features of the generated future.
    pub generated: TrackFeatures,
}

/// How well a classifier distinguishes tracks by a set of features.
#[derive(Debug, Clone, PartialEq)]
pub struct SetAuc {
    /// The features.
    pub set: FeatureSet,
    /// Over tracks.
    pub tracks: Auc,
    /// Over tracks that move at present, with their number; `None` if there are too few.
    pub moving: Option<(usize, Auc)>,
    /// Over scenes, each by the mean log odds of its tracks.
    pub scenes: Option<Auc>,
}

/// A feature that gives generated tracks away.
#[derive(Debug, Clone, PartialEq)]
pub struct TellingFeature {
    /// Its index among the features.
    pub feature: usize,
    /// By how much the area over tracks falls if its values are shuffled among the tracks.
    pub drop: f64,
    /// The area of its values alone.
    pub alone: f64,
    /// Its medians over recorded and over generated tracks.
    pub medians: [f64; 2],
}

/// The result of the test.
pub struct TwoSampleTest {
    /// The results by set of features.
    pub by_set: Vec<SetAuc>,
    /// The features that give most away, by the classifier of all.
    pub telling: Vec<TellingFeature>,
    /// The log odds that each pair's recorded and generated track were generated, by all features.
    log_odds: Vec<[f64; 2]>,
    /// The fold of each scene, by increasing scene.
    folds: Vec<(usize, usize)>,
    /// The trees that have not seen a fold, by all features.
    trees: Vec<BoostedTrees>,
}

impl TwoSampleTest {
    /// Tests these pairs. `None` if there are too few, or fewer scenes than folds.
    pub fn new(pairs: &[TrackPair]) -> Option<Self> {
        let folds = folds(pairs);
        if pairs.len() < MIN_TRACKS || folds.len() < N_FOLDS {
            return None;
        }
        let mut by_set: Vec<(SetAuc, Vec<[f64; 2]>, Vec<BoostedTrees>)> = FeatureSet::ALL
            .into_par_iter()
            .filter_map(|set| {
                let indices = set.indices();
                let trees: Vec<BoostedTrees> =
                    (0..N_FOLDS).into_par_iter().map(|fold| fit(pairs, &folds, fold, &indices)).collect();
                let log_odds = pairs.iter().map(|pair| {
                    let trees = &trees[fold_of(&folds, pair.scene)];
                    [&pair.recorded, &pair.generated].map(|values| trees.log_odds(|idx| values.get(indices[idx])))
                });
                let log_odds = log_odds.collect::<Vec<_>>();
                let of_set = set_auc(pairs, set, &log_odds)?;
                Some((of_set, log_odds, trees))
            })
            .collect();
        let (_, log_odds, trees) = by_set
            .first_mut()
            .map(|(of_set, log_odds, trees)| (of_set.set, std::mem::take(log_odds), std::mem::take(trees)))?;
        let by_set = by_set.into_iter().map(|(of_set, ..)| of_set).collect();
        let mut test = Self { by_set, telling: Vec::new(), log_odds, folds, trees };
        test.telling = test.most_telling(pairs);
        Some(test)
    }

    /// The number of pairs for which `is_meant` holds, and the area by all features over them; `None` if there are too
    /// few.
    pub fn of_part(&self, pairs: &[TrackPair], is_meant: impl Fn(usize) -> bool) -> Option<(usize, Auc)> {
        part(pairs, &self.log_odds, is_meant)
    }

    /// The probability that the tracks of a scenario were recorded, by the mean of their log odds, from trees that have
    /// not seen `scene`; `None` without tracks.
    pub fn likeness<'v>(&self, scene: usize, tracks: impl Iterator<Item = &'v TrackFeatures>) -> Option<f64> {
        let trees = &self.trees[fold_of(&self.folds, scene)];
        let log_odds: Vec<f64> = tracks.map(|values| trees.log_odds(|idx| values.get(idx))).collect();
        let mean = log_odds.iter().sum::<f64>() / log_odds.len() as f64;
        (!log_odds.is_empty()).then(|| 1.0 / (1.0 + mean.exp()))
    }

    fn most_telling(&self, pairs: &[TrackPair]) -> Vec<TellingFeature> {
        let mut alone: Vec<(usize, f64)> = (0..features().len())
            .filter_map(|feature| {
                let of = |values: &TrackFeatures| Some(values.get(feature)).filter(|value| !value.is_nan());
                let values: Vec<[Option<f64>; 2]> =
                    pairs.iter().map(|pair| [of(&pair.recorded), of(&pair.generated)]).collect();
                Some((feature, area(&scored(pairs, &values, |_| true))?))
            })
            .collect();
        alone.sort_by(|a, b| (b.1 - 0.5).abs().total_cmp(&(a.1 - 0.5).abs()));
        alone.truncate(N_TRIED);
        let mut telling: Vec<TellingFeature> = alone
            .into_par_iter()
            .map(|(feature, alone)| TellingFeature {
                feature,
                drop: self.drop_without(pairs, feature),
                alone,
                medians: [0, 1].map(|kind| {
                    median(pairs.iter().map(|pair| [&pair.recorded, &pair.generated][kind].get(feature)).collect())
                }),
            })
            .collect();
        telling.sort_by(|a, b| b.drop.total_cmp(&a.drop));
        telling.truncate(N_NAMED);
        telling
    }

    /// By how much the area falls if the values of a feature are shuffled among the tracks of each fold.
    fn drop_without(&self, pairs: &[TrackPair], feature: usize) -> f64 {
        let mut rng = Seed(0).derive("shuffled feature", &[feature as u64]).rng();
        let mut log_odds = self.log_odds.clone();
        for (fold, trees) in self.trees.iter().enumerate() {
            let own: Vec<usize> = (0..pairs.len()).filter(|i| fold_of(&self.folds, pairs[*i].scene) == fold).collect();
            let both = |i: &usize| [&pairs[*i].recorded, &pairs[*i].generated].map(|values| values.get(feature));
            let mut values: Vec<f64> = own.iter().flat_map(both).collect();
            rng.shuffle(&mut values);
            for (i, shuffled) in own.into_iter().zip(values.chunks_exact(2)) {
                let with = |values: &TrackFeatures, other: f64| {
                    trees.log_odds(|idx| if idx == feature { other } else { values.get(idx) })
                };
                log_odds[i] = [with(&pairs[i].recorded, shuffled[0]), with(&pairs[i].generated, shuffled[1])];
            }
        }
        let before = area(&scored(pairs, &known(&self.log_odds), |_| true));
        let after = area(&scored(pairs, &known(&log_odds), |_| true));
        before.zip(after).map_or(0.0, |(before, after)| before - after)
    }
}

/// The fold of each scene, by increasing scene: a fifth of the scenes each, drawn by their numbers alone.
fn folds(pairs: &[TrackPair]) -> Vec<(usize, usize)> {
    let mut scenes: Vec<usize> = pairs.iter().map(|pair| pair.scene).collect();
    scenes.sort_unstable();
    scenes.dedup();
    scenes.sort_by_cached_key(|scene| Seed(0).derive("fold", &[*scene as u64]).0);
    let mut folds: Vec<(usize, usize)> =
        scenes.into_iter().enumerate().map(|(i, scene)| (scene, i % N_FOLDS)).collect();
    folds.sort_unstable();
    folds
}

/// The fold of a scene. One that no trees have seen may be judged by any of them.
fn fold_of(folds: &[(usize, usize)], scene: usize) -> usize {
    folds.binary_search_by_key(&scene, |(scene, _)| *scene).map_or(0, |at| folds[at].1)
}

/// Trees fitted to the tracks of all scenes except those of `fold`.
fn fit(pairs: &[TrackPair], folds: &[(usize, usize)], fold: usize, features: &[usize]) -> BoostedTrees {
    let others = || pairs.iter().filter(|pair| fold_of(folds, pair.scene) != fold);
    let column = |feature: &usize| {
        others().flat_map(|pair| [&pair.recorded, &pair.generated]).map(|values| values.get(*feature)).collect()
    };
    let columns: Vec<Vec<f64>> = features.iter().map(column).collect();
    let is_generated: Vec<bool> = others().flat_map(|_| [false, true]).collect();
    BoostedTrees::fit(&columns, &is_generated)
}

/// The areas for log odds by this set of features.
fn set_auc(pairs: &[TrackPair], set: FeatureSet, log_odds: &[[f64; 2]]) -> Option<SetAuc> {
    let tracks = area_with_interval(&scored(pairs, &known(log_odds), |_| true))?;
    let speed = features().iter().position(|feature| feature.name == "speed_now")?;
    let moving = part(pairs, log_odds, |i| pairs[i].recorded.get(speed) > MOVING_MPS);
    let mut of_scenes: Vec<Scored> = Vec::new();
    let mut in_order: Vec<usize> = (0..pairs.len()).collect();
    in_order.sort_by_key(|i| pairs[*i].scene);
    for of_scene in in_order.chunk_by(|a, b| pairs[*a].scene == pairs[*b].scene) {
        let mean = |kind: usize| of_scene.iter().map(|i| log_odds[*i][kind]).sum::<f64>() / of_scene.len() as f64;
        let scene = pairs[of_scene[0]].scene;
        of_scenes.extend([0, 1].map(|kind| Scored { scene, generated: kind == 1, score: mean(kind) }));
    }
    Some(SetAuc { set, tracks, moving, scenes: area_with_interval(&of_scenes) })
}

fn part(pairs: &[TrackPair], log_odds: &[[f64; 2]], is_meant: impl Fn(usize) -> bool) -> Option<(usize, Auc)> {
    let items = scored(pairs, &known(log_odds), is_meant);
    let n = items.len() / 2;
    Some((n, (n >= MIN_TRACKS).then(|| area_with_interval(&items))??))
}

fn known(values: &[[f64; 2]]) -> Vec<[Option<f64>; 2]> {
    values.iter().map(|both| both.map(Some)).collect()
}

/// The tracks of the pairs for which `is_meant` holds, with the values that are known.
fn scored(pairs: &[TrackPair], values: &[[Option<f64>; 2]], is_meant: impl Fn(usize) -> bool) -> Vec<Scored> {
    let meant = pairs.iter().zip(values).enumerate().filter(|(i, _)| is_meant(*i));
    let both = meant.flat_map(|(_, (pair, values))| [false, true].into_iter().zip(*values).map(|of| (pair.scene, of)));
    both.filter_map(|(scene, (generated, score))| Some(Scored { scene, generated, score: score? })).collect()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.retain(|value| !value.is_nan());
    values.sort_by(f64::total_cmp);
    quantile(&values, 0.5).unwrap_or(f64::NAN)
}
