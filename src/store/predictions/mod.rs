//! Predictions in the formats of benchmarks.
//!
//! They are never read back.

mod argoverse;
mod interaction;

pub use argoverse::ArgoversePredictions;
pub use interaction::InteractionPredictions;

use crate::metrics::Modes;
use crate::scene::{Scene, State};

/// The future states of a track in each mode, in the recording's frame. `None` if there are no modes, or one lacks a
/// state.
fn predicted(recorded: &Scene, modes: &Modes, agent_idx: usize) -> Option<Vec<Vec<State>>> {
    let of_mode = |sample: &Scene| -> Option<Vec<State>> {
        let states = (sample.n_history..sample.n_timesteps).map(|timestep| {
            sample.state(agent_idx, timestep).map(|state| state.transformed(&recorded.world_from_scene))
        });
        states.collect::<Option<Vec<State>>>().filter(|states| !states.is_empty())
    };
    modes.samples.iter().map(of_mode).collect::<Option<Vec<_>>>().filter(|modes| !modes.is_empty())
}
