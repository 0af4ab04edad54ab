//! Motion along the route of the ego, and other agents as seen from it.

use crate::behavior::footprint::Footprint;
use crate::geometry::Vec2;
use crate::metrics::Seen;
use crate::scene::State;
use crate::simulate::Situation;
use crate::simulate::driver::Failed;
use crate::simulate::world::World;
use std::f64::consts::FRAC_PI_2;

/// The distance over which an ego beside its route comes over to it, meters.
const COMES_OVER_M: f64 = 7.0;

/// The last moment, over which braking is judged, seconds.
const LAST_MOMENT_S: f64 = 0.3;

/// The fastest change of the acceleration by ordinary drivers, m/s³: as the careful driver of UN Regulation No. 157
/// brakes.
const JERK_MPS3: f64 = 12.65;

/// The acceleration at which an ego that wants this one arrives within a timestep, m/s².
pub(super) fn eased(situation: &Situation, world: &World, wanted_mps2: f64) -> f64 {
    let (ego_idx, now, dt_s) = (situation.ego_idx, world.now(), situation.scene.dt_s);
    let before = now.checked_sub(1).and_then(|timestep| world.state(ego_idx, timestep));
    let Some((before, state)) = before.zip(world.present(ego_idx)) else { return wanted_mps2 };
    let own_mps2 = (state.speed_mps() - before.speed_mps()) / dt_s;
    wanted_mps2.clamp(own_mps2 - JERK_MPS3 * dt_s, own_mps2 + JERK_MPS3 * dt_s)
}

/// The present state of the ego.
pub(super) fn ego(situation: &Situation, world: &World) -> Result<State, Failed> {
    world.present(situation.ego_idx).ok_or_else(|| Failed::because("the ego is not there"))
}

/// The ego a timestep later along its route, with this acceleration until then, m/s²; it does not reverse.
pub(super) fn advanced(situation: &Situation, state: &State, acceleration_mps2: f64) -> State {
    let (route, dt_s) = (&situation.route, situation.scene.dt_s);
    let speed_mps = state.speed_mps();
    let then_mps = (speed_mps + acceleration_mps2 * dt_s).max(0.0);
    let moved_m = f64::midpoint(speed_mps, then_mps) * dt_s;
    let Some((place, driven_m)) = route.project(state.position).zip(route.driven_m(state.position)) else {
        return *state;
    };
    let (center, along_rad) = route.pose_at(driven_m + moved_m);
    let aside_m = place.offset_m * (-moved_m / COMES_OVER_M).exp();
    let position = center + Vec2::from_angle(along_rad + FRAC_PI_2) * aside_m;
    // Headings of very short steps are noise.
    let heading_rad = if moved_m > 0.05 { (position - state.position).angle() } else { state.heading_rad };
    State { position, heading_rad, velocity: Vec2::from_angle(heading_rad) * then_mps }
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

/// The other agents at a timestep, by track, as seen from the ego's route; `None` for absent ones.
pub(super) fn seen(situation: &Situation, world: &World, timestep: usize) -> Vec<Option<Seen>> {
    let route = &situation.route;
    let ego = world.state(situation.ego_idx, timestep);
    let ego = ego.and_then(|ego| Some((ego, route.driven_m(ego.position)?)));
    let seen = |agent_idx: usize| {
        let (ego, driven_m) = ego?;
        let state = world.state(agent_idx, timestep).filter(|_| agent_idx != situation.ego_idx)?;
        let place = route.project(state.position)?;
        let body = situation.body(agent_idx, &state);
        let across = Vec2::from_angle(place.heading_rad + FRAC_PI_2);
        let along_mps = state.velocity.dot(Vec2::from_angle(place.heading_rad));
        let offset_m = place.offset_m.abs();
        Some(Seen {
            offset_m,
            flank_m: offset_m - Footprint::new(&body).half_extent_m(across),
            gap_m: route.gap_m(&body)? - driven_m,
            closing_mps: ego.speed_mps() - along_mps,
            lengths_m: body.length_m + situation.body(situation.ego_idx, &ego).length_m,
        })
    };
    (0..world.n_tracks()).map(seen).collect()
}
