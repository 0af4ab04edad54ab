//! An agent that continues along one of its ways at constant acceleration, until it may brake.

use crate::behavior::feasible::{Way, effort, ways};
use crate::behavior::footprint::Footprint;
use crate::behavior::lane_relation::SceneLanes;
use crate::geometry::{OrientedBox, Vec2};
use crate::scene::{Extent, Scene, State};

/// The accelerations that are tried until one of the two brakes, m/s²: at most half of the limits of driving.
pub(super) const ORDINARY_MPS2: [f64; 5] = [-2.0, -1.0, 0.0, 0.6, 1.25];
/// Spacing of the stored places of a way, meters.
const SPACING_M: f64 = 0.5;
/// Ways whose reachable parts end within this of each other are the same, meters.
const SAME_M: f64 = 1.0;
/// Spacing of the places at which a way that begins on the road is checked for staying on it.
const ROAD_STRIDE: usize = 4;
/// How long it takes to press a pedal, and to ease a stop, seconds.
const PEDAL_S: f64 = 0.3;
/// Integration steps per timestep.
const N_STEPS: usize = 5;

/// When and how hard an agent brakes.
#[derive(Clone, Copy)]
pub(super) struct Brake {
    /// Seconds after the present.
    pub(super) from_s: f64,
    pub(super) deceleration_mps2: f64,
}

/// An agent at present, with the places that it can reach along each way in the map.
pub(super) struct Driver {
    pub(super) state: State,
    /// Its box, and the inner part of it.
    pub(super) extents: [Extent; 2],
    pub(super) rails: Vec<Rail>,
    dt_s: f64,
    n_steps: usize,
}

/// Positions and directions along a way, from the present place on.
pub(super) struct Rail(Vec<(Vec2, Vec2)>);

/// A drive along a rail; one entry per timestep after the present.
pub(super) struct Drive {
    /// The share of the limits of driving that it takes before anybody brakes.
    pub(super) effort: f64,
    /// Speeds, m/s, and boxes: the whole, and the inner parts.
    pub(super) speeds_mps: Vec<f64>,
    pub(super) outer: Vec<Footprint>,
    pub(super) inner: Vec<Footprint>,
}

impl Driver {
    /// An agent with its box and the inner part of it. `None` if it is not tracked at present.
    pub(super) fn new(scene: &Scene, lanes: &SceneLanes<'_>, agent_idx: usize, extents: [Extent; 2]) -> Option<Self> {
        let state = *scene.state(agent_idx, scene.current_timestep()).filter(|state| state.is_finite())?;
        let n_steps = scene.n_timesteps - scene.n_history;
        let horizon_s = n_steps as f64 * scene.dt_s;
        let hardest_mps2 = ORDINARY_MPS2.into_iter().fold(0.0, f64::max);
        let reach_m = (state.speed_mps() + hardest_mps2 * horizon_s / 2.0) * horizon_s;
        let mut rails: Vec<Rail> = Vec::new();
        let is_on_road = |point: Vec2| lanes.lanes_at(point).next().is_some();
        let keeps_road = is_on_road(state.position);
        for rail in ways(lanes, &state).iter().filter_map(|way| Rail::new(way, reach_m)) {
            let is_new = rails.iter().all(|other| other.end().distance(rail.end()) > SAME_M);
            if is_new && !(keeps_road && rail.0.iter().step_by(ROAD_STRIDE).any(|(point, _)| !is_on_road(*point))) {
                rails.push(rail);
            }
        }
        Some(Self { state, extents, rails, dt_s: scene.dt_s, n_steps })
    }

    /// The drive along one of its rails with this acceleration, until it may brake.
    pub(super) fn drive(&self, rail: usize, acceleration_mps2: f64, brake: Option<Brake>) -> Drive {
        let (mut driven_m, mut speed_mps, step_s) = (0.0, self.state.speed_mps(), self.dt_s / N_STEPS as f64);
        let mut motion = Vec::with_capacity(self.n_steps);
        for step in 0..self.n_steps * N_STEPS {
            let braked_s = brake.map_or(0.0, |brake| (step as f64 * step_s - brake.from_s).max(0.0));
            let pressed = (braked_s / PEDAL_S).min(1.0);
            let least_mps2 = -brake.map_or(0.0, |brake| brake.deceleration_mps2);
            let wanted_mps2 = acceleration_mps2 + (least_mps2 - acceleration_mps2) * pressed;
            let then_mps = (speed_mps + wanted_mps2.max(-speed_mps / PEDAL_S) * step_s).max(0.0);
            driven_m += f64::midpoint(speed_mps, then_mps) * step_s;
            speed_mps = then_mps;
            if step % N_STEPS == N_STEPS - 1 {
                motion.push((driven_m, speed_mps));
            }
        }
        let boxes = |extent: Extent| {
            let footprint = |(driven_m, _): &(f64, f64)| {
                let (center, along) = self.rails[rail].at(*driven_m);
                let Extent { length_m, width_m } = extent;
                Footprint::new(&OrientedBox { center, heading_rad: along.angle(), length_m, width_m })
            };
            motion.iter().map(footprint).collect()
        };
        let [outer, inner] = self.extents.map(boxes);
        Drive {
            effort: effort(acceleration_mps2),
            speeds_mps: motion.iter().map(|(_, mps)| *mps).collect(),
            outer,
            inner,
        }
    }

    /// Its positions on a drive, at present and at each timestep after it.
    pub(super) fn positions(&self, rail: usize, drive: &Drive) -> Vec<Vec2> {
        let start = self.rails[rail].at(0.0).0;
        std::iter::once(start).chain(drive.outer.iter().map(|footprint| footprint.center)).collect()
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

    fn at(&self, driven_m: f64) -> (Vec2, Vec2) {
        let before = ((driven_m / SPACING_M) as usize).min(self.0.len() - 2);
        let share = driven_m / SPACING_M - before as f64;
        let ((from, along), (to, then_along)) = (self.0[before], self.0[before + 1]);
        (from.lerp(to, share), along.lerp(then_along, share))
    }
}

impl Drive {
    /// Its velocity at a step.
    pub(super) fn velocity(&self, step: usize) -> Vec2 {
        self.outer[step].forward * self.speeds_mps[step]
    }

    /// The first step at which the inner parts of the two touch.
    pub(super) fn meets(&self, other: &Self) -> Option<usize> {
        self.inner.iter().zip(&other.inner).position(|(own, others)| own.overlaps(others))
    }

    /// Whether the boxes of the two always stay this far apart.
    pub(super) fn keeps(&self, other: &Self, distance_m: f64) -> bool {
        !self.outer.iter().zip(&other.outer).any(|(own, others)| own.is_closer_than(others, distance_m))
    }
}
