//! Reasons to brake that can be seen: a line at which to stop, somebody slower ahead, somebody who comes over close
//! ahead, and somebody ahead who brakes for one of these.

use super::driver::{SLOWER_MPS, STANDS_MPS, Travel};
use super::{Driver, Pace};
use crate::behavior::cause::{MOST_LATE_S, STANDSTILL_GAP_M, not_enough_mps2};
use crate::behavior::cut_in;
use crate::behavior::following::{Ahead, Follower};
use crate::behavior::lane_relation::SceneLanes;
use crate::behavior::limits::REACTIONS_S;
use crate::geometry::Vec2;
use crate::scene::{LaneDuty, Scene};

/// How hard the one ahead brakes, m/s², and how long before the agent behind, seconds: drivers need that long to react
/// to brake lights that they expect, or not (Green 2000), or after an ordinary glance away.
const LEADER_MPS2: [f64; 4] = [2.5, 3.5, 4.5, 6.0];
const REACTS_S: [f64; 2] = [0.75, MOST_LATE_S];
/// When it begins to brake for what is there at present, earlier by up to this, as drivers differ, seconds.
const LEADER_BEGINS_S: [f64; 4] = [0.3, 0.8, 1.3, 1.9];
const EARLIER_S: f64 = 0.3;
/// The soonest that anybody begins to brake, seconds after the present, and how many times of braking are tried.
const SOONEST_S: f64 = 0.1;
const N_BEGINS: usize = 4;
/// How soon somebody who comes over is reacted to that is in the way, seconds: by attentive drivers who expect it, or
/// after an ordinary glance away.
const SEES_S: [f64; 2] = [REACTIONS_S[1], 1.5];
/// How many ways of one agent to come over are tried.
const N_COMING_OVER: usize = 12;
/// How far ahead somebody, or a line, is looked for, meters.
const REACH_M: f64 = 60.0;

/// Agents, with their positions at present and at each timestep after it.
pub(in crate::behavior) type Others = Vec<(usize, Vec<Vec2>)>;

/// A reason to brake.
pub(in crate::behavior) struct Reason {
    what: What,
    /// When those who see it begin to brake, seconds after the present; `None` if it is there at present.
    from_s: Option<[f64; 2]>,
    /// Those who move so that there is a reason.
    pub(in crate::behavior) others: Others,
}

/// What is ahead.
enum What {
    /// A line, this far ahead of the front, meters.
    Line(f64),
    /// Somebody this far ahead of the front, meters, with the distances that it drives.
    Leader { gap_m: f64, driven_m: Vec<f64> },
}

/// How an agent brakes for a reason.
pub(in crate::behavior) struct Braking {
    pub(in crate::behavior) pace: Pace,
    pub(in crate::behavior) travel: Travel,
}

/// A way to slow down along one of the rails of an agent, and those who move so that there is a reason.
pub(in crate::behavior) struct Slowing {
    pub(in crate::behavior) rail: usize,
    pub(in crate::behavior) pace: Pace,
    pub(in crate::behavior) others: Others,
}

impl Reason {
    /// When an agent may begin to brake for it, seconds after the present; at `anyway` if it is there at present.
    pub(in crate::behavior) fn begins(&self, anyway: &[f64]) -> Vec<f64> {
        let between = |[first, last]: [f64; 2]| {
            let share = |i: usize| i as f64 / (N_BEGINS - 1) as f64;
            (0..N_BEGINS).map(|i| (first + (last - first) * share(i)).max(SOONEST_S)).collect()
        };
        self.from_s.map_or_else(|| anyway.to_vec(), between)
    }

    /// How a driver brakes for it with `mps2` from `from_s` on, down to its speed or to a stand. `None` if that is not
    /// enough, or much less would be.
    pub(in crate::behavior) fn braking(
        &self,
        driver: &Driver,
        rail: usize,
        (from_s, mps2): (f64, f64),
        dt_s: f64,
    ) -> Option<Braking> {
        let steady = Pace::steady(driver.braking_mps2().min(0.0));
        let before = driver.travel(rail, &steady);
        let begins = ((from_s / dt_s) as usize).min(before.driven_m.len().checked_sub(1)?);
        let own_mps = before.speeds_mps[begins];
        let their_mps = match &self.what {
            What::Line(_) => 0.0,
            What::Leader { driven_m, .. } => {
                driven_m[begins..].windows(2).map(|pair| (pair[1] - pair[0]) / dt_s).fold(own_mps, f64::min)
            }
        };
        // Nobody stops behind somebody that goes on.
        let goes_on = their_mps > STANDS_MPS;
        let slower = SLOWER_MPS.iter().filter(|_| goes_on);
        let slower = slower.map(|mps| steady.clone().losing(from_s, mps2, own_mps - their_mps + mps));
        let stops = (!goes_on).then(|| steady.clone().stopping(from_s, mps2, own_mps));
        let mut brakings = slower.chain(stops).map(|pace| Braking { travel: driver.travel(rail, &pace), pace });
        brakings.find(|braking| self.explains(not_enough_mps2(mps2), (begins, own_mps), &braking.travel.driven_m, dt_s))
    }

    /// Whether braking with `mps2`, after `driven_m` with this speed at timestep `begins`, is too little for it, and
    /// the planned drive is enough.
    fn explains(&self, mps2: f64, (begins, speed_mps): (usize, f64), driven_m: &[f64], dt_s: f64) -> bool {
        let braked_m = |time_s: f64| {
            let time_s = time_s.min(speed_mps / mps2);
            driven_m[begins] + speed_mps * time_s - mps2 * time_s * time_s / 2.0
        };
        let (Some(end_m), Some(last)) = (driven_m.last(), driven_m.len().checked_sub(1)) else { return false };
        match &self.what {
            What::Line(line_m) => braked_m(f64::INFINITY) > *line_m && end_m <= line_m,
            What::Leader { gap_m, driven_m: led_m } => {
                let last_mps = (led_m[last] - led_m[last - 1]) / dt_s;
                let led_m =
                    |step: usize| led_m[step.min(last)] + step.saturating_sub(last) as f64 * dt_s * last_mps + gap_m;
                let n_steps = (speed_mps / mps2 / dt_s) as usize;
                let hits = (begins..=begins + n_steps)
                    .any(|step| led_m(step) - braked_m((step - begins) as f64 * dt_s) < STANDSTILL_GAP_M);
                let mut after = driven_m.iter().enumerate().skip(begins);
                hits && after.all(|(step, own_m)| led_m(step) - own_m >= STANDSTILL_GAP_M)
            }
        }
    }
}

/// Somebody ahead in the lane, and the reasons for it to brake.
pub(in crate::behavior) struct Leader<'a> {
    scene: &'a Scene,
    ahead: Ahead,
    driver: Driver,
    reasons: Vec<Reason>,
}

impl<'a> Leader<'a> {
    /// `None` if nobody is ahead.
    pub(in crate::behavior) fn of(scene: &'a Scene, lanes: &SceneLanes<'_>, agent_idx: usize) -> Option<Self> {
        let (ahead, driver) = in_front(scene, lanes, &Follower::as_observed(scene, lanes, agent_idx)?)?;
        let reasons = in_sight(scene, lanes, ahead.agent_idx, Some(agent_idx));
        Some(Self { scene, ahead, driver, reasons })
    }

    /// The ways in which it brakes for a reason, each a reason for those behind it.
    pub(in crate::behavior) fn brakes(&self) -> Vec<Reason> {
        let begins = LEADER_BEGINS_S.map(|from_s| (from_s - EARLIER_S * self.driver.style).max(SOONEST_S));
        let tried = self.reasons.iter().flat_map(|reason| reason.begins(&begins).into_iter().map(move |s| (reason, s)));
        let tried = tried.flat_map(|(reason, from_s)| LEADER_MPS2.map(|mps2| (reason, (from_s, mps2))));
        let brakes = tried.filter_map(|(reason, (from_s, mps2))| {
            let braking = reason.braking(&self.driver, 0, (from_s, mps2), self.scene.dt_s)?;
            let mut led = driven(&self.driver, self.ahead, braking.travel);
            led.others.extend(reason.others.iter().cloned());
            Some(Reason { from_s: Some(REACTS_S.map(|reacts_s| from_s + reacts_s)), ..led })
        });
        brakes.collect()
    }
}

/// The ways in which an agent slows down for a reason that it sees; it begins at `at_s` if the reason is there at
/// present. Nobody comes over who is `but`.
pub(in crate::behavior) fn slowing(
    scene: &Scene,
    lanes: &SceneLanes<'_>,
    (agent_idx, driver): (usize, &Driver),
    at_s: f64,
    but: usize,
) -> Vec<Slowing> {
    let reasons = in_sight(scene, lanes, agent_idx, Some(but));
    let tried = reasons.iter().flat_map(|reason| (0..driver.rails.len()).map(move |rail| (reason, rail)));
    let slowing = tried.filter_map(|(reason, rail)| {
        let from_s = reason.begins(&[at_s])[0].max(SOONEST_S);
        let braking = LEADER_MPS2.iter().find_map(|mps2| reason.braking(driver, rail, (from_s, *mps2), scene.dt_s));
        Some(Slowing { rail, pace: braking?.pace, others: reason.others.clone() })
    });
    slowing.collect()
}

/// What an agent sees to brake for: lines, the one ahead as it goes on, and those who come over, but for `but`.
pub(in crate::behavior) fn in_sight(
    scene: &Scene,
    lanes: &SceneLanes<'_>,
    agent_idx: usize,
    but: Option<usize>,
) -> Vec<Reason> {
    let Some(own) = Follower::as_observed(scene, lanes, agent_idx) else { return Vec::new() };
    let front_m = scene.tracks[agent_idx].extent_or_nominal().length_m / 2.0;
    let place = scene.state(agent_idx, scene.current_timestep()).and_then(|now| own.lane.project(now.position));
    let ends = own.lane.ids().iter().filter_map(|id| lanes.get(*id)).map(|lane| lane.lane);
    let ends = ends.filter(|lane| lane.attributes.duties().any(|(_, duty)| duty != LaneDuty::HasRightOfWay));
    let ahead_m = |end: Vec2| Some(own.lane.project(end)?.station_m - place?.station_m - front_m);
    let lines = ends.filter_map(|lane| ahead_m(*lane.centerline.0.last()?)).filter(|m| (0.0..REACH_M).contains(m));
    let line = |m: f64| Reason { what: What::Line(m), from_s: None, others: Vec::new() };
    let goes_on = in_front(scene, lanes, &own).map(|(ahead, driver)| {
        let travel = driver.travel(0, &Pace::steady(driver.braking_mps2().min(0.0)));
        driven(&driver, ahead, travel)
    });
    lines.map(line).chain(goes_on).chain(coming_over(scene, &own, agent_idx, but)).collect()
}

/// The agent ahead of another, with its driver.
fn in_front(scene: &Scene, lanes: &SceneLanes<'_>, own: &Follower<'_>) -> Option<(Ahead, Driver)> {
    let ahead = *own.ahead(scene.current_timestep(), REACH_M).first()?;
    let driver = Driver::new(scene, lanes, ahead.agent_idx)?;
    (!driver.rails.is_empty()).then_some((ahead, driver))
}

/// Somebody ahead that travels like this.
fn driven(driver: &Driver, Ahead { gap_m, agent_idx, .. }: Ahead, Travel { driven_m, .. }: Travel) -> Reason {
    let others = vec![(agent_idx, driver.positions(0, &driven_m))];
    Reason { what: What::Leader { gap_m, driven_m }, from_s: None, others }
}

/// Those who can cut in before an agent such that it must brake, but for `but`.
fn coming_over(scene: &Scene, own: &Follower<'_>, agent_idx: usize, but: Option<usize>) -> Vec<Reason> {
    let Some(now) = scene.state(agent_idx, scene.current_timestep()) else { return Vec::new() };
    let length_m = |idx: usize| scene.tracks[idx].extent_or_nominal().length_m;
    let others = (0..scene.tracks.len()).filter(|idx| *idx != agent_idx && Some(*idx) != but);
    let ways = others
        .flat_map(|idx| cut_in::closing(scene, [agent_idx, idx], N_COMING_OVER).into_iter().map(move |way| (idx, way)));
    let reason = |(idx, (time_s, positions)): (usize, (f64, Vec<Vec2>))| {
        let stations: Option<Vec<f64>> = positions.iter().map(|at| Some(own.lane.project(*at)?.station_m)).collect();
        let stations = stations?;
        let gap_m =
            stations[0] - own.lane.project(now.position)?.station_m - (length_m(agent_idx) + length_m(idx)) / 2.0;
        let driven_m = stations[1..].iter().map(|station_m| station_m - stations[0]).collect();
        let from_s = Some(SEES_S.map(|sees_s| time_s + sees_s));
        Some(Reason { what: What::Leader { gap_m, driven_m }, from_s, others: vec![(idx, positions)] })
    };
    ways.filter_map(reason).collect()
}
