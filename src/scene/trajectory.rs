//! The states of one agent over the timesteps of a scene.

use crate::geometry::{Transform2, Vec2};

/// One agent at one timestep.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct State {
    /// Center of the agent in the scene frame, meters.
    pub position: Vec2,
    /// Direction in the scene frame, radians in (-π, π].
    pub heading_rad: f64,
    /// Velocity in the scene frame, meters per second.
    pub velocity: Vec2,
}

impl State {
    /// Speed, meters per second.
    pub fn speed_mps(&self) -> f64 {
        self.velocity.norm()
    }

    /// The state in another frame.
    pub fn transformed(&self, to_from_here: &Transform2) -> Self {
        Self {
            position: to_from_here.point(self.position),
            heading_rad: to_from_here.heading(self.heading_rad),
            velocity: to_from_here.vector(self.velocity),
        }
    }

    /// Whether every number is finite.
    pub fn is_finite(&self) -> bool {
        self.position.is_finite() && self.heading_rad.is_finite() && self.velocity.is_finite()
    }
}

/// The derived parts of a recorded trajectory.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Derivation {
    /// One entry a timestep: whether the heading is held because the agent moves too slowly. Otherwise the headings of
    /// a trajectory with a derivation follow from its motion.
    pub held_headings: Vec<bool>,
    /// If the states were smoothed, the recorded positions by ascending time; otherwise empty.
    pub recorded: Vec<RecordedPosition>,
}

/// A recorded position with its time: timesteps are evenly spaced, recordings need not be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RecordedPosition {
    /// Seconds after the present.
    pub time_s: f64,
    /// Center of the agent in the scene frame, meters.
    pub position: Vec2,
}

/// One entry a timestep; timesteps at which the agent was not tracked hold nothing.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Trajectory {
    states: Vec<Option<State>>,
    derivation: Option<Box<Derivation>>,
}

impl Trajectory {
    /// A trajectory from one optional state a timestep.
    pub const fn new(states: Vec<Option<State>>) -> Self {
        Self { states, derivation: None }
    }

    /// The trajectory, marked as derived in this way.
    #[must_use]
    pub fn derived(self, derivation: Derivation) -> Self {
        Self { derivation: Some(Box::new(derivation)), ..self }
    }

    /// The trajectory with other states, derived in the same way.
    #[must_use]
    pub fn with_states(&self, states: Vec<Option<State>>) -> Self {
        Self { states, derivation: self.derivation.clone() }
    }

    /// The derived parts, if there are any.
    pub fn derivation(&self) -> Option<&Derivation> {
        self.derivation.as_deref()
    }

    /// Number of timesteps, tracked or not.
    pub const fn n_timesteps(&self) -> usize {
        self.states.len()
    }

    /// The state at `timestep`, if the agent was tracked then.
    pub fn get(&self, timestep: usize) -> Option<&State> {
        self.states.get(timestep).and_then(Option::as_ref)
    }

    /// Whether the agent was tracked at `timestep`.
    pub fn is_valid(&self, timestep: usize) -> bool {
        self.get(timestep).is_some()
    }

    /// All entries, one a timestep.
    pub fn entries(&self) -> &[Option<State>] {
        &self.states
    }

    /// The tracked states with their timesteps.
    pub fn valid(&self) -> impl DoubleEndedIterator<Item = (usize, &State)> {
        self.states.iter().enumerate().filter_map(|(timestep, state)| state.as_ref().map(|s| (timestep, s)))
    }

    /// Number of tracked timesteps.
    pub fn n_valid(&self) -> usize {
        self.valid().count()
    }

    /// The trajectory in another frame.
    pub fn transformed(&self, to_from_here: &Transform2) -> Self {
        self.clone().into_frame(to_from_here)
    }

    /// The trajectory moved to another frame.
    #[must_use]
    pub fn into_frame(mut self, to_from_here: &Transform2) -> Self {
        for state in self.states.iter_mut().flatten() {
            *state = state.transformed(to_from_here);
        }
        for recorded in self.derivation.iter_mut().flat_map(|derivation| &mut derivation.recorded) {
            recorded.position = to_from_here.point(recorded.position);
        }
        self
    }
}
