//! Can tracks that the model drives be told from recorded ones of the same agents?

use crate::metrics::distinguishability::{FeatureSet, Surroundings, TrackPair, TwoSampleTest};
use crate::scene::{Scene, SceneId, Track, Trajectory};
use crate::simulate::{Situation, World};
use serde::Serialize;
use std::collections::BTreeSet;

/// The compared parts of a drive, seconds after the present: its beginning, a part of the same length after five
/// seconds, and all of it. The second distinguishes drift from what a longer track gives away anyway. Recordings of
/// many datasets end before.
const SPANS_S: [[f64; 2]; 3] = [[0.0, 3.0], [5.0, 8.0], [0.0, 8.0]];
/// The most tracks that a classifier learns from.
const MOST_TRACKS: usize = 2000;

/// The performance of a classifier that tells driven tracks from recorded ones.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ToldApart {
    /// The beginning of the compared part, seconds after the present.
    pub from_s: f64,
    /// Its end.
    pub to_s: f64,
    /// Tracks of either kind.
    pub n_tracks: u64,
    /// Probability that it picks the driven one of a recorded and a driven track: 0.5 is indistinguishable.
    pub auc: f64,
    /// The 95 % interval of `auc` over scenes.
    pub interval: [f64; 2],
}

/// Tracks that the model drove, with their recordings.
#[derive(Debug, Default)]
pub(super) struct Tracks {
    scenes: BTreeSet<SceneId>,
    pairs: [Vec<TrackPair>; SPANS_S.len()],
}

impl Tracks {
    /// Whether more tracks of this scene are needed: one drive suffices.
    pub(super) fn want(&self, scene_id: &SceneId) -> bool {
        !self.scenes.contains(scene_id)
    }

    /// Adds the tracks of a drive that the model moved all along: none of the agents of the event, and the ego only if
    /// it `drives_ego`.
    pub(super) fn add(&mut self, situation: &Situation, world: &World, recorded: &[Track], drives_ego: bool) {
        let (scene, number) = (&situation.scene, self.scenes.len());
        self.scenes.insert(scene.id.clone());
        let driven = situation.driven(world);
        let n_recorded = recorded.iter().map(|track| track.trajectory.n_timesteps()).min().unwrap_or_default();
        for (span_s, pairs) in SPANS_S.iter().zip(&mut self.pairs) {
            let [from, to] = span_s.map(|s| (s / scene.dt_s).round() as usize);
            let timesteps = from..scene.n_history + to;
            if n_recorded.min(driven.n_timesteps) < timesteps.end || pairs.len() > MOST_TRACKS {
                continue;
            }
            let cut = |tracks: &[Track]| {
                let cut = |track: &Track| {
                    let trajectory = Trajectory::new(track.trajectory.entries()[timesteps.clone()].to_vec());
                    Track { trajectory, ..track.clone() }
                };
                Scene { tracks: tracks.iter().map(cut).collect(), n_timesteps: timesteps.len(), ..scene.clone() }
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

    /// The performance of a classifier on each part with enough tracks.
    pub(super) fn tell_apart(&self) -> Vec<ToldApart> {
        let told = SPANS_S.iter().zip(&self.pairs).filter_map(|(&[from_s, to_s], pairs)| {
            let test = TwoSampleTest::new(pairs)?;
            let auc = test.by_set.iter().find(|by_set| by_set.set == FeatureSet::All)?.tracks;
            let n_tracks = pairs.len() as u64;
            Some(ToldApart { from_s, to_s, n_tracks, auc: auc.value, interval: auc.interval })
        });
        told.collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Vec2;
    use crate::scene::State;
    use crate::simulate::testing::{record, situation};

    /// A track that drives along x, and wavers from `wavers_from_s` on.
    fn states(situation: &Situation, agent_idx: usize, wavers_from_s: f64) -> Vec<Option<State>> {
        let scene = &situation.scene;
        let state = |timestep: usize| {
            let after_s = (timestep as f64 - scene.current_timestep() as f64) * scene.dt_s;
            let aside_m = if after_s >= wavers_from_s { 0.1 * (9.0 * after_s).sin() } else { 0.0 };
            let position = Vec2::new(10.0 * after_s, 40.0 * agent_idx as f64 + aside_m);
            Some(State { position, heading_rad: 0.0, velocity: Vec2::new(10.0, 0.0) })
        };
        (0..scene.n_history + 80).map(state).collect()
    }

    #[test]
    fn drift_is_told_where_it_begins() {
        let mut situation = situation(&record());
        let mut tracks = Tracks::default();
        for number in 0..60 {
            situation.scene.id = format!("scene {number}").as_str().into();
            let n_tracks = situation.scene.tracks.len();
            let of_all = |from_s| -> Vec<_> { (0..n_tracks).map(|idx| states(&situation, idx, from_s)).collect() };
            let world = World::new("drifts", 0, 0, of_all(5.5).iter().map(Vec::as_slice));
            let recorded: Vec<Track> = of_all(f64::INFINITY)
                .into_iter()
                .zip(&situation.scene.tracks)
                .map(|(states, track)| Track { trajectory: Trajectory::new(states), ..track.clone() })
                .collect();
            tracks.add(&situation, &world, &recorded, true);
        }
        let told = tracks.tell_apart();
        assert_eq!(told.iter().map(|told| [told.from_s, told.to_s]).collect::<Vec<_>>(), SPANS_S);
        let aucs: Vec<f64> = told.iter().map(|told| told.auc).collect();
        assert!((aucs[0] - 0.5).abs() < 0.05 && aucs[1..].iter().all(|auc| *auc > 0.95), "{aucs:?}");
    }
}
