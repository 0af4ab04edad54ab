//! The intelligent driver model (Treiber, Hennecke and Helbing 2000) along the way of the ego.

use super::way::{advanced, eased, ego, seen};
use crate::metrics::Seen;
use crate::scene::State;
use crate::simulate::driver::{Driver, Failed};
use crate::simulate::{Situation, World};

/// Time headway, seconds; least gap, meters; acceleration and comfortable deceleration, m/s².
const HEADWAY_S: f64 = 1.5;
const LEAST_GAP_M: f64 = 2.0;
const ACCELERATES_MPS2: f64 = 1.5;
const BRAKES_MPS2: f64 = 2.0;
/// Full braking, m/s².
const MOST_MPS2: f64 = 8.0;
/// An agent this close to the flank of the ego, meters, is in its way.
const MARGIN_M: f64 = 0.2;

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
    let half_width_m = situation.scene.tracks[situation.ego_idx].extent_or_nominal().width_m / 2.0;
    let all = seen.iter().enumerate().filter_map(|(agent_idx, seen)| Some((agent_idx, (*seen)?)));
    all.filter(|(agent_idx, _)| situation.can_touch(*agent_idx))
        .filter(move |(_, seen)| seen.flank_m < half_width_m + MARGIN_M && seen.gap_m > -seen.lengths_m / 2.0)
}

/// The distance to the nearest agent in the way of the ego now, meters; infinite if there is none.
pub(in crate::simulate) fn free_m(situation: &Situation, world: &World) -> f64 {
    leaders(situation, &seen(situation, world, world.now())).map(|(_, seen)| seen.gap_m).fold(f64::INFINITY, f64::min)
}

/// The model's acceleration behind these leaders, m/s²; without any, that on a free road.
pub(super) fn acceleration(situation: &Situation, ego: &State, leaders: impl Iterator<Item = Seen>) -> f64 {
    let (speed_mps, wanted_mps) = (ego.speed_mps(), situation.wanted_speed_mps(ego.position).max(1.0));
    let free = (1.0 - (speed_mps / wanted_mps).powi(4)).max(-BRAKES_MPS2 / ACCELERATES_MPS2);
    let held = leaders.map(|seen| {
        let closing_m = speed_mps * seen.closing_mps / (2.0 * (ACCELERATES_MPS2 * BRAKES_MPS2).sqrt());
        let wanted_m = LEAST_GAP_M + (speed_mps * HEADWAY_S + closing_m).max(0.0);
        (wanted_m / seen.gap_m.max(0.1)).powi(2)
    });
    (ACCELERATES_MPS2 * (free - held.fold(0.0, f64::max))).max(-MOST_MPS2)
}
