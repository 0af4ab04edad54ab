//! What the ego will do, if a driver that plans nothing drives it on.

use crate::scene::State;
use crate::simulate::driver::Driver;
use crate::simulate::{Situation, World};

/// The states of the ego at the next `n_steps` timesteps if `driver` drives it, or until it does not drive on; `then`
/// gives the state of another agent by track and timestep.
pub(in crate::simulate) fn ahead(
    driver: &mut dyn Driver,
    situation: &Situation,
    world: &World,
    n_steps: usize,
    then: impl Fn(usize, usize) -> Option<State>,
) -> Vec<State> {
    let mut world = world.clone();
    let next = |_| {
        let (state, timestep) = (driver.next(situation, &world, None).ok()?, world.n_timesteps());
        let at = |idx: usize| if idx == situation.ego_idx { Some(state) } else { then(idx, timestep) };
        let all: Vec<Option<State>> = (0..world.n_tracks()).map(at).collect();
        world.push(all);
        Some(state)
    };
    (0..n_steps).map_while(next).collect()
}
