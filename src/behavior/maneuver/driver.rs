//! An agent that goes on along one of its ways: evenly, until it may change its pace.

use crate::behavior::feasible::{Way, effort, ways};
use crate::behavior::footprint::Footprint;
use crate::behavior::lane_relation::SceneLanes;
use crate::geometry::{OrientedBox, Vec2};
use crate::scene::{Extent, Scene, State};

/// How drivers ordinarily accelerate, m/s²: with no more than half of what they could.
pub(in crate::behavior) const ORDINARY_MPS2: [f64; 5] = [-2.0, -1.0, 0.0, 0.6, 1.25];
/// Spacing of the places that are kept of a way, meters.
const SPACING_M: f64 = 0.5;
/// Ways that end within this of each other, as far as anybody can get, are the same, meters.
const SAME_M: f64 = 1.0;
/// How long a pedal takes to be pressed, and who brakes to come to a halt gently, seconds.
const PEDAL_S: f64 = 0.3;
/// Steps of a timestep in which speeds are summed up.
const N_STEPS: usize = 5;

/// How an agent accelerates: with one acceleration at first, and with others later.
#[derive(Debug, Clone)]
pub(in crate::behavior) struct Pace {
    first_mps2: f64,
    /// Seconds after the present, and the acceleration to which a pedal is pressed then, m/s²; by ascending times.
    changes: Vec<(f64, f64)>,
}

/// An agent at present with the places that it can reach, on each way that the map leaves it.
pub(in crate::behavior) struct Driver {
    pub(in crate::behavior) state: State,
    pub(in crate::behavior) rails: Vec<Rail>,
    dt_s: f64,
    n_steps: usize,
}

/// Positions and directions along a way, from the present place on.
pub(in crate::behavior) struct Rail(Vec<(Vec2, Vec2)>);

/// How far an agent has come, meters, and its speed, m/s, at each timestep after the present.
pub(in crate::behavior) struct Progress {
    pub(in crate::behavior) driven_m: Vec<f64>,
    pub(in crate::behavior) speeds_mps: Vec<f64>,
}

impl Pace {
    /// One acceleration all the time, m/s².
    pub(in crate::behavior) const fn steady(first_mps2: f64) -> Self {
        Self { first_mps2, changes: Vec::new() }
    }

    /// Another one from so many seconds after the present on, later than all before.
    #[must_use]
    pub(in crate::behavior) fn then(mut self, from_s: f64, acceleration_mps2: f64) -> Self {
        self.changes.push((from_s, acceleration_mps2));
        self
    }

    /// The share of what driving allows that it takes at first.
    pub(in crate::behavior) fn effort(&self) -> f64 {
        effort(self.first_mps2)
    }

    /// The acceleration so many seconds after the present, m/s².
    fn at(&self, elapsed_s: f64) -> f64 {
        let pressed = |from_s: f64| ((elapsed_s - from_s).max(0.0) / PEDAL_S).min(1.0);
        self.changes.iter().fold(self.first_mps2, |before, (from_s, then)| before + (then - before) * pressed(*from_s))
    }
}

impl Driver {
    /// An agent that accelerates as drivers ordinarily do at most. `None` where it is not tracked at present.
    pub(in crate::behavior) fn new(scene: &Scene, lanes: &SceneLanes<'_>, agent_idx: usize) -> Option<Self> {
        let state = *scene.state(agent_idx, scene.current_timestep()).filter(|state| state.is_finite())?;
        let n_steps = scene.n_timesteps - scene.n_history;
        let horizon_s = n_steps as f64 * scene.dt_s;
        let hardest_mps2 = ORDINARY_MPS2.into_iter().fold(0.0, f64::max);
        let reach_m = (state.speed_mps() + hardest_mps2 * horizon_s / 2.0) * horizon_s;
        let mut rails: Vec<Rail> = Vec::new();
        for rail in ways(lanes, &state).iter().filter_map(|way| Rail::new(way, reach_m)) {
            if rails.iter().all(|other| other.end().distance(rail.end()) > SAME_M) {
                rails.push(rail);
            }
        }
        Some(Self { state, rails, dt_s: scene.dt_s, n_steps })
    }

    /// How far it gets at this pace. Who comes to a halt stands.
    pub(in crate::behavior) fn progress(&self, pace: &Pace) -> Progress {
        let (mut driven_m, mut speed_mps, step_s) = (0.0, self.state.speed_mps(), self.dt_s / N_STEPS as f64);
        let mut progress =
            Progress { driven_m: Vec::with_capacity(self.n_steps), speeds_mps: Vec::with_capacity(self.n_steps) };
        for step in 0..self.n_steps * N_STEPS {
            let then_mps = (speed_mps + pace.at(step as f64 * step_s).max(-speed_mps / PEDAL_S) * step_s).max(0.0);
            driven_m += f64::midpoint(speed_mps, then_mps) * step_s;
            speed_mps = then_mps;
            if step % N_STEPS == N_STEPS - 1 {
                progress.driven_m.push(driven_m);
                progress.speeds_mps.push(speed_mps);
            }
        }
        progress
    }

    /// Its positions along a rail: at present, and at each timestep after it.
    pub(in crate::behavior) fn positions(&self, rail: usize, driven_m: &[f64]) -> Vec<Vec2> {
        std::iter::once(&0.0).chain(driven_m).map(|driven_m| self.rails[rail].at(*driven_m).0).collect()
    }

    /// The boxes of this size along a rail at each timestep after the present.
    pub(in crate::behavior) fn boxes(&self, rail: usize, driven_m: &[f64], extent: Extent) -> Vec<Footprint> {
        let footprint = |driven_m: &f64| {
            let (center, along) = self.rails[rail].at(*driven_m);
            let Extent { length_m, width_m } = extent;
            Footprint::new(&OrientedBox { center, heading_rad: along.angle(), length_m, width_m })
        };
        driven_m.iter().map(footprint).collect()
    }
}

impl Rail {
    fn new(way: &Way, reach_m: f64) -> Option<Self> {
        let n_places = (reach_m / SPACING_M).ceil() as usize + 2;
        let places: Option<Vec<(Vec2, Vec2)>> = (0..n_places).map(|i| way.place(i as f64 * SPACING_M)).collect();
        places.map(Self)
    }

    fn end(&self) -> Vec2 {
        self.0[self.0.len() - 1].0
    }

    /// Where it is after so many meters, and its direction there.
    pub(in crate::behavior) fn at(&self, driven_m: f64) -> (Vec2, Vec2) {
        let before = ((driven_m / SPACING_M) as usize).min(self.0.len() - 2);
        let share = driven_m / SPACING_M - before as f64;
        let ((from, along), (to, then_along)) = (self.0[before], self.0[before + 1]);
        (from.lerp(to, share), along.lerp(then_along, share))
    }
}
