//! The intelligent driver model (Treiber, Hennecke and Helbing 2000) along the way of the ego.

use super::way::{advanced, eased, ego, seen};
use crate::metrics::{Seen, acceleration_mps2, half_width_m};
use crate::scene::State;
use crate::simulate::driver::{Driver, Failed};
use crate::simulate::{Situation, World};

/// The intelligent driver model. It knows no rules of right of way, and reacts only to the nearest agent in its way.
#[derive(Debug, Clone, Copy, Default)]
pub(in crate::simulate) struct Idm;

impl Driver for Idm {
    fn begin(&mut self, _situation: &Situation, _world: &World) -> Result<(), Failed> {
        Ok(())
    }

    fn next(&mut self, situation: &Situation, world: &World, _sampled: Option<State>) -> Result<State, Failed> {
        let state = ego(situation, world)?;
        let wanted_mps2 = behind_nearest(situation, &state, &seen(situation, world, world.now()));
        Ok(advanced(situation, &state, eased(situation, world, wanted_mps2)))
    }
}

/// The states of the ego at the next `n_steps` timesteps if this model drives it; `then` gives the state of another
/// agent by track and timestep.
pub(in crate::simulate) fn reacting(
    situation: &Situation,
    world: &World,
    n_steps: usize,
    then: impl Fn(usize, usize) -> Option<State>,
) -> Vec<State> {
    let mut world = world.clone();
    let next = |_| {
        let state = Idm.next(situation, &world, None).ok()?;
        let timestep = world.n_timesteps();
        let states = (0..world.n_tracks()).map(|idx| match idx == situation.ego_idx {
            true => Some(state),
            false => then(idx, timestep),
        });
        let states: Vec<Option<State>> = states.collect();
        world.push(states);
        Some(state)
    };
    (0..n_steps).map_while(next).collect()
}

/// The model's acceleration behind the nearest agent in the way of the ego, m/s².
fn behind_nearest(situation: &Situation, ego: &State, seen: &[Option<Seen>]) -> f64 {
    let nearest = leaders(situation, seen).map(|(_, seen)| seen).min_by(|a, b| a.gap_m.total_cmp(&b.gap_m));
    acceleration(situation, ego, nearest.into_iter())
}

/// The agents ahead in the way of the ego, with their present states as seen from it.
pub(super) fn leaders(situation: &Situation, seen: &[Option<Seen>]) -> impl Iterator<Item = (usize, Seen)> {
    let half_width_m = half_width_m(situation.scene.tracks[situation.ego_idx].extent_or_least().width_m);
    let all = seen.iter().enumerate().filter_map(|(agent_idx, seen)| Some((agent_idx, (*seen)?)));
    all.filter(move |(agent_idx, seen)| situation.can_touch(*agent_idx) && seen.leads(half_width_m))
}

/// The distance to the nearest agent in the way of the ego now, meters; infinite if there is none.
pub(in crate::simulate) fn free_m(situation: &Situation, world: &World) -> f64 {
    leaders(situation, &seen(situation, world, world.now())).map(|(_, seen)| seen.gap_m).fold(f64::INFINITY, f64::min)
}

/// The model's acceleration behind these leaders, m/s²; without any, that on a free road.
pub(super) fn acceleration(situation: &Situation, ego: &State, leaders: impl Iterator<Item = Seen>) -> f64 {
    acceleration_mps2(ego.speed_mps(), situation.way.wanted_speed_mps(ego.position), leaders)
}
