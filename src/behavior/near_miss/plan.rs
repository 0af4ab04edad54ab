//! Near misses of two agents that continue along their lanes: solved for the time at which they would meet, and for the
//! one that avoids it.

use super::NearMiss;
use super::body::{FOLLOWING_RAD, extents};
use super::drive::{Brake, Drive, Driver, ORDINARY_MPS2};
use crate::behavior::footprint::Footprint;
use crate::behavior::lane_relation::SceneLanes;
use crate::behavior::outcome::Outcome;
use crate::behavior::template::Template;
use crate::behavior::time_to_collision::time_to_collision_s;
use crate::behavior::{Behavior, BehaviorEvent, EventLabel};
use crate::geometry::Vec2;
use crate::scene::{Scene, State};
use std::collections::BTreeMap;

/// The times to collision at which one brakes, seconds, and the decelerations, m/s².
const BRAKES_AT_S: [f64; 5] = [0.6, 0.8, 1.0, 1.2, 1.4];
const BRAKES_MPS2: [f64; 2] = [5.0, 7.0];
/// The largest acceleration in any direction, m/s²: it excludes agents that leave a roundabout but would continue
/// around it, and fast bends.
const MOST_MPS2: f64 = 8.0;
/// The earliest time of braking after the present, seconds.
const SOONEST_S: f64 = 0.3;
/// Safety margin of the time to collision, seconds: the simulated drive and the template differ slightly.
const SPARE_S: f64 = 0.1;
/// How far apart the boxes stay, whether one brakes or they cross, meters.
const APART_M: f64 = 0.4;
/// How many plans of one kind are kept, and how many drafts are tried for them.
const N_ALIKE: usize = 4;
const N_TRIED: usize = 8;
/// Spacing of the timesteps at which others in the way are looked for.
const STRIDE: usize = 2;

/// The outcome of two agents, and their positions from the present on, one per timestep.
pub(super) struct NearMissPlan {
    pub(super) outcome: Outcome,
    positions: [Vec<Vec2>; 2],
}

/// A plan that was not tried yet. Plans of one kind resemble each other.
struct Draft {
    kind: Kind,
    effort: f64,
    positions: [Vec<Vec2>; 2],
}

/// The one that brakes (0 or 1), and how many timesteps before they would meet; `None` if nobody brakes.
type Kind = Option<(usize, usize)>;

/// A pair, known from the past and the map.
struct Search<'a> {
    behavior: &'a NearMiss,
    drivers: [Driver; 2],
    /// All others that may be in the way of each of the two: their boxes if they continue straight, one list per
    /// timestep.
    others: [Vec<Vec<Footprint>>; 2],
    dt_s: f64,
}

/// A drive, the rail that it follows, and the first step at which somebody else is in the way.
struct Course {
    rail: usize,
    acceleration_mps2: f64,
    drive: Drive,
    clear: usize,
}

impl NearMiss {
    /// The near misses that two agents can still reach, easiest first. Either one brakes hard, at a time to collision
    /// that is then the smallest (`min_ttc_s`), or nobody brakes and one crosses shortly after the other (`pet_s`).
    /// Until then they accelerate with at most half of -4 to 2.5 m/s², and nobody else is in the way. Each plan was
    /// checked: with the two agents alone, the event is found.
    pub(super) fn plans(&self, scene: &Scene, agents: [usize; 2]) -> Vec<NearMissPlan> {
        let config = self.config();
        let takes_part = |agent_idx: &usize| {
            let track = &scene.tracks[*agent_idx];
            config.agents.admits(track.class) && (!config.recorded_sizes || track.extent.is_some())
        };
        if !agents.iter().all(takes_part) {
            return Vec::new();
        }
        let Some(search) = Search::new(self, scene, agents) else { return Vec::new() };
        let alone = Scene { tracks: agents.map(|agent_idx| scene.tracks[agent_idx].clone()).into(), ..scene.clone() };
        let mut drafts = search.drafts();
        drafts.sort_by(|a, b| a.effort.total_cmp(&b.effort));
        let mut n_alike: BTreeMap<Kind, [usize; 2]> = BTreeMap::new();
        let tried = drafts.into_iter().filter_map(|draft| {
            let [n_tried, n_found] = n_alike.entry(draft.kind).or_default();
            if *n_tried == N_TRIED || *n_found == N_ALIKE {
                return None;
            }
            *n_tried += 1;
            let plan = self.tried(&alone, draft)?;
            *n_found += 1;
            Some(plan)
        });
        tried.collect()
    }

    /// The plan of a draft for two agents that are `alone`; `None` if it does not lead to a near miss.
    fn tried(&self, alone: &Scene, draft: Draft) -> Option<NearMissPlan> {
        let mut plan = NearMissPlan { outcome: Outcome::default().at_effort(draft.effort), positions: draft.positions };
        let mut driven = alone.clone();
        let template = plan.template(alone, [0, 1]).filter(|template| template.is_within(alone, MOST_MPS2))?;
        template.apply(&mut driven);
        // A near miss that is over at present does not count.
        let is_meant =
            |event: &BehaviorEvent| event.label == EventLabel::Positive && event.end_timestep >= alone.n_history;
        let event = self.detect(&driven).into_iter().find(is_meant)?;
        for name in [if draft.kind.is_some() { "min_ttc_s" } else { "pet_s" }, "heading_difference_rad"] {
            plan.outcome = plan.outcome.with(name, event.parameters.get(name).copied());
        }
        Some(plan)
    }
}

impl NearMissPlan {
    /// The template of both agents. `None` if one of them cannot follow it.
    pub(super) fn template(&self, scene: &Scene, agents: [usize; 2]) -> Option<Template> {
        agents.into_iter().zip(&self.positions).try_fold(Template::empty(), |template, (agent_idx, positions)| {
            template.with(scene, agent_idx, |elapsed_s| {
                let step = elapsed_s / scene.dt_s;
                let before = (step as usize).min(positions.len() - 1);
                let after = (before + 1).min(positions.len() - 1);
                Some(positions[before].lerp(positions[after], step - before as f64))
            })
        })
    }
}

impl<'a> Search<'a> {
    fn new(behavior: &'a NearMiss, scene: &Scene, agents: [usize; 2]) -> Option<Self> {
        let lanes = SceneLanes::new(&scene.lanes);
        let driver = |agent_idx: usize| {
            let extents = extents(&scene.tracks[agent_idx], behavior.config());
            Driver::new(scene, &lanes, agent_idx, extents)
        };
        let [first, second] = agents.map(driver);
        let drivers = [first?, second?];
        let others = [&drivers[0], &drivers[1]].map(|driver| others(scene, agents, driver));
        Some(Self { behavior, drivers, others, dt_s: scene.dt_s })
    }

    fn drafts(&self) -> Vec<Draft> {
        let courses = [0, 1].map(|who| -> Vec<Course> {
            let rails = 0..self.drivers[who].rails.len();
            let tried = rails.flat_map(|rail| ORDINARY_MPS2.map(|acceleration_mps2| (rail, acceleration_mps2)));
            tried.map(|(rail, acceleration_mps2)| self.course(who, rail, acceleration_mps2, None)).collect()
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

    fn course(&self, who: usize, rail: usize, acceleration_mps2: f64, brake: Option<Brake>) -> Course {
        let drive = self.drivers[who].drive(rail, acceleration_mps2, brake);
        let steps = (0..drive.outer.len()).step_by(STRIDE);
        let is_blocked = |step: &usize| self.others[who][*step].iter().any(|other| other.overlaps(&drive.outer[*step]));
        let clear = steps.into_iter().find(is_blocked).unwrap_or(drive.outer.len());
        Course { rail, acceleration_mps2, drive, clear }
    }

    /// Two agents that would meet at `meets`; the evader brakes at a time to collision of `at_s` and avoids it. `None`
    /// if that is not urgent, or does not help.
    fn avoided(&self, courses: [&Course; 2], meets: usize, evader: usize, at_s: f64) -> Option<Draft> {
        let (own, other) = (courses[evader], courses[1 - evader]);
        let n_before = (at_s / self.dt_s).round() as usize;
        let begins = meets.checked_sub(n_before)?;
        let from_s = (begins + 1) as f64 * self.dt_s;
        if from_s < SOONEST_S || own.clear <= begins || other.clear < other.drive.outer.len() {
            return None;
        }
        let velocities = [own.drive.velocity(begins), other.drive.velocity(begins)];
        let straight_s =
            time_to_collision_s(&own.drive.inner[begins], velocities[0], &other.drive.inner[begins], velocities[1])?;
        let relative_mps = (velocities[0] - velocities[1]).norm();
        if !self.behavior.config().is_urgent(straight_s.max(at_s) + SPARE_S, relative_mps) {
            return None;
        }
        BRAKES_MPS2.into_iter().find_map(|deceleration_mps2| {
            let brake = Some(Brake { from_s, deceleration_mps2 });
            let braked = self.course(evader, own.rail, own.acceleration_mps2, brake);
            let helps = braked.clear == braked.drive.outer.len() && braked.drive.keeps(&other.drive, APART_M);
            let pair = if evader == 0 { [&braked, other] } else { [other, &braked] };
            helps.then(|| self.draft(Some((evader, n_before)), pair))
        })
    }

    /// Two agents that cross shortly after each other. `None` if they do not.
    fn crossed(&self, courses: [&Course; 2]) -> Option<Draft> {
        let config = self.behavior.config();
        let [one, other] = courses.map(|course| &course.drive);
        let n_steps = one.outer.len();
        if courses.iter().any(|course| course.clear < n_steps) {
            return None;
        }
        let most_delay = (config.max_pet_s / self.dt_s - 1e-6).floor().max(0.0) as usize;
        let pairs =
            |delay: usize| (0..n_steps.saturating_sub(delay)).flat_map(move |t| [(t, t + delay), (t + delay, t)]);
        let crosses = |(t, u): (usize, usize)| {
            one.speeds_mps[t].min(other.speeds_mps[u]) >= config.min_speed_mps
                && one.inner[t].forward.dot(other.inner[u].forward) < FOLLOWING_RAD.cos()
                && one.inner[t].overlaps(&other.inner[u])
        };
        let is_crossed = (1..=most_delay).any(|delay| pairs(delay).any(crosses));
        (is_crossed && one.keeps(other, APART_M)).then(|| self.draft(None, courses))
    }

    fn draft(&self, kind: Kind, courses: [&Course; 2]) -> Draft {
        let positions = |who: usize| self.drivers[who].positions(courses[who].rail, &courses[who].drive);
        let effort = courses[0].drive.effort.max(courses[1].drive.effort);
        Draft { kind, effort, positions: [0, 1].map(positions) }
    }
}

/// The boxes of all others at each timestep after the present, if they continue straight. Agents behind `driver` are
/// left out, because they react to it.
fn others(scene: &Scene, agents: [usize; 2], driver: &Driver) -> Vec<Vec<Footprint>> {
    let now = &driver.state;
    let forward = Vec2::from_angle(now.heading_rad);
    let is_behind = |state: &State| {
        (state.position - now.position).dot(forward) < 0.0 && Vec2::from_angle(state.heading_rad).dot(forward) > 0.0
    };
    let tracks = scene.tracks.iter().enumerate().filter(|(idx, _)| !agents.contains(idx));
    let present = tracks.filter_map(|(_, track)| Some((track, *track.trajectory.get(scene.current_timestep())?)));
    let in_the_way: Vec<_> = present.filter(|(_, state)| state.is_finite() && !is_behind(state)).collect();
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
