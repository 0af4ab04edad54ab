//! The states of everybody from the start of the past to now. They can be saved, and forked.

use super::motion::plain;
use super::{Error, Result};
use crate::files::regular;
use crate::geometry::Vec2;
use crate::scene::State;
use crate::seed::Seed;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::path::Path;

/// The version of the format of saved worlds.
const VERSION: u32 = 3;

/// The states of all agents of a scenario up to now, in its scene frame. Nothing else decides what comes next.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct World {
    version: u32,
    /// The scenario from which it started.
    pub scenario_id: String,
    /// The seed of everything random.
    pub seed: u64,
    /// The last timestep at which the agents of the event follow their plan.
    pub plan_ends: usize,
    /// Plans that were solved again: the agent, the timestep of the first state, and the states.
    plans: Vec<(usize, usize, Vec<[f64; 5]>)>,
    /// By track in the order of the scenario, then by timestep: x, y, heading, velocity in x and y.
    states: Vec<Vec<Option<[f64; 5]>>>,
}

fn packed(state: &State) -> [f64; 5] {
    [state.position.x, state.position.y, state.heading_rad, state.velocity.x, state.velocity.y]
}

fn unpacked([x, y, heading_rad, vx, vy]: [f64; 5]) -> State {
    State { position: Vec2::new(x, y), heading_rad, velocity: Vec2::new(vx, vy) }
}

/// Whether a state is one of traffic: [x, y, heading, vx, vy] in meters and radians in the scene, m/s.
fn is_possible(state: &[f64; 5]) -> bool {
    // Farther than any drive leads, and faster than anybody.
    state.iter().zip([1e6, 1e6, 100.0, 1e3, 1e3]).all(|(number, most)| number.abs() <= most)
}

impl World {
    /// A world with these states, by track, all with the same number of timesteps.
    pub(super) fn new<'s, T>(scenario_id: &str, seed: u64, plan_ends: usize, tracks: T) -> Self
    where
        T: IntoIterator<Item = &'s [Option<State>]>,
    {
        let states = tracks.into_iter().map(|states| states.iter().map(|s| s.as_ref().map(packed)).collect());
        Self {
            version: VERSION,
            scenario_id: scenario_id.to_owned(),
            seed,
            plan_ends,
            plans: Vec::new(),
            states: states.collect(),
        }
    }

    /// The name of the stream of noise, where futures have this seed: that of the scenario, or the world's own once it
    /// was made to draw anew.
    pub(super) fn stream(&self, seed: u64) -> Cow<'_, str> {
        match self.seed == seed {
            true => Cow::Borrowed(&self.scenario_id),
            false => Cow::Owned(format!("{} {:016x}", self.scenario_id, self.seed)),
        }
    }

    /// Makes what comes next independent of what comes next for other copies of this world.
    pub(super) fn draw_anew(&mut self, copy: usize) {
        self.seed = Seed(self.seed).derive("copy", &[self.now() as u64, copy as u64]).0;
    }

    /// The world as it was at a timestep that was reached.
    pub(super) fn until(&self, timestep: usize) -> Self {
        let mut world = self.clone();
        world.states.iter_mut().for_each(|states| states.truncate(timestep + 1));
        world
    }

    /// Number of tracks.
    pub const fn n_tracks(&self) -> usize {
        self.states.len()
    }

    /// Number of timesteps reached; the last of them is now.
    pub fn n_timesteps(&self) -> usize {
        self.states.first().map_or(0, Vec::len)
    }

    /// The present timestep.
    pub fn now(&self) -> usize {
        self.n_timesteps().saturating_sub(1)
    }

    /// The state of a track at a timestep; `None` where it is not there.
    pub fn state(&self, agent_idx: usize, timestep: usize) -> Option<State> {
        self.states.get(agent_idx)?.get(timestep)?.map(unpacked)
    }

    /// The state of a track now.
    pub fn present(&self, agent_idx: usize) -> Option<State> {
        self.state(agent_idx, self.now())
    }

    /// Advances one timestep, to these states of each track.
    pub(super) fn push(&mut self, next: impl IntoIterator<Item = Option<State>>) {
        for (states, next) in self.states.iter_mut().zip(next) {
            states.push(next.as_ref().map(packed));
        }
    }

    /// Puts a track that was never there somewhere now.
    pub(super) fn place(&mut self, agent_idx: usize, state: State) {
        if let Some(last) = self.states.get_mut(agent_idx).and_then(|states| states.last_mut()) {
            *last = Some(packed(&state));
        }
    }

    /// Makes agents of the event follow these states up to the timestep `ends`. The first states are the present ones.
    pub(super) fn plan_anew(&mut self, ends: usize, plans: &[(usize, Vec<State>)]) {
        let first = self.now();
        self.plan_ends = ends;
        let packed =
            |(agent_idx, states): &(usize, Vec<State>)| (*agent_idx, first, states.iter().map(packed).collect());
        self.plans = plans.iter().map(packed).collect();
    }

    /// The state of an agent at a timestep by the last plan that was solved again. `None` if there is none, or it ends
    /// earlier.
    pub(super) fn planned(&self, agent_idx: usize, timestep: usize) -> Option<State> {
        let (_, first, states) = self.plans.iter().find(|(idx, ..)| *idx == agent_idx)?;
        states.get(timestep.checked_sub(*first)?).copied().map(unpacked)
    }

    /// Whether a plan was solved again for an agent.
    pub(super) fn is_planned_anew(&self, agent_idx: usize) -> bool {
        self.plans.iter().any(|(idx, ..)| *idx == agent_idx)
    }

    /// Adds absent tracks up to `n_tracks`.
    pub(super) fn with_tracks(mut self, n_tracks: usize) -> Self {
        let nowhere = vec![None; self.n_timesteps()];
        self.states.resize(n_tracks.max(self.states.len()), nowhere);
        self
    }

    /// Takes a track away from now on.
    pub(super) fn remove(&mut self, agent_idx: usize) {
        if let Some(last) = self.states.get_mut(agent_idx).and_then(|states| states.last_mut()) {
            *last = None;
        }
    }

    /// The world as JSON; numbers are exact.
    ///
    /// # Errors
    /// When a number is not finite.
    pub fn to_json(&self) -> Result<String> {
        serde_json::to_string(self).map_err(|error| Error::Config(format!("the state cannot be saved: {error}")))
    }

    /// Reads a saved world.
    ///
    /// # Errors
    /// [`Error::State`] when the file is not a saved world, or of another version.
    pub fn read(path: &Path) -> Result<Self> {
        regular(path)?;
        let text = fs_err::read_to_string(path)?;
        let refuse = |why: String| Error::State { path: path.to_owned(), why };
        let world: Self = serde_json::from_str(&text)
            .map_err(|error| refuse(format!("expected a state that djinn drive --save-at wrote: {error}")))?;
        let n_timesteps = world.n_timesteps();
        let plans = world.plans.iter().flat_map(|(_, _, states)| states);
        let mut states = world.states.iter().flatten().flatten().chain(plans);
        if let Some([x, y, heading_rad, vx, vy]) = states.find(|state| !is_possible(state)) {
            let state = [x, y, heading_rad, vx, vy].map(|number| plain(*number)).join(", ");
            return Err(refuse(format!("no road user is ever at [{state}]; save the state again")));
        }
        match world.version {
            VERSION if world.states.iter().all(|states| states.len() == n_timesteps) => Ok(world),
            VERSION => Err(refuse("tracks have different numbers of timesteps; save the state again".to_owned())),
            version => Err(refuse(format!("has version {version}, expected {VERSION}; save the state again"))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_saved_world_is_the_same_to_the_last_digit_and_foreign_files_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("state.json");
        let state = unpacked([1.0 / 3.0, -0.1 + 0.2, 1e-17, 1e3 / 3.0, f64::MIN_POSITIVE]);
        let tracks = [[Some(state), None], [None, Some(State::default())]];
        let mut world = World::new("s", 7, 5, tracks.iter().map(<[_; 2]>::as_slice));
        world.push([None, Some(state)]);
        assert_eq!((world.now(), world.present(0), world.present(1)), (2, None, Some(state)));
        fs_err::write(&path, world.to_json().unwrap()).unwrap();
        assert_eq!(World::read(&path).unwrap(), world);
        fs_err::write(&path, world.to_json().unwrap().replacen("\"version\":3", "\"version\":9", 1)).unwrap();
        assert!(World::read(&path).unwrap_err().to_string().contains("has version 9, expected 3"));
        let speed = (1e3_f64 / 3.0).to_string();
        fs_err::write(&path, world.to_json().unwrap().replacen(&speed, "1e308", 1)).unwrap();
        assert!(World::read(&path).unwrap_err().to_string().contains("1.000e308"));
        fs_err::write(&path, "{}").unwrap();
        assert!(World::read(&path).unwrap_err().to_string().contains("--save-at"));
    }
}
