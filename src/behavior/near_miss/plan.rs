//! Near misses of two agents that continue along their lanes: solved for the time at which they would meet, and for the
//! agent that avoids it.

use super::NearMiss;
use super::body::{FOLLOWING_RAD, extents};
use super::config::MIN_SPEED_MPS;
use super::drive::Drive;
use crate::behavior::cause::{COMFORTABLE_MPS2, MOST_LATE_S};
use crate::behavior::cut_in;
use crate::behavior::footprint::Footprint;
use crate::behavior::lane_relation::SceneLanes;
use crate::behavior::limits::REACTIONS_S;
use crate::behavior::maneuver::{
    Driver, Maneuver, Others, Pace, SLOWER_MPS, STANDS_MPS, Slowing, building_up_s, slowing,
};
use crate::behavior::template::follows;
use crate::behavior::time_to_collision::time_to_collision_s;
use crate::geometry::Vec2;
use crate::scene::{Extent, Scene, State};
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::rc::Rc;

/// The times to collision at which one brakes, seconds, and the decelerations, m/s².
const BRAKES_AT_S: [f64; 5] = [0.6, 0.8, 1.0, 1.2, 1.4];
const BRAKES_MPS2: [f64; 4] = [4.5, 5.4, 6.3, 7.0];
/// The earliest time of braking after the present, seconds.
const SOONEST_S: f64 = 0.3;
/// Gas that is given, for how long, and the latest that drivers begin to slow down for what is there at present, m/s²
/// and seconds.
const GAS_MPS2: [f64; 2] = [0.6, 1.25];
const GAS_S: f64 = 3.0;
const SLOWS_S: f64 = 1.2;
/// How many ways to cut in are tried.
const N_CUTTING_IN: usize = 40;
/// Safety margin of the time to collision, seconds: the simulated drive and the template differ slightly.
const SPARE_S: f64 = 0.1;
/// Safety margin of the lateness of braking, seconds: it builds up, and leaves a gap.
const SPARE_LATE_S: f64 = 0.4;
/// How far apart the boxes stay, whether one brakes or they cross, meters.
const APART_M: f64 = 0.4;
/// The kind of maneuvers in which nobody brakes. The kind of all others is the agent that brakes (0 or 1), and how many
/// timesteps before they would meet.
const NOBODY_BRAKES: [usize; 2] = [2, 0];
/// Spacing of the timesteps that are searched for other agents in the way.
const STRIDE: usize = 2;

/// A pair, known from the past and the map.
struct Search<'a> {
    behavior: &'a NearMiss,
    scene: &'a Scene,
    agents: [usize; 2],
    drivers: [Driver; 2],
    /// The box of each, and the inner part of it.
    extents: [[Extent; 2]; 2],
    /// Other agents that may be in the way of each of the two: their boxes if they continue straight, one list per
    /// timestep.
    others: [Vec<Vec<Footprint>>; 2],
    dt_s: f64,
    /// Courses on which one brakes.
    braked: RefCell<BTreeMap<Braking, Rc<PlannedDrive>>>,
}

/// Who brakes, on which rail, at which of its paces before, and from which step on; the bits of its deceleration and of
/// the speed that it loses.
type Braking = ([usize; 4], [u64; 2]);

/// A drive, and the first step at which another agent is in the way.
struct PlannedDrive {
    /// The rail, and the pace with its number; `None` for one that cuts in.
    along: Option<(usize, (usize, Pace))>,
    /// The positions at present and at each timestep after it.
    positions: Vec<Vec2>,
    /// When the other can react to it at the soonest, seconds after the present.
    seen_s: f64,
    drive: Drive,
    clear: usize,
    /// Those who move so that there is a reason for the pace.
    others: Others,
}

impl NearMiss {
    /// Ways in which two agents may come to a near miss. Either one brakes hard, at a time to collision that is then
    /// the smallest (`min_ttc_s`), or nobody brakes and one crosses shortly after the other (`pet_s`). Until then they
    /// give gas with at most 1.25 m/s² or slow down: the one ahead of another for a reason that is seen, those who
    /// cross as drivers do without one. No other agent is in the way.
    pub(super) fn drafts(&self, scene: &Scene, agents: [usize; 2]) -> Vec<Maneuver> {
        let takes_part = |agent_idx: &usize| {
            let track = &scene.tracks[*agent_idx];
            track.class.is_road_user() && (!self.recorded_sizes || track.extent.is_some())
        };
        let search = agents.iter().all(takes_part).then(|| Search::new(self, scene, agents)).flatten();
        search.map_or_else(Vec::new, |search| search.drafts())
    }
}

impl<'a> Search<'a> {
    fn new(behavior: &'a NearMiss, scene: &'a Scene, agents: [usize; 2]) -> Option<Self> {
        let lanes = SceneLanes::new(&scene.lanes);
        let [first, second] = agents.map(|agent_idx| Driver::new(scene, &lanes, agent_idx));
        let mut drivers = [first?, second?];
        // Where no size is recorded, near misses are told by smaller boxes than templates keep apart.
        let extents = agents.map(|agent_idx| {
            let track = &scene.tracks[agent_idx];
            let [_, inner] = extents(track);
            [track.extent_or_nominal(), inner]
        });
        Driver::keep_rails_that_meet(&mut drivers, extents.map(|[outer, _]| outer));
        if drivers.iter().any(|driver| driver.rails.is_empty()) {
            return None;
        }
        let others = [&drivers[0], &drivers[1]].map(|driver| others(scene, agents, driver));
        let dt_s = scene.dt_s;
        Some(Self { behavior, scene, agents, drivers, extents, others, dt_s, braked: RefCell::default() })
    }

    fn drafts(&self) -> Vec<Maneuver> {
        let lanes = SceneLanes::new(&self.scene.lanes);
        let [own, other] =
            [&self.drivers[0].state, &self.drivers[1].state].map(|now| Vec2::from_angle(now.heading_rad));
        let follows = own.dot(other) > FOLLOWING_RAD.cos();
        let courses = [0, 1].map(|who| -> Vec<PlannedDrive> {
            let driver = &self.drivers[who];
            let (steady, slows_s) = (Pace::steady(0.0), SLOWS_S * driver.style);
            let gas = GAS_MPS2.map(|mps2| Pace::steady(mps2).then(GAS_S, 0.0));
            let crossing = driver.slowing(&steady, slows_s).into_iter().filter(|_| !follows);
            let anyway: Vec<Pace> = [steady.clone()].into_iter().chain(gas).chain(crossing).collect();
            let along =
                |rail: usize| anyway.iter().map(move |pace| Slowing { rail, pace: pace.clone(), others: Vec::new() });
            let [agent_idx, behind] = [self.agents[who], self.agents[1 - who]];
            let seen = follows.then(|| slowing(self.scene, &lanes, (agent_idx, driver), slows_s, behind));
            let all = (0..driver.rails.len()).flat_map(along).chain(seen.into_iter().flatten()).enumerate();
            let course = |(nth, Slowing { rail, pace, others }): (usize, Slowing)| {
                let effort = pace.effort();
                PlannedDrive { others, ..self.course(who, rail, (nth, pace), effort) }
            };
            let cutting_in = follows.then(|| self.cutting_in(who)).into_iter().flatten();
            all.map(course).chain(cutting_in).collect()
        });
        let mut drafts = Vec::new();
        for own in &courses[0] {
            for others in &courses[1] {
                match own.drive.meets(&others.drive) {
                    None => drafts.extend(self.crossed([own, others])),
                    Some(step) => {
                        let solved = |evader| BRAKES_AT_S.map(|at_s| self.avoided([own, others], step, evader, at_s));
                        drafts.extend([0, 1].into_iter().flat_map(solved).flatten());
                    }
                }
            }
        }
        drafts
    }

    fn course(&self, who: usize, rail: usize, pace: (usize, Pace), effort: f64) -> PlannedDrive {
        let drive = Drive::new(&self.drivers[who], rail, &pace.1, (effort, self.extents[who]));
        let positions = self.drivers[who].positions(rail, &drive.driven_m);
        self.planned(who, drive, positions, Some((rail, pace)))
    }

    /// The ways in which one of the two cuts in before the other.
    fn cutting_in(&self, who: usize) -> impl Iterator<Item = PlannedDrive> {
        let ways = cut_in::closing(self.scene, [self.agents[1 - who], self.agents[who]], N_CUTTING_IN);
        ways.into_iter().map(move |(time_s, positions)| {
            let drive = Drive::over(&positions, self.extents[who], self.dt_s);
            PlannedDrive { seen_s: time_s + REACTIONS_S[1], ..self.planned(who, drive, positions, None) }
        })
    }

    fn planned(
        &self,
        who: usize,
        drive: Drive,
        positions: Vec<Vec2>,
        along: Option<(usize, (usize, Pace))>,
    ) -> PlannedDrive {
        let steps = (0..drive.outer.len()).step_by(STRIDE);
        let is_blocked = |step: &usize| self.others[who][*step].iter().any(|other| other.overlaps(&drive.outer[*step]));
        let clear = steps.into_iter().find(is_blocked).unwrap_or(drive.outer.len());
        PlannedDrive { along, positions, seen_s: SOONEST_S, drive, clear, others: Vec::new() }
    }

    /// Two agents that would meet at `meets`; the evader brakes at a time to collision of `at_s` and avoids it. As its
    /// deceleration builds up, it begins earlier, so that it loses no distance to one that has it at once. `None` if
    /// that is not urgent, or does not help.
    fn avoided(&self, courses: [&PlannedDrive; 2], meets: usize, evader: usize, at_s: f64) -> Option<Maneuver> {
        let (own, other) = (courses[evader], courses[1 - evader]);
        let n_before = (at_s / self.dt_s).round() as usize;
        let begins = meets.checked_sub(n_before)?;
        let at_once_s = (begins + 1) as f64 * self.dt_s;
        let (rail, (nth, pace)) = own.along.as_ref()?;
        if at_once_s < other.seen_s || own.clear <= begins || other.clear < other.drive.outer.len() {
            return None;
        }
        let velocities = [own.drive.velocity(begins), other.drive.velocity(begins)];
        let straight_s =
            time_to_collision_s(&own.drive.inner[begins], velocities[0], &other.drive.inner[begins], velocities[1])?;
        let relative_mps = (velocities[0] - velocities[1]).norm();
        // Who looks too late at somebody ahead gives no gas, and looks up in time for an ordinary mistake.
        let is_behind = own.drive.outer[begins].forward.dot(other.drive.outer[begins].forward) > FOLLOWING_RAD.cos();
        let late_s = relative_mps / (2.0 * COMFORTABLE_MPS2) - at_s;
        let is_ordinary = !is_behind || (pace.at(0.0) <= 0.0 && late_s < MOST_LATE_S - SPARE_LATE_S);
        if !is_ordinary || !self.behavior.is_urgent(straight_s.max(at_s) + SPARE_S, relative_mps) {
            return None;
        }
        let own_mps = own.drive.speeds_mps[begins];
        let their_mps = other.drive.speeds_mps[begins..].iter().copied().fold(f64::INFINITY, f64::min);
        // Who brakes behind somebody that goes on lets go of the brake.
        let slower = SLOWER_MPS.iter().map(|mps| own_mps - their_mps + mps).filter(|mps| *mps < own_mps);
        let losses_mps: Vec<f64> = if is_behind && their_mps > STANDS_MPS { slower.collect() } else { vec![own_mps] };
        let tried = BRAKES_MPS2.map(|mps2| self.drivers[evader].firmly(mps2));
        let tried = tried.iter().flat_map(|mps2| losses_mps.iter().map(|loses_mps| (*mps2, *loses_mps)));
        tried.into_iter().find_map(|(deceleration_mps2, loses_mps)| {
            let building_up_s = building_up_s(pace.at(at_once_s), -deceleration_mps2);
            let from_s = (at_once_s - building_up_s / 2.0).max(SOONEST_S);
            let key = ([evader, *rail, *nth, begins], [deceleration_mps2, loses_mps].map(f64::to_bits));
            let braking = match loses_mps < own_mps {
                true => pace.clone().losing(from_s, deceleration_mps2, loses_mps),
                false => pace.clone().then(from_s, -deceleration_mps2),
            };
            let course = || PlannedDrive {
                others: own.others.clone(),
                ..self.course(evader, *rail, (*nth, braking), own.drive.effort)
            };
            let braked = Rc::clone(self.braked.borrow_mut().entry(key).or_insert_with(|| Rc::new(course())));
            let helps = braked.clear == braked.drive.outer.len() && braked.drive.keeps(&other.drive, APART_M);
            let pair = if evader == 0 { [&*braked, other] } else { [other, &*braked] };
            helps.then(|| self.draft([evader, n_before], &["min_ttc_s", "heading_difference_rad"], pair))
        })
    }

    /// Two agents that cross shortly after each other. `None` if they do not.
    fn crossed(&self, courses: [&PlannedDrive; 2]) -> Option<Maneuver> {
        let [one, other] = courses.map(|course| &course.drive);
        let n_steps = one.outer.len();
        if courses.iter().any(|course| course.clear < n_steps) {
            return None;
        }
        let most_delay = (self.behavior.max_pet_s / self.dt_s - 1e-6).floor().max(0.0) as usize;
        let pairs =
            |delay: usize| (0..n_steps.saturating_sub(delay)).flat_map(move |t| [(t, t + delay), (t + delay, t)]);
        let crosses = |(t, u): (usize, usize)| {
            one.speeds_mps[t].min(other.speeds_mps[u]) >= MIN_SPEED_MPS
                && one.inner[t].forward.dot(other.inner[u].forward) < FOLLOWING_RAD.cos()
                && one.inner[t].overlaps(&other.inner[u])
        };
        let is_crossed = (1..=most_delay).any(|delay| pairs(delay).any(crosses));
        let parameters = &["pet_s", "heading_difference_rad"];
        (is_crossed && one.keeps(other, APART_M)).then(|| self.draft(NOBODY_BRAKES, parameters, courses))
    }

    fn draft(&self, kind: [usize; 2], parameters: &'static [&'static str], courses: [&PlannedDrive; 2]) -> Maneuver {
        let effort = courses[0].drive.effort.max(courses[1].drive.effort);
        Maneuver {
            kind,
            effort,
            parameters,
            in_the_way: None,
            positions: courses.map(|course| course.positions.clone()).into(),
            others: courses.iter().flat_map(|course| course.others.iter().cloned()).collect(),
        }
    }
}

/// The boxes of all other agents at each timestep after the present, if they continue straight. Agents behind `driver`
/// are left out, because they react to it.
fn others(scene: &Scene, agents: [usize; 2], driver: &Driver) -> Vec<Vec<Footprint>> {
    let now = &driver.state;
    let tracks = scene.tracks.iter().enumerate().filter(|(idx, _)| !agents.contains(idx));
    let present = tracks.filter_map(|(_, track)| Some((track, *track.trajectory.get(scene.current_timestep())?)));
    let in_the_way: Vec<_> = present.filter(|(_, state)| state.is_finite() && !follows(state, now)).collect();
    let at = |step: usize| {
        let elapsed_s = step as f64 * scene.dt_s;
        let boxes = in_the_way.iter().map(|(track, state)| {
            let there = State { position: state.position + state.velocity * elapsed_s, ..*state };
            Footprint::new(&track.footprint(&there))
        });
        boxes.collect()
    };
    (1..=scene.n_timesteps - scene.n_history).map(at).collect()
}
