//! The lane that an agent keeps: its course, its width, and the places of others relative to it.

use super::lane_relation::{HALF_NOMINAL_WIDTH_M, IndexedLane, SceneLanes};
use crate::geometry::{Path, Polyline, Projection, Vec2, angle_difference};
use crate::scene::{Lane, LaneId, Scene, State, Trajectory};
use std::f64::consts::FRAC_PI_4;

/// An agent keeps only a lane whose direction differs from its heading by less than this, radians.
const MAX_HEADING_DIFFERENCE_RAD: f64 = FRAC_PI_4;
/// An agent is still in its lane when its center is beyond a side by no more than this, meters.
const HYSTERESIS_M: f64 = 0.3;
/// How far the lane is followed ahead of and behind the agent's present lane, meters: farther than any agent of
/// interest.
const AHEAD_M: f64 = 200.0;
const BEHIND_M: f64 = 100.0;
/// How far its lines run straight on where the map ends, meters.
const EXTENSION_M: f64 = 100.0;
/// Points closer together than this are merged, meters: lanes that follow on repeat the last point.
const MIN_SPACING_M: f64 = 0.05;

/// The lane in which an agent is at present, with the lanes that lead to it and those that continue it. Where the road
/// forks, it continues in the lanes that the agent drives, or otherwise in the straightest.
pub(super) struct KeptLane {
    center: Path,
    /// Left and right boundaries, if all of its lanes have them.
    sides: Option<[Path; 2]>,
    /// The lanes in driving direction. Empty for a straight line.
    lanes: Vec<LaneId>,
}

impl KeptLane {
    /// The lane that an agent keeps. `None` if the agent is not tracked at present or is in no lane.
    pub(super) fn of(scene: &Scene, lanes: &SceneLanes<'_>, agent_idx: usize) -> Option<Self> {
        Self::among(scene, lanes, agent_idx, scene.n_timesteps)
    }

    /// The lane predicted from the past alone. `None` if the agent is not tracked at present or is in no lane.
    pub(super) fn as_observed(scene: &Scene, lanes: &SceneLanes<'_>, agent_idx: usize) -> Option<Self> {
        Self::among(scene, lanes, agent_idx, scene.n_history)
    }

    /// The lane that starts with this one and continues with the straightest successor at each fork.
    pub(super) fn from_lane(lanes: &SceneLanes<'_>, lane: &IndexedLane<'_>) -> Self {
        Self::along(&route(lanes, lane, &[], &[]))
    }

    /// This lane, driven against its direction.
    #[must_use]
    pub(super) fn reversed(mut self) -> Self {
        self.center = self.center.reversed();
        self.sides = self.sides.map(|[left, right]| [right.reversed(), left.reversed()]);
        self.lanes.reverse();
        self
    }

    /// The straight line ahead of an agent in this state.
    pub(super) fn straight_on(state: &State) -> Self {
        let ahead = Vec2::from_angle(state.heading_rad);
        let center = extended([state.position, state.position + ahead].iter());
        Self { center, sides: None, lanes: Vec::new() }
    }

    /// The lane, among those in which the agent is at present, that contains most of its positions up to `end`; among
    /// equals, the one whose center line is nearest to them.
    fn among(scene: &Scene, lanes: &SceneLanes<'_>, agent_idx: usize, end: usize) -> Option<Self> {
        let trajectory = &scene.tracks[agent_idx].trajectory;
        let state = scene.state(agent_idx, scene.current_timestep()).filter(|state| state.is_finite())?;
        let future: Vec<Vec2> = positions(trajectory, scene.current_timestep()..end);
        let history: Vec<Vec2> = positions(trajectory, 0..scene.n_history);
        let is_along =
            |heading_rad: f64| angle_difference(heading_rad, state.heading_rad).abs() < MAX_HEADING_DIFFERENCE_RAD;
        let mut own = lanes.lanes_at(state.position).filter(|(_, place)| is_along(place.heading_rad)).peekable();
        let first = own.next().map(|(lane, _)| lane)?;
        let route = |lane| route(lanes, lane, &future, &history);
        if own.peek().is_none() {
            return Some(Self::along(&route(first)));
        }
        let ranked = std::iter::once(first).chain(own.map(|(lane, _)| lane)).map(|lane| {
            let kept = Self::along(&route(lane));
            let n_outside = future.iter().filter(|point| !kept.holds(**point)).count();
            let offsets_m = future.iter().filter_map(|point| Some(kept.project(*point)?.offset_m.abs()));
            (n_outside, offsets_m.sum::<f64>(), kept)
        });
        ranked.min_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1))).map(|(_, _, kept)| kept)
    }

    fn along(lanes: &[&Lane]) -> Self {
        let joined = |line: fn(&Lane) -> &Polyline| extended(lanes.iter().flat_map(|lane| &line(lane).0));
        let has_sides = lanes.iter().all(|lane| lane.left.0.len() >= 2 && lane.right.0.len() >= 2);
        Self {
            center: joined(|lane| &lane.centerline),
            sides: has_sides.then(|| [joined(|lane| &lane.left), joined(|lane| &lane.right)]),
            lanes: lanes.iter().map(|lane| lane.id).collect(),
        }
    }

    /// The lanes in driving direction. Empty for a straight line.
    pub(super) fn ids(&self) -> &[LaneId] {
        &self.lanes
    }

    /// The direction of the center line at this distance along it, radians.
    pub(super) fn heading_at(&self, station_m: f64) -> Option<f64> {
        self.center.pose_at(station_m).map(|(_, heading_rad)| heading_rad)
    }

    /// Whether the lane is in the map at this distance along its center line, which runs straight on beyond both ends.
    pub(super) fn is_mapped(&self, station_m: f64) -> bool {
        (EXTENSION_M..=self.center.length_m() - EXTENSION_M).contains(&station_m)
    }

    /// The point at this distance along the center line.
    pub(super) fn point_at(&self, station_m: f64) -> Option<Vec2> {
        self.center.pose_at(station_m).map(|(point, _)| point)
    }

    /// The point at this distance along the center line and this offset from it, positive to the left.
    pub(super) fn beside(&self, station_m: f64, offset_m: f64) -> Option<Vec2> {
        let (point, heading_rad) = self.center.pose_at(station_m)?;
        Some(point + Vec2::from_angle(heading_rad).left() * offset_m)
    }

    /// Whether `point` may be within `reach_m` of the center line.
    pub(super) fn may_come_within(&self, point: Vec2, reach_m: f64) -> bool {
        self.center.may_come_within(point, reach_m)
    }

    /// The position of `point` along the center line and beside it.
    pub(super) fn project(&self, point: Vec2) -> Option<Projection> {
        self.center.project(point)
    }

    /// How far `point` is beyond the left (+1) or right (-1) side of the lane, meters; negative inside it.
    pub(super) fn beyond_m(&self, point: Vec2, side: f64) -> Option<f64> {
        match &self.sides {
            Some([left, right]) => {
                let line = if side > 0.0 { left } else { right };
                line.project(point).map(|place| side * place.offset_m)
            }
            None => self.project(point).map(|place| side * place.offset_m - HALF_NOMINAL_WIDTH_M),
        }
    }

    /// Whether an agent whose center is at `point` is in the lane, or beyond a side by no more than the hysteresis.
    pub(super) fn holds(&self, point: Vec2) -> bool {
        [1.0, -1.0].into_iter().all(|side| self.beyond_m(point, side).is_some_and(|beyond_m| beyond_m <= HYSTERESIS_M))
    }

    /// Where the lane ends beside one that goes on, as at the end of a ramp: how far along its center line, and that
    /// one. `None` if it goes on itself, or the map ends.
    pub(super) fn ends_beside(&self, lanes: &SceneLanes<'_>) -> Option<(f64, Self)> {
        let last = lanes.get(*self.lanes.last()?).filter(|last| last.lane.successors.is_empty())?.lane;
        let mut beside = [last.left_neighbor, last.right_neighbor].into_iter().flatten().filter_map(|id| lanes.get(id));
        let next = beside.find(|beside| !beside.lane.successors.is_empty())?;
        Some((self.center.length_m() - EXTENSION_M, Self::from_lane(lanes, next)))
    }

    /// Whether the two lanes lead into each other.
    pub(super) fn joins(&self, other: &Self) -> bool {
        self.lanes.iter().any(|lane| other.lanes.contains(lane))
    }
}

/// The middle of the lane in which each of these agents drives from the present to the end of the scene, carried
/// straight on beyond the map; `None` for who is in no lane.
pub(crate) fn driven_middles(scene: &Scene, agents: &[usize]) -> Vec<(usize, Option<Path>)> {
    let lanes = SceneLanes::new(&scene.lanes);
    let middle = |agent_idx: &usize| KeptLane::of(scene, &lanes, *agent_idx).map(|lane| lane.center);
    agents.iter().map(|agent_idx| (*agent_idx, middle(agent_idx))).collect()
}

fn positions(trajectory: &Trajectory, timesteps: std::ops::Range<usize>) -> Vec<Vec2> {
    let states = timesteps.filter_map(|timestep| trajectory.get(timestep));
    states.filter(|state| state.is_finite()).map(|state: &State| state.position).collect()
}

/// The lanes to `start`, itself, and those that continue it, in driving direction, without repetitions.
///
/// In a small roundabout, the lanes ahead are the ones behind, too: those already driven are behind, the rest are
/// ahead.
fn route<'a>(lanes: &SceneLanes<'a>, start: &IndexedLane<'a>, future: &[Vec2], history: &[Vec2]) -> Vec<&'a Lane> {
    let mut route = vec![start.lane];
    let driven_m = history.windows(2).map(|pair| pair[0].distance(pair[1])).sum::<f64>().min(BEHIND_M);
    extend_route(lanes, &mut route, history, driven_m, |lane| &lane.predecessors);
    route.reverse();
    extend_route(lanes, &mut route, future, AHEAD_M, |lane| &lane.successors);
    route.reverse();
    extend_route(lanes, &mut route, history, BEHIND_M - driven_m, |lane| &lane.predecessors);
    route.reverse();
    route
}

/// Follows connections from the last lane of `route`: at a fork, to the lane that holds most of `driven`, of equal ones
/// the straightest.
fn extend_route<'a>(
    lanes: &SceneLanes<'a>,
    route: &mut Vec<&'a Lane>,
    driven: &[Vec2],
    length_m: f64,
    connections: impl Fn(&Lane) -> &Vec<LaneId>,
) {
    let mut added_m = 0.0;
    while let Some(last) = route.last().filter(|_| added_m < length_m) {
        let next = connections(last).iter().filter(|id| route.iter().all(|lane| lane.id != **id));
        let next = next.filter_map(|id| lanes.get(*id)).min_by(|a, b| {
            let n_held = |lane: &IndexedLane<'_>| {
                driven.iter().filter(|point| lane.place(**point).is_some_and(|place| place.margin_m >= 0.0)).count()
            };
            let bend = |lane: &IndexedLane<'_>| bend_rad(&lane.lane.centerline);
            n_held(b).cmp(&n_held(a)).then(bend(a).total_cmp(&bend(b)))
        });
        let Some(next) = next else { break };
        added_m += next.lane.centerline.length_m();
        route.push(next.lane);
    }
}

/// How much a line changes its direction from its start to its end, radians.
fn bend_rad(line: &Polyline) -> f64 {
    let direction = |pair: &[Vec2]| (pair[1] - pair[0]).angle();
    let (first, last) = (line.0.windows(2).next(), line.0.windows(2).next_back());
    first.zip(last).map_or(0.0, |(first, last)| angle_difference(direction(last), direction(first)).abs())
}

/// The line through `points`, carried straight on at both ends.
pub(super) fn extended<'a>(points: impl Iterator<Item = &'a Vec2>) -> Path {
    // The place of the extension before the first point is kept free.
    let mut line: Vec<Vec2> = vec![Vec2::ZERO];
    for point in points {
        if line.len() == 1 || (line[line.len() - 1] - *point).norm_squared() > MIN_SPACING_M * MIN_SPACING_M {
            line.push(*point);
        }
    }
    let onward = |from: Vec2, to: Vec2| to + (to - from).unit() * EXTENSION_M;
    if let [_, first, second, ..] = line[..] {
        line.push(onward(line[line.len() - 2], line[line.len() - 1]));
        line[0] = onward(second, first);
    } else {
        line.remove(0);
    }
    Path::new(Polyline(line))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::behavior::testing::lane_graph;
    use crate::scene::testing::{Drive, scene};
    use std::sync::Arc;

    #[test]
    fn a_ring_goes_on_ahead_and_not_behind() {
        // A ring of four lanes, 10 m from corner to corner, in one direction.
        let lanes = lane_graph(
            "lanes = [
                { id = 1, centerline = [[0, 0], [10, 0]], successors = [2], predecessors = [4] },
                { id = 2, centerline = [[10, 0], [10, 10]], successors = [3], predecessors = [1] },
                { id = 3, centerline = [[10, 10], [0, 10]], successors = [4], predecessors = [2] },
                { id = 4, centerline = [[0, 10], [0, 0]], successors = [1], predecessors = [3] },
            ]",
        );
        let scene = Scene { lanes: Arc::new(lanes), ..scene(&[Drive::straight(4.0, 0.0, 0.0, 5.0)]) };
        let kept = KeptLane::as_observed(&scene, &SceneLanes::new(&scene.lanes), 0).unwrap();
        assert_eq!(kept.ids().last(), Some(&LaneId(3)), "{:?}", kept.ids());
        assert_eq!(kept.ids().len(), 4);
        let now = kept.project(scene.state(0, scene.current_timestep()).unwrap().position).unwrap();
        let ahead = kept.point_at(now.station_m + 12.0).unwrap();
        assert!(ahead.x > 9.9 && ahead.y > 1.0, "around the corner: {ahead:?}");
    }

    #[test]
    fn lanes_join_where_one_leads_into_the_other_or_both_into_a_third() {
        // 1 and 2 merge into 3; 4 runs on its own.
        let lanes = lane_graph(
            "lanes = [
                { id = 1, centerline = [[0, 0], [40, 0]], successors = [3] },
                { id = 2, centerline = [[0, 8], [40, 0]], successors = [3] },
                { id = 3, centerline = [[40, 0], [80, 0]], predecessors = [1, 2] },
                { id = 4, centerline = [[0, -8], [80, -8]] },
            ]",
        );
        let graph = lanes;
        let drives = [(5.0, 0.0), (5.0, 7.0), (50.0, 0.0), (5.0, -8.0)];
        let scene = scene(&drives.map(|(x, y)| Drive::straight(x, y, 0.0, 10.0)));
        let scene = Scene { lanes: Arc::new(graph), ..scene };
        let index = SceneLanes::new(&scene.lanes);
        let kept: Vec<KeptLane> =
            (0..4).map(|idx| KeptLane::as_observed(&scene, &index, idx).expect("it is in a lane")).collect();
        let joining = |lane: &KeptLane| kept.iter().map(|other| u8::from(lane.joins(other))).collect::<Vec<_>>();
        assert_eq!(joining(&kept[0]), [1, 1, 1, 0]);
        assert_eq!(joining(&kept[3]), [0, 0, 0, 1]);
    }
}
