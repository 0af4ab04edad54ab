//! How close do two road users come to each other?

use crate::behavior::footprint::Footprint;
use crate::behavior::time_to_collision::time_to_collision_s;
use crate::scene::State;
use crate::simulate::{Situation, World};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Road users that are farther apart are not looked at, meters.
const WITHIN_M: f64 = 60.0;

/// A measure of how close two road users come, of which one at least is motorized, while they are on a collision
/// course: if both kept their velocities.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// The deceleration that avoids the collision, half of the closing speed over the time to collision.
    #[default]
    RequiredDecelerationMps2,
    /// The time to collision.
    TimeToCollisionS,
    /// The gap between the two.
    GapM,
}

impl Severity {
    /// The value as a severity: the larger, the more severe.
    pub(super) fn signed(self, value: f64) -> f64 {
        if self == Self::RequiredDecelerationMps2 { value } else { -value }
    }

    /// The largest severity at a timestep, of a road user or of any. Who touches already is past it.
    pub(super) fn at(self, situation: &Situation, world: &World, of: Option<usize>, timestep: usize) -> f64 {
        let there: Vec<(usize, State, Footprint)> = (0..world.n_tracks())
            .filter_map(|idx| {
                let state = world.state(idx, timestep)?;
                Some((idx, state, Footprint::new(&situation.body(idx, &state))))
            })
            .collect();
        let is_motorized = |idx: usize| situation.scene.tracks[idx].class.is_motorized();
        let mut most = f64::NEG_INFINITY;
        for (i, (one, state, body)) in there.iter().enumerate() {
            for (other, other_state, other_body) in &there[i + 1..] {
                let is_far = state.position.distance(other_state.position) > WITHIN_M;
                let is_asked = of.is_none_or(|of| [*one, *other].contains(&of));
                if is_far || !is_asked || !(is_motorized(*one) || is_motorized(*other)) {
                    continue;
                }
                let ttc_s = time_to_collision_s(body, state.velocity, other_body, other_state.velocity);
                let Some(ttc_s) = ttc_s.filter(|ttc_s| *ttc_s > 0.0) else { continue };
                let value = match self {
                    Self::RequiredDecelerationMps2 => (state.velocity - other_state.velocity).norm() / (2.0 * ttc_s),
                    Self::TimeToCollisionS => ttc_s,
                    Self::GapM => body.distance_m(other_body),
                };
                most = most.max(self.signed(value));
            }
        }
        most
    }
}
