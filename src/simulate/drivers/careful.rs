//! The careful driver of UN Regulation No. 157 in a closed loop ([`CarefulDriver`]).

use super::way::{advanced, ego, own_mps2, seen};
use crate::metrics::CarefulDriver;
use crate::scene::State;
use crate::simulate::driver::{Driver, Failed};
use crate::simulate::{Situation, World};

/// The driver.
#[derive(Debug, Clone, Default)]
pub(crate) struct Careful {
    driver: CarefulDriver,
}

impl Careful {
    fn look(&mut self, situation: &Situation, world: &World, timestep: usize) {
        let dt_s = situation.scene.dt_s;
        let since_s = (timestep as f64 - situation.scene.current_timestep() as f64) * dt_s;
        let ego_mps = world.state(situation.ego_idx, timestep).map_or(0.0, |ego| ego.speed_mps());
        let all = seen(situation, world, timestep).into_iter().enumerate();
        let all = all.map(|(agent_idx, seen)| seen.filter(|_| situation.can_touch(agent_idx)));
        self.driver.look([since_s, dt_s], ego_mps, all);
    }
}

impl Driver for Careful {
    /// Looks at all that has happened: its knowledge is a function of the world.
    fn begin(&mut self, situation: &Situation, world: &World) -> Result<(), Failed> {
        let width_m = situation.scene.tracks[situation.ego_idx].extent_or_least().width_m;
        self.driver = CarefulDriver::new(world.n_tracks(), width_m, 0.0);
        (0..world.now()).for_each(|timestep| self.look(situation, world, timestep));
        Ok(())
    }

    fn next(&mut self, situation: &Situation, world: &World, _sampled: Option<State>) -> Result<State, Failed> {
        let state = ego(situation, world)?;
        self.look(situation, world, world.now());
        let motion = [state.speed_mps(), own_mps2(situation, world).unwrap_or_default()];
        let wanted_mps = situation.way.wanted_speed_mps(state.position);
        let acceleration_mps2 = self.driver.acceleration_mps2(motion, wanted_mps, situation.scene.dt_s);
        Ok(advanced(situation, &state, acceleration_mps2))
    }
}
