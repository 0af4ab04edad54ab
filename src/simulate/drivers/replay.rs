//! Drivers that do not react: the scenario's own states, as long as there are any, and a constant speed; and the model,
//! which is sampled.

use super::Idm;
use super::way::{advanced, ego};
use crate::scene::State;
use crate::simulate::driver::{Driver, Failed};
use crate::simulate::{Situation, World};

/// The ego as the model samples it.
#[derive(Debug, Clone, Copy, Default)]
pub(in crate::simulate) struct Model;

/// The ego as in the scenario; after its end, as the intelligent driver, calmly.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Log;

/// The ego along its route at the present speed.
#[derive(Debug, Clone, Copy, Default)]
pub(in crate::simulate) struct AtConstantVelocity;

impl Driver for Model {
    fn begin(&mut self, _situation: &Situation, _world: &World) -> Result<(), Failed> {
        Ok(())
    }

    fn next(&mut self, _situation: &Situation, _world: &World, sampled: Option<State>) -> Result<State, Failed> {
        sampled.ok_or_else(|| Failed::because("the model has no future for the ego"))
    }

    fn is_model(&self) -> bool {
        true
    }
}

impl Driver for Log {
    fn begin(&mut self, _situation: &Situation, _world: &World) -> Result<(), Failed> {
        Ok(())
    }

    fn next(&mut self, situation: &Situation, world: &World, _sampled: Option<State>) -> Result<State, Failed> {
        match situation.scene.state(situation.ego_idx, world.n_timesteps()) {
            // As a planner that answers with these states drives.
            Some(State { position, heading_rad, .. }) => {
                let velocity = (*position - ego(situation, world)?.position) * (1.0 / situation.scene.dt_s);
                Ok(State { position: *position, heading_rad: *heading_rad, velocity })
            }
            None => Idm::settling(situation, world),
        }
    }

    fn answers(&self) -> bool {
        false
    }
}

impl Log {
    /// The states of the ego at the next `n_steps` timesteps if the others keep to their plans, or to their speeds.
    pub(in crate::simulate) fn ahead(situation: &Situation, world: &World, n_steps: usize) -> Vec<State> {
        let (mut world, dt_s) = (world.clone(), situation.scene.dt_s);
        let next = |_| {
            let (state, timestep) = (Self.next(situation, &world, None).ok()?, world.n_timesteps());
            let goes_on = |s: State| State { position: s.position + s.velocity * dt_s, ..s };
            let other = |idx: usize| situation.plan(&world, idx, timestep).or_else(|| world.present(idx).map(goes_on));
            let all = (0..world.n_tracks()).map(|idx| if idx == situation.ego_idx { Some(state) } else { other(idx) });
            let all: Vec<Option<State>> = all.collect();
            world.push(all);
            Some(state)
        };
        (0..n_steps).map_while(next).collect()
    }
}

impl Driver for AtConstantVelocity {
    fn begin(&mut self, _situation: &Situation, _world: &World) -> Result<(), Failed> {
        Ok(())
    }

    fn next(&mut self, situation: &Situation, world: &World, _sampled: Option<State>) -> Result<State, Failed> {
        Ok(advanced(situation, &ego(situation, world)?, 0.0))
    }
}
