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

    /// Whether the two lanes lead into each other.
    pub(super) fn joins(&self, other: &Self) -> bool {
        self.lanes.iter().any(|lane| other.lanes.contains(lane))
    }
}

/// The points at which an agent continues after the last timestep of its track, which lasts to the end of the scene:
/// along the lane that it is in there, the straightest at forks, for `length_m` or to the end of the map. From its own
/// direction and bend it comes over to the middle of the lane, over a longer way the faster it is. Empty if it is in no
/// lane.
pub(crate) fn way_on(scene: &Scene, agent_idx: usize, length_m: f64) -> Vec<Vec2> {
    const SPACING_M: f64 = 1.0;
    // The spring is at rest after some six times as much.
    const COMES_OVER_M: f64 = 4.5;
    const COMES_OVER_S: f64 = 0.8;
    let ended = Scene { n_history: scene.n_timesteps, ..scene.clone() };
    let lanes = SceneLanes::new(&scene.lanes);
    let last = ended.current_timestep();
    let lane = KeptLane::as_observed(&ended, &lanes, agent_idx);
    let Some((lane, state)) = lane.as_ref().zip(scene.state(agent_idx, last)) else { return Vec::new() };
    let Some(place) = lane.project(state.position) else { return Vec::new() };
    let over_m = COMES_OVER_M.max(COMES_OVER_S * state.speed_mps());
    let slope = angle_difference(state.heading_rad, place.heading_rad).tan();
    let bend_1pm = bend_beside_1pm(&ended, agent_idx, lane).unwrap_or_default();
    // A spring with a triple pole, which goes on with the same offset, slope and bend.
    let linear = slope + place.offset_m / over_m;
    let square = (bend_1pm + (2.0 * linear - place.offset_m / over_m) / over_m) / 2.0;
    let n_points = (length_m / SPACING_M).ceil() as usize;
    let on = (1..=n_points).map_while(|i| {
        let ahead_m = i as f64 * SPACING_M;
        let offset_m = place.offset_m + (linear + square * ahead_m) * ahead_m;
        lane.beside(place.station_m + ahead_m, offset_m * (-ahead_m / over_m).exp())
    });
    on.collect()
}

/// By how much more than the lane an agent has turned in the last moment before the present, 1/m. `None` if it hardly
/// moved.
fn bend_beside_1pm(scene: &Scene, agent_idx: usize, lane: &KeptLane) -> Option<f64> {
    const N_STEPS: usize = 3;
    const LEAST_M: f64 = 0.5;
    const MOST_1PM: f64 = 0.1;
    let now = scene.current_timestep();
    let [before, after] =
        [now.checked_sub(N_STEPS)?, now].map(|timestep| scene.state(agent_idx, timestep).filter(|s| s.is_finite()));
    let (before, after) = before.zip(after)?;
    let moved_m = before.position.distance(after.position);
    let along = |state: &State| Some(angle_difference(state.heading_rad, lane.project(state.position)?.heading_rad));
    let turned_rad = along(after)? - along(before)?;
    (moved_m >= LEAST_M).then(|| (turned_rad / moved_m).clamp(-MOST_1PM, MOST_1PM))
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
    fn an_agent_goes_on_in_its_own_direction_and_comes_over_to_the_middle() {
        let lanes = lane_graph("lanes = [{ id = 1, centerline = [[-50, 0], [150, 0]] }]");
        let scene = Scene { lanes: Arc::new(lanes), ..scene(&[Drive::straight(0.0, 0.3, 0.1, 5.0)]) };
        let last = scene.state(0, scene.n_timesteps - 1).unwrap();
        let way = way_on(&scene, 0, 60.0);
        let first_rad = (way[0] - last.position).angle();
        assert!(way.len() == 60 && (first_rad - 0.1).abs() < 0.03, "{first_rad}");
        let bends = way.windows(3).map(|w| ((w[2] - w[1]).angle() - (w[1] - w[0]).angle()).abs());
        assert!(bends.fold(0.0, f64::max) < 0.06);
        assert!(way[40].y.abs() < 0.1 && way[59].y.abs() < 0.01, "{:?}", way[40]);
        // A fast one goes on straight, and takes longer: an offset of 0.4 m is (1 + s + s²/2) e^-s times as much after s
        // times 16 m.
        let fast = crate::scene::testing::scene(&[Drive::straight(0.0, 0.4, 0.0, 20.0)]);
        let fast = Scene { lanes: Arc::clone(&scene.lanes), ..fast };
        let way = way_on(&fast, 0, 60.0);
        for (i, share) in [(15, 2.5 / std::f64::consts::E), (31, 5.0 * (-2.0_f64).exp())] {
            assert!((way[i].y - 0.4 * share).abs() < 1e-9, "{:?}", way[i]);
        }
    }

    #[test]
    fn an_agent_in_a_bend_of_its_own_lets_go_of_it_slowly() {
        let lanes = lane_graph("lanes = [{ id = 1, centerline = [[-50, 0], [150, 0]] }]");
        let mut scene = Scene { lanes: Arc::new(lanes), ..scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0)]) };
        // A circle of 100 m, at whose end it has turned by 0.05.
        let last = scene.n_timesteps - 1;
        let states = (0..=last).map(|t| {
            let rad = 0.05 - (last - t) as f64 * scene.dt_s * 10.0 / 100.0;
            let position = Vec2::new(100.0 * rad.sin(), 100.0 * (1.0 - rad.cos()));
            Some(State { position, heading_rad: rad, velocity: Vec2::from_angle(rad) * 10.0 })
        });
        scene.tracks[0].trajectory = Trajectory::new(states.collect());
        let from = scene.state(0, last).unwrap().position;
        let way: Vec<Vec2> = [from].into_iter().chain(way_on(&scene, 0, 40.0)).collect();
        let headings: Vec<f64> = way.windows(2).map(|pair| (pair[1] - pair[0]).angle()).collect();
        // In half a meter it lets go of little of 1/100 per meter.
        assert!((headings[0] - 0.054).abs() < 0.001, "{}", headings[0]);
        let turns: Vec<f64> = headings.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let most = turns.windows(2).map(|pair| (pair[1] - pair[0]).abs()).fold(0.0, f64::max);
        assert!(most < 0.0065, "{most}");
        assert!(way[40].y.abs() < 0.2, "{:?}", way[40]);
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
