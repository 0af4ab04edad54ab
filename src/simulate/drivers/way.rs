//! Motion along the way of the ego, and other agents as seen from it.

use crate::metrics::{Seen, eased_mps2};
use crate::scene::State;
use crate::simulate::Situation;
use crate::simulate::driver::Failed;
use crate::simulate::world::World;

/// After the end of its plan, an ego presses and releases its pedals within about this time, seconds, and no faster
/// than with this jerk, m/s³.
const PEDAL_S: f64 = 0.4;
const GENTLE_MPS3: f64 = 4.0;
/// The last moment, over which braking is judged, seconds.
const LAST_MOMENT_S: f64 = 0.3;

/// The acceleration at which an ego that wants this one arrives within a timestep, m/s².
pub(super) fn eased(situation: &Situation, world: &World, wanted_mps2: f64) -> f64 {
    own_mps2(situation, world).map_or(wanted_mps2, |own_mps2| eased_mps2(wanted_mps2, own_mps2, situation.scene.dt_s))
}

/// The ego a timestep later along its way, with an acceleration that comes from that of its last steps to the wanted
/// one, m/s², no faster than gentle drivers press a pedal, and let go of it. Positions alone count: the velocity of a
/// state from a log is the mean over its last timestep, that of a driven one is of its end. `None` without a past.
pub(super) fn advanced_gently(situation: &Situation, world: &World, wanted_mps2: f64) -> Option<State> {
    let (now, dt_s) = (world.now(), situation.scene.dt_s);
    let state = |n_before: usize| world.state(situation.ego_idx, now.checked_sub(n_before)?);
    let step_mps = |n: usize| Some(state(n)?.position.distance(state(n + 1)?.position) / dt_s);
    let (last_mps, before_mps) = (step_mps(0)?, step_mps(1)?);
    let own_mps2 = (last_mps - before_mps) / dt_s;
    let mps3 = ((wanted_mps2 - own_mps2) / PEDAL_S).clamp(-GENTLE_MPS3, GENTLE_MPS3);
    let mps2 = own_mps2 + mps3 * dt_s;
    // The next step is that much faster than the last one.
    let ego = state(0)?;
    let along = ego.velocity * ego.speed_mps().max(f64::MIN_POSITIVE).recip();
    let began = State { velocity: along * (last_mps + mps2 * dt_s / 2.0).max(0.0), ..ego };
    Some(advanced(situation, &began, mps2))
}

/// The acceleration of the ego over the last timestep, m/s².
pub(super) fn own_mps2(situation: &Situation, world: &World) -> Option<f64> {
    let before = world.state(situation.ego_idx, world.now().checked_sub(1)?)?;
    Some((world.present(situation.ego_idx)?.speed_mps() - before.speed_mps()) / situation.scene.dt_s)
}

/// The present state of the ego.
pub(super) fn ego(situation: &Situation, world: &World) -> Result<State, Failed> {
    world.present(situation.ego_idx).ok_or_else(|| Failed::because("the ego is not there"))
}

/// The ego a timestep later along its way, with this acceleration until then, m/s²; it does not reverse.
pub(super) fn advanced(situation: &Situation, state: &State, acceleration_mps2: f64) -> State {
    situation.way.advanced(state, acceleration_mps2, situation.scene.dt_s)
}

/// The states of the ego that others expect at the next `n_steps` timesteps: it goes on along its route at its speed,
/// or keeps braking as in the last moment until it stands.
pub(in crate::simulate) fn expected(situation: &Situation, world: &World, n_steps: usize) -> Vec<State> {
    let (now, ego_idx) = (world.now(), situation.ego_idx);
    let Some(state) = world.state(ego_idx, now) else { return Vec::new() };
    let n_before = (LAST_MOMENT_S / situation.scene.dt_s).round().max(1.0) as usize;
    let before = now.checked_sub(n_before).and_then(|timestep| world.state(ego_idx, timestep));
    let change_mps = before.map_or(0.0, |before| state.speed_mps() - before.speed_mps());
    let acceleration_mps2 = (change_mps / (n_before as f64 * situation.scene.dt_s)).min(0.0);
    let mut state = state;
    let next = |_| {
        state = advanced(situation, &state, acceleration_mps2);
        state
    };
    (0..n_steps).map(next).collect()
}

/// The other agents at a timestep, by track, as seen from the ego's way; `None` for absent ones.
pub(super) fn seen(situation: &Situation, world: &World, timestep: usize) -> Vec<Option<Seen>> {
    let (way, tracks) = (&situation.way, &situation.scene.tracks);
    let ego = world.state(situation.ego_idx, timestep);
    let ego = ego.and_then(|ego| Some((ego, way.route.driven_m(ego.position)?)));
    let length_m = tracks[situation.ego_idx].extent_or_least().length_m;
    let seen = |agent_idx: usize| {
        let (ego, driven_m) = ego?;
        let state = world.state(agent_idx, timestep).filter(|_| agent_idx != situation.ego_idx)?;
        Some(way.place(&tracks[agent_idx], &state)?.seen_from(driven_m, ego.speed_mps(), length_m))
    };
    (0..world.n_tracks()).map(seen).collect()
}
