//! Does anybody drive into somebody, though nobody asked for it?

use super::{Check, Judged, ValidityConfig, Violation, keep_worse};
use crate::geometry::Vec2;
use crate::metrics::collision_rate::collisions;

/// The collision with the highest relative speed, as the collision rate counts them: boxes that overlap at a future timestep and did
/// not at present, of two of whom at least one moves. One of the two must be generated there; the two that were asked are excused
/// where the limits say so.
pub(super) fn worst(judged: &Judged<'_>, config: &ValidityConfig) -> Option<Violation> {
    let scene = judged.scene;
    let asked: Vec<usize> = judged.asked.iter().filter_map(|(_, track)| scene.track_idx(track)).collect();
    let mut worst = None;
    for collision in collisions(scene) {
        let [first, second] = collision.pair;
        let is_excused = config.asked_may_collide && asked.contains(&first) && asked.contains(&second);
        let is_generated = collision.pair.iter().any(|i| judged.is_generated(*i, collision.timestep));
        if is_excused || !is_generated {
            continue;
        }
        let velocity = |agent_idx: usize| scene.state(agent_idx, collision.timestep).map_or(Vec2::ZERO, |s| s.velocity);
        let relative_mps = (velocity(first) - velocity(second)).norm();
        // Any touch is one too many, at whatever speed.
        keep_worse(&mut worst, Violation::new(Check::Collision, scene, first, collision.timestep, (relative_mps, 0.0)));
    }
    worst
}
