//! Who enters? A corpus knows nobody who was not there at the present of a scene, so arrivals are drawn from the
//! traffic that its scenes of the place have just behind the ends of the map.
//!
//! An [`Entry`] is a lane that no other leads to, from where traffic is first seen on it. The flow through its first
//! meters is the speeds of those that the scenes have there, over length and number of scenes (Edie 1963); an arrival
//! has the size, speed and offset of one of them, drawn in proportion to its speed, since the fast pass more often.

use super::situation::Situation;
use super::world::World;
use crate::geometry::{OrientedBox, Polyline, Vec2, angle_difference};
use crate::scene::{LaneGraph, LaneId, Scene, State, Track, TrackId, TrackRole, Trajectory};
use crate::seed::Seed;
use std::collections::BTreeSet;
use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};
use std::sync::Arc;

/// How far behind its beginning traffic may first be seen on a lane, and how long the stretch is whose flow is
/// measured, meters; shorter ones say too little.
const FIRST_SEEN_M: f64 = 40.0;
const STRETCH_M: f64 = 30.0;
const LEAST_STRETCH_M: f64 = 5.0;
/// Who is farther than this from the middle of a lane, meters, is not in it.
const IN_LANE_M: f64 = 2.0;
/// Slower ones, m/s, do not arrive: they wait already.
const LEAST_MPS: f64 = 1.0;
/// An arrival keeps this gap, meters, and this time, seconds, and brakes with at most this, m/s².
const GAP_M: f64 = 2.0;
const HEADWAY_S: f64 = 1.0;
const BRAKES_MPS2: f64 = 3.0;
/// Who finds no gap for so long, seconds, does not come.
pub(super) const WAITS_S: f64 = 5.0;
/// No more arrivals a drive than this.
const MOST_ARRIVALS: usize = 1000;

/// Where traffic enters a place, in the frame of its recordings.
#[derive(Debug, Default)]
pub(super) struct Entries(Vec<Entry>);

/// A lane at the end of the map.
#[derive(Debug)]
struct Entry {
    /// It and the lanes that follow before others join, each with its distance from the beginning.
    lanes: Vec<(Polyline, f64)>,
    /// Where traffic is first seen.
    starts_at_m: f64,
    /// Those behind that point, with how many such a second arrive.
    seen: Vec<(Track, Arrival, f64)>,
}

/// Who arrives when, and how.
#[derive(Debug, Clone, Copy)]
pub(super) struct Arrival {
    timestep: usize,
    entry_idx: usize,
    speed_mps: f64,
    offset_m: f64,
}

/// Who arrives in a drive: the last tracks of its scene, in the order of time.
#[derive(Debug, Clone, Default)]
pub(super) struct Arrivals {
    entries: Arc<Entries>,
    expected: Vec<Arrival>,
}

impl Entries {
    /// The entries of a map with these scenes of it, each another.
    pub(super) fn of(map: &LaneGraph, scenes: &[Scene]) -> Self {
        let mut entries: Vec<Entry> = map
            .lanes()
            .iter()
            .filter(|lane| lane.predecessors.is_empty())
            .map(|lane| Entry { lanes: lanes_from(map, lane.id), starts_at_m: f64::INFINITY, seen: Vec::new() })
            .collect();
        let mut present = Vec::new();
        for scene in scenes {
            for track in scene.tracks.iter().filter(|track| track.class.is_motorized()) {
                for (timestep, state) in track.trajectory.valid().take_while(|(t, _)| *t < scene.n_history) {
                    let state = state.transformed(&scene.world_from_scene);
                    let places = entries.iter().map(|entry| entry.place(&state)).enumerate();
                    let places = places.filter_map(|(entry_idx, place)| Some((entry_idx, place?)));
                    let Some((entry_idx, [station_m, offset_m])) =
                        places.min_by(|(_, a), (_, b)| a[1].abs().total_cmp(&b[1].abs()))
                    else {
                        continue;
                    };
                    entries[entry_idx].starts_at_m = entries[entry_idx].starts_at_m.min(station_m);
                    if timestep == scene.current_timestep() {
                        let arrival = Arrival { timestep, entry_idx, speed_mps: state.speed_mps(), offset_m };
                        present.push((station_m, track, arrival));
                    }
                }
            }
        }
        for (station_m, track, arrival) in present {
            let entry = &mut entries[arrival.entry_idx];
            let behind_m = station_m - entry.starts_at_m;
            let length_m = (entry.length_m() - entry.starts_at_m).min(STRETCH_M);
            if entry.starts_at_m <= FIRST_SEEN_M
                && length_m >= LEAST_STRETCH_M
                && behind_m <= length_m
                && arrival.speed_mps >= LEAST_MPS
            {
                let rate_per_s = arrival.speed_mps / (length_m * scenes.len() as f64);
                let track =
                    Track { trajectory: Trajectory::new(Vec::new()), role: TrackRole::Context, ..track.clone() };
                entry.seen.push((track, arrival, rate_per_s));
            }
        }
        Self(entries)
    }

    /// How many arrive in a second.
    fn rate_per_s(&self) -> f64 {
        self.seen().map(|(_, _, rate_per_s)| rate_per_s).sum()
    }

    fn seen(&self) -> impl Iterator<Item = &(Track, Arrival, f64)> {
        self.0.iter().flat_map(|entry| &entry.seen)
    }
}

impl Entry {
    fn length_m(&self) -> f64 {
        self.lanes.iter().map(|(lane, start_m)| start_m + lane.length_m()).fold(0.0, f64::max)
    }

    /// How far from the beginning somebody is in the lane, and how far to the left of its middle, meters.
    fn place(&self, state: &State) -> Option<[f64; 2]> {
        let places = self.lanes.iter().filter_map(|(lane, start_m)| {
            let place = lane.project(state.position)?;
            let is_along = angle_difference(place.heading_rad, state.heading_rad).abs() < FRAC_PI_4;
            (is_along && place.point.distance(state.position) < IN_LANE_M)
                .then_some([start_m + place.station_m, place.offset_m])
        });
        places.min_by(|a, b| a[1].abs().total_cmp(&b[1].abs()))
    }

    /// The state in which somebody enters.
    fn state(&self, speed_mps: f64, offset_m: f64) -> Option<State> {
        let holds = |(lane, start_m): &&(Polyline, f64)| start_m + lane.length_m() > self.starts_at_m;
        let (lane, start_m) = self.lanes.iter().find(holds)?;
        let middle = lane.point_at(self.starts_at_m - start_m)?;
        let heading_rad = lane.project(middle)?.heading_rad;
        let position = middle + Vec2::from_angle(heading_rad + FRAC_PI_2) * offset_m;
        Some(State { position, heading_rad, velocity: Vec2::from_angle(heading_rad) * speed_mps })
    }
}

/// A lane and those that follow before others join, each with its distance from the beginning of the first.
fn lanes_from(map: &LaneGraph, first: LaneId) -> Vec<(Polyline, f64)> {
    let (mut lanes, mut known, mut open) = (Vec::new(), BTreeSet::from([first]), vec![(first, 0.0)]);
    while let Some((id, start_m)) = open.pop() {
        let Some(lane) = map.get(id) else { continue };
        lanes.push((lane.centerline.clone(), start_m));
        let end_m = start_m + lane.centerline.length_m();
        let joins_alone = |id: &&LaneId| map.get(**id).is_some_and(|lane| lane.predecessors.len() == 1);
        for id in lane.successors.iter().filter(joins_alone).filter(|_| end_m < FIRST_SEEN_M + STRETCH_M) {
            if known.insert(*id) {
                open.push((*id, end_m));
            }
        }
    }
    lanes.sort_by(|a, b| a.1.total_cmp(&b.1));
    lanes
}

impl Arrivals {
    /// Those who arrive within `n_steps` after the present of this scenario, and at least so many tracks of them.
    pub(super) fn draw(
        entries: &Arc<Entries>,
        scene: &Scene,
        name: &str,
        seed: u64,
        sizes: [usize; 2],
    ) -> (Self, Vec<Track>) {
        let ([n_steps, n_least], rate_per_s) = (sizes, entries.rate_per_s());
        let mut rng = Seed(seed).derive_named("arrivals", name).rng();
        let (mut arrivals, mut tracks) = (Self { entries: Arc::clone(entries), expected: Vec::new() }, Vec::new());
        let mut after_s = 0.0;
        while rate_per_s > 0.0 && tracks.len() < MOST_ARRIVALS {
            after_s -= (1.0 - rng.uniform()).ln() / rate_per_s;
            let n_after = (after_s / scene.dt_s).ceil() as usize;
            if n_after > n_steps && tracks.len() >= n_least {
                break;
            }
            let mut left = rng.uniform() * rate_per_s;
            let drawn = entries.seen().find(|(_, _, rate_per_s)| {
                left -= rate_per_s;
                left <= 0.0
            });
            let Some((track, arrival, _)) = drawn.or_else(|| entries.seen().last()) else { break };
            arrivals.expected.push(Arrival { timestep: scene.current_timestep() + n_after, ..*arrival });
            let id = TrackId(format!("arrival_{}", tracks.len() + 1));
            tracks.push(Track { id, trajectory: Trajectory::new(vec![None; scene.n_timesteps]), ..track.clone() });
        }
        (arrivals, tracks)
    }

    /// How many may arrive.
    pub(super) fn n_expected(&self) -> usize {
        self.expected.len()
    }

    /// How many were to arrive before a timestep.
    pub(super) fn n_until(&self, timestep: usize) -> usize {
        self.expected.iter().take_while(|arrival| arrival.timestep < timestep).count()
    }

    /// Lets those in who are due now and find a gap: at their own speed, or else at that of whoever is ahead.
    pub(super) fn enter(&self, situation: &Situation, world: &mut World) {
        let (now, dt_s) = (world.now(), situation.scene.dt_s);
        let first_idx = world.n_tracks() - self.expected.len();
        let first_due = now.saturating_sub((WAITS_S / dt_s).round() as usize);
        for (i, arrival) in self.expected.iter().enumerate().take_while(|(_, arrival)| arrival.timestep <= now) {
            let agent_idx = first_idx + i;
            let has_come = (arrival.timestep..=now).any(|timestep| world.state(agent_idx, timestep).is_some());
            if arrival.timestep < first_due || has_come {
                continue;
            }
            if let Some(state) = self.entering(situation, world, agent_idx, arrival) {
                world.place(agent_idx, state);
            }
        }
    }

    fn entering(&self, situation: &Situation, world: &World, agent_idx: usize, arrival: &Arrival) -> Option<State> {
        let (world_from_scene, entry) = (&situation.scene.world_from_scene, self.entries.0.get(arrival.entry_idx)?);
        let state = |speed_mps: f64| {
            let state = entry.state(speed_mps, arrival.offset_m)?;
            Some(state.transformed(&world_from_scene.inverse()))
        };
        let others: Vec<(usize, State)> =
            (0..world.n_tracks()).filter_map(|idx| Some((idx, world.present(idx)?))).collect();
        let length_m = |idx: usize| situation.scene.tracks[idx].extent_or_nominal().length_m;
        // The one ahead in the lane: its gap and speed.
        let ahead = others.iter().filter_map(|(idx, other)| {
            let [station_m, _] = entry.place(&other.transformed(world_from_scene))?;
            let between_m = (length_m(*idx) + length_m(agent_idx)) / 2.0;
            (station_m + between_m > entry.starts_at_m)
                .then(|| (station_m - entry.starts_at_m - between_m, other.speed_mps()))
        });
        let ahead = ahead.min_by(|a, b| a.0.total_cmp(&b.0));
        let is_free = |speed_mps: &f64| {
            let keeps_gap = ahead.is_none_or(|(gap_m, ahead_mps)| {
                let braking_m = (speed_mps.powi(2) - ahead_mps.powi(2)).max(0.0) / (2.0 * BRAKES_MPS2);
                gap_m >= GAP_M + HEADWAY_S * speed_mps + braking_m
            });
            let Some(own) = state(*speed_mps) else { return false };
            let body = situation.body(agent_idx, &own);
            let clear_m = GAP_M + HEADWAY_S * speed_mps;
            let center = body.center + Vec2::from_angle(own.heading_rad) * (clear_m / 2.0);
            let swept = OrientedBox { center, length_m: body.length_m + clear_m, ..body };
            keeps_gap && others.iter().all(|(idx, other)| !swept.overlaps(&situation.body(*idx, other)))
        };
        let slower = ahead.map(|(_, ahead_mps)| ahead_mps.min(arrival.speed_mps)).filter(|mps| *mps >= LEAST_MPS);
        [Some(arrival.speed_mps), slower].into_iter().flatten().find(is_free).and_then(state)
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{record, situation};
    use super::*;

    /// A road of 200 m along x, of which traffic is first seen at 10 m; a side road joins it at 100 m.
    fn map() -> LaneGraph {
        let line = |points: &[[f64; 2]]| Polyline(points.iter().map(|[x, y]| Vec2::new(*x, *y)).collect());
        let lane = |id: i64, points: &[[f64; 2]], successors: &[i64], predecessors: &[i64]| {
            let ids = |ids: &[i64]| ids.iter().map(|id| LaneId(*id)).collect();
            let lane = crate::scene::Lane::unconnected(id, line(points), [Polyline::default(), Polyline::default()]);
            crate::scene::Lane { successors: ids(successors), predecessors: ids(predecessors), ..lane }
        };
        LaneGraph::new(vec![
            lane(1, &[[0.0, 0.0], [100.0, 0.0]], &[2], &[]),
            lane(2, &[[100.0, 0.0], [200.0, 0.0]], &[], &[1, 3]),
            lane(3, &[[100.0, -50.0], [100.0, -1.0]], &[2], &[]),
        ])
    }

    /// A scene with vehicles that drive along x, given by place at present and speed.
    fn scene(vehicles: &[[f64; 2]]) -> Scene {
        let mut scene = situation(&record()).scene;
        scene.world_from_scene = crate::geometry::Transform2::from_pose(Vec2::new(3.0, 1.0), 0.5);
        let track = scene.tracks[0].clone();
        let scene_from_world = scene.world_from_scene.inverse();
        let vehicle = |[x, mps]: &[f64; 2]| {
            let velocity = Vec2::new(*mps, 0.0);
            let state = |timestep: usize| {
                let after_s = (timestep as f64 - scene.current_timestep() as f64) * scene.dt_s;
                let position = Vec2::new(*x, 0.0) + velocity * after_s;
                // Nobody is seen before 10 m.
                let state = State { position, heading_rad: 0.0, velocity };
                (position.x > 10.0 - 1e-9).then(|| state.transformed(&scene_from_world))
            };
            Track { trajectory: Trajectory::new((0..scene.n_timesteps).map(state).collect()), ..track.clone() }
        };
        scene.tracks = vehicles.iter().map(vehicle).collect();
        scene
    }

    #[test]
    fn arrivals_are_as_many_and_as_fast_as_the_flow_behind_the_end_of_the_map() {
        // In 30 m: 15 m/s in the first scene, 5 m/s and one that stands in the second; those farther on do not count.
        let scenes = [scene(&[[11.0, 15.0], [60.0, 15.0], [150.0, 9.0]]), scene(&[[39.0, 5.0], [20.0, 0.0]])];
        let entries = Arc::new(Entries::of(&map(), &scenes));
        let wanted_per_s = (15.0 + 5.0) / 30.0 / 2.0;
        assert!((entries.rate_per_s() - wanted_per_s).abs() < 0.02, "{}", entries.rate_per_s());
        let draw = |name: &str, sizes| Arrivals::draw(&entries, &scenes[0], name, 7, sizes);
        let (all, tracks) = draw("a", [20_000, 0]);
        let n_wanted = wanted_per_s * 2000.0;
        assert!((all.n_expected() as f64 - n_wanted).abs() < 4.0 * n_wanted.sqrt(), "{}", all.n_expected());
        let n_fast = all.expected.iter().filter(|arrival| arrival.speed_mps > 10.0).count();
        assert!((n_fast as f64 / all.n_expected() as f64 - 0.75).abs() < 0.07, "{n_fast} of {}", all.n_expected());
        // Longer drives have the same arrivals and some more, others scenarios have others.
        let (few, first) = draw("a", [100, 0]);
        assert!(first.len() < tracks.len() && tracks.starts_with(&first) && all.n_until(110) == few.n_expected());
        let times = |arrivals: &Arrivals| arrivals.expected.iter().take(5).map(|a| a.timestep).collect::<Vec<_>>();
        assert!(times(&all) != times(&draw("b", [20_000, 0]).0) && draw("a", [0, 9]).0.n_expected() == 9);
    }

    #[test]
    fn who_finds_no_gap_waits_and_then_does_not_come() {
        let scene = scene(&[[30.0, 10.0], [11.0, 10.0]]);
        let entries = Arc::new(Entries::of(&map(), std::slice::from_ref(&scene)));
        let mut situation = situation(&record());
        let lanes = map().into_frame(&scene.world_from_scene.inverse());
        situation.scene = Scene { lanes: Arc::new(lanes), ..scene };
        situation.scene.tracks.truncate(1);
        situation.expect(&entries, 1, 50, 0);
        let n_expected = situation.arrivals.n_expected();
        assert!(n_expected > 5, "{n_expected}");
        // Somebody stands 5 m behind the beginning until he goes on.
        let scene_from_world = situation.scene.world_from_scene.inverse();
        let at = |x: f64| {
            let state = State { position: Vec2::new(x, 0.0), ..State::default() };
            state.transformed(&scene_from_world)
        };
        let world_with = |x: f64, n_steps: usize| {
            let mut world = situation.start(1);
            for _ in 0..n_steps {
                world.push((0..world.n_tracks()).map(|idx| (idx == 0).then(|| at(x))).collect::<Vec<_>>());
            }
            situation.arrivals.enter(&situation, &mut world);
            (1..world.n_tracks()).filter(|idx| world.present(*idx).is_some()).collect::<Vec<_>>()
        };
        let first = situation.arrivals.expected[0].timestep - situation.scene.current_timestep();
        assert_eq!(
            (world_with(15.0, first), world_with(90.0, first), world_with(90.0, first - 1)),
            (vec![], vec![1], vec![])
        );
        // One at a time, and none that is more than 5 s late.
        let found = world_with(90.0, first + 51);
        assert!(found.len() == 1 && found[0] > 1, "{found:?}");
    }
}
