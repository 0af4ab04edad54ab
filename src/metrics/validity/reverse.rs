//! The check that vehicles do not drive backward.

use super::check::exceeds;
use super::{Check, Judged, Violation, keep_worse};
use crate::geometry::Vec2;
use crate::scene::{AgentClass, State};

/// A vehicle goes back by at most this, meters, unless it went back farther in its given states: whoever parks is seen
/// to. Of recorded vehicles that come to a stand, 3 in 1,000 go back by a third of it.
const MAX_REVERSE_M: f64 = 0.3;

/// The longest way back of a vehicle against its headings that ends in a generated state.
pub(super) fn worst(judged: &Judged<'_>) -> Option<Violation> {
    let scene = judged.scene;
    let mut worst = None;
    for agent_idx in judged.generated_agents() {
        if !judged.is_vehicle(agent_idx) && scene.tracks[agent_idx].class != AgentClass::Cyclist {
            continue;
        }
        let (mut given_m, mut generated) = (0.0_f64, (0.0, 0));
        // How far back the agent is from the place farthest ahead, and the state before.
        let (mut back_m, mut before) = (0.0, None::<&State>);
        for timestep in 0..scene.n_timesteps {
            let state = scene.state(agent_idx, timestep).filter(|state| state.is_finite());
            back_m = match state.zip(before) {
                Some((now, before)) => {
                    let ahead = Vec2::from_angle(before.heading_rad);
                    f64::max(back_m - (now.position - before.position).dot(ahead), 0.0)
                }
                None => 0.0,
            };
            before = state;
            match judged.is_generated(agent_idx, timestep) {
                true if back_m > generated.0 => generated = (back_m, timestep),
                true => (),
                false => given_m = given_m.max(back_m),
            }
        }
        if exceeds(generated.0, MAX_REVERSE_M) && given_m <= MAX_REVERSE_M {
            let limits = (generated.0, MAX_REVERSE_M);
            keep_worse(&mut worst, Violation::new(Check::Reverse, scene, agent_idx, generated.1, limits));
        }
    }
    worst
}
