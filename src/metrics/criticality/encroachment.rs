//! Post-encroachment time: between one road user leaving the place where two paths cross and the other entering it.

use super::agent::MovingAgent;
use crate::behavior::footprint::Footprint;
use crate::behavior::swept_boxes::SweptBoxes;
use crate::geometry::wrap_angle;
use crate::scene::{Scene, State};

/// Halvings of a timestep by which an entry or exit is located: a thousandth of a timestep.
const N_HALVINGS: usize = 10;

/// Post-encroachment time of two agents, seconds: the entry of the second minus the exit of the first, in the order in
/// which this is positive. The first may leave the area before the present, but the second must enter it in the future.
/// Agents move at constant velocity between timesteps. `None` if the swept areas do not overlap, both are in the
/// overlap at once, or the first never leaves it.
pub(super) fn post_encroachment_s(scene: &Scene, [first, second]: [&MovingAgent; 2]) -> Option<f64> {
    if !first.sweep.may_come_within(&second.sweep, 0.0) {
        return None;
    }
    let visits = [Visit::of(scene, first, &second.sweep)?, Visit::of(scene, second, &first.sweep)?];
    let gap = |earlier: &Visit, later: &Visit| {
        let gap_steps = later.entry? - earlier.exit?;
        let enters_in_future = later.entry? > scene.current_timestep() as f64;
        (gap_steps >= 0.0 && enters_in_future).then_some(gap_steps * scene.dt_s)
    };
    gap(&visits[0], &visits[1]).or_else(|| gap(&visits[1], &visits[0]))
}

/// When an agent is in the conflict area, in timesteps.
struct Visit {
    /// When it enters; `None` if it is there from its first state on.
    entry: Option<f64>,
    /// When it leaves; `None` if it is still there in its last state.
    exit: Option<f64>,
}

impl Visit {
    /// `None` if it is never there.
    fn of(scene: &Scene, agent: &MovingAgent, swept: &SweptBoxes) -> Option<Self> {
        let timesteps = 0..scene.n_timesteps;
        let is_there = |footprint: &Footprint| swept.overlaps_any(footprint, timesteps.clone());
        let there = |timestep: usize| agent.sweep.at(timestep).is_some_and(is_there);
        let first = timesteps.clone().find(|timestep| there(*timestep))?;
        let last = timesteps.clone().rev().find(|timestep| there(*timestep))?;
        let track = &scene.tracks[agent.agent_idx];
        let crossing = |inside: usize, outside: Option<usize>| {
            let (inner, outer) = (track.trajectory.get(inside)?, track.trajectory.get(outside?)?);
            let (mut low, mut high) = (0.0, 1.0);
            for _ in 0..N_HALVINGS {
                let middle = f64::midpoint(low, high);
                match is_there(&Footprint::new(&track.footprint(&between(inner, outer, middle)))) {
                    true => low = middle,
                    false => high = middle,
                }
            }
            let share = f64::midpoint(low, high);
            Some(inside as f64 + (outside? as f64 - inside as f64) * share)
        };
        Some(Self { entry: crossing(first, first.checked_sub(1)), exit: crossing(last, Some(last + 1)) })
    }
}

/// The state at a fraction of the way from one to another.
fn between(from: &State, to: &State, share: f64) -> State {
    State {
        position: from.position.lerp(to.position, share),
        heading_rad: wrap_angle(from.heading_rad + wrap_angle(to.heading_rad - from.heading_rad) * share),
        velocity: from.velocity.lerp(to.velocity, share),
    }
}
