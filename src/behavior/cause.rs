//! Why does somebody brake hard, or barely avoid another: what in the scene explains it, or what mistake?

use super::event::BehaviorEvent;
use super::footprint::Footprint;
use super::kept_lane::{KeptLane, extended};
use super::lane_relation::SceneLanes;
use super::speed_profile::smoothed_accelerations_mps2;
use super::way_on::{SETTLES_S, way_on};
use super::{hard_brake, near_miss};
use crate::geometry::{Path, Vec2};
use crate::scene::{LaneDuty, Scene, State, Track};
use crate::settings::named;
use std::f64::consts::FRAC_PI_6;

/// Comfortable braking, m/s².
pub(super) const COMFORTABLE_MPS2: f64 = 2.0;
/// Whoever can do with half the braking, or with a comfortable one, has no cause to brake as hard.
const NEEDED_SHARE: f64 = 0.5;
/// Drivers stop this far behind what is ahead, meters.
pub(super) const STANDSTILL_GAP_M: f64 = 1.0;
/// A deceleration over half a second is known this long after it begins, seconds.
const BUILDING_UP_S: f64 = 0.4;
/// How far the way leads on behind the last state, meters, and the longest time in which braking is looked at, seconds.
const WAY_ON_M: f64 = 60.0;
const LONGEST_S: f64 = 6.0;
/// Who has been in the way for less than this has come into it, seconds.
const COMES_IN_S: f64 = 1.5;
/// Courses that differ by more than this cross, radians.
const CROSSING_RAD: f64 = FRAC_PI_6;
/// An agent below this speed stands, m/s; one that slows down by more than this brakes, m/s².
const STANDING_MPS: f64 = 1.0;
const BRAKING_MPS2: f64 = 1.0;
/// Braking as for a hazard, m/s²: see [`super::FailureToYield`].
const HAZARD_MPS2: f64 = 3.4;
/// The longest lateness of an ordinary mistake, seconds: glances away from the road of more than two seconds double the
/// risk of a crash (Klauer et al. 2006, the 100-car study), so drivers look up before.
pub(super) const MOST_LATE_S: f64 = 2.0;
/// Who does not look gains no more speed than this within that time, m/s; who misjudges a gap accelerates by no more
/// than the second, m/s².
const GAINS_MPS: f64 = 0.3;
const MOST_GAS_MPS2: f64 = 3.0;
/// The time between two that cross without a mistake, seconds: the longest time to collision of a near miss.
const ENOUGH_S: f64 = 1.5;
/// Speeds are smoothed over this, seconds.
const SMOOTHING_S: f64 = 0.4;

/// What explains an event.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Cause {
    /// Somebody on foot, or on a bicycle.
    Vulnerable,
    /// Somebody came into the way from beside.
    ComesIn,
    /// Somebody crosses.
    Crosses,
    /// Somebody or something stands.
    StandsAhead,
    /// The one ahead brakes.
    BrakesAhead,
    /// The one ahead is slower.
    SlowerAhead,
    /// The line of a rule at which to stop or yield.
    StopLine,
    /// One looked too late at the other ahead.
    LookedTooLate,
    /// One misjudged the gap in which it crossed.
    GapMisjudged,
}

named! { Cause {
    Vulnerable = "vulnerable", ComesIn = "comes_in", Crosses = "crosses", StandsAhead = "stands_ahead",
    BrakesAhead = "brakes_ahead", SlowerAhead = "slower_ahead", StopLine = "stop_line",
    LookedTooLate = "looked_too_late", GapMisjudged = "gap_misjudged",
} }

/// The cause of an event, and the size of the mistake if it is one, seconds.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Explanation {
    /// What explains it.
    pub cause: Cause,
    /// How much too late one looked: the time from when comfortable braking (2 m/s²) no longer avoids the other until
    /// it brakes. Or by how much the gap was too small: what the shorter of time to collision and post-encroachment
    /// time lacks of 1.5 s.
    pub mistake_s: Option<f64>,
}

/// Whether events of this behavior happen for a reason: hard brakes and near misses.
pub fn needs_cause(behavior: &str) -> bool {
    [hard_brake::ID, near_miss::ID].contains(&behavior)
}

/// What explains an event of such a behavior; `None` if nothing does.
///
/// - A *hard brake* has a cause if half the deceleration from the same moment, and no less than 2 m/s², is not enough:
///   along its way the agent would come closer than 1 m to somebody ahead of it, as everybody moves, or drive over the
///   end of a lane at which a rule of the map has it stop or yield, at which it stops now.
/// - A *near miss* has one if it is an ordinary mistake. If the courses differ by 30 degrees or more, the gap was
///   misjudged; nobody then accelerates with more than 3 m/s². Otherwise the one behind looked too late, by 2 s at
///   most: it gains no speed in the 2 s before it brakes, and brakes with 3.4 m/s² or more.
pub fn explanation(scene: &Scene, event: &BehaviorEvent) -> Option<Explanation> {
    let agents: Option<Vec<usize>> = event.roles.tracks().map(|track| scene.track_idx(track)).collect();
    match agents?[..] {
        [agent_idx] => {
            let hardest_mps2 = event.parameters.get("max_deceleration_mps2").copied().unwrap_or_default();
            of_braking(scene, agent_idx, event.start_timestep, not_enough_mps2(hardest_mps2))
        }
        [first, second] => of_near_miss(scene, [first, second], event),
        _ => None,
    }
}

/// The braking that must not be enough where somebody brakes this hard, m/s².
pub(super) fn not_enough_mps2(hardest_mps2: f64) -> f64 {
    (NEEDED_SHARE * hardest_mps2).max(COMFORTABLE_MPS2)
}

fn of_braking(scene: &Scene, agent_idx: usize, start: usize, mps2: f64) -> Option<Explanation> {
    let from = start.saturating_sub((BUILDING_UP_S / scene.dt_s).round() as usize);
    let way = Way::of(scene, agent_idx, from)?;
    let hit = way.hit_by_braking(from, mps2, &|idx, timestep| moved_on(&scene.tracks[idx], timestep, scene.dt_s));
    let stops = || way.stops_at_line(from, mps2).then_some(Cause::StopLine);
    let cause = hit.map(|idx| way.kind_of(idx, from)).or_else(stops);
    cause.map(|cause| Explanation { cause, mistake_s: None })
}

fn of_near_miss(scene: &Scene, pair: [usize; 2], event: &BehaviorEvent) -> Option<Explanation> {
    let parameter = |name: &str| event.parameters.get(name).copied();
    if parameter("heading_difference_rad")? >= CROSSING_RAD {
        let gap_s = [parameter("pet_s"), parameter("min_ttc_s")].into_iter().flatten().reduce(f64::min)?;
        let before = event.start_timestep.saturating_sub((MOST_LATE_S / scene.dt_s) as usize);
        let is_gentle = |idx: &usize| {
            let accelerations = accelerations_mps2(scene, *idx);
            accelerations[before..=event.end_timestep].iter().flatten().all(|mps2| *mps2 <= MOST_GAS_MPS2)
        };
        let mistake_s = Some((ENOUGH_S - gap_s).max(0.0));
        return pair.iter().all(is_gentle).then_some(Explanation { cause: Cause::GapMisjudged, mistake_s });
    }
    let [first, second] = pair;
    let late_s = late_s(scene, [first, second], event).or_else(|| late_s(scene, [second, first], event))?;
    Some(Explanation { cause: Cause::LookedTooLate, mistake_s: Some(late_s) })
}

/// How much too late `own` brakes for `other`, seconds. `None` if it brakes in time, not as for a hazard, or so late,
/// or after such a gain of speed, that it is no ordinary mistake.
fn late_s(scene: &Scene, [own, other]: [usize; 2], event: &BehaviorEvent) -> Option<f64> {
    let n_late = (MOST_LATE_S / scene.dt_s).round() as usize;
    let accelerations = accelerations_mps2(scene, own);
    let is_below = |timestep: usize, mps2: f64| accelerations[timestep].is_some_and(|own| own <= mps2);
    let window =
        event.start_timestep.saturating_sub(n_late / 2)..accelerations.len().min(event.end_timestep + n_late / 2);
    let hard = window.into_iter().find(|timestep| is_below(*timestep, -HAZARD_MPS2))?;
    let acts = (0..=hard).rev().take_while(|timestep| is_below(*timestep, -BRAKING_MPS2)).last()?;
    let earliest = acts.saturating_sub(n_late + 1);
    let way = Way::of(scene, own, earliest)?;
    let needs = |timestep: &usize| {
        let timestep = *timestep;
        let goes_on = |idx: usize, then: usize| {
            let state = scene.state(idx, timestep).filter(|_| idx == other)?;
            Some(State {
                position: state.position + state.velocity * ((then - timestep) as f64 * scene.dt_s),
                ..*state
            })
        };
        way.hit_by_braking(timestep, COMFORTABLE_MPS2, &goes_on).is_some()
    };
    let n_needed = (earliest..=acts).rev().take_while(needs).count();
    let speed_mps = |timestep: usize| scene.state(own, timestep).map(State::speed_mps);
    let slowest_mps = (acts.saturating_sub(n_late)..=acts).filter_map(speed_mps).fold(f64::INFINITY, f64::min);
    let is_ordinary = n_needed <= n_late + 1 && speed_mps(acts)? <= slowest_mps + GAINS_MPS;
    (n_needed > 1 && is_ordinary).then(|| (n_needed - 1) as f64 * scene.dt_s)
}

fn accelerations_mps2(scene: &Scene, agent_idx: usize) -> Vec<Option<f64>> {
    smoothed_accelerations_mps2(&scene.tracks[agent_idx].trajectory, scene.current_timestep(), scene.dt_s, SMOOTHING_S)
}

/// The state of a track at a timestep; behind the end of the scene, if it is tracked until there, at its last velocity.
fn moved_on(track: &Track, timestep: usize, dt_s: f64) -> Option<State> {
    let last = track.trajectory.n_timesteps() - 1;
    let state = track.trajectory.get(timestep.min(last)).filter(|state| state.is_finite())?;
    let beyond_s = timestep.saturating_sub(last) as f64 * dt_s;
    Some(State { position: state.position + state.velocity * beyond_s, ..*state })
}

/// The way of an agent from a timestep on: what it drives, and the lane that it is in then.
struct Way<'a> {
    scene: &'a Scene,
    agent_idx: usize,
    path: Path,
}

impl<'a> Way<'a> {
    fn of(scene: &'a Scene, agent_idx: usize, from: usize) -> Option<Self> {
        let track = &scene.tracks[agent_idx];
        let now = *track.trajectory.get(from).filter(|state| state.is_finite())?;
        let states = track.trajectory.valid().filter(|(timestep, state)| *timestep >= from && state.is_finite());
        let mut points: Vec<Vec2> = states.map(|(_, state)| state.position).collect();
        points.extend(way_on(scene, agent_idx, WAY_ON_M, SETTLES_S));
        // Where it stands until the end and is in no lane, its heading says where the way leads.
        points.push(points.last().copied()? + Vec2::from_angle(now.heading_rad) * STANDSTILL_GAP_M);
        Some(Self { scene, agent_idx, path: extended(points.iter()) })
    }

    /// The first agent ahead that this one would come closer to than [`STANDSTILL_GAP_M`] if it braked with `mps2` from
    /// timestep `from` on, while others are at `place(agent, timestep)`.
    fn hit_by_braking(&self, from: usize, mps2: f64, place: &dyn Fn(usize, usize) -> Option<State>) -> Option<usize> {
        let scene = self.scene;
        let now = scene.state(self.agent_idx, from)?;
        let (start_m, speed_mps) = (self.path.project(now.position)?.station_m, now.speed_mps());
        let extent = scene.tracks[self.agent_idx].extent_or_nominal();
        let stops_s = (speed_mps / mps2).min(LONGEST_S);
        let ahead = Vec2::from_angle(now.heading_rad);
        let is_behind =
            |idx: usize| place(idx, from).is_some_and(|state| (state.position - now.position).dot(ahead) < 0.0);
        let others: Vec<usize> =
            (0..scene.tracks.len()).filter(|idx| *idx != self.agent_idx && !is_behind(*idx)).collect();
        (0..=(stops_s / scene.dt_s) as usize).find_map(|step| {
            let elapsed_s = step as f64 * scene.dt_s;
            let driven_m = speed_mps * elapsed_s - mps2 * elapsed_s * elapsed_s / 2.0;
            let (center, heading_rad) = self.path.pose_at(start_m + driven_m)?;
            let forward = Vec2::from_angle(heading_rad);
            let size_m = [extent.length_m + STANDSTILL_GAP_M, extent.width_m];
            let body = Footprint::along(center + forward * (STANDSTILL_GAP_M / 2.0), forward, size_m);
            others.iter().copied().find(|idx| {
                place(*idx, from + step).is_some_and(|state| {
                    let is_ahead = (state.position - center).dot(forward) > 0.0;
                    is_ahead && body.overlaps(&Footprint::new(&scene.tracks[*idx].footprint(&state)))
                })
            })
        })
    }

    /// What the agent at `other_idx` is for this one, which begins to brake at timestep `from`.
    fn kind_of(&self, other_idx: usize, from: usize) -> Cause {
        let (scene, other) = (self.scene, &self.scene.tracks[other_idx]);
        let steps = |time_s: f64| (time_s / scene.dt_s).round() as usize;
        let widths_m =
            (scene.tracks[self.agent_idx].extent_or_nominal().width_m + other.extent_or_nominal().width_m) / 2.0;
        let place = |timestep: usize| {
            let state = scene.state(other_idx, timestep)?;
            Some((state, self.path.project(state.position)?))
        };
        let came_in = place(from.saturating_sub(steps(COMES_IN_S))).is_some_and(|(_, at)| at.offset_m.abs() > widths_m);
        let Some((now, at)) = place(from) else { return Cause::ComesIn };
        let along = Vec2::from_angle(at.heading_rad);
        let crosses = now.speed_mps() > STANDING_MPS && now.velocity.dot(along) < now.speed_mps() * CROSSING_RAD.cos();
        let around = from.saturating_sub(steps(COMES_IN_S))..=from + steps(COMES_IN_S);
        let accelerations = accelerations_mps2(scene, other_idx);
        let brakes =
            around.into_iter().filter_map(|timestep| *accelerations.get(timestep)?).any(|mps2| mps2 < -BRAKING_MPS2);
        match () {
            () if other.class.is_vulnerable() => Cause::Vulnerable,
            () if crosses => Cause::Crosses,
            () if came_in => Cause::ComesIn,
            () if brakes => Cause::BrakesAhead,
            () if now.speed_mps() <= STANDING_MPS => Cause::StandsAhead,
            () => Cause::SlowerAhead,
        }
    }

    /// Whether braking with `mps2` leads over the end of a lane at which a rule has the agent stop or yield, before
    /// which it is still at the end.
    fn stops_at_line(&self, from: usize, mps2: f64) -> bool {
        let scene = self.scene;
        let lanes = SceneLanes::new(&scene.lanes);
        let (Some(kept), Some(now)) = (KeptLane::of(scene, &lanes, self.agent_idx), scene.state(self.agent_idx, from))
        else {
            return false;
        };
        let last = scene.tracks[self.agent_idx].trajectory.valid().next_back().map(|(_, state)| state.position);
        let half_m = scene.tracks[self.agent_idx].extent_or_nominal().length_m / 2.0;
        let station_m = |point: Vec2| self.path.project(point).map(|place| place.station_m + half_m);
        let ends = kept.ids().iter().filter_map(|id| lanes.get(*id)).map(|lane| lane.lane);
        let ends = ends.filter(|lane| lane.attributes.duties().any(|(_, duty)| duty != LaneDuty::HasRightOfWay));
        let Some((front_m, last_m)) = station_m(now.position).zip(last.and_then(station_m)) else { return false };
        let needed_m = now.speed_mps().powi(2) / (2.0 * mps2);
        ends.filter_map(|lane| station_m(*lane.centerline.0.last()?))
            .map(|line_m| line_m - half_m)
            .any(|line_m| (front_m..front_m + needed_m).contains(&line_m) && last_m <= line_m + STANDSTILL_GAP_M)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::behavior::testing::SceneSpec;
    use crate::behavior::{Behavior, EventLabel, HardBrake, NearMiss};

    const LANE: &str = "lanes = [{ id = 1, centerline = [[-100, 0], [300, 0]], width_m = 3.5 }]";

    /// A lane that ends here, where everybody stops.
    fn stop(x: f64) -> String {
        let tags = "{ 'regulatory:1' = 'role=yield;subtype=all_way_stop' }";
        format!("lanes = [{{ id = 1, centerline = [[-100, 0], [{x}, 0]], width_m = 3.5, tags = {tags} }}]")
    }

    fn car(id: &str, x: f64, speed_mps: f64, segments: &str) -> String {
        format!(
            "{{ id = '{id}', start = {{ x_m = {x}, y_m = 0, speed_mps = {speed_mps} }}, segments = [{segments}] }},"
        )
    }

    /// The explanation of the first event of these agents.
    fn explained(behavior: &dyn Behavior, agents: &[String], lanes: &str) -> Option<Explanation> {
        let spec: Result<SceneSpec, _> = toml::from_str(&format!("agents = [{}]\n{lanes}", agents.concat()));
        let scene = spec.expect("valid").build("cause");
        let events = behavior.detect(&scene);
        let event = events.iter().find(|event| event.label == EventLabel::Positive).expect("an event");
        explanation(&scene, event)
    }

    #[test]
    fn hard_brakes_have_a_cause_if_half_the_braking_would_not_do() {
        // At x = 20 with 10 m/s: half the braking takes 16.7 m, a comfortable one 25 m.
        let own = car("a", 0.0, 10.0, "{ duration_s = 2.0 }, { duration_s = 1.5, acceleration_mps2 = -6 }");
        let leader = "{ duration_s = 1.2 }, { duration_s = 2.0, acceleration_mps2 = -5 }";
        let [stop, late_stop] = [33.0, 42.0].map(stop);
        for (other, lanes, expected) in [
            (None, LANE, None),
            (Some(car("b", 36.0, 0.0, "")), LANE, Some(Cause::StandsAhead)),
            (Some(car("b", 60.0, 0.0, "")), LANE, None),
            (Some(car("b", 16.0, 10.0, leader)), LANE, Some(Cause::BrakesAhead)),
            (Some(car("b", -12.0, 10.0, "")), LANE, None),
            (None, &stop, Some(Cause::StopLine)),
            (None, &late_stop, None),
        ] {
            let agents: Vec<String> = std::iter::once(own.clone()).chain(other).collect();
            let found = explained(&HardBrake::default(), &agents, lanes);
            assert_eq!(found.map(|explanation| explanation.cause), expected, "{agents:?} {lanes}");
        }
    }

    #[test]
    fn near_misses_are_ordinary_mistakes_of_a_stated_size() {
        // 28.5 m are free at first, and comfortable braking takes 26 m with the gap: it is late from 0.25 s on, and
        // brakes at 2 s, which slopes over 0.4 s show up to 0.2 s before.
        let late = explained(
            &NearMiss::default(),
            &[
                car("a", 0.0, 10.0, "{ duration_s = 2.0 }, { duration_s = 1.58, acceleration_mps2 = -6.3 }"),
                car("b", 33.0, 0.0, ""),
            ],
            LANE,
        );
        let late = late.expect("a mistake");
        assert_eq!(late.cause, Cause::LookedTooLate);
        assert!(late.mistake_s.is_some_and(|late_s| (1.5..=1.75).contains(&late_s)), "{late:?}");
        // The same, but it gains speed.
        let gaining = "{ duration_s = 2.0, acceleration_mps2 = 0.5 }, { duration_s = 1.54, acceleration_mps2 = -6.8 }";
        let found = explained(&NearMiss::default(), &[car("a", 0.0, 9.5, gaining), car("b", 33.0, 0.0, "")], LANE);
        assert_eq!(found, None);
    }
}
