//! The features of all agents of one future, as series over its timesteps.

use super::road_edge::RoadEdges;
use crate::behavior::footprint::Footprint;
use crate::geometry::{OrientedBox, wrap_angle};
use crate::metrics::sample_group::future;
use crate::scene::{Scene, State, Track};

pub(super) const N_SERIES: usize = 7;
/// Longest time to collision, seconds.
pub(super) const MAX_TTC_S: f64 = 5.0;
/// The radius by which the corners of a box are rounded, as a share of half of its shorter side.
const ROUNDING: f64 = 0.7;
/// A follower's heading differs at most this much from that of the agent ahead, radians.
const MAX_TURN_RAD: f64 = 75.0 * std::f64::consts::PI / 180.0;
/// The limit of that turn if their paths overlap by little, radians.
const MAX_TURN_AT_EDGE_RAD: f64 = 10.0 * std::f64::consts::PI / 180.0;
/// A little overlap, meters.
const EDGE_M: f64 = 0.5;

/// The series of the judged agents over future timesteps, NaN where undefined: speed, acceleration, yaw rate, yaw
/// acceleration, distance to the nearest, time to collision, distance to the road's edge.
pub(super) struct FutureFeatures {
    n_timesteps: usize,
    has_edges: bool,
    /// Agent by agent.
    series: [Vec<f64>; N_SERIES],
}

impl FutureFeatures {
    /// The features of the agents `judged` in the future of `scene`, which contains the agents `present`.
    pub(super) fn of(scene: &Scene, present: &[usize], judged: &[usize], edges: Option<&RoadEdges>) -> Self {
        let bodies: Vec<Body> = present.iter().map(|idx| Body::new(scene, &scene.tracks[*idx])).collect();
        let mut found =
            Self { n_timesteps: future(scene).len(), has_edges: edges.is_some(), series: Default::default() };
        for own in (0..present.len()).filter(|own| judged.contains(&present[*own])) {
            let body = &bodies[own];
            for (place, timestep) in body.places.iter().zip(future(scene)) {
                let others = || {
                    let others = bodies.iter().enumerate().filter(|(other, _)| *other != own);
                    others.filter_map(|(_, other)| {
                        Some((other.places[timestep - scene.n_history].as_ref()?, other.speeds[timestep]))
                    })
                };
                let around = place.as_ref().map(|place| {
                    [
                        place.distance_to_nearest_m(others().map(|(place, _)| place)),
                        place.time_to_collision_s(body.speeds[timestep], others()),
                        edges.map_or(f64::NAN, |edges| edges.most_off_road_m(&place.outline.corners)),
                    ]
                });
                let motion = [&body.speeds, &body.accelerations, &body.yaw_rates, &body.yaw_accelerations];
                let values = motion.map(|of_all| of_all[timestep]).into_iter().chain(around.unwrap_or([f64::NAN; 3]));
                found.series.iter_mut().zip(values).for_each(|(series, value)| series.push(value));
            }
        }
        found
    }

    /// A series of the judged agent with this number; `None` if the map lacks the data for it.
    pub(super) fn of_agent(&self, series: usize, agent: usize) -> Option<&[f64]> {
        let is_known = self.has_edges || series != N_SERIES - 1;
        is_known.then(|| self.series.get(series)?.chunks(self.n_timesteps).nth(agent))?
    }
}

/// A road user over time.
struct Body {
    speeds: Vec<f64>,
    accelerations: Vec<f64>,
    yaw_rates: Vec<f64>,
    yaw_accelerations: Vec<f64>,
    /// Its place at each future timestep.
    places: Vec<Option<Place>>,
}

impl Body {
    fn new(scene: &Scene, track: &Track) -> Self {
        let state = |timestep: usize| track.trajectory.get(timestep);
        let change = |values: &[f64], of: fn(f64) -> f64| -> Vec<f64> {
            let at = |timestep: usize| values.get(timestep).copied().unwrap_or(f64::NAN);
            let around = |timestep: usize| of(at(timestep + 1) - timestep.checked_sub(1).map_or(f64::NAN, at));
            (0..values.len()).map(|timestep| around(timestep) / (2.0 * scene.dt_s)).collect()
        };
        let speed = |timestep: usize| {
            let both = timestep.checked_sub(1).and_then(state).zip(state(timestep + 1));
            both.map_or(f64::NAN, |(before, after)| (after.position - before.position).norm() / (2.0 * scene.dt_s))
        };
        let timesteps = 0..scene.n_timesteps;
        let speeds: Vec<f64> = timesteps.clone().map(speed).collect();
        let headings: Vec<f64> =
            timesteps.map(|timestep| state(timestep).map_or(f64::NAN, |state| state.heading_rad)).collect();
        let yaw_rates = change(&headings, wrap_angle);
        Self {
            accelerations: change(&speeds, |change| change),
            yaw_accelerations: change(&yaw_rates, |change| change),
            places: future(scene).map(|timestep| Some(Place::new(track, state(timestep)?))).collect(),
            speeds,
            yaw_rates,
        }
    }
}

/// The place of a road user.
struct Place {
    heading_rad: f64,
    outline: Footprint,
    /// The core of its box: everything within `rounding_m` of it is the box with rounded corners.
    core: Footprint,
    rounding_m: f64,
}

impl Place {
    fn new(track: &Track, state: &State) -> Self {
        let whole = track.footprint(state);
        let rounding_m = whole.length_m.min(whole.width_m) * ROUNDING / 2.0;
        let [length_m, width_m] = [whole.length_m, whole.width_m].map(|side| side - 2.0 * rounding_m);
        let core = Footprint::new(&OrientedBox { length_m, width_m, ..whole });
        Self { heading_rad: state.heading_rad, outline: Footprint::new(&whole), core, rounding_m }
    }

    /// The least distance from others with rounded corners, below 0 if they overlap; infinite if there are none.
    fn distance_to_nearest_m<'p>(&self, others: impl Iterator<Item = &'p Self>) -> f64 {
        others.fold(f64::INFINITY, |least_m, other| {
            let rounding_m = self.rounding_m + other.rounding_m;
            match self.core.distance_lower_bound_m(&other.core) - rounding_m < least_m {
                true => least_m.min(signed_distance_m(&self.core, &other.core) - rounding_m),
                false => least_m,
            }
        })
    }

    /// The time until the agent, at `speed_mps`, is at the tail of the nearest of `others` that it follows.
    fn time_to_collision_s<'p>(&self, speed_mps: f64, others: impl Iterator<Item = (&'p Self, f64)>) -> f64 {
        let ahead = others.filter_map(|(other, speed_mps)| Some((self.gap_to_followed_m(other)?, speed_mps)));
        let nearest = ahead.min_by(|a, b| a.0.total_cmp(&b.0));
        let time_s = nearest.map_or(f64::NAN, |(gap_m, other_mps)| match speed_mps > other_mps {
            true => gap_m / (speed_mps - other_mps),
            false => f64::NAN,
        });
        // The lesser of a number and NaN is the number.
        time_s.min(MAX_TTC_S)
    }

    /// The gap along the heading to an agent that this one follows.
    fn gap_to_followed_m(&self, other: &Self) -> Option<f64> {
        let (own, theirs) = (&self.outline, &other.outline);
        let left = own.forward.left();
        let between = theirs.center - own.center;
        let gap_m = between.dot(own.forward) - own.half_length_m - theirs.half_extent_m(own.forward);
        let beside_m = between.dot(left).abs() - own.half_width_m - theirs.half_extent_m(left);
        if !(gap_m > 0.0 && beside_m < 0.0) {
            return None;
        }
        let turn_rad = wrap_angle(other.heading_rad - self.heading_rad).abs();
        (turn_rad <= if beside_m < -EDGE_M { MAX_TURN_RAD } else { MAX_TURN_AT_EDGE_RAD }).then_some(gap_m)
    }
}

/// The distance between two boxes; if they overlap, minus the shortest displacement that separates them.
fn signed_distance_m(a: &Footprint, b: &Footprint) -> f64 {
    let between = b.center - a.center;
    let axes = [a, b].into_iter().flat_map(|body| [body.forward, body.forward.left()]);
    let apart_m = axes.map(|axis| between.dot(axis).abs() - a.half_extent_m(axis) - b.half_extent_m(axis));
    let apart_m = apart_m.fold(f64::NEG_INFINITY, f64::max);
    if apart_m > 0.0 { a.distance_m(b) } else { apart_m }
}
