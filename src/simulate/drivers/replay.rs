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

impl Driver for AtConstantVelocity {
    fn begin(&mut self, _situation: &Situation, _world: &World) -> Result<(), Failed> {
        Ok(())
    }

    fn next(&mut self, situation: &Situation, world: &World, _sampled: Option<State>) -> Result<State, Failed> {
        Ok(advanced(situation, &ego(situation, world)?, 0.0))
    }
}
