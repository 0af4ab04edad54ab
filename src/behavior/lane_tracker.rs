//! The lane of an agent over time, and its crossings to lanes beside.

use super::lane_relation::{IndexedLane, LanePlace, LaneRelation, SceneLanes};
use crate::geometry::{Vec2, angle_difference};
use crate::scene::{State, Trajectory};
use std::f64::consts::FRAC_PI_4;

/// An agent is only in lanes whose direction differs from its heading by less than this, radians.
const MAX_HEADING_DIFFERENCE_RAD: f64 = FRAC_PI_4;
/// How far into the next lane a point is placed to find that lane, meters.
const PROBE_M: f64 = 0.5;

/// A move from one lane to one beside it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LaneMove<'a> {
    /// The first timestep at which the agent is out of the old lane.
    pub(crate) timestep: usize,
    /// +1 to the left, -1 to the right.
    pub(crate) side: f64,
    /// Direction of the new lane there, radians.
    pub(crate) heading_rad: f64,
    /// The last timestep up to which the agent is tracked without being lost.
    pub(crate) last_followed: usize,
    /// The place of the agent then.
    pub(crate) position: Vec2,
    /// The old lane and the new one.
    pub(crate) from: &'a IndexedLane<'a>,
    pub(crate) lane: &'a IndexedLane<'a>,
}

/// A timestep at which an agent is close to a lane beside its own.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Drift {
    pub(crate) timestep: usize,
    /// Distance to the side of its lane, meters; negative while it is beyond it by less than the hysteresis.
    pub(crate) margin_m: f64,
    /// +1 when the other lane is to the left, -1 to the right.
    pub(crate) side: f64,
}

/// The lane of an agent at every timestep at which it is known, with hysteresis.
pub(crate) struct LaneTrace<'a> {
    steps: Vec<LaneStep<'a>>,
    /// The moves to lanes beside, by time.
    pub(crate) crossings: Vec<LaneMove<'a>>,
}

struct LaneStep<'a> {
    timestep: usize,
    position: Vec2,
    lane: &'a IndexedLane<'a>,
    place: LanePlace,
}

impl<'a> LaneTrace<'a> {
    /// Follows an agent. It stays in its lane until its center is more than `hysteresis_m` beyond a side or the lane
    /// ends, and is lost where more than `max_gap` timesteps are not tracked.
    pub(crate) fn follow(
        lanes: &'a SceneLanes<'a>,
        trajectory: &Trajectory,
        hysteresis_m: f64,
        max_gap: usize,
    ) -> Self {
        let mut trace = Self { steps: Vec::new(), crossings: Vec::new() };
        let mut current: Option<(usize, &'a IndexedLane<'a>)> = None;
        let mut first_crossing_followed = 0;
        for (timestep, state) in trajectory.valid().filter(|(_, state)| state.is_finite()) {
            if current.is_some_and(|(last, _)| timestep - last > max_gap) {
                current = None;
                first_crossing_followed = trace.crossings.len();
            }
            let own = current.and_then(|(_, lane)| Some((lane, lane.place(state.position)?)));
            let step = match (current, own) {
                (_, Some((lane, place))) if place.margin_m >= -hysteresis_m => Some((lane, place)),
                (Some((_, from)), _) => trace.leave(lanes, from, timestep, state),
                (None, _) => candidates(lanes, state).max_by(|a, b| a.1.margin_m.total_cmp(&b.1.margin_m)),
            };
            if let Some((lane, place)) = step {
                current = Some((timestep, lane));
                trace.steps.push(LaneStep { timestep, position: state.position, lane, place });
            } else if let Some((last, _)) = &mut current {
                // Off the lanes the agent is still followed: it may come back.
                *last = timestep;
            }
            for crossing in &mut trace.crossings[first_crossing_followed..] {
                crossing.last_followed = timestep;
            }
        }
        trace
    }

    /// The lane of an agent that has left `from`; notes a crossing if that lane is beside `from`.
    fn leave(
        &mut self,
        lanes: &'a SceneLanes<'a>,
        from: &'a IndexedLane<'a>,
        timestep: usize,
        state: &State,
    ) -> Option<(&'a IndexedLane<'a>, LanePlace)> {
        let mut found: Vec<_> = candidates(lanes, state)
            .map(|(lane, place)| (lanes.relation(from, lane, state.position), lane, place))
            .collect();
        // Lanes that follow on precede lanes beside; among each kind, the one with the agent deepest inside comes
        // first.
        found.sort_by(|a, b| b.2.margin_m.total_cmp(&a.2.margin_m));
        let best_of = |wanted: LaneRelation| found.iter().find(|(relation, _, _)| *relation == wanted);
        let (relation, lane, place) = best_of(LaneRelation::Along)
            .or_else(|| best_of(LaneRelation::Beside))
            .or_else(|| found.first())
            .copied()?;
        if relation == LaneRelation::Beside {
            let side = from.lane.centerline.project(state.position).map_or(1.0, |p| p.offset_m.signum());
            let (heading_rad, position) = (place.heading_rad, state.position);
            let crossing = LaneMove { timestep, side, heading_rad, last_followed: timestep, position, from, lane };
            self.crossings.push(crossing);
        }
        Some((lane, place))
    }

    /// The first timestep up to `crossing` at which the agent is more than `offset_m` off the center line of its lane,
    /// toward the side to which it crosses.
    pub(crate) fn departure(&self, crossing: &LaneMove<'_>, offset_m: f64) -> usize {
        let before = self.steps.iter().rev().skip_while(|step| step.timestep >= crossing.timestep);
        before
            .take_while(|step| {
                step.lane.lane.id != crossing.lane.lane.id && step.place.offset_m * crossing.side > offset_m
            })
            .last()
            .map_or(crossing.timestep, |step| step.timestep)
    }

    /// The timesteps at which the agent is less than `margin_m` from a lane beside its own.
    pub(crate) fn drifts(&self, lanes: &'a SceneLanes<'a>, margin_m: f64) -> impl Iterator<Item = Drift> {
        self.steps.iter().filter(move |step| step.place.margin_m < margin_m).filter_map(|step| {
            let side = step.place.offset_m.signum();
            let to_side = Vec2::from_angle(step.place.heading_rad + side * std::f64::consts::FRAC_PI_2);
            let probe = step.position + to_side * (step.place.margin_m + PROBE_M);
            let mut beyond = lanes.lanes_at(probe).filter(|(_, place)| runs_along(place, step.place.heading_rad));
            beyond.any(|(lane, _)| lanes.relation(step.lane, lane, probe) == LaneRelation::Beside).then_some(Drift {
                timestep: step.timestep,
                margin_m: step.place.margin_m,
                side,
            })
        })
    }
}

/// The lanes that an agent in `state` may be driving in.
fn candidates<'a>(lanes: &'a SceneLanes<'a>, state: &State) -> impl Iterator<Item = (&'a IndexedLane<'a>, LanePlace)> {
    lanes.lanes_at(state.position).filter(|(_, place)| runs_along(place, state.heading_rad))
}

fn runs_along(place: &LanePlace, heading_rad: f64) -> bool {
    angle_difference(place.heading_rad, heading_rad).abs() < MAX_HEADING_DIFFERENCE_RAD
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::behavior::testing::lane_graph;
    use crate::scene::testing::{Drive, scene};

    #[test]
    fn who_comes_to_the_end_of_a_lane_goes_on_in_the_next_even_where_one_beside_is_nearer() {
        // At y = -1.3, an agent is 0.6 m inside lane 2, which follows on, and 1 m inside lane 4 beside that.
        let lanes = lane_graph(
            "lanes = [
                { id = 1, centerline = [[0, 0], [20, 0]], successors = [2] },
                { id = 2, centerline = [[20, 0], [60, 0]], predecessors = [1], right_neighbor = 4 },
                { id = 4, centerline = [[20, -2.2], [60, -2.2]] },
            ]",
        );
        let graph = lanes;
        let index = SceneLanes::new(&graph);
        let scene = scene(&[Drive::straight(12.0, -1.3, 0.0, 10.0)]);
        let trace = LaneTrace::follow(&index, &scene.tracks[0].trajectory, 0.3, 1);
        assert!(trace.crossings.is_empty());
        let ids: Vec<i64> = trace.steps.iter().map(|step| step.lane.lane.id.0).collect();
        assert_eq!((ids.first(), ids.last(), ids.contains(&4)), (Some(&1), Some(&2), false));
    }
}
