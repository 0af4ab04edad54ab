//! Can what the model drives be told from what was recorded of the same agents?

use super::situation::Situation;
use super::world::World;
use crate::metrics::distinguishability::{FeatureSet, Surroundings, TrackPair, TwoSampleTest};
use crate::scene::{Scene, SceneId, Track, Trajectory};
use serde::Serialize;
use std::collections::BTreeSet;

/// After so long both are compared, seconds; recordings of many datasets are shorter than the second.
const HORIZONS_S: [f64; 2] = [3.0, 8.0];
/// Most tracks that a classifier learns from.
const MOST_TRACKS: usize = 2000;

/// The performance of a classifier that tells driven tracks from recorded ones.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ToldApart {
    /// How long they are, seconds after the present.
    pub horizon_s: f64,
    /// Tracks of either kind.
    pub n_tracks: u64,
    /// Probability that of a recorded and a driven track it picks the driven one: .5 is indistinguishable.
    pub auc: f64,
    /// Its interval of 95 % over scenes.
    pub interval: [f64; 2],
}

/// Tracks that the model drove, with their recordings.
#[derive(Debug, Default)]
pub(super) struct Tracks {
    scenes: BTreeSet<SceneId>,
    pairs: [Vec<TrackPair>; HORIZONS_S.len()],
}

impl Tracks {
    /// Whether tracks of this scene are wanted still: those of one drive are.
    pub(super) fn want(&self, scene_id: &SceneId) -> bool {
        !self.scenes.contains(scene_id)
    }

    /// Adds the tracks of a drive that the model moved all along: nobody of the event, and the ego only if it
    /// `drives_ego`.
    pub(super) fn add(&mut self, situation: &Situation, world: &World, recorded: &[Track], drives_ego: bool) {
        let (scene, number) = (&situation.scene, self.scenes.len());
        self.scenes.insert(scene.id.clone());
        let driven = situation.driven(world);
        for (horizon_s, pairs) in HORIZONS_S.iter().zip(&mut self.pairs) {
            let n_timesteps = scene.n_history + (horizon_s / scene.dt_s).round() as usize;
            let n_recorded = recorded.iter().map(|track| track.trajectory.n_timesteps()).min().unwrap_or_default();
            if n_recorded < n_timesteps || driven.n_timesteps < n_timesteps || pairs.len() > MOST_TRACKS {
                continue;
            }
            let cut = |tracks: &[Track]| {
                let cut = |track: &Track| {
                    let trajectory = Trajectory::new(track.trajectory.entries()[..n_timesteps].to_vec());
                    Track { trajectory, ..track.clone() }
                };
                Scene { tracks: tracks.iter().map(cut).collect(), n_timesteps, ..scene.clone() }
            };
            let [recorded, driven] = [recorded, driven.tracks.as_slice()].map(cut);
            let around = [&recorded, &driven].map(Surroundings::new);
            for (own_idx, track) in driven.tracks.iter().enumerate() {
                let is_driven = !situation.planned.contains(&own_idx) && (drives_ego || own_idx != situation.ego_idx);
                let recorded_idx = recorded.track_idx(&track.id).filter(|_| is_driven);
                let is_judged = |idx: &usize| around[0].is_judged(*idx) && around[1].is_judged(own_idx);
                if let Some(recorded_idx) = recorded_idx.filter(is_judged) {
                    let (recorded, generated) = (around[0].features_of(recorded_idx), around[1].features_of(own_idx));
                    pairs.push(TrackPair { scene: number, recorded, generated });
                }
            }
        }
    }

    /// What a classifier makes of them, for each time with enough tracks.
    pub(super) fn tell_apart(&self) -> Vec<ToldApart> {
        let told = HORIZONS_S.iter().zip(&self.pairs).filter_map(|(horizon_s, pairs)| {
            let test = TwoSampleTest::new(pairs)?;
            let auc = test.by_set.iter().find(|by_set| by_set.set == FeatureSet::All)?.tracks;
            let n_tracks = pairs.len() as u64;
            Some(ToldApart { horizon_s: *horizon_s, n_tracks, auc: auc.value, interval: auc.interval })
        });
        told.collect()
    }
}
