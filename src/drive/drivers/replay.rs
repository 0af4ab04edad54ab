//! Drivers that do not react: the scenario's own states, and a constant speed; and the model, which is sampled.

use super::idm::acceleration;
use super::way::{advanced, ego};
use crate::drive::driver::{Driver, Failed};
use crate::drive::{Situation, World};
use crate::geometry::Vec2;
use crate::scene::State;

/// The ego as the model samples it.
#[derive(Debug, Clone, Copy, Default)]
pub(in crate::drive) struct Model;

/// The ego as in the scenario; after its end, along its route at the last speed, or as fast as bends allow.
#[derive(Debug, Clone, Copy, Default)]
pub(in crate::drive) struct Log;

/// The ego along its route at the present speed.
#[derive(Debug, Clone, Copy, Default)]
pub(in crate::drive) struct AtConstantVelocity;

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
            Some(state) => Ok(*state),
            None => {
                let state = ego(situation, world)?;
                Ok(advanced(situation, &state, acceleration(situation, &state, std::iter::empty()).min(0.0)))
            }
        }
    }

    fn answers(&self) -> bool {
        false
    }
}

/// The ego at this position and heading at the next timestep, with the velocity that takes it there.
///
/// # Errors
/// When the ego is not there now.
pub(in crate::drive) fn follow_log(
    situation: &Situation,
    world: &World,
    position: Vec2,
    heading_rad: f64,
) -> Result<State, Failed> {
    let velocity = (position - ego(situation, world)?.position) * (1.0 / situation.scene.dt_s);
    Ok(State { position, heading_rad, velocity })
}

impl Driver for AtConstantVelocity {
    fn begin(&mut self, _situation: &Situation, _world: &World) -> Result<(), Failed> {
        Ok(())
    }

    fn next(&mut self, situation: &Situation, world: &World, _sampled: Option<State>) -> Result<State, Failed> {
        Ok(advanced(situation, &ego(situation, world)?, 0.0))
    }
}
