//! The careful driver of UN Regulation No. 157 in a closed loop.
//!
//! It keeps its path and its distance as an ordinary driver does, by the intelligent driver model with at most 2 m/s²,
//! considering agents that it has perceived; and it brakes hard when, and as, the regulation's driver does
//! ([`CarefulWatch`]).

use super::idm::{acceleration, leaders};
use super::way::{advanced, eased, ego, seen};
use crate::metrics::{CarefulWatch, Seen};
use crate::scene::State;
use crate::simulate::driver::{Driver, Failed};
use crate::simulate::{Situation, World};

/// The deceleration of ordinary driving, m/s².
const ORDINARY_MPS2: f64 = 2.0;

/// The driver.
#[derive(Debug, Clone, Default)]
pub(crate) struct Careful {
    watches: Vec<CarefulWatch>,
}

impl Careful {
    /// Looks around; returns the agents that it sees.
    fn look(&mut self, situation: &Situation, world: &World, timestep: usize) -> Vec<Option<Seen>> {
        let dt_s = situation.scene.dt_s;
        let all = seen(situation, world, timestep);
        for (agent_idx, (watch, seen)) in self.watches.iter_mut().zip(&all).enumerate() {
            let seen = seen.as_ref().filter(|_| situation.can_touch(agent_idx));
            watch.look(timestep as f64 * dt_s, dt_s, seen);
        }
        all
    }
}

impl Driver for Careful {
    /// Looks at all that has happened: its knowledge is a function of the world.
    fn begin(&mut self, situation: &Situation, world: &World) -> Result<(), Failed> {
        self.watches = vec![CarefulWatch::default(); world.n_tracks()];
        (0..world.now()).for_each(|timestep| drop(self.look(situation, world, timestep)));
        Ok(())
    }

    fn next(&mut self, situation: &Situation, world: &World, _sampled: Option<State>) -> Result<State, Failed> {
        let state = ego(situation, world)?;
        let seen = self.look(situation, world, world.now());
        let now_s = world.now() as f64 * situation.scene.dt_s;
        let braking_mps2 = self.watches.iter().map(|watch| watch.braking_mps2(now_s)).fold(0.0, f64::max);
        let perceived =
            leaders(situation, &seen).filter(|(agent_idx, _)| self.watches[*agent_idx].has_perceived(now_s));
        let ordinary_mps2 = acceleration(situation, &state, perceived.map(|(_, seen)| seen)).max(-ORDINARY_MPS2);
        let ordinary_mps2 = eased(situation, world, ordinary_mps2);
        Ok(advanced(situation, &state, ordinary_mps2.min(if braking_mps2 > 0.0 { -braking_mps2 } else { f64::MAX })))
    }
}
