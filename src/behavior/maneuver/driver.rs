//! An agent that continues along one of its ways, with accelerations that change at given times.

use super::ways::{Way, ways};
use crate::behavior::footprint::{Bounds, Footprint};
use crate::behavior::lane_relation::SceneLanes;
use crate::behavior::limits::effort;
use crate::behavior::template::observed_acceleration;
use crate::geometry::Vec2;
use crate::scene::{Extent, Scene, State};
use crate::seed::Seed;

/// Ordinary accelerations, at most half of the limits, m/s².
pub(in crate::behavior) const ORDINARY_MPS2: [f64; 5] = [-2.0, -1.0, 0.0, 0.6, 1.25];
/// Spacing of the places along a way, meters.
const SPACING_M: f64 = 0.5;
/// Ways whose reachable parts end within this of each other are the same, meters.
const SAME_M: f64 = 1.0;
/// How much slower than the one ahead an agent becomes that brakes, if it must, and below which speed that one stands,
/// m/s.
pub(in crate::behavior) const SLOWER_MPS: [f64; 3] = [0.7, 1.5, 2.5];
pub(in crate::behavior) const STANDS_MPS: f64 = 1.0;
/// How vehicles slow down for no reason that is seen: the deceleration at its peak, m/s², and the speed that they lose,
/// m/s, but no more than this share of it. In the bundled recordings, 95 % of all brakings lose at most 6.7 m/s, with
/// at most 4.4 m/s²; those of vehicles with nobody within 50 m ahead lose 3.8 m/s in the median, with 3.4 m/s².
const SLOWS: [[f64; 2]; 4] = [[1.2, 2.0], [2.0, 3.5], [3.0, 4.5], [4.0, 6.5]];
const MOST_LOST: f64 = 0.6;
/// How fast they then gain speed again, m/s²: this at most, by driver.
const REGAINS_MPS2: f64 = 0.8;
/// By how much firmer the firmest driver brakes than the gentlest one, and how much less speed it loses, as shares.
const FIRMER: f64 = 0.2;
const LOSES_LESS: f64 = 0.5;
/// How much firmer than in the mean who stops brakes at first, and how much less at the end, as a factor, and the
/// firmest that it becomes, m/s².
const FIRST_FIRMER: f64 = 1.15;
const FIRMEST_MPS2: f64 = 7.8;
/// How long it takes to press a pedal, and to ease a stop, seconds.
const PEDAL_S: f64 = 0.3;
const PEDAL_RATE_HZ: f64 = 1.0 / PEDAL_S;
/// The lateral acceleration in bends, the deceleration before them, and the hardest one if it is late for that, m/s².
const ACROSS_MPS2: f64 = 2.6;
const EASES_MPS2: f64 = 2.0;
const BRAKES_MPS2: f64 = 3.5;
/// Deceleration before a bend that is known early enough to let go of the gas for, m/s², and within which time the gas
/// is let go of, seconds.
const COASTS_MPS2: f64 = 1.0;
const LETS_GO_S: f64 = 1.0;
/// The fastest changes of acceleration, m/s³: from gas to full braking in a second, and from the brake to the gas.
const BRAKING_JERK_MPS3: f64 = 10.0;
const EASING_JERK_MPS3: f64 = 2.5;
/// The change of acceleration where a brake is pressed without haste, and where hard braking is let go of, m/s³.
const UNHURRIED_JERK_MPS3: f64 = 3.0;
pub(crate) const RELEASE_JERK_MPS3: f64 = 5.0;
/// Braking beyond this is urgent, m/s².
const URGENT_MPS2: f64 = 4.45;
/// More than an agent leaves the places of its rail: drifting aside, or beyond the last.
const LEAVES_RAIL_M: f64 = 5.0;
/// The curvature of a bend is taken over this many places on either side.
const BEND_PLACES: usize = 4;
/// Integration steps per timestep.
const N_STEPS: usize = 5;

/// The accelerations of an agent over time.
#[derive(Debug, Clone)]
pub(in crate::behavior) struct Pace {
    first_mps2: f64,
    changes: Vec<Change>,
    /// Speed in bends, as a multiple of the ordinary one.
    briskness: f64,
}

/// An agent at present, with the places that it can reach along each way in the map.
pub(in crate::behavior) struct Driver {
    pub(in crate::behavior) state: State,
    pub(in crate::behavior) rails: Vec<Rail>,
    /// From 0 to 1: how this driver differs from others.
    pub(in crate::behavior) style: f64,
    /// Its acceleration at present along its motion, m/s², from which it changes over to that of its pace.
    observed_mps2: f64,
    dt_s: f64,
    n_steps: usize,
}

/// A way, from the present place on.
pub(in crate::behavior) struct Rail {
    /// Positions and directions, evenly spaced.
    places: Vec<(Vec2, Vec2)>,
    /// The rectangle around them.
    bounds: Bounds,
    /// The largest speeds at each place that still allow braking, and coasting, for the bends ahead, m/s.
    allowed_mps: Vec<[f64; 2]>,
    /// The least of them.
    least_allowed_mps: [f64; 2],
}

/// The distance driven, meters, and the speed, m/s, at each timestep after the present.
pub(in crate::behavior) struct Travel {
    pub(in crate::behavior) driven_m: Vec<f64>,
    pub(in crate::behavior) speeds_mps: Vec<f64>,
}

/// How long it takes to brake at `then_mps2` from `mps2`, m/s², which is more, seconds.
pub(in crate::behavior) fn building_up_s(mps2: f64, then_mps2: f64) -> f64 {
    ((mps2 - then_mps2) / BRAKING_JERK_MPS3).max(PEDAL_S)
}

/// A change of acceleration.
#[derive(Debug, Clone, Copy)]
struct Change {
    /// Seconds after the present.
    from_s: f64,
    /// The acceleration after it, m/s².
    mps2: f64,
    /// How long it is to take, seconds; `None` for as long as pressing a pedal takes, and easing the brake.
    takes_s: Option<f64>,
}

impl Pace {
    /// A constant acceleration, m/s².
    pub(in crate::behavior) const fn steady(first_mps2: f64) -> Self {
        Self { first_mps2, changes: Vec::new(), briskness: 1.0 }
    }

    /// Adds a change to another acceleration from `from_s` seconds after the present on, later than all other changes.
    #[must_use]
    pub(in crate::behavior) fn then(mut self, from_s: f64, acceleration_mps2: f64) -> Self {
        self.changes.push(Change { from_s, mps2: acceleration_mps2, takes_s: None });
        self
    }

    /// Adds braking from `from_s` seconds after the present on that builds up to `mps2`, fades, and costs this much
    /// speed, m/s.
    #[must_use]
    pub(in crate::behavior) fn losing(mut self, from_s: f64, mps2: f64, loses_mps: f64) -> Self {
        let [pressed_s, released_s] = match mps2 < URGENT_MPS2 {
            true => [mps2 / UNHURRIED_JERK_MPS3; 2],
            false => [building_up_s(0.0, -mps2), mps2 / RELEASE_JERK_MPS3],
        };
        // On average, half of the deceleration is there while it changes.
        let lasts_s = (loses_mps / mps2 + (pressed_s - released_s) / 2.0).max(PEDAL_S);
        self.changes.push(Change { from_s, mps2: -mps2, takes_s: Some(pressed_s) });
        self.changes.push(Change { from_s: from_s + lasts_s, mps2: 0.0, takes_s: Some(released_s) });
        self
    }

    /// Adds braking from `from_s` seconds after the present on, at this speed, m/s, to a stand: with `mps2` in the
    /// mean, firmer at first.
    #[must_use]
    pub(in crate::behavior) fn stopping(mut self, from_s: f64, mps2: f64, speed_mps: f64) -> Self {
        let firmer = FIRST_FIRMER.min(FIRMEST_MPS2 / mps2).max(1.0);
        let pressed_s = building_up_s(0.0, -mps2 * firmer);
        let fades = Change { from_s: from_s + pressed_s, mps2: -mps2 / firmer, takes_s: Some(speed_mps / mps2) };
        self.changes.extend([Change { from_s, mps2: -mps2 * firmer, takes_s: Some(pressed_s) }, fades]);
        self
    }

    /// The plan with this acceleration after its last change, m/s².
    fn ending_with(mut self, mps2: f64) -> Self {
        self.changes.last_mut().into_iter().for_each(|last| last.mps2 = mps2);
        self
    }

    /// The plan with this multiple of the ordinary speed in bends; the lateral acceleration grows with its square.
    #[must_use]
    pub(in crate::behavior) fn brisk(self, briskness: f64) -> Self {
        Self { briskness, ..self }
    }

    /// The share of the limits of driving that the first acceleration uses.
    pub(in crate::behavior) fn effort(&self) -> f64 {
        effort(self.first_mps2)
    }

    /// The acceleration at this time after the present, m/s².
    pub(in crate::behavior) fn at(&self, elapsed_s: f64) -> f64 {
        self.changes.iter().fold(self.first_mps2, |before_mps2, change| {
            let share = ((elapsed_s - change.from_s) / change.takes_s.unwrap_or(PEDAL_S)).clamp(0.0, 1.0);
            before_mps2 + (change.mps2 - before_mps2) * share
        })
    }

    /// How fast the acceleration rises at most at this time, m/s³: as fast as planned, or as brakes are eased.
    fn eases_mps3(&self, elapsed_s: f64) -> f64 {
        let is_planned = |change: &Change| {
            let takes_s = change.takes_s.unwrap_or_default();
            (change.from_s..change.from_s + takes_s).contains(&elapsed_s)
        };
        if self.changes.iter().any(is_planned) { RELEASE_JERK_MPS3 } else { EASING_JERK_MPS3 }
    }
}

impl Driver {
    /// `None` if the agent is not tracked at present, or the scene ends there.
    pub(in crate::behavior) fn new(scene: &Scene, lanes: &SceneLanes<'_>, agent_idx: usize) -> Option<Self> {
        let state = *scene.state(agent_idx, scene.current_timestep()).filter(|state| state.is_finite())?;
        let n_steps = scene.n_timesteps.checked_sub(scene.n_history).filter(|n_steps| *n_steps > 0)?;
        let horizon_s = n_steps as f64 * scene.dt_s;
        let hardest_mps2 = ORDINARY_MPS2.into_iter().fold(0.0, f64::max);
        let reach_m = (state.speed_mps() + hardest_mps2 * horizon_s / 2.0) * horizon_s;
        let mut rails: Vec<Rail> = Vec::new();
        let observed = observed_acceleration(scene, agent_idx).unwrap_or_default();
        let forward = state.velocity * (1.0 / state.speed_mps().max(f64::MIN_POSITIVE));
        let curvature_1pm = forward.cross(observed) / state.speed_mps().powi(2).max(f64::MIN_POSITIVE);
        for rail in ways(lanes, &state, curvature_1pm).iter().filter_map(|way| Rail::new(way, reach_m)) {
            if rails.iter().all(|other| other.end().distance(rail.end()) > SAME_M) {
                rails.push(rail);
            }
        }
        let observed_mps2 = observed.dot(forward).clamp(-BRAKES_MPS2, BRAKES_MPS2);
        let who = format!("{} {}", scene.id, scene.tracks[agent_idx].id);
        let style = Seed(0).derive_named("driving style", &who).rng().uniform();
        Some(Self { state, rails, style, observed_mps2, dt_s: scene.dt_s, n_steps })
    }

    /// Drops the rails of two agents of these sizes on which neither can come to any of the other's.
    pub(in crate::behavior) fn keep_rails_that_meet(drivers: &mut [Self; 2], extents: [Extent; 2]) {
        let within_m =
            LEAVES_RAIL_M + extents.iter().map(|extent| (extent.length_m + extent.width_m) / 2.0).sum::<f64>();
        let bounds = drivers.each_ref().map(|driver| driver.rails.iter().map(|rail| rail.bounds).collect::<Vec<_>>());
        for (driver, others) in drivers.iter_mut().zip(bounds.iter().rev()) {
            driver.rails.retain(|rail| others.iter().any(|other| rail.bounds.is_within(other, within_m)));
        }
    }

    /// This deceleration, m/s², as this driver brakes.
    pub(in crate::behavior) fn firmly(&self, mps2: f64) -> f64 {
        mps2 * (1.0 + FIRMER * (self.style - 0.5))
    }

    /// The ways in which it may slow down from `from_s` on without a reason that is seen, where it drives at this pace
    /// until then.
    pub(in crate::behavior) fn slowing(&self, pace: &Pace, from_s: f64) -> [Pace; SLOWS.len()] {
        SLOWS.map(|[mps2, loses_mps]| {
            let mps2 = self.firmly(mps2);
            let loses_mps =
                (loses_mps * (1.0 - LOSES_LESS * (self.style - 0.5))).min(MOST_LOST * self.state.speed_mps());
            pace.clone().losing(from_s, mps2, loses_mps).ending_with(REGAINS_MPS2 * self.style)
        })
    }

    /// Its acceleration at present if it brakes, m/s²; otherwise infinite.
    pub(in crate::behavior) fn braking_mps2(&self) -> f64 {
        if self.observed_mps2 < -COASTS_MPS2 { self.observed_mps2 } else { f64::INFINITY }
    }

    /// Its travel along a rail at this pace, which it adopts from the observed acceleration: quickly to brake, slowly
    /// to let go of the brake. It never reverses, gives no gas toward a bend, and brakes for it.
    pub(in crate::behavior) fn travel(&self, rail: usize, pace: &Pace) -> Travel {
        let (mut driven_m, mut speed_mps, step_s) = (0.0, self.state.speed_mps(), self.dt_s / N_STEPS as f64);
        let (mut mps2, rail) = (self.observed_mps2, &self.rails[rail]);
        let mut travel =
            Travel { driven_m: Vec::with_capacity(self.n_steps), speeds_mps: Vec::with_capacity(self.n_steps) };
        for step in 0..self.n_steps * N_STEPS {
            let most_mps2 = |allowed_mps: [f64; 2]| {
                let [brakes, coasts] = allowed_mps.map(|allowed_mps| pace.briskness * allowed_mps - speed_mps);
                (brakes * PEDAL_RATE_HZ).max(-BRAKES_MPS2).min((coasts / LETS_GO_S).max(0.0))
            };
            let mut wanted_mps2 = pace.at(step as f64 * step_s);
            // Where no bend of the rail matters, its places need no look.
            if wanted_mps2 > most_mps2(rail.least_allowed_mps) {
                wanted_mps2 = wanted_mps2.min(most_mps2(rail.allowed_mps(driven_m)));
            }
            let easing_mps3 = pace.eases_mps3(step as f64 * step_s);
            mps2 = wanted_mps2.clamp(mps2 - BRAKING_JERK_MPS3 * step_s, mps2 + easing_mps3 * step_s);
            // Nobody stops with a jolt.
            mps2 = mps2.max(-speed_mps * PEDAL_RATE_HZ);
            let then_mps = (speed_mps + mps2 * step_s).max(0.0);
            driven_m += f64::midpoint(speed_mps, then_mps) * step_s;
            speed_mps = then_mps;
            if step % N_STEPS == N_STEPS - 1 {
                travel.driven_m.push(driven_m);
                travel.speeds_mps.push(speed_mps);
            }
        }
        travel
    }

    /// Its positions along a rail, at present and at each timestep after it.
    pub(in crate::behavior) fn positions(&self, rail: usize, driven_m: &[f64]) -> Vec<Vec2> {
        self.places(rail, driven_m).into_iter().map(|(at, _)| at).collect()
    }

    /// Like [`Self::positions`], each with the direction of the way there.
    pub(in crate::behavior) fn places(&self, rail: usize, driven_m: &[f64]) -> Vec<(Vec2, Vec2)> {
        std::iter::once(&0.0).chain(driven_m).map(|driven_m| self.rails[rail].at(*driven_m)).collect()
    }

    /// Its boxes with this size along a rail, at each timestep after the present.
    pub(in crate::behavior) fn boxes(&self, rail: usize, driven_m: &[f64], extent: Extent) -> Vec<Footprint> {
        let footprint = |driven_m: &f64| {
            let (center, along) = self.rails[rail].at(*driven_m);
            Footprint::along(center, along.unit(), [extent.length_m, extent.width_m])
        };
        driven_m.iter().map(footprint).collect()
    }
}

impl Rail {
    fn new(way: &Way, reach_m: f64) -> Option<Self> {
        let n_places = (reach_m / SPACING_M).ceil() as usize + 2;
        let places: Option<Vec<(Vec2, Vec2)>> = (0..n_places).map(|i| way.place(i as f64 * SPACING_M)).collect();
        let places = places?;
        let mut allowed_mps: Vec<[f64; 2]> = (0..n_places).map(|i| [bend_mps(&places, i); 2]).collect();
        for i in (1..n_places).rev() {
            for (kind, mps2) in [EASES_MPS2, COASTS_MPS2].into_iter().enumerate() {
                let before_mps = (allowed_mps[i][kind].powi(2) + 2.0 * mps2 * SPACING_M).sqrt();
                allowed_mps[i - 1][kind] = allowed_mps[i - 1][kind].min(before_mps);
            }
        }
        let least = |kind: usize| allowed_mps.iter().map(|mps| mps[kind]).fold(f64::INFINITY, f64::min);
        let (bounds, least_allowed_mps) = (Bounds::around(places.iter().map(|(at, _)| *at))?, [least(0), least(1)]);
        Some(Self { bounds, places, allowed_mps, least_allowed_mps })
    }

    fn end(&self) -> Vec2 {
        self.places[self.places.len() - 1].0
    }

    /// The position after `driven_m`, and the direction there.
    fn at(&self, driven_m: f64) -> (Vec2, Vec2) {
        let (before, share) = self.before(driven_m);
        let ((from, along), (to, then_along)) = (self.places[before], self.places[before + 1]);
        (from.lerp(to, share), along.lerp(then_along, share))
    }

    fn allowed_mps(&self, driven_m: f64) -> [f64; 2] {
        let (before, share) = self.before(driven_m);
        let (from, to) = (self.allowed_mps[before], self.allowed_mps[before + 1]);
        std::array::from_fn(|kind| from[kind] + (to[kind] - from[kind]) * share.clamp(0.0, 1.0))
    }

    /// The index of the last place before, and the share of the distance to the next one.
    fn before(&self, driven_m: f64) -> (usize, f64) {
        let before = ((driven_m / SPACING_M) as usize).min(self.places.len() - 2);
        (before, driven_m / SPACING_M - before as f64)
    }
}

/// The speed at which the bend around a place takes the ordinary lateral acceleration, m/s.
fn bend_mps(places: &[(Vec2, Vec2)], i: usize) -> f64 {
    let (first, last) = (i.saturating_sub(BEND_PLACES), (i + BEND_PLACES).min(places.len() - 1));
    let turned_rad = places[first].1.angle_to(places[last].1).abs();
    let curvature_1pm = turned_rad / ((last - first) as f64 * SPACING_M);
    (ACROSS_MPS2 / curvature_1pm.max(f64::MIN_POSITIVE)).sqrt()
}
