//! Cuts the windows of a closed loop, for as long as everything in it is valid.

use super::sight::Sight;
use crate::ingest::RawScene;
use crate::metrics::{Judged, MetricSettings};
use crate::scene::{MapId, Roles, Scene, SceneSource, Track};
use crate::simulate::{Situation, World};

/// The windows of a loop whose presents are `n_every` timesteps apart, with as many timesteps as its scene has, in the
/// frame of the recording. The first frame counts from that of the scene.
pub(super) fn windows(
    situation: &Situation,
    world: &World,
    n_every: usize,
    (judged_by, sight): (&MetricSettings, &Sight),
) -> Vec<RawScene> {
    let start = &situation.scene;
    let (n_history, n_future) = (start.n_history, start.n_timesteps - start.n_history);
    let n_windows = (world.now() - start.current_timestep()).saturating_sub(n_future) / n_every;
    let mut found = Vec::new();
    for number in 1..=n_windows {
        let present = start.current_timestep() + number * n_every;
        // From the previous present on.
        let piece = situation.piece(world, present + 1 - n_history - n_every, n_history + n_every);
        if !is_valid(&piece, judged_by) {
            break;
        }
        let first = present + 1 - n_history;
        let scene = situation.piece(world, first, n_history + n_future);
        let is_there = |track: &Track| track.trajectory.is_valid(n_history - 1);
        let in_recording =
            |track: Track| Track { trajectory: track.trajectory.into_frame(&start.world_from_scene), ..track };
        let seen = scene.tracks.into_iter().map(in_recording).map(|track| {
            let track = sight.seen(track, n_history - 1);
            let trajectory = track.trajectory.with_velocities_from_positions(n_history, start.dt_s);
            Track { trajectory, ..track }
        });
        let tracks = seen.filter(is_there);
        found.push(RawScene {
            id: start.id.clone(),
            source: SceneSource { first_frame: first.to_string(), ..start.source.clone() },
            dt_s: start.dt_s,
            n_timesteps: n_history + n_future,
            n_history,
            tracks: tracks.collect(),
            heading_gaps: Vec::new(),
            map_id: start.map_id.clone().unwrap_or_else(|| MapId(String::new())),
            own_map: None,
            findings: Vec::new(),
        });
    }
    found
}

/// Whether the future of a scene is valid.
pub(super) fn is_valid(scene: &Scene, judged_by: &MetricSettings) -> bool {
    let judged = Judged::future_of(scene, Roles::none()).with_gaps(&judged_by.map_gaps);
    judged.violations(&judged_by.validity).is_empty()
}
