//! Braking hard along the lane for a reason: behind somebody ahead, who may brake first, or before a line at which to
//! stop.

use super::driver::{SLOWER_MPS, STANDS_MPS, Travel};
use super::moving_over::ways_over;
use super::{Driver, Maneuver, Pace};
use crate::behavior::cause::{MOST_LATE_S, STANDSTILL_GAP_M, not_enough_mps2};
use crate::behavior::following::{Ahead, Follower};
use crate::behavior::hard_brake::HardBrake;
use crate::behavior::lane_relation::SceneLanes;
use crate::behavior::template::InTheWay;
use crate::geometry::Vec2;
use crate::scene::{LaneDuty, Scene};
use std::ops::RangeInclusive;

/// Decelerations that are tried, above the least one of an event, because the measured one is smoothed; by how much
/// harder the firmest driver brakes; and the hardest, m/s².
const MORE_MPS2: [f64; 4] = [0.4, 1.1, 1.9, 2.8];
const HARDER_MPS2: f64 = 0.7;
const HARDEST_MPS2: f64 = 7.75;
/// When braking begins, earlier by up to this, as drivers differ, seconds.
const BEGINS_S: [f64; 6] = [0.5, 1.0, 1.5, 2.0, 2.5, 3.0];
const EARLIER_S: f64 = 0.3;
/// How hard the one ahead brakes for a reason of its own, m/s², and how long before the agent, seconds: drivers need
/// that long to react to brake lights that they expect, or not (Green 2000), or after an ordinary glance away.
const LEADER_MPS2: [f64; 3] = [3.5, 4.5, 6.0];
const REACTIONS_S: [f64; 4] = [0.75, 1.0, 1.4, MOST_LATE_S];
/// The soonest that the one ahead begins to brake, seconds after the present.
const SOONEST_S: f64 = 0.1;
/// How much slower somebody is that cuts in, m/s, and how soon after being midway between the lanes somebody is seen
/// and reacted to, seconds: a corner is in the lane half a second before.
const LEAST_CLOSING_MPS: f64 = 2.0;
const SEES_S: RangeInclusive<f64> = -0.2..=0.8;
/// How far ahead somebody, or a line, is looked for, meters.
const REACH_M: f64 = 60.0;

/// What to brake for.
enum Reason {
    /// A line, this far ahead of the front, meters.
    Line(f64),
    /// Somebody this far ahead of the front, meters, with the distances that it drives and its positions at present and
    /// at each timestep after it.
    Leader { gap_m: f64, driven_m: Vec<f64>, agent_idx: usize, positions: Vec<Vec2> },
}

impl Reason {
    /// The travel of a driver that brakes for it with `mps2` from `from_s` on, down to its speed or to a stand. `None`
    /// if that is not enough, or much less would be.
    fn braking(&self, driver: &Driver, rail: usize, (from_s, mps2): (f64, f64), dt_s: f64) -> Option<Travel> {
        let steady = Pace::steady(driver.braking_mps2().min(0.0));
        let before = driver.travel(rail, &steady);
        let begins = ((from_s / dt_s) as usize).min(before.driven_m.len().checked_sub(1)?);
        let own_mps = before.speeds_mps[begins];
        let their_mps = match self {
            Self::Line(_) => 0.0,
            Self::Leader { driven_m, .. } => {
                driven_m[begins..].windows(2).map(|pair| (pair[1] - pair[0]) / dt_s).fold(own_mps, f64::min)
            }
        };
        // Nobody stops behind somebody that goes on.
        let goes_on = their_mps > STANDS_MPS;
        let slower = SLOWER_MPS.iter().filter(|_| goes_on);
        let slower = slower.map(|mps| steady.clone().losing(from_s, mps2, own_mps - their_mps + mps));
        let stops = (!goes_on).then(|| steady.clone().then(from_s, -mps2));
        let mut travels = slower.chain(stops).map(|pace| driver.travel(rail, &pace));
        travels.find(|travel| self.explains(not_enough_mps2(mps2), (begins, own_mps), &travel.driven_m, dt_s))
    }

    /// Whether braking with `mps2`, after `driven_m` with this speed at timestep `begins`, is too little for it, and
    /// the planned drive is enough.
    fn explains(&self, mps2: f64, (begins, speed_mps): (usize, f64), driven_m: &[f64], dt_s: f64) -> bool {
        let braked_m = |time_s: f64| {
            let time_s = time_s.min(speed_mps / mps2);
            driven_m[begins] + speed_mps * time_s - mps2 * time_s * time_s / 2.0
        };
        let (Some(end_m), Some(last)) = (driven_m.last(), driven_m.len().checked_sub(1)) else { return false };
        match self {
            Self::Line(line_m) => braked_m(f64::INFINITY) > *line_m && end_m <= line_m,
            Self::Leader { gap_m, driven_m: led_m, .. } => {
                let last_mps = (led_m[last] - led_m[last - 1]) / dt_s;
                let led_m =
                    |step: usize| led_m[step.min(last)] + step.saturating_sub(last) as f64 * dt_s * last_mps + gap_m;
                let n_steps = (speed_mps / mps2 / dt_s) as usize;
                let hits = (begins..=begins + n_steps)
                    .any(|step| led_m(step) - braked_m((step - begins) as f64 * dt_s) < STANDSTILL_GAP_M);
                hits && driven_m.iter().enumerate().all(|(step, own_m)| led_m(step) - own_m >= STANDSTILL_GAP_M)
            }
        }
    }
}

impl HardBrake {
    /// Maneuvers of an agent that keeps its speed, or brakes on, and then brakes hard for a reason.
    pub(in crate::behavior) fn brakings(&self, scene: &Scene, agent_idx: usize) -> Vec<Maneuver> {
        let lanes = SceneLanes::new(&scene.lanes);
        let is_admitted = scene.tracks[agent_idx].class.is_motorized();
        let driver = is_admitted.then(|| Driver::new(scene, &lanes, agent_idx)).flatten();
        let Some(driver) = driver.filter(|driver| driver.state.speed_mps() >= self.min_speed_mps) else {
            return Vec::new();
        };
        let Some(own) = Follower::as_observed(scene, &lanes, agent_idx) else { return Vec::new() };
        let cutters = cutters(scene, &lanes, &own, agent_idx);
        let (mut maneuvers, mut unexplained) = (Vec::new(), Vec::new());
        let harder_mps2 = HARDER_MPS2 * driver.style;
        let tried = MORE_MPS2.iter().map(|more_mps2| self.min_deceleration_mps2 + more_mps2 + harder_mps2);
        for (i, deceleration_mps2) in tried.enumerate().filter(|(_, mps2)| *mps2 <= HARDEST_MPS2) {
            for from_s in BEGINS_S.map(|from_s| from_s - EARLIER_S * driver.style) {
                let [seen, unseen] = reasons(scene, &lanes, &own, agent_idx, from_s);
                let react = |midway_s: f64| SEES_S.contains(&(from_s - midway_s));
                let cut_off = cutters.iter().filter(|(midway_s, _)| react(*midway_s)).map(|(_, reason)| reason);
                let seen = seen.iter().chain(cut_off).map(|reason| (reason, true));
                let reasons: Vec<_> = seen.chain(unseen.iter().map(|reason| (reason, false))).collect();
                let tried = (0..driver.rails.len()).flat_map(|rail| reasons.iter().map(move |reason| (rail, *reason)));
                for (rail, (reason, is_seen)) in tried {
                    let braking = (from_s, deceleration_mps2);
                    let Some(travel) = reason.braking(&driver, rail, braking, scene.dt_s) else { continue };
                    let others = match reason {
                        Reason::Line(_) => Vec::new(),
                        Reason::Leader { agent_idx, positions, .. } => vec![(*agent_idx, positions.clone())],
                    };
                    let kept = if is_seen { &mut maneuvers } else { &mut unexplained };
                    kept.push(Maneuver {
                        kind: [i, (from_s * 10.0) as usize],
                        effort: deceleration_mps2 / HARDEST_MPS2,
                        parameters: &["max_deceleration_mps2"],
                        in_the_way: Some(InTheWay::Ahead),
                        positions: vec![driver.positions(rail, &travel.driven_m)],
                        others,
                    });
                }
            }
        }
        // A leader that slows down for a reason out of sight is the last resort.
        if maneuvers.is_empty() { unexplained } else { maneuvers }
    }
}

/// Those beside an agent that can move over ahead of it, with the time at which they are midway between the lanes,
/// seconds.
fn cutters(scene: &Scene, lanes: &SceneLanes<'_>, own: &Follower<'_>, agent_idx: usize) -> Vec<(f64, Reason)> {
    let state = |idx: usize| scene.state(idx, scene.current_timestep()).filter(|state| state.is_finite());
    let length_m = |idx: usize| scene.tracks[idx].extent_or_nominal().length_m;
    let Some((now, place)) = state(agent_idx).and_then(|now| Some((now, own.lane.project(now.position)?))) else {
        return Vec::new();
    };
    let beside = (0..scene.tracks.len()).filter(|idx| *idx != agent_idx && scene.tracks[*idx].class.is_motorized());
    let beside = beside.filter_map(|idx| {
        let (theirs, there) = state(idx).and_then(|theirs| Some((theirs, own.lane.project(theirs.position)?)))?;
        let gap_m = there.station_m - place.station_m - (length_m(agent_idx) + length_m(idx)) / 2.0;
        let is_slower = theirs.speed_mps() + LEAST_CLOSING_MPS < now.speed_mps();
        (is_slower && (0.0..REACH_M).contains(&gap_m) && !own.lane.holds(theirs.position)).then_some((idx, gap_m))
    });
    let ways = beside.flat_map(|(idx, gap_m)| {
        let ways = ways_over(scene, lanes, idx, 1.0).into_iter();
        let ways = ways.filter(move |way| way.has_room(scene, idx, &[agent_idx]));
        ways.filter_map(move |way| {
            let stations: Option<Vec<f64>> =
                way.positions.iter().map(|at| Some(own.lane.project(*at)?.station_m)).collect();
            let stations = stations?;
            own.lane.holds(*way.positions.last()?).then(|| {
                let driven_m = stations.iter().map(|station_m| station_m - stations[0]).collect();
                (way.midway_s, Reason::Leader { gap_m, driven_m, agent_idx: idx, positions: way.positions })
            })
        })
    });
    ways.collect()
}

/// What an agent could brake for that begins to at `from_s`: what is ahead as everybody goes on, or somebody ahead that
/// slows down as what is ahead of that one explains; and somebody that slows down as drivers do without a reason that
/// is seen.
fn reasons(
    scene: &Scene,
    lanes: &SceneLanes<'_>,
    own: &Follower<'_>,
    agent_idx: usize,
    from_s: f64,
) -> [Vec<Reason>; 2] {
    let (mut reasons, leader) = in_front(scene, lanes, own, agent_idx);
    let Some((ahead, leader)) = &leader else { return [reasons, Vec::new()] };
    let its_own = Follower::as_observed(scene, lanes, ahead.agent_idx);
    let its_reasons = its_own.map(|own| in_front(scene, lanes, &own, ahead.agent_idx).0).unwrap_or_default();
    let goes_on = Pace::steady(leader.braking_mps2().min(0.0));
    let reacted = REACTIONS_S.map(|reaction_s| from_s - reaction_s).into_iter();
    let mut unexplained = Vec::new();
    for starts_s in reacted.filter(|starts_s| *starts_s >= SOONEST_S) {
        let explained = LEADER_MPS2.into_iter().flat_map(|mps2| {
            let braking = (starts_s, mps2);
            its_reasons.iter().filter_map(move |its| its.braking(leader, 0, braking, scene.dt_s))
        });
        reasons.extend(explained.map(|travel| led(leader, *ahead, travel)));
        unexplained.extend(leader.slowing(&goes_on, starts_s).map(|pace| led(leader, *ahead, leader.travel(0, &pace))));
    }
    // Not every one slows down alike.
    let n_first = (leader.style * unexplained.len() as f64) as usize;
    unexplained.rotate_left(n_first);
    [reasons, unexplained]
}

/// The lines ahead of an agent, and the agent ahead as it goes on, with its driver.
fn in_front(
    scene: &Scene,
    lanes: &SceneLanes<'_>,
    own: &Follower<'_>,
    agent_idx: usize,
) -> (Vec<Reason>, Option<(Ahead, Driver)>) {
    let front_m = scene.tracks[agent_idx].extent_or_nominal().length_m / 2.0;
    let place = scene.state(agent_idx, scene.current_timestep()).and_then(|now| own.lane.project(now.position));
    let ends = own.lane.ids().iter().filter_map(|id| lanes.get(*id)).map(|lane| lane.lane);
    let ends = ends.filter(|lane| lane.attributes.duties().any(|(_, duty)| duty != LaneDuty::HasRightOfWay));
    let ahead_m = |end: Vec2| Some(own.lane.project(end)?.station_m - place?.station_m - front_m);
    let lines = ends.filter_map(|lane| ahead_m(*lane.centerline.0.last()?));
    let mut reasons: Vec<Reason> = lines.filter(|m| (0.0..REACH_M).contains(m)).map(Reason::Line).collect();
    let ahead = own.ahead(scene.current_timestep(), REACH_M).first().copied();
    let leader = ahead.and_then(|ahead| Some((ahead, Driver::new(scene, lanes, ahead.agent_idx)?)));
    let leader = leader.filter(|(_, leader)| !leader.rails.is_empty());
    reasons.extend(
        leader.as_ref().map(|(ahead, leader)| {
            led(leader, *ahead, leader.travel(0, &Pace::steady(leader.braking_mps2().min(0.0))))
        }),
    );
    (reasons, leader)
}

/// Somebody ahead that travels like this.
fn led(leader: &Driver, Ahead { gap_m, agent_idx, .. }: Ahead, Travel { driven_m, .. }: Travel) -> Reason {
    let positions = leader.positions(0, &driven_m);
    Reason::Leader { gap_m, driven_m, agent_idx, positions }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::behavior::Behavior;
    use crate::behavior::testing::{going_on, two_lanes};
    use crate::scene::testing::Drive;
    use std::collections::BTreeMap;

    #[test]
    fn a_driver_brakes_hard_for_somebody_slow_who_comes_over_close_ahead() {
        let hard = HardBrake::default();
        let n_with = |their_mps: f64, y: f64| {
            let drives = [Drive::straight(0.0, 0.0, 0.0, 15.0), Drive::straight(32.0, y, 0.0, their_mps)];
            let scene = going_on(&drives, two_lanes());
            let maneuvers = hard.brakings(&scene, 0);
            let comes_over = |maneuver: &&Maneuver| {
                let (agent_idx, positions) = &maneuver.others[0];
                // From the lane beside into that of the ego.
                *agent_idx == 1 && positions[0].y.abs() > 3.0 && positions.last().is_some_and(|at| at.y.abs() < 1.0)
            };
            let n_over = maneuvers.iter().filter(comes_over).count();
            assert_eq!(n_over, maneuvers.len(), "nobody else is there");
            (n_over, hard.template(&scene, &[0], &BTreeMap::new(), 0).is_some())
        };
        let (n_slow, has_template) = n_with(7.0, 3.5);
        assert!(n_slow > 0 && has_template, "{n_slow}");
        // Hardly slower, and two lanes away.
        assert_eq!([n_with(14.0, 3.5), n_with(7.0, 7.0)], [(0, false); 2]);
    }
}
