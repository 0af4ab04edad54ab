//! Could it have happened? Checks of single scenarios that no recording of real traffic should fail.
//!
//! Every check looks at what was generated: at windows of time that hold a generated state, at collisions of generated agents, at
//! the seams between given and generated states. The recording, seen as if it had been generated, is judged beside it: what it passes
//! shows how much the limits ask.
//!
//! Velocities, accelerations and jerks come from polynomials fitted to positions over 0.7 s ([`LocalFit`]), so that rounding and the
//! noise of trackers do not count, but a step in position or speed does. One check a function; [`Check`] names them all.

mod check;
mod collision;
mod config;
mod fit;
mod map_fit;
mod motion;
mod offroad;
mod seam;
#[cfg(test)]
mod tests;
mod validity_rate;

pub use check::{Check, Violation};
pub use config::ValidityConfig;
pub use fit::LocalFit;
pub use map_fit::MapFit;
pub use validity_rate::ValidityRate;

use crate::scene::{AgentClass, Roles, Scene};

/// A scene to be judged, and which of its states were generated.
pub struct Judged<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Who was asked to show something: their collisions with each other can be excused.
    pub asked: &'a Roles,
    may_collide: bool,
    generated: Box<dyn Fn(usize, usize) -> bool + 'a>,
}

impl<'a> Judged<'a> {
    /// A scene whose states are generated where `generated(agent_idx, timestep)` says so.
    pub fn new(scene: &'a Scene, asked: &'a Roles, generated: impl Fn(usize, usize) -> bool + 'a) -> Self {
        Self { scene, asked, may_collide: false, generated: Box::new(generated) }
    }

    /// A scene whose whole future is taken as generated.
    pub fn future_of(scene: &'a Scene, asked: &'a Roles) -> Self {
        Self::new(scene, asked, |_, timestep| timestep >= scene.n_history)
    }

    /// The same, with the collisions of those who were asked with each other excused if they were `asked_to_collide`.
    #[must_use]
    pub fn excused_if(self, asked_to_collide: bool) -> Self {
        Self { may_collide: asked_to_collide, ..self }
    }

    /// Whether a state is there and was generated.
    fn is_generated(&self, agent_idx: usize, timestep: usize) -> bool {
        self.scene.state(agent_idx, timestep).is_some() && (self.generated)(agent_idx, timestep)
    }

    /// The agents with any generated state.
    fn generated_agents(&self) -> impl Iterator<Item = usize> + '_ {
        let has_any = |i: &usize| (0..self.scene.n_timesteps).any(|timestep| self.is_generated(*i, timestep));
        (0..self.scene.tracks.len()).filter(has_any)
    }

    /// Whether the agent drives as vehicles do. Of agents of unknown class too little is known, but in Argoverse 1 nearly all are cars.
    fn is_vehicle(&self, agent_idx: usize) -> bool {
        matches!(
            self.scene.tracks[agent_idx].class,
            AgentClass::Vehicle | AgentClass::Bus | AgentClass::Motorcyclist | AgentClass::Unknown
        )
    }

    /// The checks that the scene fails, in the order of [`Check::ALL`], each with its worst place. Empty: the scene is valid.
    pub fn violations(&self, config: &ValidityConfig) -> Vec<Violation> {
        let not_checked = self.not_checked(config);
        let mut found = Vec::new();
        if config.checks_motion_of(self.scene.source.dataset) {
            found.extend(motion::violations(self, config));
            found.extend(seam::violations(self, config));
        }
        found.extend(collision::worst(self, config));
        if !not_checked.contains(&Check::Offroad) {
            found.extend(offroad::worst(self, config));
        }
        found.retain(|violation| !not_checked.contains(&violation.check));
        found.sort_by_key(|violation| violation.check);
        found
    }
}

/// Keeps of two violations of a check the one that is farther beyond its limit; the first of equals.
fn keep_worse(worst: &mut Option<Violation>, candidate: Violation) {
    if worst.as_ref().is_none_or(|known| candidate.excess() > known.excess()) {
        *worst = Some(candidate);
    }
}
