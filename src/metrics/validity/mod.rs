//! Is a scenario possible? Checks of single scenarios that no recording of real traffic should fail.
//!
//! Only generated states count: windows of time that contain a generated state, collisions of generated agents, the
//! seams between observed and generated states. The recording is judged beside it, as if it had been generated, and
//! shows how strict the limits are.
//!
//! Velocities, accelerations and jerks come from polynomials fitted to positions over 0.7 s ([`LocalFit`]), so that
//! rounding and the noise of trackers do not count, but a step in position or speed does. Each check is a function;
//! [`Check`] names them all.

mod check;
mod collision;
mod config;
mod deserted;
mod driven_area;
mod fit;
mod map_fit;
mod map_gaps;
mod motion;
mod offroad;
mod reverse;
mod seam;
#[cfg(test)]
mod tests;
mod validity_rate;

pub use check::{Check, Violation};
pub use config::ValidityConfig;
pub use driven_area::DrivenArea;
pub use fit::LocalFit;
pub use map_fit::MapFit;
pub use map_gaps::MapGaps;
pub use validity_rate::ValidityRate;

use crate::scene::{AgentClass, Roles, Scene};

/// A scene to be judged, and which of its states were generated.
pub struct Judged<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// The requested agents, whose collisions with each other can be excused.
    pub asked: &'a Roles,
    may_collide: bool,
    map_gaps: &'a MapGaps,
    generated: Box<dyn Fn(usize, usize) -> bool + 'a>,
}

impl<'a> Judged<'a> {
    /// A scene whose state of an agent at a timestep is generated if `generated(agent_idx, timestep)` holds.
    pub fn new(scene: &'a Scene, asked: &'a Roles, generated: impl Fn(usize, usize) -> bool + 'a) -> Self {
        Self { scene, asked, may_collide: false, map_gaps: MapGaps::none(), generated: Box::new(generated) }
    }

    /// A scene whose whole future is taken as generated.
    pub fn future_of(scene: &'a Scene, asked: &'a Roles) -> Self {
        Self::new(scene, asked, |_, timestep| timestep >= scene.n_history)
    }

    /// Takes the maps to have these gaps.
    #[must_use]
    pub fn with_gaps(self, map_gaps: &'a MapGaps) -> Self {
        Self { map_gaps, ..self }
    }

    /// Excuses collisions among the requested agents if they were `asked_to_collide`.
    #[must_use]
    pub fn excused_if(self, asked_to_collide: bool) -> Self {
        Self { may_collide: asked_to_collide, ..self }
    }

    /// Whether a state exists and was generated.
    fn is_generated(&self, agent_idx: usize, timestep: usize) -> bool {
        self.scene.state(agent_idx, timestep).is_some() && (self.generated)(agent_idx, timestep)
    }

    /// The agents with any generated state.
    fn generated_agents(&self) -> impl Iterator<Item = usize> + '_ {
        let has_any = |i: &usize| (0..self.scene.n_timesteps).any(|timestep| self.is_generated(*i, timestep));
        (0..self.scene.tracks.len()).filter(has_any)
    }

    /// Whether the agent moves like a vehicle. Agents of unknown class count, because nearly all of them are cars in
    /// Argoverse 1.
    fn is_vehicle(&self, agent_idx: usize) -> bool {
        matches!(
            self.scene.tracks[agent_idx].class,
            AgentClass::Vehicle | AgentClass::Bus | AgentClass::Motorcyclist | AgentClass::Unknown
        )
    }

    /// The checks that the scene fails, in the order of [`Check::ALL`], each with its worst place. Empty: the scene is
    /// valid.
    pub fn violations(&self, config: &ValidityConfig) -> Vec<Violation> {
        let not_checked = self.not_checked(config);
        let mut found = Vec::new();
        if config.checks_motion_of(self.scene.source.dataset) {
            found.extend(motion::violations(self, config));
            found.extend(reverse::worst(self));
            found.extend(seam::violations(self, config));
        }
        found.extend(collision::worst(self, config));
        found.extend(deserted::worst(self));
        if !not_checked.contains(&Check::Offroad) {
            found.extend(offroad::worst(self, config));
        }
        found.retain(|violation| !not_checked.contains(&violation.check));
        found.sort_by_key(|violation| violation.check);
        found
    }
}

/// Keeps the violation that is farther beyond its limit; the first among equals.
fn keep_worse(worst: &mut Option<Violation>, candidate: Violation) {
    if worst.as_ref().is_none_or(|known| candidate.excess() > known.excess()) {
        *worst = Some(candidate);
    }
}
