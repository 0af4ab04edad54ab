//! The check for collisions, except requested ones.

use super::{Check, Judged, ValidityConfig, Violation, keep_worse};
use crate::geometry::Vec2;
use crate::metrics::collision_rate::collisions;
use crate::scene::{Scene, Track};
use std::borrow::Cow;

/// The collision with the highest relative speed, as the collision rate counts them: boxes that overlap at a future
/// timestep and did not at present, of two agents at least one of which moves. One of the two must be generated there.
/// The requested agents are excused if a collision was requested or the limits allow it. If the recording gives no
/// size, an agent has the least size of its class ([`Track::extent_or_least`]), and two agents do not count if they
/// overlap at present with one at its nominal size: trackers follow some vehicles twice. The metrics of collisions take
/// nominal sizes.
pub(super) fn worst(judged: &Judged<'_>, config: &ValidityConfig) -> Option<Violation> {
    let scene = judged.scene;
    let asked: Vec<usize> = judged.asked.tracks().filter_map(|track| scene.track_idx(track)).collect();
    let mut worst = None;
    for collision in collisions(&at_least_size(scene)) {
        let [first, second] = collision.pair;
        let may_collide = judged.may_collide || config.asked_may_collide;
        let is_excused = may_collide && asked.contains(&first) && asked.contains(&second);
        let is_generated = collision.pair.iter().any(|i| judged.is_generated(*i, collision.timestep));
        if is_excused || !is_generated || may_be_one(scene, collision.pair) {
            continue;
        }
        let velocity = |agent_idx: usize| scene.state(agent_idx, collision.timestep).map_or(Vec2::ZERO, |s| s.velocity);
        let relative_mps = (velocity(first) - velocity(second)).norm();
        // Any touch is a violation, at whatever speed.
        keep_worse(&mut worst, Violation::new(Check::Collision, scene, first, collision.timestep, (relative_mps, 0.0)));
    }
    worst
}

/// Whether the least box of one agent overlaps the nominal box of the other at present.
fn may_be_one(scene: &Scene, pair: [usize; 2]) -> bool {
    let boxes = pair.map(|agent_idx| {
        let track = &scene.tracks[agent_idx];
        let state = track.trajectory.get(scene.current_timestep())?;
        Some([track.clone(), sized(track)].map(|track| track.footprint(state)))
    });
    let [Some([usual, least]), Some([other_usual, other_least])] = boxes else { return false };
    usual.overlaps(&other_least) || least.overlaps(&other_usual)
}

/// The scene with agents of unknown size at their least size.
fn at_least_size(scene: &Scene) -> Cow<'_, Scene> {
    if scene.tracks.iter().all(|track| track.extent.is_some()) {
        return Cow::Borrowed(scene);
    }
    Cow::Owned(Scene { tracks: scene.tracks.iter().map(sized).collect(), ..scene.clone() })
}

fn sized(track: &Track) -> Track {
    Track { extent: Some(track.extent_or_least()), ..track.clone() }
}
