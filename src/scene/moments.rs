//! Do two scenes show the same moment of the same traffic, whatever their files are called?

use super::{Scene, Track};
use std::hash::{DefaultHasher, Hash, Hasher};

/// The least motion of an agent within a timestep, meters: who stands is the same at any moment.
const LEAST_MOTION_M: f64 = 0.05;
/// Places are told to this length, meters.
const CELL_M: f64 = 0.01;
/// Where cells begin, meters: what a recording rounds to millimeters or tenths of these is never at the edge of one.
const EDGE_M: f64 = 0.000_15;

/// Marks of the moments of a scene, at most one a timestep, with their timesteps: the places of two moving agents there
/// and a timestep later, in the recording's frame. A moment in which fewer move has no mark. Scenes that have any mark
/// in common overlap: two pairs of agents do not move so alike by chance.
pub fn moments(scene: &Scene) -> Vec<(usize, u64)> {
    let at = |timestep: usize| {
        let mut moving: Vec<u64> =
            scene.tracks.iter().filter_map(|track| motion_mark(scene, track, timestep)).collect();
        // A scene may lack agents that another one of the same moment has; the two smallest marks are mostly in both.
        moving.sort_unstable();
        let [first, second, ..] = moving[..] else { return None };
        Some((timestep, hash_of(&(first, second))))
    };
    (0..scene.n_timesteps.saturating_sub(1)).filter_map(at).collect()
}

/// The mark of an agent's motion from a timestep on, if it moves.
fn motion_mark(scene: &Scene, track: &Track, timestep: usize) -> Option<u64> {
    let [from, to] = [timestep, timestep + 1].map(|timestep| Some(track.trajectory.get(timestep)?.position));
    let (from, to) = (from?, to?);
    let cell = |m: f64| ((m + EDGE_M) / CELL_M).floor() as i64;
    let place = |at| {
        let at = scene.world_from_scene.point(at);
        [cell(at.x), cell(at.y)]
    };
    (from.distance(to) >= LEAST_MOTION_M).then(|| hash_of(&[place(from), place(to)]))
}

/// A number that is compared within this process only.
fn hash_of(value: &impl Hash) -> u64 {
    let mut hasher = DefaultHasher::new();
    value.hash(&mut hasher);
    hasher.finish()
}
